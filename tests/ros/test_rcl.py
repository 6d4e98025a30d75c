"""Compiled code talks through rcl where that is as it must be, and rclpy does where it is not."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import signal
import subprocess
import sys
import threading
import time
import types

import numba
import numpy as np
import pytest
from domains import DOMAINS
from geometry_msgs.msg import PoseStamped, WrenchStamped
from processes import python
from rclpy.serialization import serialize_message
from ros_helpers import REPOSITORY, TIMEOUT, Client, environment

from finger_sim.errors import FingerSimError
from finger_sim.physics.compile import kernel
from finger_sim.physics.records import held
from finger_sim.ros import endpoints as ends
from finger_sim.ros import rcl, rclpy_private, wire
from finger_sim.ros.endpoints import Endpoints
from finger_sim.ros.memory import bytes_at
from finger_sim.ros.messages import pose_template, wrench_template
from finger_sim.ros.pose_bytes import LOOK, frame_bytes, read_pose

NUMBERS = itertools.count()
"""Of topics."""


@kernel
def fill_and_publish(outgoing, k, time, numbers):
    wire.fill(outgoing, k, time, numbers)
    return wire.publish(outgoing, k)


@kernel
def stream(outgoing, period, clock, counts):
    """Publishes message 0 every `period` [ns] until counts[0] is set; counts[1] were sent, counts[2] failed."""
    due = wire.steady_ns(clock)
    while counts[0] == 0:
        due += period
        wire.sleep_until(clock, due)
        if wire.publish(outgoing, 0) == 0:
            counts[1] += 1
        else:
            counts[2] += 1


@kernel
def hear(incoming, frame, pose, received):
    length = wire.take(incoming, 0)
    if length < 0:
        return length
    received[0] = incoming.infos[0, wire.RECEIVED]
    data = bytes_at(incoming.messages[0, wire.ADDRESS], incoming.messages[0, wire.LENGTH])
    return read_pose(data, frame, pose)


class Streaming:
    """`stream` in a thread of its own."""

    def __init__(self, endpoints, period):
        self.counts = np.zeros(3, np.int64)
        arguments = (held(endpoints.outgoing), period, held(rcl.clock()), self.counts)
        self._thread = threading.Thread(target=stream, args=arguments)
        self._thread.start()

    def __enter__(self):
        return self.counts

    def __exit__(self, *_):
        self.counts[0] = 1
        self._thread.join()


@pytest.fixture(scope="module")
def client():
    with Client(next(DOMAINS)) as client:
        yield client


@pytest.fixture
def pair(client):
    """A publisher and a raw subscription of poses on a topic of their own, which know each other."""
    topic = f"poses_{next(NUMBERS)}"
    publisher = client.node.create_publisher(PoseStamped, topic, 1000)
    subscription = client.node.create_subscription(PoseStamped, topic, lambda _: None, 1000, raw=True)
    client.executor.remove_node(client.node)  # it would take what comes
    client.until(lambda: publisher.get_subscription_count() == 1 and client.node.count_publishers(topic) == 1)
    yield publisher, subscription
    client.node.destroy_publisher(publisher)
    client.node.destroy_subscription(subscription)
    client.executor.add_node(client.node)


def next_of(client, endpoints, k=0):
    return client.until(lambda: endpoints.take(k))


def pose(frame_id, sec=0, nanosec=0, values=(0.0,) * 6 + (1.0,)):
    message = PoseStamped()
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = (float(value) for value in values)
    return message


def wrench(frame_id, sec, nanosec, values):
    message = WrenchStamped()
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    f, t = message.wrench.force, message.wrench.torque
    f.x, f.y, f.z, t.x, t.y, t.z = (float(value) for value in values)
    return message


def test_what_compiled_code_sends_arrives_as_rclpy_would_have_serialised_it(client):
    """Wrenches and poses of three templates, filled and published in turn: every byte, in order, none lost.

    The frames' names are as long as leaves no gap behind them, where rclpy's bytes are what was there before.
    """
    got = {"wrench": [], "other": [], "pose": []}
    kinds = {"wrench": (WrenchStamped, "tip"), "other": (WrenchStamped, "a_long_name"), "pose": (PoseStamped, "map")}
    outgoing, subscriptions = [], []
    for topic, (kind, frame) in kinds.items():
        publisher = client.node.create_publisher(kind, topic, 1000)
        subscriptions.append(client.node.create_subscription(kind, topic, got[topic].append, 1000, raw=True))
        outgoing.append((publisher, pose_template(frame) if kind is PoseStamped else wrench_template(frame)))
    client.until(lambda: all(publisher.get_subscription_count() for publisher, _ in outgoing))
    endpoints = Endpoints(outgoing)
    assert endpoints.lack == ""
    sender = held(endpoints.outgoing)
    expected = {topic: [] for topic in kinds}
    random = np.random.default_rng(1)
    for number in range(300):
        topic = list(kinds)[k := number % 3]
        sec, nanosec = int(random.integers(2**31)), int(random.integers(10**9))
        values = random.normal(size=7 if topic == "pose" else 6) * 10.0 ** random.integers(-9, 9)
        assert fill_and_publish(sender, k, sec * 10**9 + nanosec, values) == 0
        make = pose if topic == "pose" else wrench
        expected[topic].append(bytes(serialize_message(make(kinds[topic][1], sec, nanosec, values))))
    client.until(lambda: sum(map(len, got.values())) == 300)
    assert {topic: [bytes(data) for data in messages] for topic, messages in got.items()} == expected
    endpoints.release()


@pytest.mark.parametrize("switch", ["1", "0"])
def test_what_rclpy_sends_is_taken_whole(client, pair, monkeypatch, switch):
    """By rcl and by rclpy: also messages that are longer than there is room, with the times of sending and receipt."""
    monkeypatch.setenv(rcl.SWITCH, switch)
    publisher, subscription = pair
    endpoints = Endpoints([], [subscription])
    assert (endpoints.lack == "") == (switch == "1")
    for size in (0, 5, ends.ROOM, 3, 20_000, 1_000_000, 7):
        data = bytes(serialize_message(pose("x" * size, sec=size)))
        before = time.time_ns()
        publisher.publish(data)
        taken = next_of(client, endpoints)
        assert taken.data == data
        assert before <= taken.sent <= taken.received <= time.time_ns()
        assert endpoints.take(0) is None
    for number in range(1000):
        publisher.publish(bytes(serialize_message(pose("world", sec=number))))
    for number in range(1000):
        assert next_of(client, endpoints).data == bytes(serialize_message(pose("world", sec=number)))
    endpoints.release()


def test_compiled_code_hears_commands(client, pair):
    """Poses in their order with stamp and time of receipt; what it does not take Python can look at."""
    publisher, subscription = pair
    endpoints = Endpoints([], [subscription])
    heard, received = np.zeros(7), np.zeros(1, np.int64)
    arguments = (held(endpoints.incoming), frame_bytes("world"), heard, received)
    assert hear(*arguments) == wire.NOTHING
    for number in range(50):
        values = np.random.default_rng(number).normal(size=7)
        values[3:] /= np.linalg.norm(values[3:])
        good, other = (bytes(serialize_message(pose(frame, 5, number, values))) for frame in ("world", "w" * number))
        before = time.time_ns()
        publisher.publish(good)
        publisher.publish(other)
        assert client.until(lambda: (stamp := hear(*arguments)) != wire.NOTHING and stamp) == 5_000_000_000 + number
        np.testing.assert_allclose(heard, values, rtol=1e-15)
        assert before <= received[0] <= time.time_ns()
        assert client.until(lambda: (stamp := hear(*arguments)) != wire.NOTHING and stamp) == LOOK
        assert endpoints.taken(0).data == other
        assert hear(*arguments) == wire.NOTHING
    endpoints.release()


def round_trip(client, publisher, endpoints, template, number):
    """What is sent by `send` is what `take` gives."""
    data = template.fill(number, np.arange(7.0).tobytes())
    endpoints.send(0)
    taken = next_of(client, endpoints)
    assert taken.data == data
    assert abs(time.time_ns() - taken.received) < 60_000_000_000


class Changed:
    """A library with other functions in place of some of its own; None: it has none of that name."""

    def __init__(self, library, **functions):
        self._library, self._functions = library, functions

    def __getattr__(self, name):
        function = self._functions.get(name, 0)
        if function is None:
            raise AttributeError(name)
        return function or getattr(self._library, name)


def array_of(address, words):
    return np.ctypeslib.as_array((ctypes.c_int64 * words).from_address(address))


def changed_init(change):
    """rcutils_uint8_array_init, after which `change` is made to the first twelve words from its array on."""
    real = ctypes.CDLL("librcutils.so").rcutils_uint8_array_init
    real.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)

    def init(message, capacity, allocator):
        code = real(message, capacity, allocator)
        return change(array_of(message, 12)) or code

    return ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)(init)


def shift(words):
    """As if the length came before the address."""
    words[:2] = words[1], words[0]


def swap_length_and_capacity(words):
    words[1:3] = words[2], words[1]


def shorten_allocator(words):
    words[6:8] = words[7], wire.GUARDED


def lengthen(words):
    words[8] = 0


def begin_with_something(words):
    words[1] = 7


def have_no_bytes(words):
    words[0] = 0


def leave_the_address(words):
    words[0] = wire.GUARDED


def fail(words):
    return 10


def keep_address(message):
    return 0


FUNCTIONS = {
    "librcl.so": ("rcl_publish_serialized_message", "rcl_take_serialized_message"),
    "librcutils.so": (
        "rcutils_reset_error",
        "rcutils_uint8_array_init",
        "rcutils_uint8_array_fini",
        "rcutils_get_default_allocator",
    ),
}


def lacking(name):
    return lambda monkeypatch: put(monkeypatch, **{name: None})


def put(monkeypatch, **functions):
    """Other functions in the libraries."""
    loaded = rcl._loaded
    monkeypatch.setattr(rcl, "_loaded", lambda name: Changed(loaded(name), **functions))


def with_init(change):
    return lambda monkeypatch: put(monkeypatch, rcutils_uint8_array_init=changed_init(change))


def with_another_allocator(monkeypatch):
    put(monkeypatch, rcutils_get_default_allocator=ctypes.CDLL("librcutils.so").rcutils_get_zero_initialized_allocator)


def with_another_fini(monkeypatch):
    put(monkeypatch, rcutils_uint8_array_fini=ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(keep_address))


def without_libraries(monkeypatch):
    loaded = rcl._loaded
    monkeypatch.setattr(rcl, "_loaded", lambda name: loaded(f"no_{name}"))


def on_another_machine(monkeypatch):
    monkeypatch.setattr(sys, "byteorder", "big")


def switched_off(monkeypatch):
    monkeypatch.setenv(rcl.SWITCH, "0")


class NoPointer:
    """A publisher whose handle does not tell its address."""

    def __init__(self, publisher):
        self._publisher = publisher
        self.handle = contextlib.nullcontext()

    def __getattr__(self, name):
        return getattr(self._publisher, name)


def without_pointer(monkeypatch):
    held_address = rclpy_private.held_address

    def changed(entity, keep):
        return held_address(NoPointer(entity), keep)

    monkeypatch.setattr(rclpy_private, "held_address", changed)


UNFIT = {
    "rclpy has not loaded no_librcl.so": without_libraries,
    "no little-endian machine": on_another_machine,
    "FINGER_SIM_RCL=0": switched_off,
    "has no NoPointer.handle.pointer, which": without_pointer,
    "rcutils_get_default_allocator gives no four functions": with_another_allocator,
    "rcutils_uint8_array_fini leaves": with_another_fini,
    "rcutils_uint8_array_init gives rcl's code 10 (no memory) for 12345 bytes": with_init(fail),
    **{f"no function {name}": lacking(name) for names in FUNCTIONS.values() for name in names},
}
"""What is wrong, by a part of what is said of it."""
CHANGES = (
    shift,
    swap_length_and_capacity,
    shorten_allocator,
    lengthen,
    begin_with_something,
    have_no_bytes,
    leave_the_address,
)
STRUCTURE = "rcutils_uint8_array_t is another structure"


@pytest.mark.parametrize(
    ("said", "make_unfit"), [*UNFIT.items(), *((STRUCTURE, with_init(change)) for change in CHANGES)]
)
def test_where_anything_is_not_as_it_must_be_rclpy_does_it(client, pair, monkeypatch, said, make_unfit):
    """The reason is told, nothing is kept from ending, and messages come and go."""
    make_unfit(monkeypatch)
    publisher, subscription = pair
    template = pose_template("world")
    endpoints = Endpoints([(publisher, template)], [subscription])
    assert said in endpoints.lack
    assert endpoints.outgoing.publish == endpoints.incoming.take == 0
    for number in range(3):
        round_trip(client, publisher, endpoints, template, number)
    endpoints.release()


def test_where_all_is_as_it_must_be_rcl_does_it(client, pair):
    publisher, subscription = pair
    template = pose_template("world")
    endpoints = Endpoints([(publisher, template)], [subscription])
    assert endpoints.lack == ""
    for number in range(3):
        round_trip(client, publisher, endpoints, template, number)
        assert endpoints.incoming.fits[0] == 1
    endpoints.release()


def test_what_was_sent_is_waited_for(client, pair):
    """Until a reliable reader has it; where the publisher is gone nothing is."""
    publisher, subscription = pair
    endpoints = Endpoints([(publisher, pose_template("world"))], [subscription])
    assert endpoints.delivered(0.0)
    endpoints.send(0)
    assert endpoints.delivered(10.0)
    assert endpoints.take(0) is not None
    endpoints.release()
    client.node.destroy_publisher(publisher)
    assert not endpoints.delivered(10.0)


VERSION = "<package><name>rcl</name>\n <version>{}</version></package>"


@pytest.mark.parametrize(
    ("text", "fits"),
    [
        (VERSION.format("9.2.0"), True),
        (VERSION.format(" 9.2.17 "), True),
        (VERSION.format("9.3.0"), False),
        (VERSION.format("10.1.2"), False),
        (VERSION.format("9.20.0"), False),
        ("<package/>", True),
        (None, True),
    ],
)
def test_versions(tmp_path, monkeypatch, text, fits):
    """Of another one than Jazzy's nothing is used; one that cannot be read is not asked for."""
    library = tmp_path / "ros" / "lib" / "librcl.so"
    monkeypatch.setattr(rcl, "_file_of", lambda address: library)
    if text is not None:
        package = tmp_path / "ros" / "share" / "rcl" / "package.xml"
        package.parent.mkdir(parents=True)
        package.write_text(text)
    if fits:
        assert rcl.find().publish
    else:
        with pytest.raises(rcl.UnfitError, match=r"must be 9\.2"):
            rcl.find()


def test_the_version_is_that_of_the_loaded_library():
    """Its file is found by the address of a function in it, and its package.xml beside it."""
    file = rcl._file_of(rcl.find().publish)
    assert file.name == "librcl.so"
    assert (file.parents[1] / "share" / "rcl" / "package.xml").is_file()
    assert rcl._file_of(8).name == ""


def test_no_library_is_loaded_beside_those_of_rclpy():
    """Where rclpy has not been imported there is none."""
    code = "from finger_sim.ros import rcl\ntry: rcl.find()\nexcept rcl.UnfitError as error: print(error)"
    assert python(code) == "rclpy has not loaded librcl.so\n"


def changed_take(change):
    """rcl_take_serialized_message, after which `change` is made to the information and a word behind it."""
    real = ctypes.CDLL("librcl.so").rcl_take_serialized_message
    real.argtypes = (ctypes.c_void_p,) * 4

    def take(subscription, message, info, allocation):
        code = real(subscription, message, info, allocation)
        if code == 0:
            change(array_of(info, 9))
        return code

    return ctypes.CFUNCTYPE(ctypes.c_int, *(ctypes.c_void_p,) * 4)(take)


def receive_later(words):
    words[1] += 10_000_000_000


def receive_long_ago(words):
    words[1] -= 86_400_000_000_000


def receive_never(words):
    words[1] = 0


def swap_with_number(words):
    words[1:3] = words[2], words[1]


def send_before_all_times(words):
    words[0] = -1


def tell_more(words):
    words[8] = 0


@pytest.mark.parametrize(
    "change", [receive_later, receive_long_ago, receive_never, swap_with_number, send_before_all_times, tell_more]
)
def test_the_first_message_shows_what_is_told_of_it(client, pair, monkeypatch, change):
    """It is not lost; from then on rclpy does it, and the reason is told."""
    put(monkeypatch, rcl_take_serialized_message=changed_take(change))
    publisher, subscription = pair
    template = pose_template("world")
    endpoints = Endpoints([(publisher, template)], [subscription])
    assert endpoints.lack == ""
    for number in range(3):
        round_trip(client, publisher, endpoints, template, number)
        assert "rmw_message_info_t is another structure: 0x" in endpoints.lack
    endpoints.release()


def test_what_is_told_is_looked_at_once(client, pair, monkeypatch):
    """A wall clock that is set later does not change the way."""
    when = types.SimpleNamespace(late=False)

    def change(words):
        if when.late:
            receive_long_ago(words)

    put(monkeypatch, rcl_take_serialized_message=changed_take(change))
    publisher, subscription = pair
    template = pose_template("world")
    endpoints = Endpoints([(publisher, template)], [subscription])
    round_trip(client, publisher, endpoints, template, 0)
    when.late = True
    endpoints.send(0)
    assert time.time_ns() - next_of(client, endpoints).received > 80_000_000_000_000
    assert endpoints.lack == ""
    endpoints.release()


@pytest.mark.parametrize("switch", ["1", "0"])
def test_handles_last_until_they_are_released(client, monkeypatch, switch):
    """Compiled code sends and takes after publisher and subscription are destroyed; then all fails cleanly."""
    monkeypatch.setenv(rcl.SWITCH, switch)
    publisher = client.node.create_publisher(PoseStamped, "lasting", 10)
    subscription = client.node.create_subscription(PoseStamped, "lasting", lambda _: None, 10, raw=True)
    client.until(lambda: publisher.get_subscription_count() == 1)
    template = pose_template("world")
    endpoints = Endpoints([(publisher, template)], [subscription])
    client.node.destroy_publisher(publisher)
    client.node.destroy_subscription(subscription)
    if switch == "1":
        for number in range(3):
            round_trip(client, publisher, endpoints, template, number)
        assert client.node.count_publishers("lasting") == 1
        outgoing, incoming = endpoints.outgoing, endpoints.incoming
        endpoints.release()
        for words in (outgoing.publishers, incoming.subscriptions, incoming.messages):
            assert not words.any()
    client.until(lambda: client.node.count_publishers("lasting") == client.node.count_subscribers("lasting") == 0)
    for _ in range(2):
        with pytest.raises(FingerSimError, match="lasting: cannot be sent: "):
            endpoints.send(0)
        with pytest.raises(FingerSimError, match="lasting: cannot be heard: "):
            endpoints.take(0)
        endpoints.release()


def test_records_of_forgotten_endpoints_are_empty(client, pair):
    """Who keeps the record and not the Endpoints has no address of what may have ended."""
    publisher, _ = pair
    endpoints = Endpoints([(publisher, pose_template("world"))])
    outgoing = endpoints.outgoing
    assert outgoing.publishers.all()
    del endpoints
    assert not outgoing.publishers.any()
    assert wire.publish(held(outgoing), 0) == 300


CHURN = """
import itertools, sys
import rclpy
from geometry_msgs.msg import PoseStamped
from finger_sim.ros.endpoints import Endpoints
from finger_sim.ros.messages import pose_template

def destroy_both(): node.destroy_publisher(publisher), node.destroy_subscription(subscription)
def release(): endpoints.release()
def forget(): globals().update(endpoints=None)
def forget_all(): globals().update(endpoints=None, publisher=None, subscription=None)
def use():
    endpoints.send(0)
    while endpoints.take(0) is not None: pass
def destroy_node(): node.destroy_node()
def shut_down(): rclpy.shutdown(context=context)

ORDERS = [(use, release, destroy_both), (destroy_both, use, release), (use, destroy_both, forget),
          (release, destroy_both)]
LAST = [(use, destroy_node, use, release, shut_down), (use, shut_down, release, destroy_node),
        (use, release, shut_down, destroy_node), (destroy_node, shut_down, forget), (shut_down, forget_all),
        (use, destroy_both, destroy_node, shut_down, release)]
count, kept = int(sys.argv[1]), pose_template("world")
for number, last in zip(range(count // 50), itertools.cycle(LAST)):
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("churn", context=context, enable_rosout=False, start_parameter_services=False)
    for order in [*itertools.islice(itertools.cycle(ORDERS), 49), last]:
        publisher = node.create_publisher(PoseStamped, "poses", 10)
        subscription = node.create_subscription(PoseStamped, "poses", lambda _: None, 10, raw=True)
        endpoints = Endpoints([(publisher, kept)], [subscription])
        assert endpoints.lack == "", endpoints.lack
        for step in order:
            step()
context = rclpy.Context()
rclpy.init(context=context)
node = rclpy.create_node("churn", context=context)
publisher = node.create_publisher(PoseStamped, "poses", 10)
subscription = node.create_subscription(PoseStamped, "poses", lambda _: None, 10, raw=True)
endpoints = Endpoints([(publisher, kept)], [subscription])
use()
print("the end, with all still held")
"""


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=[pytest.mark.slow, pytest.mark.timeout(1200)])])
def test_whatever_ends_first_nothing_crashes(count):
    """Publishers and subscriptions, made and ended in every order with their node and context; and a process's end."""
    done = subprocess.run(
        [sys.executable, "-c", CHURN, str(count)],
        env=environment(next(DOMAINS)),
        capture_output=True,
        text=True,
        timeout=1200,
        cwd=REPOSITORY / "tests",
    )
    assert (done.returncode, done.stdout) == (0, "the end, with all still held\n"), done.stderr[-3000:]


LISTENER = """
import sys, rclpy
from geometry_msgs.msg import WrenchStamped
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(WrenchStamped, "stream", lambda data: print(data.hex(), flush=True), 10, raw=True)
rclpy.spin(node)
"""


@pytest.mark.slow
def test_a_listener_that_is_killed_disturbs_nobody():
    """Compiled code goes on publishing to one that is suddenly gone, and to another that comes then."""
    domain = next(DOMAINS)
    with Client(domain) as client, contextlib.ExitStack() as end:
        publisher = client.node.create_publisher(WrenchStamped, "stream", 10)
        template = wrench_template("finger")
        endpoints = Endpoints([(publisher, template)])
        end.callback(endpoints.release)
        counts = end.enter_context(Streaming(endpoints, 1_000_000))
        for _ in range(2):
            listener = subprocess.Popen(
                [sys.executable, "-c", LISTENER], env=environment(domain), stdout=subprocess.PIPE, text=True
            )
            end.callback(listener.wait, TIMEOUT)
            end.callback(listener.kill)
            for _ in range(20):
                assert listener.stdout.readline().strip() == template.bytes.tobytes().hex()
            listener.send_signal(signal.SIGKILL)
            sent = counts[1]
            client.until(lambda sent=sent: counts[1] > sent + 1000)
        assert counts[2] == 0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="only compiled code does without the interpreter")
def test_compiled_code_does_without_the_interpreter(client, pair):
    """A thread that does not give the interpreter up sees hundreds of messages sent meanwhile."""
    endpoints = Endpoints([(pair[0], pose_template("world"))])
    interval = sys.getswitchinterval()
    with Streaming(endpoints, 100_000) as counts:
        client.until(lambda: counts[1] > 0)
        try:
            sys.setswitchinterval(1e6)
            begin, turns = counts[1], 0
            while counts[1] < begin + 300:
                turns += 1
                assert turns < 10**9
        finally:
            sys.setswitchinterval(interval)
    assert counts[2] == 0
    endpoints.release()


UNCOMPILED = """
import time
import numpy as np, rclpy
from geometry_msgs.msg import PoseStamped
from finger_sim.ros import wire
from finger_sim.ros.endpoints import Endpoints
from finger_sim.ros.messages import pose_template
rclpy.init()
node = rclpy.create_node("uncompiled")
publisher = node.create_publisher(PoseStamped, "poses", 10)
subscription = node.create_subscription(PoseStamped, "poses", lambda _: None, 10, raw=True)
while not publisher.get_subscription_count():
    time.sleep(0.01)
template = pose_template("world")
endpoints = Endpoints([(publisher, template)], [subscription])
wire.fill(endpoints.outgoing, 0, 5_000_000_006, np.arange(7.0))
endpoints.send(0)
while (taken := endpoints.take(0)) is None:
    time.sleep(0.01)
assert taken.data == template.fill(5_000_000_006, np.arange(7.0).tobytes())
assert endpoints.take(0) is None
print(endpoints.lack or "rcl")
endpoints.release()
"""


def test_uncompiled_it_is_rcl_too():
    """NUMBA_DISABLE_JIT=1 calls the same functions of rcl."""
    assert python(UNCOMPILED, NUMBA_DISABLE_JIT="1", ROS_DOMAIN_ID=str(next(DOMAINS))) == "rcl\n"

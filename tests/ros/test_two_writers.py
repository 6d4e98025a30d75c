"""A loop in compiled code and Python's threads record at the same time: nothing is lost, torn or out of order."""

from __future__ import annotations

import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from mcap.reader import make_reader
from processes import REPOSITORY
from recorder_helpers import TOPICS, WRENCH, Disk, sequences, until

from finger_sim.bags import recording
from finger_sim.bags.reader import BagReader
from finger_sim.physics.atomics import load_acquire, store_release
from finger_sim.physics.compile import kernel
from finger_sim.physics.records import held
from finger_sim.ros import recorder as recorders
from finger_sim.ros.recorder import Recorder

BYTES = np.frombuffer(WRENCH, np.uint8)
CAPACITY = 1000
MESSAGES = 10_000
"""Of each writer, twice."""
LEAD = 200


@pytest.fixture
def disk(tmp_path):
    disk = Disk(tmp_path)
    yield disk
    disk.standby.end()


@kernel
def put_all(handle, data, steady, taken, python):
    """A message for each place of `taken`, that tells how many came before it; whether it was taken.

    python : (1,) how many Python has put meanwhile; none is LEAD before the other
    """
    for k in range(taken.shape[0]):
        while load_acquire(python, 0) < k - LEAD:
            pass
        for i in range(8):
            data[8 + i] = handle.sequence[0] >> (8 * i) & 255
        taken[k] = recording.put(handle, 0, steady + k, data, data.shape[0])


def numbered(count):
    """A message that tells how many came before it."""
    return WRENCH[:8] + count.to_bytes(8, "little") + WRENCH[16:]


def numbers(taken):
    """Sequence numbers of the messages that were taken."""
    return [k for k, was in enumerate(taken, 1) if was]


def test_two_writers_and_a_process_that_stalls(disk):
    """While it takes nothing, so many messages as may wait are taken of both together; later those that find room.

    Each one that was taken is in the bag, once, whole, in its topic's order; the others are counted, and leave gaps.
    """
    recorder = disk.record(CAPACITY)
    handle, data = held(recorder.loop), BYTES.copy()
    of_loop, of_python = np.zeros(0, bool), []

    def put():
        of_python.append(recorder.put("/b", numbered(len(of_python)), recorder.began + len(of_python)))
        return of_python[-1]

    def both():
        nonlocal of_loop
        taken, python = np.zeros(MESSAGES, bool), np.zeros(1, np.int64)
        with ThreadPoolExecutor(1) as threads:
            thread = threads.submit(put_all, handle, data, recorder.began + len(of_loop), taken, python)
            for k in range(MESSAGES):
                while recorder.loop.sequence[0] < len(of_loop) + k - LEAD:
                    assert not thread.done()
                put()
                store_release(python, 0, k + 1)
            thread.result()
        put()
        of_loop = np.concatenate([of_loop, taken])

    with disk.stalled():
        both()
        assert min(of_loop.sum(), sum(of_python)) >= (CAPACITY - LEAD) // 2 - 1
        assert of_loop.sum() + sum(of_python) == CAPACITY
    both()
    until(put)
    recorder.close()
    assert recorder.error is None
    assert sequences(disk.path) == {"/a": numbers(of_loop), "/b": numbers(of_python)}
    for message in BagReader(disk.path).messages():
        assert message.data == numbered(message.sequence - 1)
    written = int(of_loop.sum()) + sum(of_python)
    dropped = len(of_loop) + len(of_python) - written
    assert (recorder.written, recorder.dropped) == (written, dropped)
    assert recorder.summary() == f"{disk.path}: {written} messages, {dropped} dropped"
    assert {topic.name: topic.lost for topic in BagReader(disk.path).topics} == {
        "/a": max(numbers(of_loop)) - of_loop.sum(), "/b": max(numbers(of_python)) - sum(of_python)
    }  # fmt: skip


def test_both_come_in_the_order_of_time_and_share_a_topic_s_numbers(disk):
    """A topic may go from one writer to the other and back."""
    recorder = disk.record()
    handle, began = held(recorder.loop), recorder.began
    with disk.stalled():
        for k in range(4):
            assert recorder.put("/b", WRENCH, began + 100 * k)
            if k < 2:
                assert recorder.put("/a", WRENCH, began + 100 * k + 10)
            else:
                assert recording.put(handle, recorder.number("/a"), began + 100 * k + 10, BYTES, len(BYTES))
        assert recording.put(handle, recorder.number("/b"), began + 400, BYTES, len(BYTES))
        assert recorder.put("/b", WRENCH, began + 500)
    recorder.close()
    (file,) = disk.path.glob("*.mcap")
    with file.open("rb") as stream:
        rows = [
            (channel.topic, message.sequence, message.log_time)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]
    first = rows[0][2]
    assert [(topic, number, time - first) for topic, number, time in rows] == [
        ("/b", 1, 0), ("/a", 1, 10), ("/b", 2, 100), ("/a", 2, 110), ("/b", 3, 200), ("/a", 3, 210), ("/b", 4, 300),
        ("/a", 4, 310), ("/b", 5, 400), ("/b", 6, 500),
    ]  # fmt: skip


def test_a_loop_may_go_on_after_the_end(disk):
    """What it puts into a recording that has ended is nowhere, also not in the next one, which has the same memory."""
    first = disk.record()
    old, pid = held(first.loop), disk.pid
    assert recording.put(old, 0, first.began, BYTES, len(BYTES))
    first.close()
    assert (first.written, first.dropped) == (1, 0)
    assert not recording.put(old, 0, first.began, BYTES, len(BYTES))
    second = Recorder(disk.path.with_name("other"), TOPICS, 10, disk.standby.pipe())
    assert not recording.put(old, 0, second.began, BYTES, len(BYTES))
    assert recording.put(held(second.loop), 1, second.began, BYTES, len(BYTES))
    second.close()
    assert disk.pid == pid
    assert (first.written, first.dropped, second.written, second.dropped) == (1, 0, 1, 0)
    assert sequences(disk.path.with_name("other")) == {"/b": [1]}


def test_a_loop_that_hangs_in_a_message_takes_the_memory_with_it(disk, monkeypatch):
    """The recording says so, and is finished with what was whole; the next one has memory of its own."""
    monkeypatch.setattr(recorders, "PUT_TIMEOUT", 0.05)
    recorder, pid = disk.record(), disk.pid
    assert recording.put(held(recorder.loop), 0, recorder.began, BYTES, len(BYTES))
    recorder.loop.control[recording.INSIDE] = 1
    recorder.close()
    assert "the loop did not come to the end of a message within 0.05 s" in recorder.error
    assert disk.told == [f"recording stopped: {recorder.error}"]
    other = Recorder(disk.path.with_name("other"), TOPICS, 10, disk.standby.pipe())
    assert disk.pid != pid
    other.close()
    until((disk.path / "metadata.yaml").is_file)
    assert sequences(disk.path) == {"/a": [1]}


KILLED = """
import os, pathlib, signal, sys
from recorder_helpers import Disk
from test_two_writers import BYTES, WRENCH, held, recording

disk = Disk(pathlib.Path(sys.argv[1]))
recorder = disk.record()
with disk.stalled():
    for k in range(200):
        assert recorder.put("/b", WRENCH, recorder.began + 2 * k)
        assert recording.put(held(recorder.loop), 0, recorder.began + 2 * k + 1, BYTES, len(BYTES))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_leaves_what_both_have_put(tmp_path):
    """It is in a whole bag, though the process that writes had not yet looked at it."""
    places = [str(place) for place in (REPOSITORY, REPOSITORY / "tests", REPOSITORY / "tests" / "ros")]
    code = f"import sys; sys.path[:0] = {places}\n{KILLED}"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, timeout=200)
    assert done.returncode == -signal.SIGKILL, done.stderr
    until((tmp_path / "bag" / "metadata.yaml").is_file)
    assert BagReader(tmp_path / "bag").warning is None
    assert sequences(tmp_path / "bag") == {"/a": list(range(1, 201)), "/b": list(range(1, 201))}

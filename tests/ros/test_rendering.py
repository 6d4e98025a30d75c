"""What a device gets, step by step: scaled, ramped in, clamped, nothing when the command is stale."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from small_fingers import small

from finger_sim import Pose
from finger_sim.ros import tick
from finger_sim.ros.device_in import DeviceIn
from finger_sim.ros.device_out import DeviceOut
from finger_sim.ros.inbox import Command
from finger_sim.ros.loop import Triggers
from finger_sim.ros.messages import pose_template, wrench_template
from finger_sim.ros.options import NodeOptions
from finger_sim.ros.outputs import Outputs
from finger_sim.ros.stepper import Stepper
from finger_sim.ros.ticker import Ticker


class Published:
    """Stands in for a publisher."""

    topic_name = topic = "/t"

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def publish(self, data: bytes) -> None:
        self.sent.append(data)


def ticker(monkeypatch: pytest.MonkeyPatch, commands: list[Command]) -> tuple[Ticker, list[Published], list[str]]:
    """One that answers commands, without ROS; what it published, by hand, and what it said."""
    monkeypatch.setenv("FINGER_SIM_RCL", "0")
    said: list[str] = []
    log: Any = SimpleNamespace(warning=said.append, info=said.append)
    clock: Any = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=7), ros_time_is_active=False)
    published = [Published() for _ in range(3)]
    templates = (wrench_template("a"), wrench_template("b"), pose_template("world"))
    outputs: Any = SimpleNamespace(
        options=NodeOptions(), recorder=None, stepped_topics=["/t"] * 3, prepare=lambda mesh: None,
        stepped=lambda: list(zip(published, templates, strict=True)), device=DeviceOut(None, None, {}, None),
    )  # fmt: skip
    scene = small("finger_coupled")
    node = Stepper(scene, outputs, log)
    inbox: Any = SimpleNamespace(
        subscriptions=(None, None), topics=("/c", "/p"), early=threading.Lock(), wait=lambda _: False,
        wake=lambda: None, device=DeviceIn(None, "world", node.rendering.record.clutched),
    )  # fmt: skip
    take = lambda now: [commands.pop(0) for _ in range(len(commands))]  # noqa: E731
    loop = Ticker(scene.dt, lambda: None, (node, outputs, inbox), take, Triggers[Command](10), clock, log)
    node.prepare(lambda _: None, loop.compile)
    loop.load(lambda _: None)
    loop._set_out()
    said.clear()
    return loop, published, said


def force(data: bytes) -> tuple[float, ...]:
    message = deserialize_message(data, WrenchStamped)
    return message.wrench.force.x, message.wrench.force.y, message.wrench.force.z


def turns(loop: Ticker, until: int) -> None:
    """Makes the calls that compiled code asks for, the last one that of `until`."""
    calls = {tick.TO_AWAIT: loop._await, tick.TO_PLACE: loop._place, tick.TO_SEND: loop._send, tick.TO_TELL: loop._tell}
    why = -1
    while why != until:
        why = loop._run_compiled()
        calls[why]()


def test_between_answers_a_device_is_let_go_of_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """As soon as the last command is too old: one wrench of nothing, and one line that says so; not before."""
    commands: list[Command] = []
    loop, (device, contact, _), said = ticker(monkeypatch, commands)
    received = time.monotonic_ns()
    commands.append(Command(Pose((0.0, 0.0, 0.01)), received))
    turns(loop, tick.TO_SEND)
    assert (len(device.sent), len(contact.sent)) == (1, 1)
    for later, sent in ((50_000_000, 1), (100_000_000, 1), (101_000_000, 2), (200_000_000, 2)):
        now = received + later
        monkeypatch.setattr("finger_sim.ros.ticker.time", SimpleNamespace(monotonic_ns=lambda now=now: now))
        turns(loop, tick.TO_AWAIT)
        assert (len(device.sent), len(contact.sent)) == (sent, 1)
    assert force(device.sent[1]) == (0.0, 0.0, 0.0)
    assert said == ["no command for 0.1 s: holding the pose, device_wrench is zero"]
    monkeypatch.setattr("finger_sim.ros.ticker.time", time)
    commands.append(Command(Pose((0.0, 0.0, 0.01)), time.monotonic_ns()))
    turns(loop, tick.TO_TELL)
    assert said[1:] == ["commands are back: device_wrench follows the contact again"]


def test_a_target_of_the_plane_is_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each that came, however it was put there; then none until the next."""
    loop, _, _ = ticker(monkeypatch, [])
    table = loop._live.body.table
    for target in (Pose(), Pose((0.0, 0.0, 0.1))):
        loop._stepper.plane = target
        for given in (1.0, 0.0):
            table.given[0] = 0.0
            turns(loop, tick.TO_AWAIT)
            assert table.given[0] == given
        assert tuple(table.target[:3]) == target.position


def test_what_the_file_of_a_mesh_lost_is_logged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each note as a warning that names the file."""
    warned: list[str] = []
    made: Any = SimpleNamespace(mesh=SimpleNamespace(notes=("2 nodes left out", "it is 10 m long")))
    monkeypatch.setattr("finger_sim.ros.stepper.Simulator", lambda scene, progress, meanwhile: made)
    monkeypatch.setattr(Stepper, "_take_budget", lambda _: None)
    scene, outputs = small("finger_coupled"), SimpleNamespace(prepare=lambda mesh: None)
    Stepper(scene, outputs, SimpleNamespace(warning=warned.append)).prepare(print)  # type: ignore[arg-type]
    assert warned == [f"{scene.mesh.file}: {note}" for note in made.mesh.notes]


def test_a_recording_begins_with_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a step brings that began before the recording is not in it, however late it is sent."""
    monkeypatch.setattr("finger_sim.ros.transforms.available", lambda: False)
    kept: list[tuple[str, int]] = []
    node = SimpleNamespace(
        create_publisher=lambda kind, name, qos: SimpleNamespace(topic_name=name, publish=lambda data: None)
    )
    outputs = Outputs(node, NodeOptions())
    recorder: Any = SimpleNamespace(began=1000, put=lambda topic, data, at: kept.append((topic, at)))
    outputs.start_recording(recorder, None, 0)
    for at in (999, 1001):
        outputs.send("mesh_points", b"", at)
    assert kept == [("mesh_topology", 1000), ("mesh_points", 1001)]

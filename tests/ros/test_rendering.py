"""What a device gets, step by step: scaled, ramped in, clamped, nothing when the command is stale."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from small_fingers import small

from finger_sim import Pose, Scene
from finger_sim.ros.inbox import Command
from finger_sim.ros.options import NodeOptions
from finger_sim.ros.outputs import Outputs
from finger_sim.ros.stepper import Stepper


def stepper(**options: Any) -> tuple[Stepper, NodeOptions]:
    """And its options."""
    return Stepper(small("finger_coupled"), SimpleNamespace(), None, None), NodeOptions(**options)  # type: ignore[arg-type]


FORCE = np.array([0.0, 0.0, 4.0, 0.0, 0.1, 0.0])


def test_between_commands_the_port_keeps_the_delay_of_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 30 ms here and 30 back, and what passed since its receipt until the wrench is sent."""
    node, options = stepper()
    command = Command(Pose(), 5_000_000_000, 0.03)
    for begin, sent in ((5_001_000_000, 5_002_000_000), (5_010_000_000, 5_010_500_000)):
        monkeypatch.setattr("finger_sim.ros.stepper.time.monotonic_ns", lambda sent=sent: sent)
        node._send(FORCE, command, begin, options)
        node._followed = command
        assert node.sender.delay == pytest.approx(0.062)


def test_between_answers_a_device_is_let_go_of_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """As soon as the last command is too old: one wrench of nothing, and one line that says so; not before."""
    said: list[str] = []
    sent: list[Any] = []
    clock: Any = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))
    outputs: Any = SimpleNamespace(options=NodeOptions(), device=lambda wrench, stamp, at: sent.append((wrench, at)))
    log: Any = SimpleNamespace(warning=said.append, info=said.append)
    node = Stepper(small("finger_coupled"), outputs, clock, log)
    node.newest = node._followed = Command(Pose(), 5_000_000_000)
    node._send(FORCE, node.newest, 5_000_000_000, outputs.options)
    for now in (5_050_000_000, 5_100_000_000, 5_101_000_000, 5_200_000_000):
        monkeypatch.setattr("finger_sim.ros.stepper.time.monotonic_ns", lambda now=now: now)
        node.idle()
    assert [(wrench.any(), at) for wrench, at in sent] == [(False, 5_101_000_000)]
    assert said == ["no command for 0.1 s: holding the pose, device_wrench is zero"]
    device = node._send(FORCE, Command(Pose(), 5_200_000_000), 5_200_000_000, outputs.options)
    assert device[2] == pytest.approx(4.0 * 0.001 / 0.2)  # the first of a new ramp
    assert said[1:] == ["commands are back: device_wrench follows the contact again"]


def test_a_target_of_the_plane_is_taken_once() -> None:
    """Each that came, however it was put there; then none until the next."""
    outputs: Any = SimpleNamespace(options=NodeOptions(), step=lambda *_: None)
    clock: Any = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))
    node, taken = Stepper(small("finger_coupled"), outputs, clock, None), []
    result: Any = SimpleNamespace(device_wrench=FORCE)
    step = lambda command, plane, now: taken.append(plane) or result  # noqa: E731
    node.sim = SimpleNamespace(step=step)  # type: ignore[assignment]
    node._window = SimpleNamespace(add=lambda _: None)  # type: ignore[assignment]
    targets = [Pose(), Pose((0.0, 0.0, 0.1))]
    for target in targets:
        node.plane = target
        node.tick(0, [])
        node.tick(0, [])
    assert taken == [targets[0], None, targets[1], None]


def test_what_the_file_of_a_mesh_lost_is_logged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each note as a warning that names the file."""
    warned: list[str] = []
    made: Any = SimpleNamespace(mesh=SimpleNamespace(notes=("2 nodes left out", "it is 10 m long")))
    monkeypatch.setattr("finger_sim.ros.stepper.Simulator", lambda scene, progress, meanwhile: made)
    monkeypatch.setattr(Stepper, "_take_budget", lambda _: None)
    scene, outputs = small("finger_coupled"), SimpleNamespace(prepare=lambda mesh: None)
    clock: Any = None
    Stepper(scene, outputs, clock, SimpleNamespace(warning=warned.append)).prepare(print)  # type: ignore[arg-type]
    assert warned == [f"{scene.mesh.file}: {note}" for note in made.mesh.notes]


class Changing(Outputs):
    """Its options change with every look at them, as where another thread sets parameters."""

    looks = 0

    @property
    def options(self) -> NodeOptions:
        self.looks += 1
        return NodeOptions(passivity=("observe", "control")[self.looks % 2])

    @options.setter
    def options(self, _: NodeOptions) -> None: ...


def test_a_step_works_on_one_snapshot_of_the_options() -> None:
    """However often they change, a step looks once: what it decides by is what it computes with."""
    publisher: Any = SimpleNamespace(topic_name="/t", publish=lambda _: None, get_subscription_count=lambda: 1)
    outputs = Changing(SimpleNamespace(create_publisher=lambda *_: publisher), NodeOptions())
    clock: Any = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))
    scene = Scene.from_dict(
        {
            "mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [2, 1, 1]}},
            "driven": {"box": [[-1, -1, 0.0099], [1, 1, 1]]},
            "plane": {},
        }
    )
    node = Stepper(scene, outputs, clock, SimpleNamespace(warning=print, info=print))
    node.prepare(lambda _: None)
    for step in range(20):
        now = time.monotonic_ns()
        node.newest = Command(Pose((0.0, 0.0, 0.01 - 1e-5 * step)), now)
        before = outputs.looks
        node.tick(now, [node.newest])
        assert outputs.looks == before + 1


def test_a_recording_begins_with_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a step brings that began before the recording is not in it, however late it is sent."""
    monkeypatch.setattr("finger_sim.ros.outputs._Broadcast.available", lambda: False)
    kept: list[tuple[str, int]] = []
    node = SimpleNamespace(
        create_publisher=lambda kind, name, qos: SimpleNamespace(topic_name=name, publish=lambda data: None)
    )
    outputs = Outputs(node, NodeOptions())
    recorder: Any = SimpleNamespace(began=1000, put=lambda topic, data, at: kept.append((topic, at)))
    outputs.start_recording(recorder, None, 0)
    for at in (999, 1001):
        outputs.device(np.zeros(6), 0, at)
    assert kept == [("mesh_topology", 1000), ("device_wrench", 1001)]

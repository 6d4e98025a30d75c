"""A recording without a scene beside it: run takes the one it was made with, and makes what was changed live again."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_sim import Pose, Scene, Simulator
from finger_sim.bags import cdr
from finger_sim.bags.origin import origin_of, read_origin
from finger_sim.bags.reader import BagReader, BagWriter
from finger_sim.errors import BagError
from finger_sim.simulation.replay import Replay, Selection, run

START = 1_700_000_000_000_000_000
MS = 1_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)
BEAM = Scene.from_dict(
    {
        "mesh": {"beam": {"size": [0.03, 0.01, 0.01], "cells": [3, 1, 1]}},
        "driven": {"box": [[-1.0, -1.0, 0.009], [1.0, 1.0, 1.0]]},
        "material": {"young": 5.0e4, "poisson": 0.3},
        "plane": {"friction": 0.4},
        "dt": 0.001,
    }
)
CHANGES = {-MS: 0.5, 0: 0.6, 3 * MS: 0.7, 3 * MS + 1: 0.8, 30 * MS: 0.1}
"""Friction set live, by the time since the first command [ns]."""
RESET, SCALE = 7_500_000, 9 * MS


def recorded(path: Path, commands: list[Pose], period: int = 2 * MS, options: dict[str, Any] | None = None) -> Path:
    """A bag as the node makes them: commands every so many ns, CHANGES of friction, a reset, one of force_scale."""
    options = {"mode": "free", "force_scale": 1.0, "finger_frame": "tip", "wrench_frame": "world"} | (options or {})
    origin = origin_of("node", BEAM, BEAM.load_mesh(), options)
    events = {at: {"plane.friction": value} for at, value in CHANGES.items()} | {SCALE: {"force_scale": 0.1}}
    with BagWriter(path, origin=origin.words()) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.add_topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
        bag.add_topic("/finger/reset", "std_msgs/msg/Empty")
        for k, pose in enumerate(commands):
            at = START + k * period
            bag.write("command_pose", cdr.pose_stamped(at, "map", pose.position, pose.orientation), at)
        for at, values in events.items():
            bag.write("/parameter_events", cdr.parameter_event(START + at, "/finger", values), START + at)
        bag.write("/finger/reset", cdr.empty(), START + RESET)
    return path


class Log:
    """Stands for a simulator; says in which step, counted from 0, it was told what."""

    def __init__(self) -> None:
        self.steps = 0
        self.told: list[tuple[int, Any]] = []
        self.scene = BEAM
        self.mesh = BEAM.load_mesh()
        self.positions = self.contact_forces = self.mesh.points
        self.strain_ratio = np.zeros(len(self.mesh.tets))
        self.plane_pose = Pose()
        self.set_down_by = 0.0

    def apply(self, values: dict[str, Any]) -> None:
        self.told.append((self.steps, values))

    def reset(self, pose: Pose | None = None, plane: Pose | None = None) -> None:
        if self.steps:
            self.told.append((self.steps, pose))

    def hear(self, pose: Pose, received: float) -> None: ...

    def step(self, pose: Pose | None = None, plane: Pose | None = None, now: float | None = None) -> Any:
        self.steps += 1
        return SimpleNamespace(
            contact_wrench=np.arange(6.0), device_wrench=np.arange(6.0), pose=Pose(), status=[], limited_tets=0,
            max_strain_ratio=0.0, max_penetration=0.0,
        )  # fmt: skip


def content(path: Path) -> bytes:
    return next(path.glob("*.mcap")).read_bytes()


def test_each_change_comes_before_the_first_step_that_begins_after_it(tmp_path: Path) -> None:
    """What was set by the first command is the scene's; what a run cannot use is left; the output gives itself."""
    bag = recorded(tmp_path / "in", [Pose()] * 11)
    replay, log = Replay(None, bag), Log()
    assert replay.scene.plane is not None
    assert replay.scene.plane.friction == 0.6
    changes = [(0.003, {"plane.friction": 0.7}, {}), (0.003000001, {"plane.friction": 0.8}, {}), (0.0075, {}, {}),
               (0.009, {}, {"force_scale": 0.1}), (0.03, {"plane.friction": 0.1}, {})]  # fmt: skip
    assert [(pytest.approx(1e-9 * (c.time - START)), c.scene, c.options) for c in replay.changes] == changes
    assert replay.options["force_scale"] == 1.0
    summary = replay.run(tmp_path / "out", simulator=log)  # type: ignore[arg-type]
    assert log.told == [(3, {"plane.friction": 0.7}), (4, {"plane.friction": 0.8}), (8, None)]
    assert (summary.steps, summary.differences) == (21, [])
    origin = read_origin(BagReader(tmp_path / "out"))
    assert origin is not None
    assert (origin.made_by, origin.machine, origin.reached) == ("run", {}, {})
    assert origin.scene["plane"]["friction"] == 0.6
    frames = {"world_frame": "map", "finger_frame": "tip", "wrench_frame": "world"}
    rendering = {"force_scale": 1.0, "force_ramp": 0.2, "command_timeout": 0.1}
    assert origin.options == {"mode": "free", **frames, **rendering}
    run(None, tmp_path / "out", tmp_path / "again" / "out", simulator=Log())  # type: ignore[arg-type]
    assert content(tmp_path / "again" / "out") == content(tmp_path / "out")


def test_a_window_begins_with_what_was_set_by_then(tmp_path: Path) -> None:
    """As commands and plane do."""
    bag = recorded(tmp_path / "in", [Pose()] * 11)
    replay, log = Replay(None, bag, Selection(start=0.008, duration=0.002)), Log()
    assert replay.scene.plane is not None
    assert replay.scene.plane.friction == 0.8
    replay.run(tmp_path / "out", simulator=log)  # type: ignore[arg-type]
    assert log.told == []


def test_a_scene_given_wins(tmp_path: Path) -> None:
    """Of the recording only commands and resets are followed; what is different and what was left out is told."""
    bag, log = recorded(tmp_path / "in", [Pose()] * 11), Log()
    other = BEAM.with_values({"material.young": 6e4})
    summary = run(other, bag, tmp_path / "out", simulator=log)  # type: ignore[arg-type]
    assert log.told == [(8, None)]
    assert summary.differences == [
        "material.young 60000.0 (recorded: 50000.0)", "plane.friction 0.4 (recorded: 0.6)",
        "finger_frame finger (recorded: tip)", "wrench_frame world_aligned (recorded: world)",
    ]  # fmt: skip
    assert (summary.left_out, summary.resets, summary.live_changes) == (4, 1, 0)


def test_mode_is_as_recorded_and_changes_are_in_the_steps_that_had_them(tmp_path: Path) -> None:
    """A command that waited for its step while friction was set is computed with it: the wrenches before it tell."""
    bag = recorded(tmp_path / "in", [Pose()] * 4, 2 * MS, {"mode": "triggered"})
    whole = tmp_path / "whole"
    with BagWriter(whole, origin=BagReader(bag).origin) as both:
        for message in BagReader(bag):
            both.write(both.add_topic(message.topic, message.type), message.data, message.log_time)
        both.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        for at in (1 * MS, 3 * MS + 2, 8 * MS, 9 * MS):  # the second step ends after both changes of friction
            both.write("contact_wrench", cdr.wrench_stamped(0, "tip", [0.0] * 6), START + at)
    log = Log()
    summary = run(None, whole, tmp_path / "out", simulator=log)  # type: ignore[arg-type]
    assert summary.steps == 4
    assert log.told == [(1, {"plane.friction": 0.7}), (1, {"plane.friction": 0.8}), (2, None)]
    run(None, tmp_path / "out", tmp_path / "again" / "out", simulator=Log())  # type: ignore[arg-type]
    assert content(tmp_path / "again" / "out") == content(tmp_path / "out")


def test_the_same_steps_by_hand(tmp_path: Path) -> None:
    """The real simulator, told the same between the same steps: the same wrenches, bit by bit."""
    poses = [Pose((2e-4 * k, 0.0, -2e-5 * k)) for k in range(21)]
    run(None, recorded(tmp_path / "in", poses, MS, {"wrench_frame": "world_aligned"}), tmp_path / "out")
    by_hand, wrenches = Simulator(BEAM.with_values({"plane.friction": 0.6})), []
    by_hand.reset(poses[0])
    for k, pose in enumerate(poses):
        if k in (3, 4):
            by_hand.apply({"plane.friction": {3: 0.7, 4: 0.8}[k]})
        if k == 8:
            by_hand.reset()
        by_hand.hear(pose, 1e-3 * k)
        wrenches.append(by_hand.step(now=1e-3 * k).contact_wrench)
    got = [m.data[-48:] for m in BagReader(tmp_path / "out").messages(["contact_wrench"])]
    assert np.linalg.norm(wrenches, axis=1).max() > 0.1
    np.testing.assert_array_equal(np.frombuffer(b"".join(got)).reshape(-1, 6), wrenches)


def test_a_recording_is_judged_in_the_frame_that_its_node_heard(tmp_path: Path) -> None:
    """Most of its commands were refused: so they are again. Of a bag that no node made, most decide."""
    for made_by, frame, good in (("node", "world", 1), ("another", "map", 2)):
        origin = origin_of(made_by, BEAM, BEAM.load_mesh(), {"world_frame": "world"})
        with BagWriter(tmp_path / made_by, origin=origin.words()) as bag:
            bag.add_topic("command_pose", cdr.POSE_STAMPED)
            for k, sent in enumerate(("map", "world", "map")):
                bag.write("command_pose", cdr.pose_stamped(k, sent, (0.0, 0.0, 0.0), LEVEL), START + k)
        replay = Replay(None, tmp_path / made_by)
        assert (replay.commands.frame_id, replay.tally.good, replay.tally.refused) == (frame, good, 3 - good)


def test_damaged_words_on_its_making_end_no_run_that_has_a_scene(tmp_path: Path) -> None:
    """They are told; without a scene there is nothing to simulate."""
    with BagWriter(tmp_path / "bag", origin={"scene": "{mesh: ["}) as bag:
        bag.write(
            bag.add_topic("command_pose", cdr.POSE_STAMPED), cdr.pose_stamped(0, "world", (0, 0, 0), LEVEL), START
        )
    (warning,) = Replay(BEAM, tmp_path / "bag").warnings
    assert "what it says of its making cannot be read" in warning
    with pytest.raises(BagError, match="what it says of its making cannot be read"):
        Replay(None, tmp_path / "bag")


def test_values_that_ros_has_otherwise(tmp_path: Path) -> None:
    """Infinite where a scene has null, lists; a value that no node took is told with where it is from, and left out."""
    scene = BEAM.with_values({"solver.budget_ms": 3.0})
    events: list[dict[str, Any]] = [{"solver.budget_ms": math.inf, "plane.normal": [0.0, 1.0, 1.0]}]
    wrong: list[dict[str, Any]] = [{"plane.friction": -1.0}, {"force_scale": "much"}]
    for name, given in {"good": events, "bad": [*events, *wrong]}.items():
        with BagWriter(tmp_path / name, origin=origin_of("node", scene, BEAM.load_mesh(), {}).words()) as bag:
            bag.add_topic("command_pose", cdr.POSE_STAMPED)
            bag.add_topic("/parameter_events", cdr.PARAMETER_EVENT)
            bag.write("command_pose", cdr.pose_stamped(0, "world", (0.0, 0.0, 0.0), LEVEL), START)
            for values in given:
                bag.write("/parameter_events", cdr.parameter_event(0, "/finger", values), START)
            if name == "bad":
                whole = cdr.parameter_event(0, "/finger", {"plane.friction": 0.9})
                bag.write("/parameter_events", whole[:-20], START)
    good, bad = (Replay(None, tmp_path / name) for name in ("good", "bad"))
    assert good.scene == bad.scene == scene.with_values({"solver.budget_ms": None, "plane.normal": [0, 1, 1]})
    assert good.warnings == []
    (warning,) = bad.warnings
    assert "3 recorded changes are left out; topic /parameter_events, message 4: " in warning
    assert bad.options["force_scale"] == 1.0


@pytest.mark.parametrize(
    ("options", "says"),
    [({"mode": "fast"}, "mode: got 'fast'"), ({"wrench_frame": 3}, "got 3"), ({"force_scale": "1"}, "got '1'")],
)
def test_parameters_that_no_node_has_are_refused(tmp_path: Path, options: dict[str, Any], says: str) -> None:
    """Of a bag that says so of its making; with a scene given they do not matter."""
    bag = recorded(tmp_path / "in", [Pose()], options=options)
    with pytest.raises(BagError, match=says):
        Replay(None, bag)
    Replay(BEAM, bag)

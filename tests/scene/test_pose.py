"""One rule refuses a pose, wherever it comes from; and no pose, however odd, spoils a simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_sim import BagError, Pose, Scene, SceneError, Simulator
from finger_sim.bags import cdr
from finger_sim.bags.imports.poses import import_poses
from finger_sim.bags.reader import BagWriter, read_commands
from finger_sim.scene import checked_pose
from finger_sim.simulation.replay import run

BLOCK: dict[str, Any] = {
    "mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [2, 1, 1]}},
    "driven": {"box": [[-1, -1, 0.0099], [1, 1, 1]]},
    "material": {"young": 5e4},
    "plane": {"point": [0, 0, 0]},
    "gravity": [0, 0, 0],
}
HERE, UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
GOOD = [
    ((1e4, -1e4, 0.0), UPRIGHT),
    (HERE, (0.0, 0.0, 0.0, 1e6)),
    (HERE, (0.0, 1e-6, 0.0, 0.0)),
]
BAD = [
    ((2e4, 0.0, 0.0), UPRIGHT),
    ((0.0, 0.0, -math.nextafter(1e4, math.inf)), UPRIGHT),
    ((math.nan, 0.0, 0.0), UPRIGHT),
    ((0.0, math.inf, 0.0), UPRIGHT),
    (HERE, (0.0, 0.0, 0.0, 0.0)),
    (HERE, (0.0, 0.0, 0.0, 9e-7)),
    (HERE, (0.0, 0.0, 0.0, 1.1e6)),
    (HERE, (1e308, 1e308, 1e308, 1e308)),
    (HERE, (0.0, math.nan, 0.0, 1.0)),
    (HERE, (0.0, math.inf, 0.0, 1.0)),
]


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(Scene.from_dict(BLOCK))


def write_bag(path: Path, *poses: tuple[Any, Any]) -> Path:
    """Commands every 2 ms."""
    with BagWriter(path) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k, (position, orientation) in enumerate(poses):
            time = 1_000_000_000 + 2_000_000 * k
            bag.write("command_pose", cdr.pose_stamped(time, "world", position, orientation), time)
    return path


def test_every_way_in_judges_alike(simulator: Simulator, tmp_path: Path) -> None:
    """Scripts, scene files, bags, CSV files, the simulator and the node take the same poses and refuse the same."""

    def by_csv(position: Any, orientation: Any) -> bool:
        (tmp_path / "poses.csv").write_text(
            "t,x,y,z,qx,qy,qz,qw\n" + ",".join(map(repr, (0.0, *position, *orientation)))
        )
        number = len(list(tmp_path.glob("csv*")))
        return taken(lambda: import_poses(tmp_path / "poses.csv", tmp_path / f"csv{number}"))

    def by_bag(position: Any, orientation: Any) -> bool:
        number = len(list(tmp_path.glob("bag*")))
        path = write_bag(tmp_path / f"bag{number}", (HERE, UPRIGHT), (position, orientation))
        return read_commands(path).refused == 0

    def taken(way: Callable[[], object]) -> bool:
        try:
            way()
        except (SceneError, BagError):
            return False
        return True

    ways: dict[str, Callable[[Any, Any], bool]] = {
        "rule": lambda p, q: taken(lambda: checked_pose(Pose(p, q))),
        "scene": lambda p, q: taken(
            lambda: Scene.from_dict(BLOCK | {"initial_pose": {"position": p, "orientation": q}})
        ),
        "command": lambda p, q: taken(lambda: simulator.step(Pose(p, q))),
        "plane": lambda p, q: taken(lambda: simulator.step(None, Pose(p, q))),
        "reset": lambda p, q: taken(lambda: simulator.reset(Pose(p, q))),
        "bag": by_bag,
        "csv": by_csv,
    }
    try:
        from finger_sim.bags.poses import StampedPose, check_pose
    except ImportError:
        pass  # no ROS here
    else:
        ways["node"] = lambda p, q: isinstance(check_pose(StampedPose(0, "world", (*p, *q)), "world"), Pose)
    for expected, poses in ((True, GOOD), (False, BAD)):
        for position, orientation in poses:
            judged = {name: way(position, orientation) for name, way in ways.items()}
            assert judged == dict.fromkeys(ways, expected), (position, orientation)


def test_numbers_of_any_kind_make_the_same_pose() -> None:
    """Arrays, lists, whole numbers and NumPy's numbers become floats in tuples: equal, hashable, and used as such."""
    plain = Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
    for same in (
        Pose(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.6, 0.8])),  # type: ignore[arg-type]
        Pose([1, 2, 3], [0, 0, 0.6, 0.8]),  # type: ignore[arg-type]
        Pose((np.int64(1), np.float32(2.0), 3), (0, 0, np.float64(0.6), 0.8)),  # type: ignore[arg-type]
    ):
        assert (same, hash(same)) == (plain, hash(plain))
        assert {type(number) for number in (*same.position, *same.orientation)} == {float}
        assert checked_pose(same) == plain


NO_POSE: list[Any] = [
    Pose((0, 0)),  # type: ignore[arg-type]
    Pose(np.zeros(2)),  # type: ignore[arg-type]
    Pose(np.zeros((3, 1))),  # type: ignore[arg-type]
    Pose((np.zeros(2), 0.0, 0.0)),  # type: ignore[arg-type]
    Pose("abc"),  # type: ignore[arg-type]
    Pose(("0", "0", "0")),  # type: ignore[arg-type]
    Pose(None),  # type: ignore[arg-type]
    Pose(3.0),  # type: ignore[arg-type]
    Pose({0.0, 1.0, 2.0}),  # type: ignore[arg-type]
    Pose((True, False, False)),
    Pose((10**400, 0, 0)),
    Pose((1j, 0, 0)),  # type: ignore[arg-type]
    Pose(HERE, (0.0, 0.0, 1.0)),  # type: ignore[arg-type]
    Pose(HERE, None),  # type: ignore[arg-type]
    np.zeros(7),
    "pose",
    (HERE, UPRIGHT),
]


def test_what_is_no_pose_is_refused_and_the_next_good_one_works() -> None:
    """As a command, as the plane, for a reset, awake and asleep: SceneError, and the run goes on as if unheard."""
    sim, undisturbed = (Simulator(Scene.from_dict(BLOCK)) for _ in range(2))
    press = Pose(np.array([0.0, 0.0, -2e-4]))  # type: ignore[arg-type]
    for steps, command in ((3, press), (300, None), (3, Pose((0.0, 0.0, -3e-4)))):
        for _ in range(steps):
            before, expected = sim.step(command), undisturbed.step(command)
        assert before.asleep == (steps == 300)
        for bad in NO_POSE:
            for name, use in (
                ("command", sim.step),
                ("plane", lambda pose: sim.step(None, pose)),
                ("command", sim.reset),
            ):
                with pytest.raises(SceneError, match=rf"^{name}.*: got .*, allowed: "):
                    use(bad)
        assert sim.pose == before.pose == expected.pose
        np.testing.assert_array_equal(sim.positions, undisturbed.positions)


def test_a_run_leaves_out_what_the_node_refuses(tmp_path: Path) -> None:
    """A bag with poses that cannot be meant is simulated to its end: they are counted, the last good one holds."""
    good = ((0.0, 0.0, -1e-4), UPRIGHT)
    bag = write_bag(tmp_path / "in", good, ((2e4, 0.0, 0.0), UPRIGHT), (HERE, (1e308,) * 4), good)
    done = run(Scene.from_dict(BLOCK), bag, tmp_path / "out")
    assert (done.commands, done.refused, done.steps) == (2, 2, 7)
    clean = run(Scene.from_dict(BLOCK), write_bag(tmp_path / "clean", good, good, good, good), tmp_path / "expected")
    assert clean.steps == done.steps
    assert clean.peak_force == pytest.approx(done.peak_force, rel=0.02)  # it has an interval that the other has not
    reasons = read_commands(bag).refusal
    assert reasons == "message 2: position: got (20000.0, 0.0, 0.0), allowed: three numbers, each in [-10000, 10000] m"

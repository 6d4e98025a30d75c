"""Replay of long bags, of windows of bags, and of poses that are refused."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_sim.bags import cdr
from finger_sim.bags.reader import BagReader, BagWriter, write_commands
from finger_sim.errors import BagError
from finger_sim.scene import Coupling, Pose, Scene
from finger_sim.scene.mesh import TetMesh
from finger_sim.simulation.costs import Costs
from finger_sim.simulation.replay import Replay, Selection, run

START = 1_700_000_000_000_000_000
MS = 1_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)


class Stub:
    """Stands for a simulator: notes what it is told, answers with what its command holds."""

    def __init__(self) -> None:
        self.told: list[tuple[float, float | None]] = []
        self.placed: float | None = None
        self.laid: float | None = None
        tets = np.array([[0, 1, 2, 3]])
        self.mesh = TetMesh.from_arrays(np.vstack([np.zeros(3), np.eye(3)]), tets)
        self.positions = self.contact_forces = self.mesh.points
        self.strain_ratio = np.zeros(1)
        self.plane_pose = None

    set_down_by = 0.0
    scene = SimpleNamespace(coupling=Coupling())

    def hear(self, pose: Pose, received: float) -> None:
        self.newest = pose

    def reset(self, pose: Pose, plane: Pose | None = None) -> None:
        self.placed = pose.position[0]
        self.laid = None if plane is None else plane.position[0]

    def step(self, pose: Pose | None, plane: Pose | None = None, now: float | None = None) -> Any:
        pose = pose or self.newest
        self.note(pose.position[0], None if plane is None else plane.position[0])
        wrench = np.array([pose.position[0], 0.0, 0.0, 0.0, 0.0, 0.0])
        return SimpleNamespace(
            contact_wrench=wrench, device_wrench=wrench, pose=pose, status=[], limited_tets=0, max_strain_ratio=0.0,
            max_penetration=0.0,
        )  # fmt: skip

    def note(self, command: float, plane: float | None) -> None:
        self.told.append((command, plane))


class Forgetful(Stub):
    """One that notes nothing."""

    def note(self, command: float, plane: float | None) -> None: ...


def scene(dt: float = 1e-3) -> Scene:
    return Scene.from_dict({"mesh": {"beam": {}}, "plane": {}, "dt": dt})


def bag_of(path: Path, commands: dict[int, float], plane: dict[int, float] | None = None) -> Path:
    """Commands and poses of the plane: x by the time of receipt [ns since START]."""
    with BagWriter(path) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.add_topic("plane_pose", cdr.POSE_STAMPED)
        for topic, poses in (("command_pose", commands), ("plane_pose", plane or {})):
            for k, (receipt, x) in enumerate(poses.items()):
                data = cdr.pose_stamped(k, "world", (x, 0.0, 0.0), LEVEL)
                bag.write(topic, data, START + receipt, START - 7, sequence=k + 1)
    return path


def content(path: Path) -> bytes:
    return next(path.glob("*.mcap")).read_bytes()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    """Three times the commands and steps: the most memory at a time grows by less than 30 bytes for each.

    What does grow is the index of chunks, one in half a second, which an MCAP file ends with.
    """
    few, many = 1_500, 4_500
    peaks = {}
    for n in (few, few, many):  # the first one loads what is loaded once
        position, orientation = np.zeros((n, 3)), np.tile(LEVEL, (n, 1))
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        bag = write_commands(folder / "in", [START + k * MS for k in range(n)], position, orientation)
        tracemalloc.start()
        done = run(scene(), bag, folder / "out", simulator=Forgetful())  # type: ignore[arg-type]
        peaks[n] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert done.steps == n
    assert peaks[many] - peaks[few] < 30 * (many - few)


def test_percentiles_of_costs() -> None:
    """Of a million costs over four decades, median and p99 are within a percent of the true ones."""
    values = np.exp(np.random.default_rng(0).normal(-7.0, 1.5, 100_000))
    costs = Costs()
    for value in values.tolist():
        costs.add(value)
    for percent in (50.0, 99.0):
        assert costs.percentile(percent) == pytest.approx(float(np.percentile(values, percent)), rel=0.01)
    assert costs.total == pytest.approx(values.sum())
    costs.add(0.0)
    costs.add(1e9)
    assert Costs().percentile(50.0) == 0.0


def test_a_window_begins_with_what_holds_there(tmp_path: Path) -> None:
    """The newest command and pose of the plane by then act at the window's start; times are the bag's."""
    commands = {0: 0.0, 10 * MS: 1.0, 11 * MS: 2.0, 16 * MS: 3.0, 40 * MS: 4.0}
    bag = bag_of(tmp_path / "in", commands, {-5 * MS: 10.0, 12 * MS: 11.0, 13 * MS: 12.0, 15 * MS: 13.0, 17 * MS: 14.0})
    stub = Stub()
    window = Selection(start=0.0145, duration=0.004)
    done = run(scene(), bag, tmp_path / "out", window, simulator=stub)  # type: ignore[arg-type]
    assert (stub.placed, stub.laid) == (2.0, 12.0)
    assert stub.told == [(2.0, None), (2.0, 13.0), (3.0, None), (3.0, 14.0)]
    assert (done.commands, done.plane_poses, done.steps) == (2, 3, 4)
    reader = BagReader(tmp_path / "out")
    received = {
        name: [(m.log_time - START, m.sequence) for m in reader.messages([name])] for name in ("command_pose", "pose")
    }
    assert received["command_pose"] == [(14_500_000, 3), (16 * MS, 4)]
    assert [time for time, _ in received["pose"]] == [15_500_000 + k * MS for k in range(4)]
    run(scene(), tmp_path / "out", tmp_path / "again" / "out", simulator=Stub())  # type: ignore[arg-type]
    assert content(tmp_path / "again" / "out") == content(tmp_path / "out")


def test_a_window_in_mode_triggered(tmp_path: Path) -> None:
    """One step for each command in it, the one that holds at its start included; replayed, it gives itself."""
    bag = bag_of(tmp_path / "in", {0: 0.0, 3 * MS: 1.0, 5 * MS: 2.0, 5 * MS + 1: 3.0, 9 * MS: 4.0}, {4 * MS: 9.0})
    stub = Stub()
    window = Selection(mode="triggered", start=0.0045, duration=0.003)
    done = run(scene(), bag, tmp_path / "out", window, simulator=stub)  # type: ignore[arg-type]
    assert stub.laid == 9.0
    assert stub.told == [(1.0, None), (2.0, None), (3.0, None)]
    assert (done.steps, done.commands) == (3, 3)
    again = Selection(mode="triggered")
    run(scene(), tmp_path / "out", tmp_path / "again" / "out", again, simulator=Stub())  # type: ignore[arg-type]
    assert content(tmp_path / "again" / "out") == content(tmp_path / "out")


def test_the_first_part_is_as_in_the_whole(tmp_path: Path) -> None:
    """A duration alone changes nothing but the end; the whole bag as a window is the whole run, byte for byte."""
    bag = bag_of(tmp_path / "in", {k * 2 * MS: float(k) for k in range(50)}, {-MS: 5.0, 30 * MS: 6.0})
    for name, window in (("all", None), ("whole", Selection(duration=0.098)), ("part", Selection(duration=0.02))):
        run(scene(), bag, tmp_path / name / "out", window, simulator=Stub())  # type: ignore[arg-type]
    assert content(tmp_path / "whole" / "out") == content(tmp_path / "all" / "out")
    whole, part = (list(BagReader(tmp_path / name / "out")) for name in ("all", "part"))
    assert part == [message for message in whole if message.log_time <= START + 21 * MS][: len(part)]
    assert max(message.log_time for message in part) == START + 21 * MS


@pytest.mark.parametrize(
    ("window", "says"),
    [
        ({"start": 0.0981}, r"start: got 0\.0981 s, allowed: 0 to 0\.098 s"),
        ({"start": -1.0}, "start: got -1 s"),
        ({"start": float("nan")}, "start: got nan s"),
        ({"duration": 0.0}, r"duration: got 0 s .* allowed: more than 0, up to 0\.098 s"),
        ({"duration": float("inf")}, "duration: got inf s"),
        ({"start": 0.05, "duration": 0.05}, r"duration: got 0\.05 s from 0\.05 s on, .* up to 0\.048 s"),
    ],
)
def test_a_window_that_is_not_in_the_bag(tmp_path: Path, window: dict[str, float], says: str) -> None:
    """Refused with what is allowed, before there is a simulator."""
    bag = bag_of(tmp_path / "in", {k * 2 * MS: float(k) for k in range(50)})
    with pytest.raises(BagError, match=says):
        Replay(scene(), bag, Selection(**window))  # type: ignore[arg-type]


def test_what_is_refused_does_not_end_a_run(tmp_path: Path) -> None:
    """The command before holds, the plane stays; both are counted and copied, and the run comes to its end."""
    commands = {0: 1.0, 2 * MS: 2e4, 4 * MS: 2.0, 5 * MS: 2e4}
    bag = bag_of(tmp_path / "in", commands, {MS: 2e4, 3 * MS: 4.0, 5 * MS: 2e4})
    stub = Stub()
    done = run(scene(), bag, tmp_path / "out", simulator=stub)  # type: ignore[arg-type]
    assert stub.told == [(1.0, None), (1.0, None), (1.0, None), (1.0, 4.0), (2.0, None)]
    assert (done.commands, done.refused, done.plane_poses, done.plane_refused) == (2, 2, 1, 2)
    assert len(list(BagReader(tmp_path / "out").messages(["command_pose"]))) == 4
    stub = Stub()
    done = run(scene(), bag, tmp_path / "answers", Selection(mode="triggered"), simulator=stub)  # type: ignore[arg-type]
    assert [command for command, _ in stub.told] == [1.0, 2.0]
    assert (done.steps, done.refused) == (2, 2)


def test_the_plane_rests_where_it_was_before_the_first_command(tmp_path: Path) -> None:
    """The newest of its poses by then: as in the node, where it has arrived there. The next one moves it."""
    bag = bag_of(tmp_path / "in", {5 * MS: 1.0, 8 * MS: 2.0}, {0: 3.0, 2 * MS: 4.0, 6 * MS: 5.0})
    stub = Stub()
    run(scene(), bag, tmp_path / "out", simulator=stub)  # type: ignore[arg-type]
    assert (stub.placed, stub.laid) == (1.0, 4.0)
    assert [place for _, place in stub.told if place is not None] == [5.0]


def test_times_that_no_stamp_can_hold(tmp_path: Path) -> None:
    """Refused before anything is made: the seconds of a stamp have 32 bits."""
    late = 2**31 * 1_000_000_000
    bag = write_commands(tmp_path / "in", [late - 2 * MS, late - 1], np.zeros((2, 3)), np.tile(LEVEL, (2, 1)))
    with pytest.raises(BagError, match=r"allowed: below 2\^31 s"):
        run(scene(), bag, tmp_path / "out", simulator=Stub())  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


class Breaks(Stub):
    """One whose step number `k` raises."""

    def __init__(self, k: int, error: BaseException) -> None:
        super().__init__()
        self.k, self.error = k, error

    def step(self, pose: Pose | None, plane: Pose | None = None, now: float | None = None) -> Any:
        if len(self.told) == self.k:
            raise self.error
        return super().step(pose, plane, now)


@pytest.mark.parametrize("error", [RuntimeError("torn"), MemoryError(), KeyboardInterrupt()])
def test_a_run_that_ends_early_leaves_a_finished_bag(tmp_path: Path, error: BaseException) -> None:
    """With its index and metadata, which say that it was cut; it can be replayed. Without a step there is no bag."""
    bag = bag_of(tmp_path / "in", {k * MS: float(k) for k in range(100)})
    replay = Replay(scene(), bag)
    with pytest.raises(type(error)):
        replay.run(tmp_path / "out", simulator=Breaks(40, error))  # type: ignore[arg-type]
    left = BagReader(tmp_path / "out")
    assert left.warning is None
    assert (tmp_path / "out" / "metadata.yaml").is_file()
    assert "after 40 of 100 steps" in str(left.cut)
    assert {topic.name: topic.count for topic in left.topics}["/pose"] == 40
    assert "cut after 40 of 100 steps" in str(replay.remains)
    assert run(scene(), tmp_path / "out", tmp_path / "again", simulator=Stub()).steps == 41  # type: ignore[arg-type]
    deep = tmp_path / "a" / "b" / "out"
    with pytest.raises(type(error)):
        run(scene(), bag, deep, simulator=Breaks(0, error))  # type: ignore[arg-type]
    assert not (tmp_path / "a").exists()

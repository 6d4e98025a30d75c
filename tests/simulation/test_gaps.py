"""Long times without a message: named, refused unless they are asked for, and not stepped by a finger at rest."""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_sim.bags import cdr, gaps
from finger_sim.bags.changes import RESET_QOS
from finger_sim.bags.origin import origin_of
from finger_sim.bags.reader import BagReader, BagWriter
from finger_sim.cli import main
from finger_sim.errors import BagError
from finger_sim.scene import Coupling, Pose, Scene
from finger_sim.scene.mesh import TetMesh
from finger_sim.simulation.replay import Replay, Selection, run

START = 1_700_000_000_000_000_000
MS, S = 1_000_000, 1_000_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)
FALLS_ASLEEP = 20
"""Steps after which a Sleeper is at rest."""


class Sleeper:
    """Stands for a simulator that sleeps some steps after it was last told something."""

    def __init__(self, sleeps: bool = True) -> None:
        self.sleeps = sleeps
        self.begins: list[float] = []
        self.told: list[tuple[int, str]] = []
        self.mesh = TetMesh.from_arrays(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
        self.positions = self.contact_forces = self.mesh.points
        self.strain_ratio = np.zeros(1)
        self.plane_pose = None
        self.set_down_by = 0.0
        self.scene = SimpleNamespace(coupling=Coupling())

    def note(self, what: str) -> None:
        self.told.append((len(self.begins), what))

    def reset(self, pose: Pose | None = None, plane: Pose | None = None) -> None:
        self.note("reset")

    def hear(self, pose: Pose, received: float) -> None:
        self.note(f"command {pose.position[0]:g}")

    def step(self, pose: Pose | None, plane: Pose | None = None, now: float | None = None) -> Any:
        if plane is not None:
            self.note(f"plane {plane.position[0]:g}")
        asleep = self.sleeps and len(self.begins) - self.told[-1][0] > FALLS_ASLEEP
        self.begins.append(now or 0.0)
        return SimpleNamespace(
            contact_wrench=np.ones(6), device_wrench=np.ones(6), pose=Pose(), status=[], limited_tets=0,
            max_strain_ratio=0.0, max_penetration=0.0, asleep=asleep,
        )  # fmt: skip


def scene(dt: float = 1e-3) -> Scene:
    return Scene.from_dict({"mesh": {"beam": {}}, "plane": {}, "dt": dt})


def bag_of(path: Path, commands: list[int], plane: tuple[int, ...] = (), resets: tuple[int, ...] = ()) -> Path:
    """Commands, poses of the plane and resets, by their log times [ns]; x counts them from 0."""
    origin = origin_of("node", scene(), scene().load_mesh(), {})
    with BagWriter(path, origin=origin.words()) as bag:
        for topic, times in (("command_pose", commands), ("plane_pose", plane)):
            bag.add_topic(topic, cdr.POSE_STAMPED)
            for k, time in enumerate(times):
                bag.write(topic, cdr.pose_stamped(k, "world", (float(k), 0.0, 0.0), LEVEL), time)
        bag.add_topic("finger/reset", cdr.EMPTY, qos=RESET_QOS)
        for time in resets:
            bag.write("finger/reset", cdr.empty(), time)
    return path


def started(bag: Path, out: Path, selection: Selection | None = None, sleeps: bool = True) -> tuple[Sleeper, Any]:
    sleeper = Sleeper(sleeps)
    return sleeper, run(scene(), bag, out, selection, simulator=sleeper)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("times", "number", "ways"),
    [
        ([0, 1, 2, START, START + 5 * MS], 4, {"start": 2}),
        ([START, START + 5 * MS, 2**61], 3, {"duration": 2}),
        ([0, 3 * MS, START, START + 1, START + 7 * MS], 3, {"start": 2, "duration": 2}),
    ],
)
def test_stray_messages_are_told_and_can_be_left_out(
    tmp_path: Path, times: list[int], number: int, ways: dict[str, int]
) -> None:
    """Refused before anything is simulated, with the message's number; what the error advises does without them."""
    bag = bag_of(tmp_path / "bag", times)
    with pytest.raises(BagError, match=rf" s without a message before message {number} on /command_pose, ") as refused:
        Replay(scene(), bag)
    advised = dict(re.findall(r"--(start|duration) ([\d.]+)", str(refused.value)))
    assert advised.keys() == ways.keys()
    for name, value in advised.items():
        replay = Replay(scene(), bag, Selection(**{name: float(value)}))
        assert (replay.tally.good, replay.warnings) == (ways[name], [])
    if times[-1] < cdr.STAMPS_END:
        answers = Replay(scene(), bag, Selection(mode="triggered"))
        assert answers.steps == len(times)
        assert f"before message {number} on /command_pose" in answers.warnings[0]


def test_days_at_rest_take_no_time_and_no_memory(tmp_path: Path) -> None:
    """A gap of a month: stepped until the finger sleeps, and again from the last step before the next message."""
    gap = 30 * 86_400 * S
    bag = bag_of(tmp_path / "bag", [MS, 2 * MS, 2 * MS + gap])
    seen: list[tuple[int, int]] = []
    sleeper = Sleeper()
    replay = Replay(scene(), bag, Selection(allow_gaps=True))
    tracemalloc.start()
    done = replay.run(tmp_path / "out", lambda k, n: seen.append((k, n)), simulator=sleeper)  # type: ignore[arg-type]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6
    assert done.steps == len(sleeper.begins) < 300
    np.testing.assert_allclose(np.array(sleeper.begins[-2:]) - 1e-9 * gap, [0.0, 1e-3], rtol=0, atol=1e-6)
    assert sleeper.told[-1] == (done.steps - 1, "command 2")
    assert seen[-1] == (replay.steps, replay.steps)
    assert done.duration + done.passed_over == pytest.approx(1e-9 * gap + 2e-3)
    stale = 0.1
    assert sleeper.begins[-3] > stale
    run(scene(), tmp_path / "out", tmp_path / "again" / "out", Selection(allow_gaps=True), simulator=Sleeper())  # type: ignore[arg-type]
    first, again = (next((tmp_path / name).glob("*.mcap")).read_bytes() for name in ("out", "again/out"))
    assert first == again


def test_all_that_comes_in_a_gap_is_followed(tmp_path: Path) -> None:
    """Poses of the plane and resets between commands, each by the step that it was for; all of them end gaps."""
    bag = bag_of(tmp_path / "bag", [START, START + 400 * S], (START + 100 * S,), (START + 200 * S + 1,))
    sleeper, done = started(bag, tmp_path / "out")
    assert [what for _, what in sleeper.told] == ["reset", "command 0", "plane 0", "reset", "command 1"]
    at = [sleeper.begins[min(k, done.steps - 1)] for k, _ in sleeper.told]
    np.testing.assert_allclose(at, [0.0, 0.0, 100.0, 200.001, 400.0], rtol=0, atol=1e-9)
    (warning,) = done.warnings
    for ending in ("200 s without a message before message 2 on /command_pose", "1 on /finger/reset"):
        assert ending in warning
    assert "100 s without a message before message 1 on /plane_pose" in warning


@pytest.mark.parametrize(("pause", "sleeps"), [(60 * S, True), (61 * S, False)])
def test_every_step_of_a_pause_is_made(tmp_path: Path, pause: int, sleeps: bool) -> None:
    """Of one that is not long, as always; and of a long one where the finger does not come to rest."""
    bag = bag_of(tmp_path / "bag", [START, START + pause])
    sleeper = Sleeper(sleeps)
    done = run(scene(0.1), bag, tmp_path / "out", simulator=sleeper)  # type: ignore[arg-type]
    assert done.steps == pause // (S // 10) + 1
    assert done.passed_over == 0.0


def test_after_a_gap_it_is_as_if_each_step_had_been_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real simulator, pressed, left alone for 61 s, and drawn sideways: the same forces, but for rounding."""
    beam = Scene.from_dict(
        {
            "mesh": {"beam": {"size": [0.03, 0.01, 0.01], "cells": [3, 1, 1]}},
            "driven": {"box": [[-1.0, -1.0, 0.009], [1.0, 1.0, 1.0]]},
            "material": {"density": 1000.0, "young": 5.0e4, "poisson": 0.3},
            "plane": {"friction": 0.5},
            "dt": 0.01,
        }
    )
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k in range(60):
            at = START + k * 10 * MS + (61 * S if k >= 30 else 0)
            place = (1e-4 * max(0, k - 30), 0.0, -2e-5 * min(k, 30))
            bag.write("command_pose", cdr.pose_stamped(at, "world", place, LEVEL), at)
    run(beam, tmp_path / "bag", tmp_path / "passed")
    monkeypatch.setattr(gaps, "GAP_TOLD", 1e9)
    run(beam, tmp_path / "bag", tmp_path / "stepped")
    passed, stepped = (
        {m.log_time: np.frombuffer(m.data[-48:]) for m in BagReader(tmp_path / name).messages(["contact_wrench"])}
        for name in ("passed", "stepped")
    )
    assert len(passed) < 1000 < 6000 < len(stepped)
    assert passed.keys() <= stepped.keys()
    resumed = [time for time in passed if time > START + 61 * S]
    assert max(abs(passed[time][0]) for time in resumed) > 0.05
    for time in passed:
        np.testing.assert_allclose(passed[time], stepped[time], rtol=0, atol=1e-9)


def test_the_verb_tells_gaps_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 without --allow-gaps; with it a warning before the kernels are loaded, and what was passed over."""
    bag = bag_of(tmp_path / "bag", [START, START + 5 * MS, START + 86_400 * S])
    command = ["run", "finger_haptic", "--bag", str(bag), "-o", str(tmp_path / "out")]
    assert main(command) == 2
    assert "before message 3 on /command_pose, allowed: 600 s, or any with --allow-gaps" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["play", str(bag)]) == 2
    assert "before message 3 on /command_pose, allowed: 600 s, or any with --allow-gaps" in capsys.readouterr().err

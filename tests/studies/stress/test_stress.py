"""`finger_sim stress`: its own judgement, cases that repeat to the last bit, and no case that fails."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cases import for_each
from processes import REPOSITORY

from finger_sim import MeshError, Pose, Scene, Simulator, Status, StepResult
from finger_sim.bags.cdr import WRENCH_STAMPED, deserialize
from finger_sim.bags.reader import BagReader
from finger_sim.cli import main
from finger_sim.simulation.replay import run as replay
from finger_sim.studies.stress import run as stress_run
from finger_sim.studies.stress.case import Case, write
from finger_sim.studies.stress.extremes import block, press_and_slide
from finger_sim.studies.stress.fuzz import fuzz_case
from finger_sim.studies.stress.motions import STILL, carried, move, pose, shake
from finger_sim.studies.stress.run import Outcome, StepClock, apart, run, verdict
from finger_sim.studies.stress.stress import Options, Report, by_family, digest, directed, stress, summary

DIRECTED = {case.name: case for case in directed()}
SEED, FUZZED = 0, 60
LONG = {"dt_1e-06_newton", "press_and_slide_20000"}
"""Each as long as thirty others."""


def drawn() -> tuple[list[str], list[int]]:
    """Of every family of directed cases one, and of the random ones as many as make twenty: the same every time."""
    rng = random.Random(SEED)
    families: dict[str, list[str]] = {}
    for case in DIRECTED.values():
        if case.name not in LONG:
            families.setdefault(case.family, []).append(case.name)
    names = [rng.choice(family) for family in families.values()]
    return names, sorted(rng.sample(range(FUZZED), 20 - len(names)))


NAMES, INDICES = drawn()


@for_each("case", [*(DIRECTED[name] for name in NAMES), *(fuzz_case(SEED, index) for index in INDICES)])
def test_no_case_of_a_draw_fails(case: Case) -> None:
    """An extreme of each family, and scenes and motions from all over what a scene may say, end as ok, degraded, or
    refused."""
    assert run(case).failures == (), case.name


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in DIRECTED if name not in NAMES])
def test_no_directed_case_fails(name: str) -> None:
    """So does every other extreme by itself."""
    assert run(DIRECTED[name]).failures == ()


@pytest.mark.slow
@pytest.mark.parametrize("index", [index for index in range(FUZZED) if index not in INDICES])
def test_no_random_case_fails(index: int) -> None:
    """So do the other random ones."""
    assert run(fuzz_case(SEED, index)).failures == ()


def small(motion: list[Pose] | None = None, **values: Any) -> Case:
    """The block, pressed and slid."""
    return Case("small", "test", block("newton", **values), tuple(motion or press_and_slide()))


class Fake(Simulator):
    """A simulator with something wrong from step 20 on."""

    spoil: Callable[[Fake, StepResult], StepResult]

    def step(self, command: Pose | None = None) -> StepResult:
        out = super().step(command)
        return type(self).spoil(self, out) if out.time > 0.02 else out


def fake(spoil: Callable[[Any, StepResult], StepResult]) -> type[Simulator]:
    return type("Spoilt", (Fake,), {"spoil": staticmethod(spoil)})


def with_wrench(out: StepResult, change: float) -> StepResult:
    return dataclasses.replace(out, contact_wrench=out.contact_wrench + change)


def kicked(sim: Any, out: StepResult) -> StepResult:
    """All free nodes 1 cm/s faster than they should be."""
    sim._state.v[sim._model.free, 0] += 0.01
    return out


def turned_inside_out(sim: Any, out: StepResult) -> StepResult:
    """A mirror image, which no status bit tells of."""
    sim._state.x[:, 1] *= -1.0
    return out


def fails_to_converge(sim: Any, out: StepResult) -> StepResult:
    return dataclasses.replace(out, status=out.status | Status.ITERATION_LIMIT)


def raises(sim: Any, out: StepResult) -> StepResult:
    raise ZeroDivisionError("nothing to divide by")


def spins(sim: Any, out: StepResult) -> StepResult:
    until = time.thread_time() + 0.25
    while time.thread_time() < until:
        pass
    return out


@pytest.mark.parametrize(
    ("spoil", "check"),
    [
        (lambda sim, out: with_wrench(out, np.nan), "finite"),
        (lambda sim, out: with_wrench(out, 1e-3), "wrench"),
        (lambda sim, out: dataclasses.replace(out, residual=np.inf), "finite"),
        (lambda sim, out: dataclasses.replace(out, status=out.status | Status.INVERTED), "inverted"),
        (lambda sim, out: dataclasses.replace(out, max_strain_ratio=1.6), "strain"),
        (lambda sim, out: dataclasses.replace(out, max_strain_ratio=0.0), "strain"),
        (lambda sim, out: dataclasses.replace(out, pose=pose((0, 0, 0.1))), "driven"),
        (turned_inside_out, "inverted"),
        (raises, "crash"),
        (spins, "hang"),
    ],
)
def test_what_is_wrong_without_a_word_fails(spoil: Any, check: str) -> None:
    """Each kind of wrong is found, named, and where it was."""
    outcome = run(small(), fake(spoil), StepClock(0.2))
    assert outcome.kind == "failed"
    assert check in {failure.split(":")[0] for failure in outcome.failures}


def test_a_machine_that_has_no_time_is_no_hang() -> None:
    """Steps that wait for longer than a hang takes, for a processor or for anything: all is well."""

    def waits(sim: Any, out: StepResult) -> StepResult:
        time.sleep(0.02)
        return out

    outcome = run(small(), fake(waits), StepClock(0.25))
    assert outcome.seconds > 0.5
    assert outcome.failures == ()


def test_a_step_that_does_not_return_ends_the_study(tmp_path: Path) -> None:
    """By the processor time of the thread that steps; the case is written first."""
    code = """
import sys
from pathlib import Path
from finger_sim.studies.stress import run, stress

def never(self, command=None):
    while True:
        pass

run.Simulator.step = never
run.StepClock.__init__.__defaults__ = (0.5, None)
stress.stress(stress.Options(cases=0, out=Path(sys.argv[1])))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "failed")], capture_output=True, text=True, timeout=200,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
    )  # fmt: skip
    assert done.returncode == 1
    assert "hang: a step does not return" in done.stderr
    (folder,) = (tmp_path / "failed").iterdir()
    assert "does not return" in (folder / "README.txt").read_text()


def test_a_step_that_raised_ends_nothing_once_the_study_is_over() -> None:
    """It never returned; what the process does afterwards is none of the clock's business."""
    ended = []
    with contextlib.closing(StepClock(0.05, lambda: ended.append(True))) as clock:
        assert run(small(), fake(raises), clock).failures[0].startswith("crash")
        clock.begin()
    until = time.thread_time() + 0.3
    while time.thread_time() < until:
        pass
    assert ended == []


@for_each("volumetric", ["element", "patch"])
def test_energy_from_nowhere_fails(volumetric: str) -> None:
    """A body that swings ever faster under its own weight, held still; the true one does not."""
    swings = {"mass": 0.0, "stiffness": 0.0}
    case = small([STILL] * 60, plane=None, limits=None, material={"damping": swings, "volumetric": volumetric})

    def faster(sim: Any, out: StepResult) -> StepResult:
        sim._state.v[sim._model.free] *= 1.5
        return out

    assert run(case).kind == "ok"
    assert run(case).energy_excess < 1e-6
    assert "energy" in run(case, fake(faster)).failures[0]


def test_momentum_from_nowhere_fails() -> None:
    """A free body in the air changes its momentum by nothing but its weight."""
    case = small([STILL] * 40, driven=None, plane=None)
    assert run(case).kind == "ok"
    assert "momentum" in run(case, fake(kicked)).failures[0]


def test_a_bone_that_is_too_fast_or_silent_fails() -> None:
    """Followed faster than the coupling allows, or held back and not said."""
    far = [STILL, *[pose((1, 0, 0))] * 10]

    def everywhere_at_once(scene: Scene) -> Simulator:
        return Simulator(scene.with_values({"coupling.max_speed": 1e4}))

    assert run(small(far)).kind == "degraded"
    assert "speed" in run(small(far), everywhere_at_once).failures[0]
    silent = fake(lambda sim, out: dataclasses.replace(out, status=out.status & ~Status.COMMAND_LIMITED))
    assert "COMMAND_LIMITED is not set" in run(small([STILL, *[pose((1, 0, 0))] * 60]), silent).failures[0]


def test_a_contact_that_sinks_in_fails() -> None:
    """A node that is deeper than its contact's spring gives, without a status bit."""

    def sinks(sim: Any, out: StepResult) -> StepResult:
        sim._state.x[sim._model.contact_nodes, 2] -= 1e-3
        return out

    assert any(failure.startswith("penetration") for failure in run(small(), fake(sinks)).failures)


def test_a_status_bit_degrades() -> None:
    """What is said is no failure."""
    outcome = run(small(), fake(fails_to_converge))
    assert (outcome.kind, outcome.status) == ("degraded", Status.ITERATION_LIMIT)


def test_what_is_refused() -> None:
    """A scene, a mesh or a command that an error names; and a command that is refused leaves the state."""
    assert run(small(dt=1.0)).kind == "refused"
    no_mesh = run(small(mesh={"beam": {"size": [1, 1, 1], "cells": [0, 1, 1]}}))
    assert no_mesh.kind == "refused"
    assert "cells" in no_mesh.said

    def refuses(scene: Scene) -> Simulator:
        raise MeshError("flat")

    assert run(small(), refuses).said == "flat"
    none_given = run(small([STILL, Pose(orientation=(0.0, 0.0, 0.0, 0.0)), STILL]))
    assert (none_given.kind, none_given.steps) == ("refused", 3)
    assert "orientation" in none_given.said


def test_verdicts() -> None:
    """The worst that can be said."""
    assert verdict(("x",), "y", Status.LOCKED) == "failed"
    assert verdict((), "y", Status.LOCKED) == "refused"
    assert verdict((), "", Status.LOCKED) == "degraded"
    assert verdict((), "", Status.OK) == "ok"


def test_a_body_that_stays_broken_fails() -> None:
    """It is let go by a simulator that does not move it; the true one heals it in the time stated."""
    case = DIRECTED["start_inside_out_held_elastic"]

    class Stuck(Simulator):
        def step(self, command: Pose | None = None) -> StepResult:
            x = self.positions.copy()
            out = super().step(command)
            self._state.x[:, :3], self._state.v[:] = x, 0.0
            return dataclasses.replace(out, status=Status.INVERTED)

    failures = run(case, Stuck).failures
    assert {failure.split(":")[0] for failure in failures} >= {"recovery", "broken"}
    healed = run(case)
    assert healed.recovery is not None
    assert 0.0 < healed.recovery < case.recovers


def test_a_step_that_strays_from_a_shared_matrix_is_taken_again() -> None:
    """One tetrahedron that hangs on a driven node: the matrix of 0.02 rad before had it thrown into the plane."""
    case = fuzz_case(0, 82)
    assert case.scene["solver"]["level"] == "lagged"
    assert run(case).failures == ()


def test_drift_and_force_fail() -> None:
    """A wrench that does not repeat from cycle to cycle, and one beyond the force stated."""
    case = small([*press_and_slide(), *move(pose((5e-3, 0, 0)), STILL, 50)])
    scene = case.scene | {"solver": case.scene["solver"] | {"tolerance": 1e-9}}
    case = dataclasses.replace(case, scene=scene, cycles=4)
    steady = run(case)
    assert steady.drift is not None
    assert steady.drift < 1e-6
    growing = fake(lambda sim, out: with_wrench(out, 1e-2 * out.time))
    assert any(failure.startswith("drift") for failure in run(case, growing).failures)
    assert run(dataclasses.replace(case, force_limit=1e-3)).failures[0].startswith("force")


def test_a_twin_is_met_up_to_a_rigid_motion() -> None:
    """Distance of nodes as they are, or after the best rotation and translation."""
    x = np.random.default_rng(0).standard_normal((9, 3))
    moved = x @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T + 3.0
    assert apart(x, x + [0.0, 3.0, 4.0], free=False) == pytest.approx(5.0)
    assert apart(moved, x, free=True) < 1e-12
    assert apart(-x, x, free=True) > 0.1


def test_the_same_seed_is_the_same_to_the_last_bit() -> None:
    """Cases and outcomes, with the positions and wrenches of every step; another seed is another."""
    first = [run(fuzz_case(3, index)) for index in range(3)]
    again = [run(fuzz_case(3, index)) for index in range(3)]
    assert digest(first) == digest(again)
    assert digest(first) != digest([run(fuzz_case(4, index)) for index in range(3)])
    assert {outcome.kind for outcome in first} != {"refused"}
    assert all(outcome.digest for outcome in first if outcome.kind != "refused")


def test_random_cases_reach_the_ends() -> None:
    """Every range of the contract is drawn from end to end, and every scene is one that a user could write."""
    scenes = [fuzz_case(SEED, index).scene for index in range(150)]
    decades = {"dt": (1e-6, 0.1), "young": (1.0, 1e12), "density": (1.0, 1e5)}
    for key, (low, high) in decades.items():
        values = [scene["dt"] if key == "dt" else scene["material"][key] for scene in scenes]
        assert low <= min(values) < 2.0 * low
        assert 0.5 * high < max(values) <= high
    poisson = [scene["material"]["poisson"] for scene in scenes]
    assert -0.9 <= min(poisson) < -0.85
    assert 0.4995 < max(poisson) <= 0.4999
    limits = [scene["limits"] for scene in scenes if "limits" in scene]
    assert {limit["projection"] for limit in limits} == {"hyperbolic", "isotropic", "tensor", "orthogonal", "linear"}
    assert any(limit["stretch"] == [1.0] * 3 for limit in limits)
    assert {scene["solver"]["method"] for scene in scenes} == {"newton", "pgs"}
    assert all(isinstance(Scene.from_dict(s), Scene) for s in scenes if "beam" in s["mesh"])


def test_a_written_case_repeats(tmp_path: Path) -> None:
    """`finger_sim run` on the folder gives the wrenches of the case, to the last bit."""
    case = fuzz_case(SEED, next(i for i in range(100) if "driven" in (s := fuzz_case(SEED, i).scene) and s["driven"]))
    folder = write(case, tmp_path / case.name, "to see")
    assert "finger_sim run scene.yaml --bag commands" in (folder / "README.txt").read_text()
    scene = Scene.load(folder / "scene.yaml")
    replay(scene, folder / "commands", tmp_path / "again")
    messages = BagReader(tmp_path / "again").messages(["/contact_wrench"])
    forces = [deserialize(message.data, WRENCH_STAMPED).wrench.force for message in messages]
    sim = Simulator(scene)
    assert case.motion[0] is not None
    sim.reset(case.motion[0])
    direct = [sim.step(command).contact_wrench[:3] for command in case.motion]
    np.testing.assert_array_equal([(f.x, f.y, f.z) for f in forces], direct)


def test_a_written_start_is_kept(tmp_path: Path) -> None:
    """What a bag cannot hold is beside it, and the README says so."""
    case = dataclasses.replace(DIRECTED["start_flat_held_newton"], cycles=2)
    folder = write(case, tmp_path / "flat", "to see")
    text = (folder / "README.txt").read_text()
    assert "start.npy" in text
    assert "one cycle of 2" in text
    np.testing.assert_array_equal(np.load(folder / "start.npy"), case.start)
    assert yaml.safe_load((folder / "scene.yaml").read_text())["dt"] == case.scene["dt"]


def test_motions() -> None:
    """Even steps, a sine of the amplitude stated, and the same motion in another frame."""
    way = move(STILL, pose((1.0, 0.0, 0.0)), 4)
    np.testing.assert_allclose([p.position[0] for p in way], [0.25, 0.5, 0.75, 1.0])
    wave = np.array([p.position for p in shake((0.0, 0.0, 0.01), 100.0, 1e-4, 100)])
    assert np.abs(wave).max() == pytest.approx(0.01)
    np.testing.assert_allclose(wave[[24, 49, 74, 99], 2], [0.01, 0.0, -0.01, 0.0], atol=1e-15)
    half_round = pose((0, 0, 5), (0, np.pi, 0))
    first, none = carried([pose((1, 0, 0)), None], half_round)
    assert none is None
    assert first is not None
    np.testing.assert_allclose(first.position, [-1, 0, 5], atol=1e-15)


def outcome(name: str, family: str, kind: Any, **worst: Any) -> Outcome:
    return Outcome(name, family, kind, **worst)


def test_the_table_counts_by_family() -> None:
    """Counts of each kind and the worst of each family, then of all."""
    some = (
        outcome("a", "jump", "ok", strain_ratio=1.5, recovery=0.1),
        outcome("b", "jump", "failed", failures=("hang: no end",), recovery=0.3),
        outcome("c", "dt", "refused", said="no"),
    )
    families = [(name, len(group)) for name, group in by_family(some)]
    assert families == [("jump", 2), ("dt", 1), ("all", 3)]
    cells = [list(column.cells) for column in summary(Report(some, 0, ())).columns]
    assert cells[0] == ["jump", "dt", "all"]
    assert cells[5] == ["1", "0", "1"]
    assert cells[9] == ["0.3", "", "0.3"]


def test_the_verb(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A table, exit code 0; with a failure its folder and what was wrong, exit code 1; never over an old folder."""
    monkeypatch.setattr("finger_sim.studies.stress.stress.directed", lambda long: [small()])
    out = tmp_path / "failed"
    assert main(["stress", "--cases", "1", "--seed", "11", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert printed.out.split("\n")[0].split()[:6] == ["family", "cases", "ok", "degraded", "refused", "failed"]
    assert not out.exists()
    monkeypatch.setattr(stress_run, "DRIFT", -1.0)
    assert main(["stress", "--cases", "0", "--out", str(out)]) == 1
    printed = capsys.readouterr()
    assert "drift" in printed.out
    assert str(out / "small") in printed.err
    assert (out / "small" / "scene.yaml").is_file()
    assert main(["stress", "--cases", "0", "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_time_runs_out() -> None:
    """No case begins after the minutes are over, and the report counts those left out."""
    report = stress(Options(cases=5, minutes=1e-9))
    assert len(report.outcomes) == 0
    assert report.left_out == 5 + len(DIRECTED)


def test_the_picture_has_every_case() -> None:
    """A bar for each family, divided by how its cases ended."""
    pytest.importorskip("matplotlib")
    from finger_sim.studies.stress.stress import make_figure

    some = (
        outcome("a", "x", "ok"),
        outcome("b", "x", "failed"),
        outcome("c", "y", "degraded"),
        outcome("d", "x", "ok"),
    )
    axes = make_figure(Report(some, 0, ())).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["x", "y"]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "ok 2", "degraded 1", "refused 0", "failed 1"
    ]  # fmt: skip
    ends = sorted(bar.get_x() + bar.get_width() for bar in axes.patches if bar.get_width())
    assert ends == [1.0, 2.0, 3.0]

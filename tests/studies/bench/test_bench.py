"""`finger_sim bench`: its arithmetic on made-up times, one tiny run of all of it, and what it refuses."""

from __future__ import annotations

import json
import math
import os
import re
import time
from typing import Any

import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose, assert_array_equal

from finger_sim import Pose, Simulator
from finger_sim.cli import main
from finger_sim.errors import MissingExtraError
from finger_sim.physics.clock import STAGES
from finger_sim.studies.bench import bench as bench_module
from finger_sim.studies.bench import peers
from finger_sim.studies.bench.before import BEFORE
from finger_sim.studies.bench.figures import (
    MUJOCO,
    Figure,
    Key,
    Records,
    by_repetition,
    errors,
    figures,
    median_and_p99,
    ratio,
    unsteadiness,
)
from finger_sim.studies.bench.scenes import DEPTH, FLAT, GAP, PHASES, SPEED, Record, finger_scene, press_and_slide

COLUMNS = {
    "size", "phase", "scene", "contender", "steps", "repeats", "median_us", "p99_us",
    "ratio_to_mujoco", "ratio_to_before",
    "iterations_median", "iterations_max", "residual_max", "converged", "error_rms", "error_max",
    "limit_rows_median", "limited_tets_median", "status",
}  # fmt: skip


class Ghost:
    """A peer that nothing touches."""

    name = "a ghost"

    def __init__(self, case: peers.PeerCase) -> None:
        self._points = case.points

    def step(self, targets: Any) -> None:
        assert targets.shape[1] == 3

    def force(self) -> Any:
        return np.zeros(3)

    def positions(self) -> Any:
        return self._points


def no_neo_hookean(case: peers.PeerCase, *, neo_hookean: bool = False) -> peers.Peer:
    raise MissingExtraError("MuJoCo 4.0", "peers")


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A tiny run through the command line, with a ghost for MuJoCo and without Drake: the JSON, and what else."""
    folder = tmp_path_factory.mktemp("bench")
    allowed = os.sched_getaffinity(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(peers, "_PEERS", {MUJOCO: ("json", Ghost), "Drake": ("no_such_module", Ghost)})
        patch.setattr(peers, "mujoco_peer", no_neo_hookean)
        code = main(
            ["bench", "--quick", "--steps", "0.02", "--repeats", "2"]
            + ["--json", str(folder / "out.json"), "--plot", str(folder / "out.png")]
        )
    assert code == 0
    assert os.sched_getaffinity(0) == allowed
    assert (folder / "out.png").read_bytes().startswith(b"\x89PNG")
    data: dict[str, Any] = json.loads((folder / "out.json").read_text())
    return data


def test_rows_are_complete(ran: dict[str, Any]) -> None:
    """Every contender in every phase; p99 no less than the median; errors finite, small where converged."""
    assert {row["phase"] for row in ran["rows"]} == set(PHASES)
    ours = [row for row in ran["rows"] if row["contender"] != MUJOCO]
    assert {row["contender"] for row in ours} == {"newton", "lagged", "pgs"}
    assert {row["scene"] for row in ours} == {"limits", "limited", "no limits"}
    for row in ran["rows"] + ran["cantilever"]:
        assert set(row) == COLUMNS
        assert row["steps"] >= 1
        assert row["repeats"] == 2
        assert 0.0 < row["median_us"] <= row["p99_us"]
        assert 0.0 <= row["error_rms"] <= row["error_max"]
    for row in ours:
        assert row["error_max"] < 0.03
        assert row["converged"] == 1.0
        assert row["residual_max"] <= 1e-3
        assert "ITERATION_LIMIT" not in row["status"]


def test_limits_are_reached(ran: dict[str, Any]) -> None:
    """In the scene of that name nearly every tetrahedron is at one; in free air none is."""
    for row in ran["rows"]:
        if row["scene"] == "limited":
            assert row["limited_tets_median"] > 270 if row["phase"] == "slide" else row["limited_tets_median"] >= 0
        if row["phase"] == "air" and row["contender"] != MUJOCO:
            assert row["limited_tets_median"] == 0


def test_a_peer_stands_beside_its_own_error(ran: dict[str, Any]) -> None:
    """The ghost feels nothing, an error of all the force there is; it is the unit of all ratios."""
    ghosts = [row for row in ran["rows"] if row["contender"] == MUJOCO]
    assert [row["ratio_to_mujoco"] for row in ghosts] == [1.0, 1.0, 1.0]
    assert [row["iterations_median"] for row in ghosts] == [None, None, None]
    assert 0.99 < max(row["error_max"] for row in ghosts) <= 1.0
    medians = {(row["phase"], row["contender"]): row["median_us"] for row in ran["rows"] if row["scene"] == "no limits"}
    row = next(r for r in ran["rows"] if (r["phase"], r["scene"], r["contender"]) == ("slide", "no limits", "newton"))
    assert_allclose(row["ratio_to_mujoco"], medians["slide", "newton"] / medians["slide", MUJOCO], rtol=1e-12)


def test_missing_peers_are_named(ran: dict[str, Any]) -> None:
    """With the reason, and the extra to install."""
    assert ran["peers"][MUJOCO] == "a ghost"
    assert ran["peers"]["Drake"].startswith("missing: No module named 'no_such_module'")
    assert "[peers]" in ran["peers"]["Drake"]
    assert ran["peers"]["MuJoCo nH"].startswith("missing: ")


def test_stages_and_machine_are_told(ran: dict[str, Any]) -> None:
    """Microseconds of every stage for every staged contender and phase; versions, processor and command.

    Half of the steps may make no factors.
    """
    assert {stage["phase"] for stage in ran["stages"]} == set(PHASES)
    for stage in ran["stages"]:
        assert set(stage) == {"size", "phase", "scene", "contender"} | {f"{name}_us" for name in STAGES}
        assert all(stage[f"{name}_us"] > 0.0 for name in STAGES if name != "factor")
        assert stage["factor_us"] >= 0.0
    assert ran["machine"]["command"].startswith("finger_sim bench --quick --steps 0.02")
    assert {"python", "numpy", "numba", "mujoco", "drake"} <= set(ran["machine"]["versions"])
    assert ran["scenes"]["base"]["material"]["young"] == 2e6


def test_figures_are_told(ran: dict[str, Any]) -> None:
    """Sixteen, each with unit and goals; those not asked for have no value; nothing is allocated."""
    assert len(ran["figures"]) == 16
    by_name = {figure["name"]: figure for figure in ran["figures"]}
    assert all(figure["unit"] and figure["must"] is not None for figure in ran["figures"])
    assert by_name["allocations of compiled code"]["value"] == 0.0
    for name in (
        "16,000 tets, press + slide",
        "patch against element on the same mesh, whole step, press + slide",
        "process start to ready, compiled before",
    ):
        assert by_name[name]["value"] is None
        assert by_name[name]["reached"] == "not measured"
    assert by_name["newton against pgs, ≥ 270 tets at a limit"]["value"] > 0.0


def test_percentiles_are_numpys() -> None:
    """Median, p99, ratio of medians and p99/median of known samples; nothing of nothing."""
    a, b = np.random.default_rng(1).lognormal(size=(2, 3, 117))
    assert_allclose(median_and_p99(a), [np.median(a), np.percentile(a, 99)], rtol=1e-15)
    assert_allclose(ratio(a, b), np.median(a) / np.median(b), rtol=1e-15)
    assert_allclose(unsteadiness(a), np.percentile(a, 99) / np.median(a), rtol=1e-15)
    ratios = [np.median(a[k]) / np.median(b[k]) for k in range(3)]
    assert by_repetition(a, b) == f", by repetition {min(ratios):.3g} to {max(ratios):.3g}"
    assert by_repetition(a[:1], b[:1]) == ""
    assert math.isnan(ratio(a, np.empty((0, 0))))
    assert math.isnan(median_and_p99(np.empty(0))[0])


def test_errors_are_shares_of_the_peak() -> None:
    """Off by (3, 4, 0) in one of four steps, peak 50 in a step that is not looked at."""
    reference = np.zeros((5, 3))
    reference[4, 2] = 50.0
    answer = reference.copy()
    answer[1, :2] = 3.0, 4.0
    answer[4] = 1e9
    mask = np.array([True, True, True, True, False])
    assert_allclose(errors(answer, reference, mask), [0.05, 0.1], rtol=1e-12)
    assert np.isnan(errors(answer, reference, np.zeros(5, np.bool_))).all()


def test_figures_look_at_the_steps_they_name() -> None:
    """Each at its phases, scene and contender, MuJoCo's in the same phase; newton and pgs where both hold many."""
    records = Records()
    records.phase |= {size: np.array([0, 1, 2, 2, 2]) for size in (350, 900, 16000)}

    def put(size: int, scene: str, contender: str, times: list[float], tets: list[int], off: float = 0.0) -> None:
        record, reference = Record.empty(1, 5), Record.empty(1, 5)
        record.seconds[0], record.limited_tets[:], record.answer[:], reference.answer[:] = times, tets, 1.0, 1.0
        record.answer[2:] += off
        records.of[Key(size, scene, contender)], records.reference[Key(size, scene, contender)] = record, reference

    put(350, "limits", "newton", [9.0] * 5, [0] * 5)
    put(350, "limits", "lagged", [1.0, 2.0, 3.0, 4.0, 5.0], [0] * 5)
    put(350, "limited", "lagged", [1.0, 2.0, 6.0, 6.0, 7.0], [0] * 5)
    put(350, "limited", "newton", [1.0, 1.0, 1.0, 1.0, 2.0], [0, 270, 269, 270, 300])
    put(350, "limited", "pgs", [1.0, 1.0, 1.0, 9.0, 24.0], [0, 269, 300, 300, 300])
    put(350, "no limits", MUJOCO, [4.0, 10.0, 10.0, 20.0, 60.0], [0] * 5)
    put(900, "limits", "patch lagged", [1.0, 7.0, 8.0, 9.0, 9.0], [0] * 5, off=1e-3)
    put(900, "limits", "lagged", [1.0, 6.0, 7.0, 8.0, 9.0], [0] * 5)
    put(16000, "limits", "lagged", [9.0, 1 / 64, 1 / 64, 1 / 64, 1 / 16], [0] * 5)
    put(900, "no limits", MUJOCO, [1.0, 100.0, 100.0, 100.0, 100.0], [0] * 5)
    by_name = {figure.name: figure for figure in figures(records, {"p99": (1.2, "made up")})}
    before = {phase: BEFORE[350, "limits", phase] for phase in PHASES}
    goals = {
        "350 tets, free air, to newton before": (1.0 / 4.0 / before["air"], "no"),
        "350 tets, press, to newton before": (2.0 / 10.0 / before["press"], "no"),
        "350 tets, slide, to newton before": (4.0 / 20.0 / before["slide"], "no"),
        "350 tets, slide, four in five at a limit, to newton before": (
            6.0 / 20.0 / BEFORE[350, "limited", "slide"],
            "no",
        ),
        "default mesh with patches, press + slide, to a slide of 350 tets before": (8.5 / 20.0 / before["slide"], "no"),
        "the same, p99/median, to that of fixed work": (1.2, "aim"),
        "the same, error of force, rms": (0.1, "no"),
        "350 tets, press + slide, to MuJoCo": (3.5 / 15.0, "no"),
        "default mesh, press + slide, to MuJoCo on it": (7.5 / 100.0, "must"),
        "the same with patches, which MuJoCo has not": (8.5 / 100.0, "no"),
        "16,000 tets, press + slide": (4.0 / (1.0 / 64.0 + 1.0 / 64.0 + 1.0 / 64.0 + 1.0 / 16.0), "no"),
        "newton against pgs, ≥ 270 tets at a limit": (16.5 / 1.5, "must"),
    }
    for name, (value, reached) in goals.items():
        assert_allclose(by_name[name].value, value, rtol=1e-9, err_msg=name)
        assert by_name[name].reached == reached
    rows = {(row.phase, row.scene, row.contender): row for row in records.rows() if row.size == 350}
    assert_allclose(rows["slide", "limits", "lagged"].ratio_to_before, 4.0 / 20.0 / before["slide"], rtol=1e-12)
    assert math.isnan(rows["slide", "limited", "pgs"].ratio_to_before)


def test_goals_hold_at_their_bounds() -> None:
    """Equal is reached, either way round."""
    assert Figure("a", 2.0, "s", 3.0, 2.0, "lower").reached == "aim"
    assert Figure("a", 20.0, "1/s", 20.0, 60.0, "higher").reached == "must"
    assert Figure("a", 19.0, "1/s", 20.0, 60.0, "higher").reached == "no"


def test_the_motion_is_at_one_speed_to_full_depth() -> None:
    """Every step is as long as the next, of any share; the lowest is DEPTH under touch; phases follow each other."""
    for scale in (1.0, 0.1, 1e-6):
        motion = press_and_slide(0.007, 1e-3, scale)
        x = np.array([motion.start.position, *(pose.position for pose in motion.poses)])
        lengths = np.linalg.norm(np.diff(x, axis=0), axis=1)
        assert_allclose(lengths[lengths > 1e-9], SPEED * 1e-3, rtol=1e-9)
        assert_allclose([x[0, 2], x[:, 2].min()], [0.007 + GAP, 0.007 - DEPTH], rtol=1e-12)
        assert_array_equal(np.unique(motion.phase), [0, 1, 2])
        assert (np.diff(motion.phase) >= 0).all()
    assert len(press_and_slide(0.0, 1e-3).poses) == 100 + 110 + 100 + 250


def test_stage_seconds_fit_into_the_step() -> None:
    """They add up to no more than the wall clock, start anew with a reset, and do not change what is computed."""
    scene = finger_scene(350, "limits")
    plain, timed = Simulator(scene), Simulator(scene, timed=True)
    down = [Pose((0.0, 0.0, 0.006 - 2e-5 * k), FLAT) for k in range(20)]
    plain.reset(down[0])
    timed.reset(down[0])
    assert plain.stage_seconds == {}
    assert timed.stage_seconds == dict.fromkeys(STAGES, 0.0)
    begun = time.perf_counter()
    for pose in down:
        out = timed.step(pose)
    wall = time.perf_counter() - begun
    assert all(seconds > 0.0 for seconds in timed.stage_seconds.values())
    assert sum(timed.stage_seconds.values()) <= wall
    assert_array_equal([plain.step(pose) for pose in down][-1].contact_wrench, out.contact_wrench)
    timed.reset()
    assert timed.stage_seconds == dict.fromkeys(STAGES, 0.0)


def test_patches_stand_beside_elements(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """With the default mesh one more figure, a ratio of medians of runs that took turns, said with their times."""
    monkeypatch.setattr(bench_module, "CONTENDERS", {900: [("limits", "patch")]})
    monkeypatch.setattr(bench_module, "STAGED", [])
    report = bench_module.bench(bench_module.Options((900,), 1, 0.01, peers=False, startup=False))
    by_name = {figure.name: figure for figure in report.figures}
    figure = by_name["patch against element on the same mesh, whole step, press + slide"]
    ours, theirs = map(float, re.findall(r"(\d+) µs", figure.note))
    assert_allclose(figure.value, ours / theirs, rtol=0.02)
    assert {row.contender for row in report.rows} == {"patch"}
    assert max(row.error_max for row in report.rows) < 0.03


def test_absent_peers_cost_the_ratios_only(capsys: pytest.CaptureFixture[str]) -> None:
    """With --no-peers the run succeeds, says so, and leaves out what needs them."""
    assert main(["bench", "--quick", "--no-peers", "--steps", "0.01"]) == 0
    out = capsys.readouterr().out
    said = next(line for line in out.splitlines() if line.startswith("MuJoCo "))
    assert said.split()[1:] == ["not", "asked", "for"]
    assert "no MuJoCo to compare with" in out


@for_each(
    "arguments, says",
    [
        (["--sizes", "350", "500"], "--sizes: got 500, allowed: 350, 900, 2000, 4000"),
        (["--repeats", "0"], "--repeats: got 0"),
        (["--steps", "1000"], "--steps: got 1000"),
        (["--cpu", "99999"], "--cpu: got 99999, allowed: 0"),
        (["--json", "no/such/folder/a.json"], "--json: got no/such/folder/a.json"),
        (["--json", "."], "--json: got ."),
        (["--plot", "a.txt"], "--plot: got a.txt, allowed: a name that ends in .png"),
    ],
)
def test_mistakes_are_said_before_anything_runs(
    capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    """One line, exit code 2."""
    assert main(["bench", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"finger_sim: error: {says}")
    assert err.count("\n") == 1

"""Steps a second by tetrahedra at a limit: how they are grouped, and that the motions reach what is grouped."""

from __future__ import annotations

import itertools
import types

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from finger_sim import Pose, Scene, Status
from finger_sim.bags.reader import read_commands
from finger_sim.physics.rotations import matrix
from finger_sim.scene.resources import find_bag
from finger_sim.studies import shared
from finger_sim.studies.paper import speed
from finger_sim.studies.paper.figures import plain
from finger_sim.studies.paper.speed import CONTENDERS, FEWEST, PIECE, Result, Timings

pytestmark = pytest.mark.slow


def ignore(done, total):
    """Told of progress."""


def course(rates, status=0):
    """One repetition of ten steps for each number of tetrahedra {tets: steps a second}."""
    tets = np.repeat(list(rates), 10)[None, :]
    seconds = np.repeat([1.0 / rate for rate in rates.values()], 10)[None, :]
    return Timings(seconds, tets, np.full(tets.shape, status))


def synthetic(slowest=300.0):
    """Every contender falling from 5000 Hz to `slowest` with 200 tetrahedra at a limit."""
    tets = np.array([0, 2, 7, 15, 30, 60, 120, 200])
    rates = dict(zip(tets.tolist(), np.geomspace(5000.0, slowest, len(tets)), strict=True))
    return Result({name: course(rates) for name in CONTENDERS}, 1e-3, {"cpu": "a processor"})


@pytest.fixture(scope="module")
def measured():
    """All contenders into the first press, twice."""
    return speed.measure(ignore, repeats=2, steps=1100)


def test_groups_hold_every_step_once():
    """Bounds belong to the group that they open; what is beyond the last belongs to it; empty ones are left out."""
    tets = np.array([[0, 1, 4, 5, 9, 10, 39], [40, 79, 160, 161, 350, 0, 3]])
    groups = speed.groups(tets, np.full(tets.shape, 0.01))
    assert [(group.fewest, group.most, group.steps) for group in groups] == [
        (0, 0, 2),
        (1, 4, 3),
        (5, 9, 2),
        (10, 19, 1),
        (20, 39, 1),
        (40, 79, 2),
        (160, None, 3),
    ]


def test_groups_are_of_rates():
    """Median and tenths of steps a second, not of seconds; the tetrahedra are the median of those in the group."""
    seconds = 1.0 / np.arange(1.0, 12.0)
    groups = speed.groups(np.array([10] * 6 + [14] * 5), seconds)
    assert len(groups) == 1
    assert_allclose(groups[0][3:], (10.0, 6.0, 2.0, 10.0))


def test_above_is_beyond_the_paper_s_number():
    """41 counts, 40 does not; nothing there: None."""
    assert speed.above(course({0: 900.0, 40: 800.0, 41: 700.0, 90: 600.0})).steps == 20
    assert speed.above(course({0: 900.0, 40: 800.0})) is None


def test_commands_of_a_bag_are_the_newest_received():
    """By a loop over the bag, at steps of 0.7 ms."""
    scene = Scene.load("finger").with_values({"dt": 7e-4})
    commands = read_commands(find_bag(speed.SLIDE))
    poses = shared.poses(scene, speed.SLIDE)
    assert len(poses) == int(np.ceil(commands.duration / scene.dt))
    for k in (0, 1, 2, 500, 2001, len(poses) - 1):
        newest = max(i for i in range(len(commands)) if commands.receipt[i] <= k * scene.dt + 1e-9)
        assert_array_equal(poses[k].position, commands.position[newest])
        assert_array_equal(poses[k].orientation, commands.orientation[newest])


def test_the_side_press_goes_7_mm_below_touch():
    """And begins and ends where the finger just touches; on its side, e3 is up."""
    scene = Scene.load("finger_paper")
    who = speed.CONTENDERS["rigid hyperbolic, pgs"]
    assert who.bag is None
    poses, points = speed.motion_of(who, scene), scene.load_mesh().points
    turn = matrix(poses[0].orientation)
    height = np.array([pose.position[2] for pose in poses]) + (points @ turn.T)[:, 2].min()
    assert_allclose(height[[0, -1]], 0.0, atol=1e-9)
    assert height.min() == pytest.approx(-7e-3, abs=1e-8)
    assert turn[2, 2] > 0.98


def test_contenders_take_turns():
    """PIECE steps each, in order, from the first to the last; every repetition from a reset."""
    said = []

    class Fake:
        def __init__(self, name):
            self.name = name

        def reset(self, pose):
            said.append((self.name, "reset", pose.position[0]))

        def step(self, pose):
            said.append((self.name, "step", pose.position[0]))
            return types.SimpleNamespace(limited_tets=int(pose.position[0]) % 7, status=Status.LOCKED)

    motions = {name: [Pose((float(k), 0.0, 0.0)) for k in range(count)] for name, count in (("a", 250), ("b", 120))}
    seen = []
    found = speed.timed({name: Fake(name) for name in motions}, motions, 2, lambda *done: seen.append(done))
    once = [("a", "reset", 0.0), ("b", "reset", 0.0)]
    for first in (0, PIECE, 2 * PIECE):
        for name, count in (("a", 250), ("b", 120)):
            once += [(name, "step", float(k)) for k in range(first, min(first + PIECE, count))]
    assert said == 2 * once
    assert_array_equal(found["b"].tets, np.tile(np.arange(120) % 7, (2, 1)))
    assert (found["a"].status == Status.LOCKED).all()
    assert (found["a"].seconds > 0.0).all()
    assert [done / total for done, total in seen] == sorted(done / total for done, total in seen)


def test_a_motion_repeats(measured):
    """The same tetrahedra are at their limits each time: times of repetitions are of the same steps."""
    for name, found in measured.courses.items():
        assert found.tets.shape == (2, 1100)
        assert_array_equal(found.tets[0], found.tets[1], err_msg=name)
        assert np.isfinite(found.seconds).all(), name
        assert (found.seconds > 0.0).all(), name


def test_motions_reach_every_group(measured):
    """Those of the bag up to 80 tetrahedra and more by the end of the press, the paper's finger to 39 or 40."""
    for name, who in CONTENDERS.items():
        found = measured.courses[name]
        groups = speed.groups(found.tets, found.seconds)
        assert sum(group.steps for group in groups) == found.tets.size
        most = 80 if who.bag else 20
        assert {group.fewest for group in groups} >= {fewest for fewest in FEWEST if fewest <= most}, name


def test_solvers_bound_the_same_tetrahedra(measured):
    """`pgs` and `newton` solve one step: within a few tetrahedra of each other all along."""
    pgs, newton = (measured.courses[f"hyperbolic, {method}"].tets[0] for method in ("pgs", "newton"))
    assert np.abs(pgs - newton).max() <= 25
    assert np.abs(pgs - newton).mean() < 1.0


def test_findings_judge_by_the_paper_s_words():
    """Real time: 1/dt with 1 to 4 tetrahedra. The paper's drop: only if nobody stays above 1 Hz."""
    fast = speed.findings(synthetic())
    assert [finding.agrees for finding in fast] == [True, False]
    assert "rigid hyperbolic, pgs: " in fast[1].measured
    assert fast[1].reason
    slow = speed.findings(synthetic(slowest=1e-3))
    assert slow[1].agrees
    slower = Result({name: course({2: 500.0, 50: 20.0}) for name in CONTENDERS}, 1e-3, {"cpu": "a processor"})
    assert not speed.findings(slower)[0].agrees


def test_numbers():
    """Plain values; above 40 the median over the paper's 1 Hz; steps that were not solved are counted."""
    result = synthetic()
    result.courses["tensor, newton"] = course({0: 8000.0, 50: 2000.0, 100: 1000.0, 150: 500.0}, Status.ITERATION_LIMIT)
    found = plain(speed.numbers(result))
    assert found["real_time_hz"] == 1000.0
    assert found["cpu"] == "a processor"
    assert found["contenders"]["hyperbolic, pgs"]["solved_steps"] == 1.0
    tensor = found["contenders"]["tensor, newton"]
    assert tensor["solved_steps"] == 0.0
    assert tensor["most_tets"] == 150
    assert tensor["above_40"]["steps"] == 30
    assert tensor["above_40"]["over_paper"] == pytest.approx(1000.0)
    assert [group["tets_from"] for group in tensor["groups"]] == [0, 40, 80]


def test_the_picture():
    """A curve of medians for each contender; under 1 Hz right of 40 is shaded; no text lies on another."""
    pytest.importorskip("matplotlib")
    result = synthetic()
    figure = speed.draw(result)
    (axes,) = figure.axes
    curves = {line.get_label(): line.get_xydata() for line in axes.lines if not line.get_label().startswith("_")}
    assert len(curves) == len(CONTENDERS)
    groups = speed.groups(*(getattr(result.courses["tensor, newton"], name) for name in ("tets", "seconds")))
    assert_allclose(curves["tensor, newton (finger_haptic)"], [(group.tets, group.median) for group in groups])
    corner = axes.collections[0].get_paths()[0].get_extents()
    assert (corner.x0, corner.y1) == (40.0, 1.0)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    texts = [*figure.texts, *axes.texts, *axes.get_legend().get_texts(), axes.xaxis.label, axes.yaxis.label]
    boxes = [text.get_window_extent(renderer) for text in texts if text.get_text()]
    assert len(boxes) >= 10
    assert not [(a, b) for a, b in itertools.combinations(boxes, 2) if a.overlaps(b)]
    assert all(box.x0 >= 0.0 and box.y0 >= 0.0 and box.x1 <= figure.bbox.width for box in boxes)

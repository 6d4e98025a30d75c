"""The parts of a fit by themselves: unknowns, ways, intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from cases import for_each
from fit.block import LEVEL, block

from finger_sim.fit.model import Residuals, curve, needs_time
from finger_sim.fit.parameters import Unknown, allowed, changes, default_names, unknowns_of
from finger_sim.fit.press import FitError, Press, at_rest_path, timed_path
from finger_sim.fit.simulate import Run
from finger_sim.fit.solve import Solution, centres, solve
from finger_sim.fit.uncertainty import bootstrap, left_out, linear_errors, local, profile, quantile


def press(depth: np.ndarray, along: np.ndarray | None = None, seconds: float = 1.0) -> Press:
    """Samples at these depths [m] of a body that touches at height 0.02 m."""
    n = len(depth)
    position = np.stack([np.zeros(n) if along is None else along, np.zeros(n), 0.02 - depth], axis=1)
    time = np.linspace(0.0, seconds, n)
    return Press("p", "pose", time, position, np.tile(LEVEL, (n, 1)), 0.02, np.maximum(depth, 0.0))


DENSE = press(-3e-4 + 2.1e-3 * np.sin(np.linspace(0.0, math.pi, 700)))
SPARSE = press(np.array([-1e-4, 4e-4, 9e-4, 1.6e-3, 8e-4, 1e-4]))


@for_each(
    "given, coarse, finer", [(DENSE, 1.0, 1), (DENSE, 2.0, 1), (DENSE, 1.0, 2), (SPARSE, 1.0, 1), (SPARSE, 1.0, 2)]
)
def test_a_force_between_two_moments_is_exponential(given, coarse, finer):
    """A law of fingertips that is computed at the moments of a way comes out at the samples, to a thousandth."""
    way = at_rest_path(given, coarse=coarse, finer=finer)
    below = given.touch - way.poses[:, 2]
    force = np.zeros((len(below), 3))
    force[:, 2] = np.where(below > 0.0, 0.3 * np.exp(2500.0 * below), 0.0)
    found = curve(given, way, Run(force, np.full(len(below), np.nan), np.zeros(6)), 1.0)
    depth = given.depth[way.used]
    there = depth > 2e-4
    np.testing.assert_allclose(found.normal[there], 0.3 * np.exp(2500.0 * depth[there]), rtol=2e-3)
    assert np.linalg.norm(np.diff(way.poses[:, :3], axis=0), axis=1).max() < (1.6 * coarse * 1e-4 + 1e-5) / finer
    np.testing.assert_array_equal(way.group, at_rest_path(given, coarse=coarse).group)


def test_a_way_in_time_is_where_the_finger_was():
    """A command at a step's time is the sample of that time; samples between steps lie between."""
    way = timed_path(DENSE, 1e-3)
    at = way.poses[way.after - 1] + (way.poses[way.after] - way.poses[way.after - 1]) * way.part[:, None]
    np.testing.assert_allclose(at[:, :3], DENSE.position[way.used], atol=2e-6)
    assert (np.linalg.norm(np.diff(way.poses[:, :3], axis=0), axis=1) < 2e-5).all()


def test_unknowns_and_their_values():
    """Names, ties, bounds and priors; what θ writes into the scene is what is told of it."""
    scene = block()
    found = unknowns_of(
        scene, ["material.young", "stretch.e13", "limits.compress.e2", "friction"], ["a"],
        {"young": (1e3, 1e5)}, {"compress.e2": (0.9, 1.5)},
    )  # fmt: skip
    assert [one.name for one in found] == ["young", "stretch.e13", "compress.e2", "friction"]
    theta = [math.log(3e4), math.log(0.2), math.log(0.07), math.log(0.6)]
    values = changes(found, scene, theta)
    assert values["limits.stretch"] == pytest.approx([1.2, 1.3, 1.2])
    assert values["limits.compress"] == pytest.approx([0.95, 0.93, 0.95])
    assert scene.with_values(values).material.young == pytest.approx(3e4)
    assert [one.told(t) for one, t in zip(found, theta, strict=True)] == pytest.approx([3e4, 1.2, 0.93, 0.6])
    assert (found[0].low, found[0].high) == (1e3, 1e5)
    assert (found[2].centre, found[2].factor) == (pytest.approx(0.1), 1.5)
    assert default_names(scene) == [
        "young",
        *(f"{side}.e{axis}" for side in ("stretch", "compress") for axis in (1, 2, 3)),
    ]


@for_each(
    "names, bounds, priors, words",
    [
        (["youngs"], {}, {}, "got 'youngs', allowed: young, stiffness, damping, friction, stretch"),
        (["stretch.e4"], {}, {}, "allowed: stretch, stretch.e1"),
        (["stretch", "stretch.e2"], {}, {}, "stretch.e2: fitted twice"),
        (["young"], {"friction": (0.1, 1.0)}, {}, "--bound: friction: not fitted; fitted are young"),
        (["stretch.e1"], {"stretch.e1": (0.9, 1.2)}, {}, "--bound: stretch.e1: got 0.9:1.2"),
        (["young"], {}, {"young": (1e4, 0.5)}, "--prior: young"),
    ],
)
def test_what_cannot_be_fitted_is_named(names, bounds, priors, words):
    with pytest.raises(FitError) as error:
        unknowns_of(block(), names, ["a"], bounds, priors)
    assert words in str(error.value)


TERMS = [{"time": 0.01, "share": 0.3}, {"time": 1.0, "share": 0.2}]


def test_terms_of_what_relaxes():
    """Names, units, bounds and what is written; the other term and the other value of a term stay."""
    scene = block(material__relaxation=TERMS)
    found = unknowns_of(scene, ["material.relaxation.2.time", "share.1"], [], {"share.1": (0.1, 0.5)})
    assert [(one.name, one.unit, one.timed) for one in found] == [("time.2", "s", True), ("share.1", "", True)]
    assert (found[0].low, found[0].high) == (pytest.approx(0.1), 1e4)
    assert (found[1].low, found[1].high) == (0.1, 0.5)
    values = changes(found, scene, [math.log(2.5), math.log(0.4 / 0.6)])
    assert [list(term) for term in values["material.relaxation"]] == [["time", "share"]] * 2
    np.testing.assert_allclose([list(t.values()) for t in values["material.relaxation"]], [[0.01, 0.4], [2.5, 0.2]])
    assert [one.told(t) for one, t in zip(found, [0.0, math.log(3.0)], strict=True)] == pytest.approx([1.0, 0.75])
    assert found[1].theta(found[1].amount(0.7)) == pytest.approx(0.7)
    assert needs_time(scene, unknowns_of(scene, ["young"], []))
    assert not needs_time(scene.with_values({"material.relaxation": []}), unknowns_of(scene, ["young"], []))


def test_shares_leave_something_whatever_is_tried():
    """0.9 and 0.9 are scaled down to 0.49 each, beside 0.2 that is not fitted to 0.39; what is less stays as it is."""
    three = block(material__relaxation=[*TERMS, {"time": 50.0, "share": 0.2}])
    for scene, most in ((block(material__relaxation=TERMS), 0.98), (three, 0.78)):
        both = unknowns_of(scene, ["share.1", "share.2"], [])
        theta = [one.theta(0.9) for one in both]
        shares = [term["share"] for term in changes(both, scene, theta)["material.relaxation"]]
        assert shares[:2] == pytest.approx([most / 2.0] * 2)
        assert shares[2:] == [0.2] * (len(shares) - 2)
        scene.with_values(changes(both, scene, theta))
        np.testing.assert_allclose(
            [one.amount(t) for one, t in zip(both, allowed(both, scene, theta), strict=True)], most / 2
        )
        less = [both[0].theta(0.5), both[1].theta(0.1)]
        np.testing.assert_array_equal(allowed(both, scene, less), less)


@for_each(
    "terms, names, bounds, words",
    [
        ([], ["share.1"], {}, "share.1: the scene has no material.relaxation, allowed: a scene with terms"),
        (TERMS, ["share.3"], {}, "got 'share.3', allowed with the 2 terms of material.relaxation: share.1, share.2"),
        (TERMS, ["time"], {}, "got 'time', allowed with the 2 terms of material.relaxation: time.1, time.2"),
        (TERMS, ["time.1", "time.1"], {}, "time.1: fitted twice"),
        (TERMS, ["share.1"], {"share.1": (0.1, 1.0)}, "--bound: share.1: got 0.1:1"),
        ([{"time": 1.0, "share": 0.0}], ["share.1"], {}, "share.1: it is 0 in the scene"),
    ],
)
def test_terms_that_cannot_be_fitted_are_named(terms, names, bounds, words):
    with pytest.raises(FitError) as error:
        unknowns_of(block(material__relaxation=terms), names, [], bounds)
    assert words in str(error.value)


def test_what_rests_and_what_is_followed_in_time():
    """Damping shows only in time; limits other than `tensor` give other forces in long steps."""
    young, damping = (unknowns_of(block(), [name], []) for name in ("young", "damping"))
    assert not needs_time(block(), young)
    assert not needs_time(block(limits=None), young)
    assert needs_time(block(), damping)
    assert needs_time(block(limits__projection="hyperbolic"), young)


def test_free_axes_and_missing_blocks_are_named():
    """A limit needs a value to begin with; isotropic limits are one."""
    with pytest.raises(FitError, match="e2 is free in the scene, allowed: a limit to begin with"):
        unknowns_of(block(limits__stretch=[1.2, None, 1.2]), ["stretch.e2"], [])
    with pytest.raises(FitError, match="isotropic, allowed: stretch"):
        unknowns_of(block(limits__projection="isotropic"), ["stretch.e1"], [])
    with pytest.raises(FitError, match="the scene has no limits"):
        unknowns_of(block(limits=None), ["stretch"], [])


@dataclass(frozen=True)
class Line:
    """Stands for a Model: differences are A θ − y, of four presses; no simulation."""

    A: np.ndarray
    y: np.ndarray
    unknowns: tuple[Unknown, ...]
    presses: tuple[str, ...] = ("a", "b", "c", "d")
    wanted: bool = False

    def residuals(self, runner: object, thetas: list[np.ndarray]) -> list[Residuals]:
        n = len(self.y)
        press = np.repeat(np.arange(4), n // 4)
        return [Residuals(self.A @ theta - self.y, press, np.zeros(n, int)) for theta in thetas]


def line(seed: int, blind: bool = False) -> tuple[Line, np.ndarray]:
    """A linear problem with three unknowns; blind: the data do not depend on the last."""
    draw = np.random.default_rng(seed)
    A = draw.standard_normal((160, 3))
    A[:, 1] += 0.8 * A[:, 0]
    if blind:
        A[:, 2] = 0.0
    truth = np.array([0.3, -0.2, 0.1])
    unknowns = tuple(
        Unknown(f"u{k}", "value", 1.0, math.exp(-3.0), math.exp(3.0), factor=math.exp(4.0)) for k in range(3)
    )
    return Line(A, A @ truth + 0.3 * draw.standard_normal(160), unknowns), truth


def near(problem: Line):
    theta = solve(problem, None, centres(problem), 0.3, 30).theta  # type: ignore[arg-type]
    residuals = problem.residuals(None, [theta])[0]
    return local(Solution(theta, residuals, 0.3, 0.0), problem.A)


def test_intervals_are_those_of_the_textbook():
    """On a linear problem with white noise the profile's ends are θ ± t s √(AᵀA)⁻¹ⱼⱼ, to a tenth (soft L1, priors)."""
    problem, _ = line(0)
    at = near(problem)
    exact = np.linalg.lstsq(problem.A, problem.y, rcond=None)[0]
    s = math.sqrt(float(np.sum((problem.A @ exact - problem.y) ** 2)) / 157)
    half = quantile(157) * s * np.sqrt(np.diag(np.linalg.inv(problem.A.T @ problem.A)))
    found = profile(problem, None, at, range(3))  # type: ignore[arg-type]
    for j, interval in found.items():
        assert not interval.low_open
        assert not interval.high_open
        assert interval.high - interval.low == pytest.approx(2.0 * half[j], rel=0.25)
        assert 0.5 * (interval.high + interval.low) == pytest.approx(exact[j], abs=0.2 * half[j])
    assert linear_errors(problem, at) == pytest.approx(half / quantile(157), rel=0.25)  # type: ignore[arg-type]


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 40 problems with three unknowns each, about 95 % do; a few more or less by chance."""
    held = []
    for seed in range(40):
        problem, truth = line(seed)
        found = profile(problem, None, near(problem), range(3))  # type: ignore[arg-type]
        held += [found[j].low <= truth[j] <= found[j].high for j in range(3)]
    assert 0.88 <= np.mean(held) <= 1.0


def test_what_data_do_not_tell_is_open_on_both_sides():
    """And the others are told none the worse."""
    problem, truth = line(1, blind=True)
    found = profile(problem, None, near(problem), range(3))  # type: ignore[arg-type]
    assert found[2].low_open
    assert found[2].high_open
    assert not found[0].low_open
    assert found[0].low - 0.05 < truth[0] < found[0].high + 0.05


def test_drawing_presses_anew():
    """With presses that agree the intervals are about as wide as the others; with three presses there are none."""
    problem, _ = line(2)
    at = near(problem)
    ends = bootstrap(problem, at)  # type: ignore[arg-type]
    whole = profile(problem, None, at, range(3))  # type: ignore[arg-type]
    for j, (low, high) in enumerate(ends):
        assert 0.2 < (high - low) / (whole[j].high - whole[j].low) < 2.5
    few = Line(problem.A, problem.y, problem.unknowns, ("a", "b", "c"))
    assert bootstrap(few, at) == []  # type: ignore[arg-type]
    assert left_out(Line(problem.A, problem.y, problem.unknowns, ("a",)), None, at) == []  # type: ignore[arg-type]

"""How well the data know each unknown: profile likelihood, bootstrap over presses, presses left out.

The profile of an unknown θ_j is the least cost over all others where θ_j is fixed. Its interval is where this cost is
no more than t² s² above the least of all, with s² the variance of differences and t Student's quantile. Priors of the
others count, its own does not: the interval is what data say. Its ends then go out by what it matters how presses are
simulated (`moved`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .model import Model, Residuals, relative_error
from .runs import Runner
from .solve import Solution, bounds, centres, robust_cost, robust_scale, robust_weights, sigmas

LEVEL = 0.95
"""Confidence of intervals."""
FARTHEST = math.log(5.0)
"""How far in θ an end of an interval is sought; of a touch TOUCHES."""
TOUCHES = 5.0
ROUNDS = 3
"""Points of a profile on each side, at most."""
DRAWS, ENOUGH = 1000, 4
"""Of the bootstrap, and presses that it takes."""


class Interval(NamedTuple):
    """Ends of an interval of θ; open: the data allow everything beyond, as far as it was sought."""

    low: float
    high: float
    low_open: bool
    high_open: bool


@dataclass(frozen=True)
class Local:
    """A solution, and the differences around it as if they were linear.

    J        : (n, p) derivatives
    weights  : (n,) see robust_weights
    variance : s² of a difference, of the channel where it is largest; repeated ones that go together count as fewer
    freedom  : how many differences there are beyond the unknowns
    """

    solution: Solution
    J: Floats
    weights: Floats
    variance: float
    freedom: int


def local(solution: Solution, J: Floats) -> Local:
    """See Local."""
    r = solution.residuals
    weights = robust_weights(r.values, robust_scale(solution.size))
    freedom = max(1, len(r.values) - J.shape[1])
    squares = weights * r.values**2
    variance = max(float(np.mean(squares[r.channel == one])) for one in np.unique(r.channel))
    variance *= len(r.values) / freedom
    return Local(solution, J, weights, max(variance * _together(solution), 1e-4), freedom)


def _together(solution: Solution) -> float:
    """By how much more the variance counts since neighbours differ alike: (1 + ρ)/(1 − ρ), within 1 and 10."""
    r = solution.residuals
    products = squares = 0.0
    for press in np.unique(r.press):
        values = r.values[(r.press == press) & (r.channel == 0)]
        values = np.clip(values, -3.0 * solution.size, 3.0 * solution.size)
        products += float(values[1:] @ values[:-1])
        squares += float(values @ values)
    rho = np.clip(products / max(squares, 1e-12), 0.0, 0.82)
    return float((1.0 + rho) / (1.0 - rho))


def quantile(freedom: int) -> float:
    """Student's t of LEVEL."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * LEVEL, freedom))


def linear_errors(model: Model, near: Local) -> Floats:
    """(p,) standard errors of θ by the derivatives alone, each without its own prior; inf where data say nothing."""
    out = []
    for j in range(near.J.shape[1]):
        C = np.linalg.inv(_hessian(model, near, without=j))
        out.append(math.sqrt(near.variance * C[j, j]) if C[j, j] > 0.0 else math.inf)
    return np.array(out)


def _hessian(model: Model, near: Local, without: int) -> Floats:
    """(p, p) of half the cost: data, and priors but one."""
    H = (near.J.T * near.weights) @ near.J
    prior = near.variance / sigmas(model) ** 2
    if 0 <= without < len(prior):
        prior[without] = 0.0
    return np.asarray(H + np.diag(prior + 1e-9))


def profile(model: Model, runner: Runner, near: Local, chosen: Sequence[int]) -> dict[int, Interval]:
    """The intervals of some unknowns; all ends are sought at once."""
    target = near.variance * quantile(near.freedom) ** 2
    low, high = bounds(model)
    theta = near.solution.theta
    ends = [_End(model, near, j, sign, low, high) for j in chosen for sign in (-1.0, 1.0)]
    for _ in range(ROUNDS):
        seeking = [end for end in ends if not end.done]
        if not seeking:
            break
        tries = [end.point() for end in seeking]
        found = model.residuals(runner, tries)
        better = [end.corrected(point, r.values) for end, point, r in zip(seeking, tries, found, strict=True)]
        again = model.residuals(runner, better)
        for end, first, r1, second, r2 in zip(seeking, tries, found, better, again, strict=True):
            end.take(min(end.cost(first, r1.values), end.cost(second, r2.values)), target)
    out = {}
    for j in chosen:
        below, above = (next(e for e in ends if e.j == j and e.sign == sign) for sign in (-1.0, 1.0))
        out[j] = Interval(float(theta[j] - below.reached), float(theta[j] + above.reached), below.open, above.open)
    return out


class _End:
    """One end of the interval of θ_j, sought along the way on which the others follow."""

    def __init__(self, model: Model, near: Local, j: int, sign: float, low: Floats, high: Floats) -> None:
        self.j, self.sign, self._model, self._near, self._low, self._high = j, sign, model, near, low, high
        self._H = _hessian(model, near, without=j)
        C = np.linalg.inv(self._H)
        self._way = C[:, j] / C[j, j]
        self._centre, self._prior = centres(model), near.variance / sigmas(model) ** 2
        self._prior[j] = 0.0
        theta = near.solution.theta
        room = (high[j] - theta[j]) if sign > 0 else (theta[j] - low[j])
        far = TOUCHES if model.unknowns[j].kind == "touch" else FARTHEST
        self._most = max(min(far, float(room)), 1e-6)
        expected = quantile(near.freedom) * math.sqrt(max(near.variance * C[j, j], 0.0))
        self.reached = min(self._most, max(expected, 1e-3))
        self.done = self.open = False
        self._least = self.cost(theta, near.solution.residuals.values)

    def point(self) -> Floats:
        """The θ to look at."""
        theta = self._near.solution.theta + self.sign * self.reached * self._way
        theta[self.j] = self._near.solution.theta[self.j] + self.sign * self.reached
        return np.asarray(np.clip(theta, self._low, self._high))

    def corrected(self, theta: Floats, values: Floats) -> Floats:
        """The same θ_j, the others a step nearer to where the cost is least."""
        others = [i for i in range(len(theta)) if i != self.j]
        if not others:
            return theta
        weights = robust_weights(values, robust_scale(self._near.solution.size))
        gradient = self._near.J.T @ (weights * values) + self._prior * (theta - self._centre)
        step = np.linalg.solve(self._H[np.ix_(others, others)], -gradient[others])
        out = theta.copy()
        out[others] += np.clip(step, -0.5, 0.5)
        return np.asarray(np.clip(out, self._low, self._high))

    def cost(self, theta: Floats, values: Floats) -> float:
        """Twice the half: comparable with t² s²."""
        data = 2.0 * robust_cost(values, robust_scale(self._near.solution.size))
        return data + float(self._prior @ (theta - self._centre) ** 2)

    def take(self, cost: float, target: float) -> None:
        """What the point cost; goes on, or is done."""
        more = cost - self._least
        if more < target and self.reached >= self._most * (1.0 - 1e-9):
            self.done = self.open = True
            return
        factor = math.sqrt(target / max(more, 0.04 * target))
        self.done = 0.85 < factor < 1.15
        self.reached = min(self._most, self.reached * float(np.clip(factor, 0.4, 3.0)))


def moved(model: Model, near: Local, others: Residuals) -> Floats:
    """(p,) by how much θ would move if presses were simulated otherwise, as if differences were linear.

    others: differences at the same θ, simulated otherwise
    """
    H = _hessian(model, near, without=-1)
    change = others.values - near.solution.residuals.values
    change = np.clip(change, -robust_scale(near.solution.size), robust_scale(near.solution.size))
    return np.asarray(np.abs(np.linalg.solve(H, near.J.T @ (near.weights * change))))


def widened(interval: Interval, by: float) -> Interval:
    """The interval with both ends moved out in θ."""
    return interval._replace(low=interval.low - by, high=interval.high + by)


def bootstrap(model: Model, near: Local, seed: int = 0) -> list[tuple[float, float]]:
    """Intervals of θ over presses drawn anew, as if differences were linear; empty with fewer than ENOUGH presses."""
    count = len(model.presses)
    if count < ENOUGH:
        return []
    r, J = near.solution.residuals, near.J
    parts = []
    for k in range(count):
        of = r.press == k
        weighted = J[of].T * near.weights[of]
        parts.append((weighted @ J[of], weighted @ r.values[of]))
    prior = near.variance / sigmas(model) ** 2
    pull = prior * (near.solution.theta - centres(model))
    draw = np.random.default_rng(seed)
    drawn = []
    for _ in range(DRAWS):
        times = np.bincount(draw.integers(count, size=count), minlength=count)
        H = sum(n * part[0] for n, part in zip(times, parts, strict=True)) + np.diag(prior + 1e-9)
        g = sum(n * part[1] for n, part in zip(times, parts, strict=True)) + pull
        drawn.append(near.solution.theta - np.linalg.solve(H, g))
    ends = np.quantile(np.array(drawn), [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL], axis=0)
    return [(float(low), float(high)) for low, high in ends.T]


class LeftOut(NamedTuple):
    """A press that was foretold by a fit to the others."""

    press: str
    fitted: float  # error of the normal force in the fit to all, see relative_error
    foretold: float  # the same where this press was left out


def left_out(model: Model, runner: Runner, near: Local) -> list[LeftOut]:
    """Each press foretold by the others; empty with a single press. Derivatives are those of the fit to all."""
    count, theta = len(model.presses), near.solution.theta
    if count < 2 or len(theta) == 0:
        return []
    low, high = bounds(model)
    prior, centre = near.variance / sigmas(model) ** 2, centres(model)
    at = [theta.copy() for _ in range(count)]
    values = [near.solution.residuals.values] * count
    for _ in range(2):
        for k in range(count):
            kept = near.solution.residuals.press != k
            J, r = near.J[kept], values[k][kept]
            weighted = J.T * robust_weights(r, robust_scale(near.solution.size))
            gradient = weighted @ r + prior * (at[k] - centre)
            step = np.linalg.solve(weighted @ J + np.diag(prior + 1e-9), -gradient)
            at[k] = np.clip(at[k] + np.clip(step, -1.0, 1.0), low, high)
        values = [each.values for each in model.residuals(runner, at)]
    all_of = model.curves(runner, [theta])[0]
    foretold = model.curves(runner, at)
    return [
        LeftOut(press.name, relative_error(press, all_of[k]), relative_error(press, foretold[k][k]))
        for k, press in enumerate(model.presses)
    ]

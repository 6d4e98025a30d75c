"""The fit itself: robust least squares with scipy, derivatives by differences that are simulated in parallel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ..arrays import Floats
from .model import Model, Residuals
from .parameters import RELAXATION
from .runs import Runner

STEP = {"value": 0.08, "stretch": 0.08, "compress": 0.08, "time": 0.15, "share": 0.15, "touch": 0.3}
"""Steps of θ that derivatives are taken over: forces of a simulation are smooth to about 0.5 %."""
ROBUST = 3.0
"""Differences above so many of the usual size count less than their square (soft L1)."""
LEAST_SIZE = 0.2
"""Usual size of a difference, at least, in errors that count as one."""


@dataclass(frozen=True)
class Solution:
    """Where a fit ended.

    theta     : (p,) unknowns
    residuals : of the data there
    size      : usual size of a difference, which robustness is relative to
    cost      : half the sum of robust squares, priors included
    """

    theta: Floats
    residuals: Residuals
    size: float
    cost: float


def solve(model: Model, runner: Runner, start: Floats, size: float, evaluations: int) -> Solution:
    """The θ at which robust differences and priors are least, from a start within the bounds.

    size        : usual size of a difference, see `usual_size`: robustness and priors are relative to it
    evaluations : of trial points at most; each step costs a derivative besides
    """
    scale, centre = robust_scale(size), centres(model)
    sigma = sigmas(model) / (LEAST_SIZE if model.wanted else size)
    low, high = bounds(model)
    count = [0]

    def function(theta: Floats) -> Floats:
        found = model.residuals(runner, [theta])[0].values
        count[0] = len(found)
        return np.concatenate([found, (theta - centre) / sigma])

    def derivative(theta: Floats) -> Floats:
        return np.concatenate([jacobian(model, runner, theta), np.diag(1.0 / sigma)])

    def loss(z: Floats) -> Floats:
        """Soft L1 of the data; priors stay squares."""
        rho = np.empty((3, len(z)))
        t = 1.0 + z
        rho[0], rho[1], rho[2] = 2.0 * (np.sqrt(t) - 1.0), t**-0.5, -0.5 * t**-1.5
        rho[0, count[0] :], rho[1, count[0] :], rho[2, count[0] :] = z[count[0] :], 1.0, 0.0
        return rho

    start = np.clip(start, low + 1e-6, high - 1e-6)
    if len(start) == 0:
        found = model.residuals(runner, [start])[0]
        return Solution(start, found, size, robust_cost(found.values, scale))
    done = least_squares(
        function, start, jac=derivative, bounds=(low, high), method="trf", loss=loss,  # type: ignore[arg-type]
        f_scale=scale, x_scale=1.0,
        ftol=2e-4, xtol=2e-3, gtol=1e-8, max_nfev=evaluations,
    )  # fmt: skip
    theta = np.asarray(done.x)
    return Solution(theta, model.residuals(runner, [theta])[0], size, float(done.cost))


def jacobian(model: Model, runner: Runner, theta: Floats, *, central: bool = False) -> Floats:
    """(n, p) derivatives of the differences. All points are simulated at once.

    central: differences to both sides, which costs twice as much; of what relaxes always, as times and shares change
             forces alike but for their curvature
    """
    low, high = bounds(model)
    points, spans = [], []
    for j, one in enumerate(model.unknowns):
        step = STEP[one.kind] if theta[j] + STEP[one.kind] <= high[j] else -STEP[one.kind]
        ahead, behind = theta.copy(), theta.copy()
        ahead[j] += step
        if (central or one.kind in RELAXATION) and low[j] <= theta[j] - step <= high[j]:
            behind[j] -= step
        points += [ahead, behind]
        spans.append(ahead[j] - behind[j])
    found = [each.values for each in model.residuals(runner, points)]
    return np.stack([(found[2 * j] - found[2 * j + 1]) / span for j, span in enumerate(spans)], axis=1)


def bounds(model: Model) -> tuple[Floats, Floats]:
    """(p,) lowest and highest θ."""
    pairs = [(one.theta(one.low), one.theta(one.high)) for one in model.unknowns]
    return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])


def centres(model: Model) -> Floats:
    """(p,) θ that priors are about."""
    return np.array([one.believed for one in model.unknowns])


def sigmas(model: Model) -> Floats:
    """(p,) standard deviations of priors."""
    return np.array([one.sigma for one in model.unknowns])


def usual_size(residuals: Residuals) -> float:
    """Usual size of a difference: 1.48 times the median of their sizes, LEAST_SIZE at least.

    That of normal forces: a tangential force that is 0 all the time would make it small.
    """
    return max(LEAST_SIZE, 1.4826 * float(np.median(np.abs(residuals.values[residuals.channel == 0]))))


def robust_scale(size: float) -> float:
    """Differences above this one count less than their square."""
    return ROBUST * size


def robust_cost(values: Floats, scale: float) -> float:
    """Half the sum of robust squares of differences, as scipy has it."""
    return float(scale**2 * np.sum(np.sqrt(1.0 + (values / scale) ** 2) - 1.0))


def robust_weights(values: Floats, scale: float) -> Floats:
    """(n,) by how much less than its square each difference counts, 0 to 1."""
    return np.asarray((1.0 + (values / scale) ** 2) ** -0.5)


def starts(model: Model, count: int, seed: int = 0) -> list[Floats]:
    """θ to begin from: that of the scene, then such as priors believe, spread evenly (a Latin hypercube)."""
    centre, sigma = centres(model), sigmas(model)
    low, high = bounds(model)
    if count <= 1 or not len(centre):
        return [centre]
    from scipy.stats import norm, qmc

    spread = norm.ppf(np.clip(qmc.LatinHypercube(len(centre), seed=seed).random(count - 1), 0.02, 0.98))
    return [centre, *(np.clip(centre + 0.7 * sigma * each, low, high) for each in spread)]


def best_modulus(model: Model, runner: Runner, thetas: list[Floats]) -> list[Floats]:
    """The same θ, E changed so that normal forces are right on the whole: it costs no simulation at rest."""
    at = next((j for j, one in enumerate(model.unknowns) if one.name == "young"), None)
    if at is None:
        return thetas
    low, high = bounds(model)
    out = []
    for theta, curves in zip(thetas, model.curves(runner, thetas), strict=True):
        ratios = []
        for press, given in zip(model.presses, curves, strict=True):
            measured = press.normal[given.way.used]
            strong = (measured > 0.1 * measured.max()) & (given.normal > 0.0)
            if strong.any():
                ratios.append(float(np.median(np.log(measured[strong] / given.normal[strong]))))
        moved = theta.copy()
        if ratios and math.isfinite(np.mean(ratios)):
            moved[at] = float(np.clip(theta[at] + np.mean(ratios), low[at], high[at]))
        out.append(moved)
    return out

"""What is known of human fingertips, as laws that a curve can be held against."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Floats

FORCES = (0.2, 5.0)
"""Normal forces over which stiffness is held against k = b + m F [N]."""
KNOWN = (0.0, 2.0)
"""Those over which that of human fingertips was measured [N]."""


class Line(NamedTuple):
    """k = b + m F, fitted to the tangent stiffness k = dF/dd of a press at rest.

    b [N/m], m [1/m], R2: share of the variance of k that it explains
    """

    b: float
    m: float
    R2: float

    def __str__(self) -> str:
        return f"k = {1e-3 * self.b:.3f} N/mm + {1e-3 * self.m:.2f}/mm F, R² = {self.R2:.3f}"


def tangent(depth: Floats, force: Floats) -> tuple[Floats, Floats]:
    """Normal forces (n − 1,) [N] and tangent stiffness there [N/m], of depths (n,) [m] and forces [N] of a press."""
    return 0.5 * (force[1:] + force[:-1]), np.diff(force) / np.diff(depth)


def stiffness_line(depth: Floats, force: Floats, between: tuple[float, float] = FORCES) -> Line | None:
    """The line over normal forces [N]; None where fewer than four slopes are there.

    Human fingertips follow it from 0 to 2 N (Pawluk and Howe 1999: force grows exponentially with depth).
    """
    F, k = tangent(depth, force)
    within = (between[0] <= F) & (between[1] >= F)
    if within.sum() < 4:
        return None
    m, b = np.polyfit(F[within], k[within], 1)
    left = k[within] - (b + m * F[within])
    return Line(float(b), float(m), float(1.0 - left.var() / k[within].var()))


def exponent(x: Floats, y: Floats) -> float:
    """p of y ∝ xᵖ, by least squares of logarithms; all above 0."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])

"""Over-constraint ("locking"): limits that leave a tetrahedron fewer ways to deform than it needs.

Two kinds are told apart. *Rows against freedoms*: a tetrahedron has six strains, fewer where its nodes are driven, and
`hyperbolic` and `orthogonal` put up to nine rows on it; a mesh of T tetrahedra has some 3 T / 5 freedoms in all.
*Limits against volume*: strain along one axis at constant volume strains the others, and their limits may end it
before its own does. With 0.75 < s_2, s_1 < 1.05, s_3 < 1.02 an e2 at its limit has 0.75 · 1.05 · 1.02 = 0.80 of its
volume at most: a bulk much stiffer than the shear forbids that, and the limit along e2 is never met.

Limits are given by `shortest` s_min and `longest` s_max along e1, e2, e3, (3,); a free axis has 0 and ∞.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats

STIFF_BULK = 3.0
"""Bulk modulus over shear modulus from which on volume counts as kept: Poisson's ratio 0.35."""
STRAINS = 6
"""Ways of a tetrahedron to deform."""


def bulk_to_shear(poisson: float) -> float:
    """K/μ = 2 (1 + ν) / (3 (1 − 2 ν))."""
    return 2.0 * (1.0 + poisson) / (3.0 * (1.0 - 2.0 * poisson))


def isochoric_strain(shortest: Floats, longest: Floats) -> Floats:
    """Strain |s_j − 1| along e_j that the limits of the other two axes allow at constant volume. (2, 3)

    Row 0 stretch, s_j ≤ 1/(s_min,k s_min,l); row 1 compression, s_j ≥ 1/(s_max,k s_max,l). ∞: the limit along e_j
    itself comes first, or the others are free: nothing contradicts.
    """
    out = np.full((2, 3), math.inf)
    for j in range(3):
        k, l = (j + 1) % 3, (j + 2) % 3
        shrunk, grown = shortest[k] * shortest[l], longest[k] * longest[l]
        if shrunk > 0.0 and 1.0 / shrunk < longest[j]:
            out[0, j] = 1.0 / shrunk - 1.0
        if grown < math.inf and 1.0 / grown > shortest[j]:
            out[1, j] = 1.0 - 1.0 / grown
    return out


def volume_at_limit(shortest: Floats, longest: Floats) -> Floats:
    """V/V₀ of a tetrahedron whose e_j is at its limit, as near to 1 as the other two limits let it come. (2, 3)

    Row 0 stretch (≥ 1), row 1 compression (≤ 1); 1: constant volume is possible. NaN where e_j is free.
    """
    own = np.array([np.where(longest < math.inf, longest, math.nan), np.where(shortest > 0.0, shortest, math.nan)])
    strain = isochoric_strain(shortest, longest)
    reach = np.stack([1.0 + strain[0], 1.0 - strain[1]])
    bound: Floats = np.where(np.isinf(strain), own / own, own / reach)
    return bound

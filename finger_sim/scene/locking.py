"""What a scene's limits may lock, before a run: physics/locking.py of its limits and its material."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..physics import locking
from ..physics.locking import STRAINS
from .parts import Limits, Material


def ends(limits: Limits) -> tuple[Floats, Floats]:
    """s_min and s_max along e1, e2, e3, (3,) each; 0 and ∞ on a free axis."""
    shortest = np.array([0.0 if s is None else s for s in limits.compress])
    longest = np.array([math.inf if s is None else s for s in limits.stretch])
    return shortest, longest


def bulk_to_shear(material: Material) -> float:
    """K/μ of the material."""
    return locking.bulk_to_shear(material.poisson)


def isochoric_strain(limits: Limits) -> Floats:
    """See physics.locking.isochoric_strain. (2, 3)"""
    return locking.isochoric_strain(*ends(limits))


def volume_at_limit(limits: Limits) -> Floats:
    """See physics.locking.volume_at_limit. (2, 3)"""
    return locking.volume_at_limit(*ends(limits))


class Count(NamedTuple):
    """Rows that limits can put up at once, against what can move."""

    rows_each: int  # of one tetrahedron, each at a limit of its own
    crowded: int  # tetrahedra with more of them than ways to deform
    rows: int  # of all tetrahedra, one each
    freedoms: int  # three a free node


def count(limits: Limits, free_nodes: Ints, nodes: int) -> Count:
    """free_nodes (T,): how many of each tetrahedron's nodes are free; nodes: free ones of the mesh."""
    axes = [sum(s is not None for s in side) for side in (limits.stretch, limits.compress)]
    each = max(axes)  # of one principal axis, on one side
    if limits.projection in ("hyperbolic", "orthogonal"):
        rows = 3 * each
    else:
        rows = 3 if limits.projection in ("isotropic", "linear") else each
    ways = np.minimum(STRAINS, 3 * free_nodes)
    crowded = int(((ways > 0) & (rows > ways)).sum())
    return Count(rows, crowded, int((ways > 0).sum()) if rows else 0, 3 * nodes)

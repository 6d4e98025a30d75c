"""The strain that limits allow by direction, and the worst row where two singular values cross.

Every projection is asked through `evaluate`, the formulas that a step's rows have.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ...arrays import Floats
from ...physics.strain_limits import evaluate
from ...scene import Limits

PROJECTIONS = ("isotropic", "hyperbolic", "tensor", "linear", "orthogonal")
ROOM = 0.04
"""Strain allowed along every axis, stretched and compressed: 0.96-1.04."""
CELLS = 20
"""Of the grid of directions, along an edge of each face of a cube; even: axes and diagonals are on it."""
SIDES = {"stretch": 1.0, "compress": -1.0}
LEAST = 1e-6
"""Part of ROOM below which nothing counts as allowed."""
ROUNDING = 1e-12
"""C so far below zero counts as zero: `orthogonal` leaves stretches of 1 no room across an axis."""

FINGER, FINGER_ISOTROPIC = ((1.05, 1.25, 1.02), (0.95, 0.75, 0.98)), ((1.05,) * 3, (0.95,) * 3)
"""s_max and s_min where singular values cross. With equal ones, `linear` and `tensor` would be `isotropic`."""
MIDDLE, THIRD = 1.03, 0.99
"""Mean of the two stretches that cross, and the other one."""
FRAME = Rotation.from_euler("zyx", (35.0, 25.0, 50.0), degrees=True).as_matrix()
"""Principal axes far from the crossing (columns), in material axes: turned well away from them."""
GAPS = np.logspace(-1.5, -6.0, 19)
"""Distances |s_1 − s_2| of the stretches that cross."""
NEAR = 1e-3
"""Gaps below are near enough for an asymptote."""
TURNS = 180
"""Ways to be so far apart: directions of (t, δ)."""
PASSES = (1e-2, 1e-3, 1e-4)
"""Off-diagonal δ with which the crossing is passed: the gap is 2 δ at least."""
REACH, POINTS = 0.02, 241
"""Largest |t| of a pass, and points of one."""
CORNERS = {"100": 0, "110": 1, "111": 2}
"""Stops of the path: along an axis, halfway between two, halfway between three."""
STOPS = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
"""Directions that the path goes through, the straight way from one to the next."""
LEG = 20
"""Parts of the path between two stops."""


@dataclass(frozen=True)
class Crossing:
    """The worst row of a projection where two stretches cross."""

    passes: Floats  # (len(PASSES), POINTS) its strain/limit as t goes from −REACH to REACH
    jump: Floats  # (len(GAPS),) largest less smallest strain/limit at that gap
    gradient: Floats  # (len(GAPS),) largest |∂C/∂F| at that gap; 1: that of a singular value

    @property
    def exponent(self) -> float:
        """Power of the gap that the gradient goes with, below NEAR."""
        near = GAPS <= NEAR
        return float(np.polyfit(np.log(GAPS[near]), np.log(self.gradient[near]), 1)[0])


def directions(cells: int) -> Floats:
    """Unit vectors through a grid of equal angles on each face of a cube. (6, cells + 1, cells + 1, 3)"""
    u, v = np.meshgrid(*2 * [np.tan(np.linspace(-0.25 * math.pi, 0.25 * math.pi, cells + 1))], indexing="ij")
    faces = [np.roll(np.stack([sign * np.ones_like(u), sign * u, v], -1), j, -1) for j in range(3) for sign in (1, -1)]
    ways = np.stack(faces)
    return np.asarray(ways / np.linalg.norm(ways, axis=-1, keepdims=True))


def path() -> tuple[Floats, Floats]:
    """Unit vectors (k, 3) along STOPS, LEG parts between two, and the angle turned by up to each (k,) [rad]."""
    shares = np.arange(LEG)[:, None] / LEG
    legs = [start + shares * (end - start) for start, end in itertools.pairwise(STOPS)]
    ways = np.concatenate([*legs, STOPS[-1:]])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    turns = np.arccos(np.clip((ways[1:] * ways[:-1]).sum(axis=1), -1.0, 1.0))
    return ways, np.concatenate([[0.0], np.cumsum(turns)])


def allowed_strains(projection: str, ways: Floats, side: str) -> Floats:
    """`allowed_strain` along unit vectors (…, 3)."""
    strains = [allowed_strain(projection, way, side) for way in ways.reshape(-1, 3)]
    return np.array(strains).reshape(ways.shape[:-1])


def allowed_strain(projection: str, direction: Floats, side: str) -> float:
    """Largest ε with C ≥ 0 at F = I ± ε d dᵀ, d = `direction`, as a part of ROOM, which is that of every axis."""
    limits = Limits(cast(Any, projection), (1.0 + ROOM,) * 3, (1.0 - ROOM,) * 3)
    along = SIDES[side] * np.outer(direction, direction)

    def margin(strain: float) -> float:
        return float(evaluate(np.eye(3) + strain * along, limits)[0].min()) + ROUNDING

    if margin(LEAST * ROOM) < 0.0:
        return 0.0
    return float(brentq(margin, LEAST * ROOM, 4.0 * ROOM, xtol=1e-9)) / ROOM


def limits_crossed(projection: str) -> Limits:
    """The limits that a projection has where singular values cross."""
    return Limits(cast(Any, projection), *(FINGER_ISOTROPIC if projection == "isotropic" else FINGER))


def stretch_near_crossing(t: float, delta: float) -> Floats:
    """U (3, 3) with stretches MIDDLE ± √(t² + δ²) and THIRD; as t changes sign their axes turn by a right angle."""
    U = np.diag([MIDDLE + t, MIDDLE - t, THIRD])
    U[0, 1] = U[1, 0] = delta
    return np.asarray(FRAME @ U @ FRAME.T)


def worst_row(U: Floats, limits: Limits) -> tuple[float, float]:
    """Strain/limit and |∂C/∂F| of the row with the largest strain/limit at F = U, symmetric.

    strain/limit is 1 − C/a, a the room of the row's material axis (`linear`: of the row). C of `tensor` is scaled as
    in a step, to count as a stretch: ∂λ/∂F = yyᵀ − [h]× by |y|² = |tr ∂λ/∂F|.
    """
    C, gradients = evaluate(U, limits)
    if limits.projection == "tensor":
        room = 1.0 / np.abs(np.trace(gradients, axis1=1, axis2=2))
        C, gradients = room * C, room[:, None, None] * gradients
    else:
        s = np.linalg.eigvalsh(U)[::-1]
        rooms = np.where(s[:, None] >= 1.0, limits.stretch_room, limits.compress_room)
        room = C + np.abs(s - 1.0) if limits.projection == "linear" else rooms[:, : len(C) // 3].ravel()
    ratio = 1.0 - C / room
    worst = int(np.argmax(ratio))
    return float(ratio[worst]), float(np.linalg.norm(gradients[worst]))


def crossing(projection: str) -> Crossing:
    """Pass the crossing nearer and nearer, and go around it closer and closer."""
    limits = limits_crossed(projection)
    passes = [[worst_row(stretch_near_crossing(t, delta), limits)[0] for t in pass_points()] for delta in PASSES]
    around = np.array([[worst_row(U, limits) for U in _around(gap)] for gap in GAPS])
    return Crossing(np.array(passes), np.ptp(around[:, :, 0], axis=1), around[:, :, 1].max(axis=1))


def pass_points() -> Floats:
    """Values of t from −REACH to REACH, close together about 0. (POINTS,)"""
    return np.asarray(REACH * np.sinh(8.0 * np.linspace(-1.0, 1.0, POINTS)) / math.sinh(8.0))


def _around(gap: float) -> list[Floats]:
    angles = 2.0 * math.pi * (np.arange(TURNS) + 0.5) / TURNS
    return [stretch_near_crossing(0.5 * gap * math.cos(a), 0.5 * gap * math.sin(a)) for a in angles]


def linear_rules(ways: Floats) -> tuple[Floats, Floats]:
    """Largest stretch along unit vectors (…, 3) by the finger's limits: of Eq. 22 as printed, and of the ellipsoid."""
    s = np.array(FINGER[0])
    return np.linalg.norm(s * ways, axis=-1), np.asarray(1.0 / np.linalg.norm(ways / s, axis=-1))

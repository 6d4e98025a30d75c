"""The shape of the parametric finger: its skin and its bones, as closed formulas.

Frame: x (e1) to the tip, y (e2) up to the nail, z (e3) across; the origin lies inside the distal bone, above the
pad. The finger is straight, and its own mirror image in z = 0. Lengths here are millimetres.

Skin and bone are of one kind: superelliptic cross-sections along x, of which a spheroidal cap closes the last ones.
With yn and zn, the offsets from the middle of a cross-section over its half axes, and f, which grows from 0 where
the cap begins to 1 at the tip, the surface is where

    (|yn|^p + |zn|^p)^(2/p) + f^2 = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from ..arrays import Floats

# x of the tip, of the bone's tip, of the two joints and of the cut faces of finger and fingertip [mm]
TIP, BONE_TIP, DIP, PIP, CUT = 11.6, 7.8, -8.0, -30.4, -58.4
DISTAL_CUT = TIP - 28.0
CAP = 2.0  # x where the rounded fingertip begins [mm]
BONE_CAP = 5.8  # the same of the bone

PAD_FROM = DIP + 3.0  # x beyond the crease of the joint [mm]
PAD_HEIGHT = 3.0  # a plane that is pressed in by so much touches the pad and no more [mm]
NAIL_FROM, NAIL_TO = -2.0, 9.5  # x of the nail plate [mm]
NAIL_BREADTH = 0.8  # of the plate, over that of the finger
NAIL_HEIGHT = 0.55  # of its lowest place over the middle of the finger, over half the depth: not the front of the tip

# Skin: x, y of the pad side, y of the nail side, half breadth [mm].
_SKIN = np.array(
    [
        [CUT, -4.6, 11.6, 9.3],
        [-45.0, -4.5, 11.2, 9.0],
        [PIP, -5.1, 10.5, 10.0],
        [-19.0, -5.0, 8.3, 8.7],
        [DIP, -6.1, 6.8, 8.4],
        [-2.0, -7.0, 5.0, 8.2],
        [2.5, -7.5, 4.4, 8.0],
        [TIP, -6.8, 3.4, 7.6],
    ]
)
# Bone, of elliptic cross-section: x, y of its centre, half breadth, half depth [mm].
_BONE = np.array(
    [
        [CUT, 3.9, 4.5, 4.0],
        [-46.0, 3.6, 3.5, 3.0],
        [-34.0, 3.3, 4.5, 3.5],
        [PIP, 3.0, 5.5, 4.0],
        [-27.0, 2.6, 5.0, 3.5],
        [-19.0, 1.6, 2.5, 2.3],
        [-11.0, 0.6, 4.0, 2.8],
        [DIP, 0.1, 5.5, 3.0],
        [-5.5, -0.2, 5.0, 2.7],
        [0.0, -0.5, 2.25, 1.9],
        [5.0, -0.6, 3.75, 1.6],
        [BONE_TIP, -0.6, 3.0, 1.3],
    ]
)
_skin = PchipInterpolator(_SKIN[:, 0], _SKIN[:, 1:])
_bone = PchipInterpolator(_BONE[:, 0], _BONE[:, 1:])


def _skin_section(x: Floats) -> tuple[Floats, Floats, Floats]:
    pad, nail, half_breadth = np.moveaxis(_skin(np.clip(x, CUT, TIP)), -1, 0)
    middle = pad + 0.5 * (nail - pad)
    return middle, middle - pad, half_breadth


def _bone_section(x: Floats) -> tuple[Floats, Floats, Floats]:
    middle, half_breadth, half_depth = np.moveaxis(_bone(np.clip(x, CUT, BONE_TIP)), -1, 0)
    return middle, half_depth, half_breadth


@dataclass(frozen=True)
class Surface:
    """The skin, or the surface of the bones.

    section:    x -> y of the middle of the cross-section, its half depth, its half breadth [mm]
    squareness: exponent p below the middle and above it; 2 is an ellipse
    cap, tip:   x where the cap begins and where it ends [mm]
    """

    section: Callable[[Floats], tuple[Floats, Floats, Floats]]
    squareness: tuple[float, float]
    cap: float
    tip: float

    def level(self, points: ArrayLike) -> Floats:
        """0 to 1 inside, 1 on the surface, more outside, of `points` (n, 3) [mm], (n,)."""
        scaled = self._scaled(np.asarray(points, dtype=np.float64))
        level: Floats = np.hypot(self._norm(scaled), scaled[:, 0])
        return level

    def nearby(self, points: ArrayLike) -> Floats:
        """Points of the surface, each near one of `points` (n, 3) [mm]: away from the axis or towards it."""
        x = np.asarray(points, dtype=np.float64)
        scaled = self._scaled(x)
        scaled /= np.hypot(self._norm(scaled), scaled[:, 0])[:, None]
        along = np.where(x[:, 0] < self.cap, x[:, 0], self.cap + scaled[:, 0] * (self.tip - self.cap))
        return self._placed(along, scaled[:, 1], scaled[:, 2])

    def grid(self, along: Floats, across: Floats, cut: float = CUT) -> Floats:
        """Points of its half at z >= 0 [mm]; `along` -1 (cut) to 0 (cap) to 1 (tip), `across` -1 (pad) to 1 (nail).

        The shaft is a half cylinder, the cap a quarter sphere over the elliptical map of a square to a disc;
        cross-sections are then made superelliptic and scaled to the outline.
        """
        u, v = np.sin(0.5 * np.pi * np.clip(along, 0.0, 1.0)), np.sin(0.5 * np.pi * across)
        forward, up = u * np.sqrt(1.0 - 0.5 * v**2), v * np.sqrt(1.0 - 0.5 * u**2)
        side = np.sqrt((1.0 - u**2) * (1.0 - v**2))
        x = np.where(along < 0.0, self.cap + along * (self.cap - cut), self.cap + forward * (self.tip - self.cap))

        exponent = self._exponent(up)
        radius = np.maximum(np.hypot(up, side), 1e-12)
        norm = (np.abs(up / radius) ** exponent + np.abs(side / radius) ** exponent) ** (1.0 / exponent)
        stretch = 1.0 / np.where(norm > 0.0, norm, 1.0)
        return self._placed(x, up * stretch, side * stretch)

    def _scaled(self, points: Floats) -> Floats:
        """f, yn and zn of points, (n, 3)."""
        x, y, z = points.T
        middle, half_depth, half_breadth = self.section(x)
        forward = np.maximum(0.0, (x - self.cap) / (self.tip - self.cap))
        return np.stack([forward, (y - middle) / half_depth, z / half_breadth], axis=-1)

    def _placed(self, x: Floats, up: Floats, side: Floats) -> Floats:
        middle, half_depth, half_breadth = self.section(x)
        return np.stack([x, middle + up * half_depth, half_breadth * side], axis=-1)

    def _norm(self, scaled: Floats) -> Floats:
        exponent = self._exponent(scaled[:, 1])
        sum_of_powers = np.abs(scaled[:, 1]) ** exponent + np.abs(scaled[:, 2]) ** exponent
        norm: Floats = sum_of_powers ** (1.0 / exponent)
        return norm

    def _exponent(self, up: Floats) -> Floats:
        return np.where(up > 0.0, self.squareness[1], self.squareness[0])


SKIN = Surface(_skin_section, (2.4, 2.7), CAP, TIP)
BONE = Surface(_bone_section, (2.0, 2.0), BONE_CAP, BONE_TIP)


def inside_bone(points: ArrayLike) -> NDArray[np.bool_]:
    """Which of `points` (n, 3) [mm] lie inside bones that end at their tip in a flat face, (n,).

    This is the bone of the solid finger, which has nodes in the bones instead of a surface.
    """
    x, y, z = np.asarray(points, dtype=np.float64).T
    middle, half_depth, half_breadth = _bone_section(x)
    inside: NDArray[np.bool_] = np.logical_and(
        np.hypot((y - middle) / half_depth, z / half_breadth) <= 1.0, x <= BONE_TIP + 1e-6
    )
    return inside


def in_pad(points: ArrayLike) -> NDArray[np.bool_]:
    """Which of `points` of the skin (n, 3) [mm] are of the pad of the fingertip: what a plane can touch, (n,)."""
    x, y, _ = np.asarray(points, dtype=np.float64).T
    lowest = _SKIN[:, 1].min()
    pad: NDArray[np.bool_] = (x >= PAD_FROM) & (y <= lowest + PAD_HEIGHT)
    return pad


def in_nail(points: ArrayLike) -> NDArray[np.bool_]:
    """Which of `points` of the skin (n, 3) [mm] are of the nail plate, (n,)."""
    x, y, z = np.asarray(points, dtype=np.float64).T
    middle, half_depth, half_breadth = _skin_section(x)
    plate = (x >= NAIL_FROM) & (x <= NAIL_TO) & (np.abs(z) <= NAIL_BREADTH * half_breadth)
    nail: NDArray[np.bool_] = plate & (y >= middle + NAIL_HEIGHT * half_depth)
    return nail


def first_touch(rotation: Floats) -> float:
    """Height of the finger frame at which the skin just touches z = 0 [m]; rotation (3, 3) from that frame to world."""
    grid = np.meshgrid(np.linspace(-1.0, 1.0, 801), np.linspace(-1.0, 1.0, 401), indexing="ij")
    half = 1e-3 * SKIN.grid(*grid).reshape(-1, 3)
    up = rotation[2]
    return -float(min((half @ up).min(), (half @ (up * [1.0, 1.0, -1.0])).min()))

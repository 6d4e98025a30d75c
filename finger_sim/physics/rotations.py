"""Unit quaternions x y z w, as plain numbers: what a step needs of them, without allocation-heavy libraries.

Compiled code calls some of these functions too (turns.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import Floats

Quaternion = tuple[float, float, float, float]

SHORT_QUATERNION, LONG_QUATERNION = 1e-6, 1e6
"""Lengths between which a quaternion is an orientation, both included.

Normalising is exact far beyond them. But who sends a shorter one means none, and a longer one is a broken number.
"""
UNIT = 4.5e-16
"""A quaternion is a unit one where its length differs from 1 by less: two steps of float64 above, four below."""


def matrix_entries(q: Any) -> Any:
    """Rotation matrix, by rows, of a unit quaternion: of numbers, or of lanes in compiled code."""
    x, y, z, w = q
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x2, y * y2, z * z2, x * y2, x * z2, y * z2, w * x2, w * y2, w * z2
    return 1.0 - (yy + zz), xy - wz, xz + wy, xy + wz, 1.0 - (xx + zz), yz - wx, xz - wy, yz + wx, 1.0 - (xx + yy)


def matrix(q: Quaternion) -> Floats:
    """Rotation matrix (3, 3) of a unit quaternion."""
    return np.array(matrix_entries(q)).reshape(3, 3)


def unit(q: Quaternion) -> Quaternion | None:
    """The unit quaternion of the same rotation; None where `q` is not finite, or not of an allowed length."""
    return normalised(q) if SHORT_QUATERNION <= math.hypot(*q) <= LONG_QUATERNION else None


def normalised(q: Sequence[float]) -> Quaternion:
    """The unit quaternion of the same rotation; `q` must not be zero. A unit one stays as it is."""
    x, y, z, w = q
    norm = math.hypot(x, y, z, w)
    return (x, y, z, w) if abs(norm - 1.0) < UNIT else (x / norm, y / norm, z / norm, w / norm)


def angle(a: Quaternion, b: Quaternion) -> float:
    """Angle between two orientations [rad], 0 to π; q and −q are the same."""
    apart = math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3])
    opposite = math.hypot(a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])
    return 4.0 * math.atan2(min(apart, opposite), max(apart, opposite))


def rotation_vector(a: Quaternion, b: Quaternion) -> tuple[float, float, float]:
    """The shorter rotation from a to b, as axis times angle [rad], in the axes that both are given in."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    x = bx * aw - bw * ax - by * az + bz * ay
    y = by * aw - bw * ay - bz * ax + bx * az
    z = bz * aw - bw * az - bx * ay + by * ax
    w = bw * aw + bx * ax + by * ay + bz * az
    size = math.hypot(x, y, z)
    if a == b or size == 0.0:
        return 0.0, 0.0, 0.0
    factor = 2.0 * math.atan2(size, abs(w)) / math.copysign(size, w)
    return factor * x, factor * y, factor * z


def slerp(a: Quaternion, b: Quaternion, fraction: float) -> Quaternion:
    """The orientation `fraction` of the shorter way from a to b (Shoemake 1985)."""
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    if dot < 0.0:
        b, dot = (-b[0], -b[1], -b[2], -b[3]), -dot
    half = math.acos(min(1.0, dot))
    if half < 1e-6:
        wa, wb = 1.0 - fraction, fraction
    else:
        wa, wb = math.sin((1.0 - fraction) * half) / math.sin(half), math.sin(fraction * half) / math.sin(half)
    return normalised((
        wa * a[0] + wb * b[0], wa * a[1] + wb * b[1], wa * a[2] + wb * b[2], wa * a[3] + wb * b[3],
    ))  # fmt: skip

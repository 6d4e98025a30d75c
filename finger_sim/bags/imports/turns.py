"""Turning many poses, putting one after another, and poses between poses. Quaternions (n, 4) are xyzw."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np

from ...arrays import Floats, Ints
from ...errors import BagError
from ...physics.rotations import Quaternion, matrix, unit

ALLOWED = 'three axes such as "x=-y y=x z=z", or a quaternion "x y z w"'
NEARLY_ONE = 1e-9
"""Cosine of the angle between two orientations is that near to one: the chord is as good as the arc."""


class Turn(NamedTuple):
    """A rotation, as a matrix (3, 3) and as a unit quaternion."""

    matrix: Floats
    quaternion: Quaternion


def parsed_turn(option: str, text: str, of_axes: bool = False) -> Turn:
    """The rotation in a text: axes, or the quaternion "x y z w".

    "x=-y y=x z=z" says that our x is their −y, our y their x, our z their z. Of that it is R with v = R v' where v are
    numbers along our axes and v' along theirs; with `of_axes` the one that turns their axes to ours, Rᵀ.
    Raises BagError, which names `option`, for anything else; also for axes that are a mirror image.
    """
    parts = text.replace(",", " ").split()
    numbers = _four_numbers(parts)
    if numbers is not None:
        quaternion = unit(numbers)
        if quaternion is None:
            raise BagError(f"{option}: got {text!r}, allowed: {ALLOWED} that is not zero")
        return Turn(matrix(quaternion), quaternion)
    found = [re.fullmatch(r"([xyz])=([+-]?)([xyz])", part) for part in parts]
    axes = {match[1]: (match[2], match[3]) for match in found if match}
    if len(parts) != 3 or len(axes) != 3 or len({theirs for _, theirs in axes.values()}) != 3:
        raise BagError(f"{option}: got {text!r}, allowed: {ALLOWED}")
    rows = np.zeros((3, 3))
    for ours, (sign, theirs) in axes.items():
        rows["xyz".index(ours), "xyz".index(theirs)] = -1.0 if sign == "-" else 1.0
    if np.linalg.det(rows) < 0.0:
        raise BagError(f"{option}: got {text!r}, which is a mirror image, allowed: axes that stay right-handed")
    turn = rows.T if of_axes else rows
    x, y, z, w = matrix_quaternions(turn[None])[0].tolist()
    return Turn(turn, (x, y, z, w))


def matrix_quaternions(matrices: Floats) -> Floats:
    """Unit quaternions (n, 4) of rotation matrices (n, 3, 3), each of the same sign as the one before."""
    from scipy.spatial.transform import Rotation

    return same_signs(np.asarray(Rotation.from_matrix(matrices).as_quat(), dtype=np.float64))


def product(a: Floats | Quaternion, b: Floats | Quaternion) -> Floats:
    """Quaternions of the rotations a after b; each is (n, 4), or one for all."""
    ax, ay, az, aw = np.asarray(a, dtype=np.float64).T
    bx, by, bz, bw = np.asarray(b, dtype=np.float64).T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def turned(q: Floats, v: Floats) -> Floats:
    """Vectors (n, 3) turned by unit quaternions (n, 4)."""
    u, w = q[:, :3], q[:, 3:]
    across = 2.0 * np.cross(u, v)
    out: Floats = v + w * across + np.cross(u, across)
    return out


def units(q: Floats) -> Floats:
    """The quaternions (n, 4) at length one."""
    out: Floats = q / np.linalg.norm(q, axis=1, keepdims=True)
    return out


def same_signs(q: Floats) -> Floats:
    """The same rotations, no quaternion about the negative of the one before."""
    flips = np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0
    signs = np.append(1.0, np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0))
    out: Floats = q * signs[:, None]
    return out


def between(times: Ints, position: Floats, orientation: Floats, wanted: Ints) -> tuple[Floats, Floats]:
    """Poses at the `wanted` times (m,) [ns]: positions on straight lines, orientations on the shorter arc (slerp).

    times (n,) must rise; before the first and after the last pose, that one holds.
    """
    if len(times) == 1:
        return np.repeat(position, len(wanted), axis=0), units(np.repeat(orientation, len(wanted), axis=0))
    clipped = np.clip(wanted, times[0], times[-1])
    i = np.clip(np.searchsorted(times, clipped, side="right") - 1, 0, len(times) - 2)
    s = ((clipped - times[i]) / (times[i + 1] - times[i]))[:, None]
    q = same_signs(units(orientation))
    a, b = q[i], q[i + 1]
    cosine = np.einsum("ij,ij->i", a, b)[:, None]
    half = np.arccos(np.minimum(cosine, 1.0))
    near = cosine > 1.0 - NEARLY_ONE
    sine = np.where(near, 1.0, np.sin(half))
    wa = np.where(near, 1.0 - s, np.sin((1.0 - s) * half) / sine)
    wb = np.where(near, s, np.sin(s * half) / sine)
    return (1.0 - s) * position[i] + s * position[i + 1], units(wa * a + wb * b)


def _four_numbers(parts: list[str]) -> Quaternion | None:
    try:
        x, y, z, w = (float(part) for part in parts)
    except ValueError:
        return None
    return (x, y, z, w) if all(map(math.isfinite, (x, y, z, w))) else None

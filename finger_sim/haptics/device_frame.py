"""How a device's frame lies in the world: poses in, wrenches out, and the clutch. Compiled code works on a `Frame`.

R turns the device's axes to the world's, s scales motion, o is an offset, T is how the finger sits on the handle. A
handle at p with orientation q commands

    p' = o + s R p,    q' = R q T.

A wrench f, τ along the world's axes, about the commanded point, becomes along the device's axes, about the handle

    f_d = s Rᵀ f,    τ_d = Rᵀ τ.

As v' = s R v and ω' = R ω, the power through the port is the same on both sides: f_d · v = f · v' and τ_d · ω = τ · ω'.
So the account of energy (account.py) holds for the hand too. What is not kept under a scale is the force, which is s
times the finger's, and the stiffness that is felt, which is s² times.

The clutch moves o and T alone (`index`): R and s stay, and with them all of the above.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..physics.compile import formula, kernel, stage
from ..physics.records import side_by_side
from ..physics.rotations import Quaternion
from ..physics.turns import matrix_entries, normalised


class Frame(NamedTuple):
    """A device's frame.

    turn   : (4,) R, unit quaternion x y z w
    scale  : (1,) s
    offset : (3,) o [m]
    tool   : (4,) T, unit quaternion
    """

    turn: Floats
    scale: Floats
    offset: Floats
    tool: Floats


def build_frame(
    turn: Quaternion = (0.0, 0.0, 0.0, 1.0),
    scale: float = 1.0,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tool: Quaternion = (0.0, 0.0, 0.0, 1.0),
) -> Frame:
    """One of these; quaternions are unit ones, and the scale is positive."""
    fields: dict[str, Any] = {**side_by_side(Frame, turn=4, offset=3, tool=4)}
    frame = Frame(**fields)
    frame.turn[:], frame.scale[0], frame.offset[:], frame.tool[:] = turn, scale, offset, tool
    return frame


def handle_at(frame: Frame, orientation: Quaternion) -> Floats:
    """Orientation (4,) of a handle whose finger has that orientation in the world: Rᵀ q' Tᵀ."""
    return np.array(_product(_product(_conjugate(frame.turn), orientation), _conjugate(frame.tool)))


@kernel
def to_world(frame: Frame, handle: Floats, out: Floats) -> None:
    """The commanded pose (7,) of a handle's (7,): position [m] and quaternion x y z w."""
    x, y, z = _turned(_four(frame.turn, 0), handle[0], handle[1], handle[2])
    s = frame.scale[0]
    out[0], out[1], out[2] = frame.offset[0] + s * x, frame.offset[1] + s * y, frame.offset[2] + s * z
    q = _product(_product(_four(frame.turn, 0), _four(handle, 3)), _four(frame.tool, 0))
    out[3], out[4], out[5], out[6] = q[0], q[1], q[2], q[3]


@kernel
def to_device(frame: Frame, wrench: Floats, out: Floats) -> None:
    """A wrench (6,) [N, N m] along the world's axes as the handle's, along the device's; `out` may be `wrench`."""
    back, s = _conjugate(frame.turn), frame.scale[0]
    x, y, z = _turned(back, wrench[0], wrench[1], wrench[2])
    u, v, w = _turned(back, wrench[3], wrench[4], wrench[5])
    out[0], out[1], out[2], out[3], out[4], out[5] = s * x, s * y, s * z, u, v, w


@kernel
def to_handle(handle: Floats, wrench: Floats, out: Floats) -> None:
    """A wrench (6,) along the device's axes along those of the handle, whose pose is (7,); `out` may be `wrench`."""
    back = (-handle[3], -handle[4], -handle[5], handle[6])
    x, y, z = _turned(back, wrench[0], wrench[1], wrench[2])
    u, v, w = _turned(back, wrench[3], wrench[4], wrench[5])
    out[0], out[1], out[2], out[3], out[4], out[5] = x, y, z, u, v, w


@kernel
def index(frame: Frame, handle: Floats, held: Floats) -> None:
    """From now on the handle's pose (7,) commands the held one (7,), and moves it on from there."""
    x, y, z = _turned(_four(frame.turn, 0), handle[0], handle[1], handle[2])
    s = frame.scale[0]
    frame.offset[0], frame.offset[1], frame.offset[2] = held[0] - s * x, held[1] - s * y, held[2] - s * z
    there = _product(_four(frame.turn, 0), _four(handle, 3))
    q = normalised(_product((-there[0], -there[1], -there[2], there[3]), _four(held, 3)))
    frame.tool[0], frame.tool[1], frame.tool[2], frame.tool[3] = q[0], q[1], q[2], q[3]


@formula
def _four(numbers: Floats, at: int) -> Quaternion:
    return numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3]


@formula
def _conjugate(q: Floats) -> Quaternion:
    return -q[0], -q[1], -q[2], q[3]


@stage
def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Of unit quaternions: the rotation a after b."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@stage
def _turned(q: Quaternion, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion."""
    a, b, c, d, e, f, g, h, i = matrix_entries(q)
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

"""The usual PoseStamped, read and checked in compiled code as bags/poses.py does it, to the last bit.

What is not usual is left to that: a refusal needs its words, and another encoding comes once in a lifetime.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Bytes, Floats
from ..bags.template import STAMP_OFFSET
from ..physics.compile import exact, kernel
from ..physics.rotations import LONG_QUATERNION, SHORT_QUATERNION, UNIT, Quaternion
from ..scene.pose import FARTHEST
from .memory import read_float64, read_int32

LOOK = -1
"""`read_pose` leaves a message to Python."""
_NAME = STAMP_OFFSET + 12
_NUMBERS = 56
_UNSIGNED = 0xFFFFFFFF
_SPLIT = 2.0**27 + 1.0
_SURE = 2.0**-30


def frame_bytes(frame_id: str) -> Bytes:
    """A frame_id as messages hold it, without the zero at its end."""
    return np.frombuffer(bytearray(frame_id.encode()), np.uint8)


@kernel
def read_pose(data: Bytes, frame: Bytes, pose: Floats) -> int:
    """The stamp [ns] of a PoseStamped in CDR bytes; LOOK where it is refused, or not usual.

    frame : the frame_id that it must have, see `frame_bytes`
    pose  : (7,) is written unless it is to be looked at: position [m] and unit quaternion x y z w
    """
    size, name = data.shape[0], frame.shape[0]
    if size < _NAME or data[0] != 0 or data[1] != 1:
        return LOOK
    seconds, nanoseconds = read_int32(data, STAMP_OFFSET), read_int32(data, STAMP_OFFSET + 4) & _UNSIGNED
    length = read_int32(data, STAMP_OFFSET + 8) & _UNSIGNED
    at = _NAME + length
    at += (STAMP_OFFSET - at) % 8
    if size < at + _NUMBERS or seconds < 0 or nanoseconds >= 1_000_000_000:
        return LOOK
    if length < name or (length > name and data[_NAME + name] != 0):
        return LOOK
    for i in range(name):
        if data[_NAME + i] != frame[i] or frame[i] == 0:
            return LOOK
    for i in range(3):
        if not abs(read_float64(data, at + 8 * i)) <= FARTHEST:
            return LOOK
    turn = (
        read_float64(data, at + 24), read_float64(data, at + 32), read_float64(data, at + 40),
        read_float64(data, at + 48),
    )  # fmt: skip
    norm = length_of(turn)
    if not SHORT_QUATERNION <= norm <= LONG_QUATERNION:
        return LOOK
    if abs(norm - 1.0) < UNIT:
        norm = 1.0
    for i in range(3):
        pose[i] = read_float64(data, at + 8 * i)
    for i in range(4):
        pose[3 + i] = turn[i] / norm
    return seconds * 1_000_000_000 + nanoseconds


@exact
def length_of(q: Quaternion) -> float:
    """|q| rounded as exactly as Python's math.hypot gives it; NaN where that is not sure, or |q| is not allowed.

    The sum s of the squares is had to twice the digits of a float64, from products and sums with their errors (Dekker
    1971). So is its root h + (s − h²)/2h; NaN where it lies so near to the middle of two numbers that even this does
    not tell which of them is nearer: one in 10⁹ does.
    """
    total, rest = 0.0, 0.0
    for i in range(4):
        square, error = _square(q[i])
        larger = total + square
        part = larger - total
        rest += error + ((total - (larger - part)) + (square - part))
        total = larger
    if not 0.25 * SHORT_QUATERNION**2 <= total <= 4.0 * LONG_QUATERNION**2:
        return math.nan
    h = math.sqrt(total)
    square, error = _square(h)
    correction = (((total - square) - error) + rest) / (2.0 * h)
    low, high = h + correction * (1.0 - _SURE), h + correction * (1.0 + _SURE)
    return low if low == high else math.nan


@exact
def _square(x: float) -> tuple[float, float]:
    """x², and what its rounding left out."""
    p = x * x
    c = _SPLIT * x
    high = c - (c - x)
    low = x - high
    return p, ((high * high - p) + 2.0 * (high * low)) + low * low

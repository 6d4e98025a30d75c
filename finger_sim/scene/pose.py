"""`Pose`: where the finger frame is, and the one rule by which a pose is refused.

Every pose that comes from outside passes `checked_pose`: a command and a pose of the plane, whether they come over ROS,
out of a bag or from a script. Scene files are judged by the same bounds, those of the fields below.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..arrays import Floats
from ..errors import SceneError
from ..physics.rotations import Quaternion, matrix, normalised, unit
from .fields import field, specs, unwrapped

Vec3 = tuple[float, float, float]

FARTHEST = 1e4
"""Largest coordinate of a position [m]: float64 resolves two picometres there, and who sends more means nothing."""


@dataclasses.dataclass(frozen=True)
class Pose:
    """A rigid placement: a point X of the mesh as read goes to R X + position [m]; orientation is R as x y z w.

    Arrays and lists become tuples of floats. What is no pose can be made, but not used: see `checked_pose`.
    """

    position: Vec3 = field(
        "vec3",
        "Origin of the finger frame in the world",
        default=(0.0, 0.0, 0.0),
        unit="m",
        low=-FARTHEST,
        high=FARTHEST,
    )
    orientation: Quaternion = field(
        "quaternion", "Orientation of the finger frame in the world, x y z w", default=(0.0, 0.0, 0.0, 1.0)
    )

    def __post_init__(self) -> None:
        if not _are_floats(self.position, self.orientation):
            object.__setattr__(self, "position", _floats(self.position))
            object.__setattr__(self, "orientation", _floats(self.orientation))


_POSITION, _ORIENTATION = specs(Pose).values()


def checked_pose(pose: Pose, name: str = "") -> Pose:
    """The pose with a unit quaternion. Raises SceneError when it is refused; `name` says there which pose it is.

    Allowed: a position of three finite numbers, each within ±FARTHEST, and an orientation of four, whose length is from
    `rotations.SHORT_QUATERNION` to `LONG_QUATERNION`.
    """
    if not isinstance(pose, Pose):
        raise SceneError(name or "pose", pose, "a Pose")
    position, orientation = pose.position, pose.orientation
    if _are_floats(position, orientation):  # the usual pose is told in a tenth of the time that its fields take
        x, y, z = position
        turn = unit(orientation)
        near = -FARTHEST <= x <= FARTHEST and -FARTHEST <= y <= FARTHEST and -FARTHEST <= z <= FARTHEST
        if near and turn is not None:
            return pose if turn == orientation else Pose(position, turn)
    prefix = f"{name}." if name else ""
    return Pose(_POSITION.parse(position, f"{prefix}position"), _ORIENTATION.parse(orientation, f"{prefix}orientation"))


def place(rest: Floats, pose: Pose) -> Floats:
    """Rest nodes X (n, 3) [m] moved rigidly with the finger frame: R X + p, (n, 3) [m], world axes."""
    return rest @ matrix(normalised(pose.orientation)).T + np.asarray(pose.position, dtype=np.float64)


def _are_floats(position: Any, orientation: Any) -> bool:
    """Whether they are tuples of three and four floats."""
    try:
        x, y, z = position
        a, b, c, d = orientation
    except (TypeError, ValueError):
        return False
    kinds = type(x) is type(y) is type(z) is type(a) is type(b) is type(c) is type(d) is float
    return kinds and type(position) is type(orientation) is tuple


def _floats(values: object) -> object:
    """Numbers in an array, a list or a tuple as a tuple of floats; what is no such number stays as it is."""
    values = unwrapped(values)
    return tuple(_float(unwrapped(value)) for value in values) if isinstance(values, list | tuple) else values


def _float(value: object) -> object:
    try:
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value
    except OverflowError:  # a whole number that no float holds
        return value

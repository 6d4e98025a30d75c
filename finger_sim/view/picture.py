"""A cloud of points as a picture: where the finger frame is, how it touches, how deep."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..haptics.carrying import turned
from ..physics.rotations import matrix, normalised
from ..scene import Plane, Pose
from .protocol import CONTACT, Picture
from .raw import Cloud

Row = tuple[float, ...]
Rows = tuple[Row, ...]
"""A matrix of few numbers, in plain ones: arrays take several times as long for as few."""

_CREEP = 1e-5
"""Speed along the plane up to which a node rests [m/s], as in simulation/touch.py."""
_ROUNDING = 1e-5
"""Part of its largest friction that the float32 force of a node may lack when it is at the cone."""


class Ground:
    """What is touched, and how well its forces are solved for.

    normal : of the plane, outward; up where none is known
    turn   : (3, 3) axes of its pose in columns
    """

    def __init__(self, plane: Pose | None = None, friction: float = math.nan, tolerance: float = 0.0) -> None:
        self.plane, self.friction, self.tolerance = plane, friction, tolerance
        self.turn = matrix(normalised((plane or Pose()).orientation))
        self.normal: list[float] = self.turn[:, 2].tolist()


class Painter:
    """Makes pictures of one mesh; remembers the last one, since slip is motion.

    rest : (n, 3) nodes at rest, finger frame [m]
    """

    def __init__(self, rest: Floats) -> None:
        self._rest = np.asarray(rest, np.float64)
        self._three = _far_apart(self._rest)
        self._first = tuple(self._rest[self._three[0]].tolist())
        self._frame = _frame(self._rest[self._three].tolist())
        self._before: tuple[float, NDArray[np.float32], Ground] | None = None

    def __len__(self) -> int:
        return len(self._rest)

    def forget(self) -> None:
        """The next picture does not follow the last one."""
        self._before = None

    def paint(self, cloud: Cloud, time: float, ground: Ground) -> Picture:
        """The picture of a cloud of this mesh at a time [s]; command and device are left to the caller."""
        points = cloud.points
        positions, forces = points[:, 0:3], points[:, 6:9]
        place, turn = self._place(points)
        picture = Picture(time, positions, points[:, 9], (*place, *_quaternion(turn)), friction=ground.friction)
        plane = ground.plane
        if plane is not None:
            picture.plane = (*plane.position, *plane.orientation)
            own = [sum(turn[i][j] * ground.normal[i] for i in range(3)) for j in range(3)]
            above = sum((place[i] - plane.position[i]) * ground.normal[i] for i in range(3))
            picture.depth = max(0.0, -above - float((self._rest @ own).min()))
        if forces.any():
            self._touch(picture, positions, forces, place, ground)
        else:
            picture.wrench = (0.0,) * 6
        self._before = (time, positions, ground)
        return picture

    def _place(self, points: NDArray[np.float32]) -> tuple[Row, Rows]:
        """Where the finger frame is: three nodes, less their displacement, lie as at rest in it."""
        placed = [(x - a, y - b, z - c) for x, y, z, a, b, c in points[self._three, :6].tolist()]
        now, rest = _frame(placed), self._frame
        turn = tuple(tuple(sum(now[k][i] * rest[k][j] for k in range(3)) for j in range(3)) for i in range(3))
        place = tuple(placed[0][i] - sum(turn[i][j] * self._first[j] for j in range(3)) for i in range(3))
        return place, turn

    def _touch(
        self, picture: Picture, positions: NDArray[np.float32], forces: NDArray[np.float32], place: Row, ground: Ground
    ) -> None:
        """The nodes in contact, what they carry together, and where."""
        touching = np.flatnonzero(forces.any(axis=1))
        at, push = positions[touching].astype(np.float64), forces[touching].astype(np.float64)
        picture.wrench = [*push.sum(axis=0).tolist(), *_cross(at - place, push).sum(axis=0).tolist()]
        picture.contacts = np.zeros(len(touching), CONTACT)
        picture.contacts["node"], picture.contacts["force"] = touching, push
        if ground.plane is None:
            return
        along = push @ ground.normal
        weight = np.maximum(along, 0.0)
        total = weight.sum()
        if total > 0.0:
            picture.centre = (weight @ at / total).tolist()
            picture.contacts["slips"] = self._slips(picture.time, touching, at, push, along, ground)

    def _slips(
        self, time: float, touching: NDArray[np.intp], at: Floats, push: Floats, along: Floats, ground: Ground
    ) -> NDArray[np.bool_]:
        """Which of the touching nodes moved along the plane since the last picture with their friction at its limit."""
        if self._before is None or not self._before[0] < time or ground.plane is None:
            return np.zeros(len(touching), bool)
        before, was, ground_was = self._before
        if ground_was.plane is None:
            return np.zeros(len(touching), bool)
        moved = (at - ground.plane.position) @ ground.turn[:, :2]
        moved -= (was[touching] - np.array(ground_was.plane.position)) @ ground_was.turn[:, :2]
        speed = np.hypot(moved[:, 0], moved[:, 1]) / (time - before)
        friction = push - along[:, None] * ground.turn[:, 2]
        most = (1.0 - max(ground.tolerance, _ROUNDING)) * ground.friction * along
        return np.asarray(((friction**2).sum(axis=1) >= most**2) & (speed > _CREEP))


def plane_frame(plane: Plane) -> Pose:
    """The pose whose x-y plane it is and whose z is its normal, as simulation/ground.py has it."""
    a, b, c = plane.unit_normal.tolist()
    return Pose(plane.point, turned((a, b, c), (0.0, 0.0, 1.0)))


def _far_apart(rest: Floats) -> NDArray[np.intp]:
    """Three nodes that span the mesh (3,)."""
    first = int(np.linalg.norm(rest - rest.mean(axis=0), axis=1).argmax())
    arms = rest - rest[first]
    second = int(np.linalg.norm(arms, axis=1).argmax())
    third = int(np.linalg.norm(np.cross(arms, arms[second]), axis=1).argmax())
    return np.array([first, second, third])


def _frame(three: Sequence[Sequence[float]]) -> Rows:
    """Three axes that turn with three points: along their first edge, across it, and along their plane's normal."""
    (px, py, pz), (qx, qy, qz), (rx, ry, rz) = three
    ax, ay, az = _unit(qx - px, qy - py, qz - pz)
    bx, by, bz = rx - px, ry - py, rz - pz
    nx, ny, nz = _unit(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    return (ax, ay, az), (ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax), (nx, ny, nz)


def _unit(x: float, y: float, z: float) -> Row:
    length = math.sqrt(x * x + y * y + z * z) or 1.0
    return x / length, y / length, z / length


def _cross(a: Floats, b: Floats) -> Floats:
    """Vector products of rows; np.cross takes five times as long for few."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def _quaternion(turn: Rows) -> tuple[float, float, float, float]:
    """x y z w of a rotation matrix; w ≥ 0."""
    (a, b, c), (d, e, f), (g, h, i) = turn
    if a + e + i > 0.0:
        q = (h - f, c - g, d - b, 1.0 + a + e + i)
    elif a >= e and a >= i:
        q = (1.0 + a - e - i, b + d, c + g, h - f)
    elif e >= i:
        q = (b + d, 1.0 - a + e - i, f + h, c - g)
    else:
        q = (c + g, f + h, 1.0 - a - e + i, d - b)
    length = math.copysign(math.hypot(*q), q[3])
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length

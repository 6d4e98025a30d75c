"""A cloud of points as a picture: where the finger frame is, how it touches, how deep."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..haptics.carrying import turned
from ..physics.rotations import matrix, normalised
from ..scene import Plane, Pose
from .protocol import CONTACT, Picture
from .raw import Cloud

_CREEP = 1e-5
"""Speed along the plane up to which a node rests [m/s], as in simulation/touch.py."""
_ROUNDING = 1e-5
"""Part of its largest friction that the float32 force of a node may lack when it is at the cone."""


@dataclass
class Ground:
    """What is touched, and how well its forces are solved for."""

    plane: Pose | None = None
    friction: float = np.nan
    tolerance: float = 0.0


class Painter:
    """Makes pictures of one mesh; remembers the last one, since slip is motion.

    rest : (n, 3) nodes at rest, finger frame [m]
    """

    def __init__(self, rest: Floats) -> None:
        self._rest = np.asarray(rest, np.float64)
        self._three = _far_apart(self._rest)
        self._frame = _frame(self._rest[self._three])
        self._before: tuple[float, NDArray[np.float32], Pose] | None = None

    def __len__(self) -> int:
        return len(self._rest)

    def forget(self) -> None:
        """The next picture does not follow the last one."""
        self._before = None

    def paint(self, cloud: Cloud, time: float, ground: Ground) -> Picture:
        """The picture of a cloud of this mesh at a time [s]; command and device are left to the caller."""
        points = cloud.points
        positions, forces = points[:, 0:3], points[:, 6:9]
        pose = self.pose_of(points)
        picture = Picture(time, positions, points[:, 9], pose, friction=ground.friction)
        touching = np.flatnonzero(forces.any(axis=1))
        at, push = positions[touching].astype(np.float64), forces[touching].astype(np.float64)
        picture.wrench = np.zeros(6)
        if touching.size:
            picture.wrench[:3] = push.sum(axis=0)
            picture.wrench[3:] = _cross(at - pose[:3], push).sum(axis=0)
        slips = np.zeros(len(touching), bool)
        plane = ground.plane
        if plane is not None:
            turn = matrix(normalised(plane.orientation))
            normal = turn[:, 2]
            picture.plane = np.array([*plane.position, *plane.orientation])
            own = normal @ matrix(normalised(pose[3:].tolist()))
            height = (self._rest @ own).min() + (pose[:3] - plane.position) @ normal
            picture.depth = max(0.0, -float(height))
            along = push @ normal
            if along.sum() > 0.0:
                weight = np.maximum(along, 0.0)
                picture.centre = weight @ at / weight.sum()
                slips = self._slips(time, touching, at, plane, turn, push, along, ground)
            self._before = (time, positions, plane)
        picture.contacts = np.zeros(len(touching), CONTACT)
        picture.contacts["node"], picture.contacts["force"], picture.contacts["slips"] = touching, push, slips
        return picture

    def pose_of(self, points: NDArray[np.float32]) -> Floats:
        """Position and x y z w (7,) of the finger frame: three nodes, less their displacement, lie as at rest in it."""
        three = points[self._three].astype(np.float64)
        placed = three[:, 0:3] - three[:, 3:6]
        turn = _frame(placed) @ self._frame.T
        return np.concatenate([placed[0] - turn @ self._rest[self._three[0]], quaternion(turn)])

    def _slips(
        self, time: float, touching: NDArray[np.intp], at: Floats, plane: Pose, turn: Floats, push: Floats,
        along: Floats, ground: Ground,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Which of the touching nodes moved along the plane since the last picture with their friction at its limit."""
        if self._before is None or not self._before[0] < time:
            return np.zeros(len(touching), bool)
        before, was, plane_was = self._before
        turn_was = turn if plane_was == plane else matrix(normalised(plane_was.orientation))
        moved = (at - plane.position) @ turn[:, :2] - (was[touching] - np.array(plane_was.position)) @ turn_was[:, :2]
        speed = np.hypot(moved[:, 0], moved[:, 1]) / (time - before)
        friction = push - along[:, None] * turn[:, 2]
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


def _frame(three: Floats) -> Floats:
    """Axes in columns (3, 3) that turn with three points: along the first edge, in their plane, along its normal."""
    (ax, ay, az), (bx, by, bz) = (three[1:] - three[0]).tolist()
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    return np.array(
        [
            [ax, ny * az - nz * ay, nx],
            [ay, nz * ax - nx * az, ny],
            [az, nx * ay - ny * ax, nz],
        ]
    )


def _cross(a: Floats, b: Floats) -> Floats:
    """Vector products of rows; np.cross takes five times as long for few."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def quaternion(turn: Floats) -> Floats:
    """x y z w of a rotation matrix; w ≥ 0."""
    xx, yy, zz = turn[0, 0], turn[1, 1], turn[2, 2]
    squares = np.array([1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz])
    k = int(squares.argmax())
    q = np.zeros(4)
    q[k] = squares[k]
    if k == 3:
        q[:3] = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    else:
        i, j = (k + 1) % 3, (k + 2) % 3
        q[i], q[j], q[3] = turn[i, k] + turn[k, i], turn[j, k] + turn[k, j], turn[j, i] - turn[i, j]
    q /= np.linalg.norm(q)
    return q if q[3] >= 0.0 else -q

"""A cloud of points as a picture: where the finger frame is, how it touches, how deep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..physics.rotations import matrix, normalised
from ..scene import Pose
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
        self._middle = self._rest.mean(axis=0)
        self._arms = self._rest - self._middle
        self._before: tuple[float, NDArray[np.float64], Pose] | None = None

    def __len__(self) -> int:
        return len(self._rest)

    def forget(self) -> None:
        """The next picture does not follow the last one."""
        self._before = None

    def paint(self, cloud: Cloud, time: float, ground: Ground) -> Picture:
        """The picture of a cloud of this mesh at a time [s]; command and device are left to the caller."""
        points = cloud.points
        positions, forces = points[:, 0:3], points[:, 6:9].astype(np.float64)
        placed = positions.astype(np.float64) - points[:, 3:6]
        pose = self.pose_of(placed)
        picture = Picture(time, positions, points[:, 9], pose, friction=ground.friction)
        arms = positions.astype(np.float64) - pose[:3]
        picture.wrench = np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])
        if ground.plane is None:
            touching = np.flatnonzero(np.any(forces != 0.0, axis=1))
            picture.contacts = _contacts(touching, forces, np.zeros(len(touching), bool))
            self._before = None
            return picture
        point, turn = np.array(ground.plane.position), matrix(normalised(ground.plane.orientation))
        normal = turn[:, 2]
        picture.plane = np.array([*ground.plane.position, *ground.plane.orientation])
        picture.depth = max(0.0, -float(((placed - point) @ normal).min()))
        push = forces @ normal
        touching = np.flatnonzero(push > 0.0)
        if touching.size:
            weight = push[touching]
            picture.centre = weight @ positions[touching].astype(np.float64) / weight.sum()
        along = (positions.astype(np.float64) - point) @ turn[:, :2]
        slips = self._slips(time, along, ground.plane, forces[touching], push[touching], normal, ground, touching)
        picture.contacts = _contacts(touching, forces, slips)
        self._before = (time, along, ground.plane)
        return picture

    def pose_of(self, placed: Floats) -> Floats:
        """Position and x y z w (7,) that take the mesh at rest to `placed` (n, 3), in least squares (Kabsch)."""
        middle = placed.mean(axis=0)
        u, _, v = np.linalg.svd((placed - middle).T @ self._arms)
        u[:, 2] *= np.linalg.det(u) * np.linalg.det(v)
        turn = u @ v
        return np.concatenate([middle - turn @ self._middle, quaternion(turn)])

    def _slips(
        self, time: float, along: Floats, plane: Pose, forces: Floats, push: Floats, normal: Floats, ground: Ground,
        touching: NDArray[np.intp],
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Which of the touching nodes moved along the plane since the last picture with their friction at its limit."""
        if self._before is None or not self._before[0] < time:
            return np.zeros(len(touching), bool)
        before, was, _ = self._before
        speed = np.linalg.norm(along[touching] - was[touching], axis=1) / (time - before)
        friction = np.linalg.norm(forces - np.outer(push, normal), axis=1)
        limited = friction >= (1.0 - max(ground.tolerance, _ROUNDING)) * ground.friction * push
        return np.asarray(limited & (speed > _CREEP))


def _contacts(nodes: NDArray[np.intp], forces: Floats, slips: NDArray[np.bool_]) -> NDArray[np.void]:
    out = np.zeros(len(nodes), CONTACT)
    out["node"], out["force"], out["slips"] = nodes, forces[nodes], slips
    return out


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

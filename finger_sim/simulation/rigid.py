"""Rigid motions of many points: carried by one, and the one nearest to theirs."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats
from ..physics.rotations import matrix
from ..scene import Pose


def carried(points: Floats, before: Pose, after: Pose) -> Floats:
    """Points (n, 3) [m], world, that go with a frame from one pose to another."""
    turn = matrix(after.orientation) @ matrix(before.orientation).T
    moved: Floats = (points - np.array(before.position)) @ turn.T + np.array(after.position)
    return moved


def twist_of(arms: Floats, velocities: Floats) -> Floats:
    """(6,) velocity [m/s] of a point and angular velocity [rad/s], nearest to velocities (n, 3) at arms from it [m]."""
    turning = np.cross(np.eye(3)[None], arms[:, None, :])  # e_k × ρ
    system = np.concatenate([np.broadcast_to(np.eye(3), turning.shape), turning], axis=1).transpose(0, 2, 1)
    twist: Floats = np.linalg.lstsq(system.reshape(-1, 6), velocities.ravel())[0]
    return twist


def best_fit(rest: Floats, points: Floats, mass: Floats) -> Pose:
    """The pose that takes points at rest (n, 3) [m] nearest to where they are, by their mass (n,)."""
    centre, rest_centre = (mass @ points / mass.sum(), mass @ rest / mass.sum())
    turn, _ = Rotation.align_vectors(points - centre, rest - rest_centre, weights=mass)
    px, py, pz = centre - turn.apply(rest_centre)
    qx, qy, qz, qw = turn.as_quat()
    return Pose((float(px), float(py), float(pz)), (float(qx), float(qy), float(qz), float(qw)))

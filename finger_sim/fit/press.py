"""`Press`: what was measured while a finger was pressed on a plane, and how it is followed in a simulation.

Plane frame: the plane is z = 0 and its normal z. Forces are of the plane on the finger. Depth is how far the bone has
come down since the skin first touched.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from ..arrays import Floats, Ints
from ..errors import FingerSimError
from ..physics.rotations import Quaternion, matrix, normalised
from ..scene import Plane, Scene
from ..scene.calibration import name_of
from ..scene.finger_shape import first_touch
from ..scene.mesh import TetMesh
from ..studies.at_rest import ORIENTATIONS

TARGET = "target"
"""Name of a press that nobody measured: see `target`."""
OTHER_FINGER = "finger_paper"
"""A shipped mesh whose skin is not that of `finger_shape`."""
PART = 1e-4
"""Of a press: way of the bone between two moments that are computed [m], or less: see `parts_of`."""
LEAST_PARTS, MOST_PARTS = 12, 150
"""So many a press."""
STEPS = 4
"""Time steps after each part, in which the finger comes to rest."""
AHEAD = 1e-4
"""Height above first touch from which a press is simulated [m]."""
SLICES = 40
"""A press that is followed in time is judged in about so many slices of its duration, and of its way."""


class FitError(FingerSimError):
    """Data that cannot be fitted, or a fit that cannot be made: where, what was found, what is allowed."""


@dataclass(frozen=True)
class Press:
    """One press. All arrays have a value for each of n samples.

    direction   : "flat", "side", "tip", or "pose" where poses were measured
    time        : (n,) [s], rising
    position    : (n, 3) origin of the finger frame, plane frame [m]
    orientation : (n, 4) unit quaternions xyzw
    touch       : height of that origin at which the skin first touches [m]
    normal      : (n,) normal force [N], ≥ 0 where the plane pushes
    tangential  : (n,) size of the tangential force [N], or (n, 2) its parts along x and y; None: not measured
    area        : (n,) contact area [m²]; None: not measured
    """

    name: str
    direction: str
    time: Floats
    position: Floats
    orientation: Floats
    touch: float
    normal: Floats
    tangential: Floats | None = None
    area: Floats | None = None

    @property
    def depth(self) -> Floats:
        """How far the bone has come down since first touch (n,) [m]."""
        return np.asarray(self.touch - self.position[:, 2])

    @property
    def slides(self) -> bool:
        """Whether the bone moves along the plane by more than 0.1 mm while the finger touches."""
        there = self.position[self.depth > 0.0, :2]
        return len(there) > 0 and float(np.ptp(there, axis=0).max()) > 1e-4


class Path(NamedTuple):
    """How a simulation follows a press, and where its samples lie on that way.

    poses : (k, 7) commands, position [m] and orientation xyzw, plane frame
    steps : (k,) time steps with each
    used  : (m,) samples that are compared
    after : (m,) the command that each of them comes by, ≥ 1
    part  : (m,) how much of the way from the command before is done then, 0 to 1
    group : (m,) samples whose differences count together, from 0 on, rising
    """

    poses: Floats
    steps: Ints
    used: Ints
    after: Ints
    part: Floats
    group: Ints


def orientation_of(direction: str) -> Quaternion:
    """Of "flat", "side" or "tip". Raises FitError for another word."""
    if direction not in ORIENTATIONS:
        raise FitError(f"direction: got {direction!r}, allowed: {', '.join(ORIENTATIONS)}")
    return ORIENTATIONS[direction]


def touch_height(scene: Scene, mesh: TetMesh, orientation: Quaternion) -> float:
    """Height of the finger frame at which the skin just touches z = 0 [m].

    For shipped fingers of the skin that all of them are meshes of; else of the mesh's own surface.
    """
    name, turn = name_of(scene.mesh.file), matrix(orientation)
    if name is not None and name != OTHER_FINGER:
        return first_touch(turn)
    return -float((mesh.points[np.unique(mesh.surface)] @ turn[2]).min())


def plane_axes(plane: Plane) -> Floats:
    """(3, 3) from world axes to the plane's: the least turn that takes its normal to z."""
    n = plane.unit_normal
    axis, cosine = np.cross(n, [0.0, 0.0, 1.0]), float(n[2])
    if cosine < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    return matrix(normalised([*axis.tolist(), 1.0 + cosine]))


def parts_of(press: Press) -> float:
    """Way between two moments that are computed [m]."""
    way = float(np.linalg.norm(np.diff(press.position[touching(press)], axis=0), axis=1).sum())
    deepest = float(press.depth.max())
    return float(np.clip(deepest / LEAST_PARTS, way / MOST_PARTS, max(PART, way / MOST_PARTS)))


def touching(press: Press) -> Ints:
    """Samples from just before the first touch to just after the last. Raises FitError where there are none."""
    inside = np.flatnonzero(press.depth > 0.0)
    if len(inside) == 0:
        raise FitError(f"{press.name}: depth: got at most {1e3 * press.depth.max():.4g} mm, allowed: some above 0")
    return np.arange(max(inside[0] - 1, 0), min(inside[-1] + 2, len(press.time)))


def at_rest_path(press: Press, shift: float = 0.0, coarse: float = 1.0, finer: int = 1) -> Path:
    """The way of a press in small parts, with rests: time does not matter.

    shift  : how much deeper the finger is than was measured [m]
    coarse : factor of the parts' length
    finer  : so many moments a part, without other groups of samples
    """
    used, part = touching(press), coarse * parts_of(press)
    at = np.concatenate([press.position[used], press.orientation[used]], axis=1)
    at[:, 2] -= shift
    corners = [0]
    deepest = int(np.argmax(press.depth[used]))
    for i in range(1, len(at)):
        if np.linalg.norm(at[i, :3] - at[corners[-1], :3]) >= part or i in (deepest, len(at) - 1):
            corners.append(i)
    above = at[0].copy()
    above[2] = max(press.touch, at[0, 2]) + AHEAD
    poses, after, share, group = [above], np.empty(len(at), int), np.ones(len(at)), np.zeros(len(at), int)
    _walk(poses, at[0], part / finer)
    after[0] = len(poses) - 1
    for number, (a, b) in enumerate(itertools.pairwise(corners), start=1):
        begin, inside = len(poses) - 1, slice(a + 1, b + 1)
        _walk(poses, at[b], part / finer)
        way = at[b, :3] - at[a, :3]
        done = np.clip((at[inside, :3] - at[a, :3]) @ way / max(float(way @ way), 1e-18), 0.0, 1.0)
        moment = done * (len(poses) - 1 - begin)
        last = np.maximum(np.ceil(moment - 1e-9), 1.0)
        after[inside], share[inside], group[inside] = begin + last.astype(int), moment - last + 1.0, number
    return Path(np.array(poses), np.full(len(poses), STEPS), used, after, share, group)


def _walk(poses: list[Floats], to: Floats, part: float) -> None:
    """Adds commands to a pose, none farther than about `part` from the one before."""
    start = poses[-1]
    parts = max(1, math.ceil(float(np.linalg.norm(to[:3] - start[:3])) / part - 0.5))
    for k in range(1, parts + 1):
        pose = start + (to - start) * (k / parts)
        pose[3:] /= np.linalg.norm(pose[3:])
        poses.append(pose)


def timed_path(press: Press, dt: float, shift: float = 0.0) -> Path:
    """The way of a press in time, one command for each step of dt [s], smooth between samples.

    shift: see `at_rest_path`
    """
    used = touching(press)
    t = press.time[used] - press.time[used[0]]
    at = np.concatenate([press.position[used], press.orientation[used]], axis=1)
    at[:, 2] -= shift
    ahead = math.ceil(0.1 / dt)  # the way down to the first sample takes a tenth of a second
    clock = dt * np.arange(math.ceil(t[-1] / dt) + 1)
    poses = PchipInterpolator(t, at)(np.minimum(clock, t[-1]))
    above = poses[0].copy()
    above[2] = max(press.touch, above[2]) + AHEAD
    lead = above + (poses[0] - above) * np.linspace(0.0, 1.0, ahead, endpoint=False)[:, None]
    poses = np.concatenate([lead, poses])
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
    moment = t / dt + ahead
    after = np.clip(np.ceil(moment - 1e-9).astype(int), 1, len(poses) - 1)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at[:, :3], axis=0), axis=1))])
    slices = way / max(parts_of(press), 1e-9) + SLICES * t / max(t[-1], 1e-9)
    _, group = np.unique(np.floor(slices), return_inverse=True)
    return Path(poses, np.ones(len(poses), int), used, after, np.clip(moment - after + 1.0, 0.0, 1.0), group)

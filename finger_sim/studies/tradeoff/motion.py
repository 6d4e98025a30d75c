"""The motions of `finger_sim tradeoff`: a path of the bone that is the same for every time step."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from ...arrays import Floats
from ...bags.reader import read_commands
from ...bags.strokes import Stroke, trace
from ...haptics.coupling import between
from ...physics.rotations import matrix
from ...scene import Pose, Scene, place
from ...scene.resources import find_bag
from .errors import TradeoffError

PRESS = "press_hold_slide"
"""Name of the motion without a bag."""
GAP, DEPTH, LENGTH = 0.2e-3, 2e-3, 6e-3
"""Height over the plane at the start, depth pressed to, length of the slide [m]."""
STROKES = (
    Stroke(0.01, (0.0, 0.0, GAP)),
    Stroke(0.2, (0.0, 0.0, -DEPTH)),
    Stroke(0.05, (0.0, 0.0, -DEPTH)),
    Stroke(0.2, (LENGTH, 0.0, -DEPTH)),
    Stroke(0.05, (LENGTH, 0.0, -DEPTH)),
)
"""Pressed, held, slid along the plane to the tip's side, held; x and z along the plane and its normal."""
KNOT_RATE = 1000.0
"""Commands a second of the motion without a bag [Hz]."""
SLOW = 5e-3
"""Speed of the bone under which it is held: as the tremor of a hand at rest [m/s]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Commands over time. Between two the bone goes straight from one to the other, whatever the time step."""

    name: str
    times: Floats  # (k,) from 0 on [s]
    position: Floats  # (k, 3) [m]
    orientation: Floats  # (k, 4) xyzw

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1])

    @property
    def digest(self) -> str:
        """Hash of the commands."""
        whole = np.concatenate([self.times[:, None], self.position, self.orientation], axis=1)
        return hashlib.sha256(whole.tobytes()).hexdigest()[:16]

    def steps(self, dt: float) -> int:
        """Whole steps of `dt` [s] in the motion."""
        return int(self.duration / dt + 1e-6)

    def at(self, time: float) -> Pose:
        """The pose at a time [s]."""
        k = min(int(np.searchsorted(self.times, time, side="right")) - 1, len(self.times) - 2)
        share = (time - self.times[k]) / (self.times[k + 1] - self.times[k])
        return between(self._pose(k), self._pose(k + 1), float(np.clip(share, 0.0, 1.0)))

    def poses(self, dt: float) -> list[Pose]:
        """The pose at the end of each step."""
        return [self.at((k + 1) * dt) for k in range(self.steps(dt))]

    def held(self, times: Floats, dt: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Whether the bone is slower than SLOW in the steps that end at `times` (n,)."""
        ends = np.array([self.at(t).position for t in times])
        starts = np.array([self.at(max(t - dt, 0.0)).position for t in times])
        return np.asarray(np.linalg.norm(ends - starts, axis=1) < SLOW * dt)

    def cut(self, duration: float) -> Motion:
        """The same, no longer than `duration` [s]."""
        keep = max(2, int(np.searchsorted(self.times, duration + 1e-9, side="right")))
        return Motion(self.name, self.times[:keep], self.position[:keep], self.orientation[:keep])

    def _pose(self, k: int) -> Pose:
        (x, y, z), (a, b, c, d) = self.position[k].tolist(), self.orientation[k].tolist()
        return Pose((x, y, z), (a, b, c, d))


def motion(scene: Scene, bag: str | None, duration: float | None = None) -> Motion:
    """The commands of a bag, or STROKES on the scene's plane, cut to `duration` [s].

    Raises TradeoffError when a scene without a plane or a bone comes without a bag, BagError when a bag is none.
    """
    whole = press(scene) if bag is None else _of_bag(bag)
    return whole if duration is None else whole.cut(duration)


def press(scene: Scene) -> Motion:
    """STROKES: from where the skin of the undeformed body, turned as in the initial pose, is GAP over the plane."""
    plane = scene.plane
    if plane is None or scene.driven is None:
        raise TradeoffError("--bag: needed for a scene without a plane or without driven nodes")
    mesh, turn = scene.load_mesh(), scene.initial_pose.orientation
    soft = np.setdiff1d(np.arange(len(mesh.points)), scene.driven_nodes(mesh))
    normal = plane.unit_normal
    skin = place(mesh.points[soft], Pose((0.0, 0.0, 0.0), turn)) @ normal
    touch = float(np.dot(plane.point, normal)) - float(skin.min())
    along = matrix(turn)[:, 0] - normal * float(matrix(turn)[:, 0] @ normal)
    if np.linalg.norm(along) < 0.1:
        along = np.cross(normal, matrix(turn)[:, 1])
    times = np.arange(round(sum(stroke.duration for stroke in STROKES) * KNOT_RATE) + 1) / KNOT_RATE
    place_of = trace(STROKES, times)
    position = np.outer(place_of[:, 0], along / np.linalg.norm(along)) + np.outer(place_of[:, 2] + touch, normal)
    return Motion(PRESS, times, position, np.tile(np.array(turn), (len(times), 1)))


def _of_bag(bag: str) -> Motion:
    """A bag's commands; of those received at the same time the last."""
    path = find_bag(bag)
    commands = read_commands(path)
    last = np.append(np.diff(commands.receipt) > 0.0, True)
    if last.sum() < 2:
        raise TradeoffError(f"--bag: {path}: holds one command, allowed: two or more")
    return Motion(path.stem, commands.receipt[last], commands.position[last], commands.orientation[last])

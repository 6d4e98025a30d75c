"""Motions of `finger_sim stress`: lists of poses, one a step, of a body that begins at the identity pose."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import Floats
from ...haptics.coupling import between
from ...scene import Pose, Vec3

STILL = Pose()


def pose(position: Iterable[float] = (0.0, 0.0, 0.0), turn: Iterable[float] = (0.0, 0.0, 0.0)) -> Pose:
    """A pose by its position [m] and its rotation vector [rad]."""
    return placed(np.array(list(position), np.float64), Rotation.from_rotvec(list(turn)))


def placed(position: Floats, turn: Rotation) -> Pose:
    """A pose of an array and a rotation."""
    x, y, z = position.tolist()
    qx, qy, qz, qw = turn.as_quat().tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def hold(at: Pose, steps: int) -> list[Pose]:
    """The same pose so many times."""
    return [at] * steps


def move(begin: Pose, end: Pose, steps: int) -> list[Pose]:
    """Evenly from one pose to the other, which is the last."""
    return [between(begin, end, k / steps) for k in range(1, steps + 1)]


def there_and_back(middle: Pose, steps: int, rest: int, begin: Pose = STILL) -> list[Pose]:
    """To `middle` and back in so many steps each, with `rest` steps of standing still after either."""
    return move(begin, middle, steps) + hold(middle, rest) + move(middle, begin, steps) + hold(begin, rest)


def shake(amplitude: Vec3, frequency: float, dt: float, steps: int, about: Pose = STILL) -> list[Pose]:
    """A sine of that amplitude [m] and frequency [Hz] about a pose."""
    wave = np.sin(2.0 * math.pi * frequency * dt * np.arange(1, steps + 1))
    around = np.array(about.position) + wave[:, None] * np.array(amplitude)
    return [Pose((x, y, z), about.orientation) for x, y, z in around.tolist()]


def walk(rng: np.random.Generator, stride: float, turn: float, steps: int) -> list[Pose]:
    """A random walk, `stride` [m] and `turn` [rad] a step."""
    way = np.cumsum(stride * rng.standard_normal((steps, 3)), axis=0)
    turns = np.cumsum(turn * rng.standard_normal((steps, 3)), axis=0)
    return [placed(p, Rotation.from_rotvec(r)) for p, r in zip(way, turns, strict=True)]


def carried(motion: Iterable[Pose | None], frame: Pose) -> tuple[Pose | None, ...]:
    """The same motion in a world in which the identity pose is `frame`."""
    turn, origin = Rotation.from_quat(frame.orientation), np.array(frame.position)
    return tuple(
        p and placed(origin + turn.apply(p.position), turn * Rotation.from_quat(p.orientation)) for p in motion
    )

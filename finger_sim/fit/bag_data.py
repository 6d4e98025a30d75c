"""A press in a bag: poses of the finger and the wrench that a sensor, or the node, told meanwhile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Floats
from ..bags import cdr
from ..bags.imports.turns import matrix_quaternions, product
from ..bags.quantities import KINDS
from ..bags.reader import BagReader, absolute, commands_of
from ..physics.rotations import normalised
from ..scene import Scene
from ..scene.mesh import TetMesh
from .press import FitError, Press, plane_axes, touch_height

RATE = 500.0
"""Samples that are kept a second [Hz], at most."""


def read_bag(path: Path, scene: Scene, mesh: TetMesh) -> list[Press]:
    """The press in a bag, as one.

    Poses are those of a topic `pose`, where the finger is, else the commands. The wrench is that of a topic
    `contact_wrench`, else the only one: of the plane on the finger, in the axes that poses are in. These are the
    scene's world, and its plane is what the finger was pressed on.

    Raises FitError where something is missing, BagError where the bag cannot be read.
    """
    if scene.plane is None:
        raise FitError("plane: the scene has none, allowed: one that the finger was pressed on")
    reader = BagReader(path)
    wrenches = _topics(reader, cdr.WRENCH_STAMPED, "contact_wrench")
    poses = _topics(reader, cdr.POSE_STAMPED, "pose", needed=False)
    if not wrenches:
        raise FitError(
            f"{path}: no topic of type {cdr.WRENCH_STAMPED}; found {', '.join(t.name for t in reader.topics)}"
        )
    commands = commands_of(reader, poses[0] if poses else None, allow_gaps=True)
    times, forces = _forces(reader, wrenches[0])
    begin = commands.start
    t, own = (times - begin) * 1e-9, commands.receipt
    inside = (t >= own[0]) & (t <= own[-1])
    if inside.sum() < 2:
        raise FitError(
            f"{path}: topic {wrenches[0]}: {int(inside.sum())} wrenches while there are poses, allowed: more"
        )
    t, forces = t[inside], forces[inside]
    keep = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], 1.0 / RATE)))
    t, forces = t[keep], forces[keep]
    turn, origin = plane_axes(scene.plane), np.array(scene.plane.point)
    at = np.searchsorted(own, t, side="right") - 1
    position = np.stack([np.interp(t, own, column) for column in commands.position.T], axis=1)
    orientation = product(matrix_quaternions(turn[None])[0], commands.orientation[at])
    position, force = (position - origin) @ turn.T, forces @ turn.T
    deepest = int(np.argmin(position[:, 2]))
    touch = touch_height(scene, mesh, normalised(orientation[deepest].tolist()))
    return [Press(path.stem, "pose", t, position, orientation, touch, force[:, 2], force[:, :2])]


def _topics(reader: BagReader, kind: str, name: str, *, needed: bool = True) -> list[str]:
    """Topics of a type that end in a name; else, where one is needed, the only one of that type."""
    of_kind = list(dict.fromkeys(absolute(topic.name) for topic in reader.topics if topic.type == kind and topic.count))
    named = [each for each in of_kind if each.rpartition("/")[2] == name]
    if named or not needed:
        return named
    if len(of_kind) > 1:
        raise FitError(f"{reader.path}: several topics of {kind}: {', '.join(of_kind)}; allowed: one named {name}")
    return of_kind


def _forces(reader: BagReader, topic: str) -> tuple[Floats, Floats]:
    """Log times [ns] and forces (n, 3) [N]."""
    times, forces = [], []
    for number, message in enumerate(reader.messages([topic], cdr.WRENCH_STAMPED), start=1):
        try:
            told: Any = cdr.deserialize(message.data, cdr.WRENCH_STAMPED)
        except ValueError as error:
            raise FitError(f"{reader.path}: topic {topic}: message {number}: {error}") from None
        force = KINDS[cdr.WRENCH_STAMPED].value(told).parts[0][0]
        if np.isfinite(force).all():
            times.append(message.log_time)
            forces.append(force)
    return np.array(times, np.float64), np.array(forces).reshape(-1, 3)

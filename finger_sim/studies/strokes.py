"""The commands of a bag, one pose for every step of a scene."""

from __future__ import annotations

import numpy as np

from ..bags.reader import read_commands
from ..scene import Pose, Scene
from ..scene.resources import find_bag


def poses(scene: Scene, bag: str) -> list[Pose]:
    """The newest command received by the start of each step of `scene.dt`, from the bag's first to its last."""
    commands = read_commands(find_bag(bag))
    starts = np.arange(0.0, commands.duration, scene.dt) + 1e-9
    newest = np.searchsorted(commands.receipt, starts, side="right") - 1
    position, orientation = commands.position[newest].tolist(), commands.orientation[newest].tolist()
    return [Pose((*p,), (*q,)) for p, q in zip(position, orientation, strict=True)]

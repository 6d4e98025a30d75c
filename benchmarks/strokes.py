"""The commands of a bag, one pose for every step of a scene."""

from __future__ import annotations

import numpy as np

from finger_sim import Pose, Scene
from finger_sim.bags import read_commands
from finger_sim.resources import find_bag


def poses(scene: Scene, bag: str) -> list[Pose]:
    """The newest command received by the start of each step of `scene.dt`, from the bag's first to its last."""
    commands = read_commands(find_bag(bag))
    starts = np.arange(0.0, commands.receipt[-1], scene.dt) + 1e-9
    newest = np.searchsorted(commands.receipt, starts, side="right") - 1
    position, orientation = commands.position.tolist(), commands.orientation.tolist()
    return [Pose(tuple(position[k]), tuple(orientation[k])) for k in newest]

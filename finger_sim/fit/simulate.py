"""One press of one scene, simulated: a function of plain values that any process can be asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..scene import Pose, Scene
from ..simulation.simulator import Simulator
from ..simulation.touch import Imprint
from ..studies.at_rest import SETTING
from ..studies.shared import biot_strain
from .press import plane_axes

PLANE: dict[str, Any] = {"plane.point": [0.0, 0.0, 0.0], "plane.normal": [0.0, 0.0, 1.0]}
"""Presses are told in the plane's frame."""
AT_REST: dict[str, Any] = {**SETTING, **PLANE, "solver.tolerance": 1e-4, "coupling.following": "hold"}
"""Of presses at rest: long steps, which let motion die out at once. Force is proportional to E then."""
FOLLOWED: dict[str, Any] = {
    **PLANE,
    "solver.sleep": False,
    "coupling.type": "kinematic",
    "coupling.following": "hold",
}
"""Of presses that are followed in time, with the scene's own step; see `in_time`."""
LOOKS = 8
"""So often in a press strain is compared with the limits."""


def in_time(scene: Scene) -> dict[str, Any]:
    """Values of a scene whose presses are followed in time: gravity, too, is told in the plane's frame."""
    gravity = np.array(scene.gravity)
    return FOLLOWED | {"gravity": (gravity if scene.plane is None else plane_axes(scene.plane) @ gravity).tolist()}


class Run(NamedTuple):
    """What a press of a scene gives at each command of a path (Path.poses).

    force : (k, 3) of the plane on the finger [N], plane frame
    area  : (k,) of contact [m²]; NaN where nobody asked
    reach : (6,) largest strain over its limit along e1, e2, e3, stretch then compression; 0 on a free axis
    """

    force: Floats
    area: Floats
    reach: Floats


def pressed(data: Mapping[str, Any], poses: Floats, steps: Ints, area: bool) -> Run:
    """The press of a scene (`portable`); see Path. Raises SceneError or MeshError."""
    scene = Scene.from_dict(data)
    simulator = Simulator(scene)
    force, areas, reach = np.empty((len(poses), 3)), np.full(len(poses), np.nan), np.zeros(6)
    look = max(1, len(poses) // LOOKS)
    simulator.reset(_pose(poses[0]))
    for k, each in enumerate(poses):
        pose = _pose(each)
        for _ in range(steps[k]):
            out = simulator.step(pose)
        force[k] = out.contact_wrench[:3]
        if area:
            areas[k] = Imprint.of(simulator).touch().area
        if k % look == look - 1 and out.contacts:
            reach = np.maximum(reach, _reach(simulator, scene))
    return Run(force, areas, reach)


def _pose(values: Floats) -> Pose:
    x, y, z, *q = values.tolist()
    return Pose((x, y, z), (q[0], q[1], q[2], q[3]))


def _reach(simulator: Simulator, scene: Scene) -> Floats:
    """(6,) see Run.reach."""
    if scene.limits is None:
        return np.zeros(6)
    strain = np.diagonal(biot_strain(simulator.mesh, simulator.positions), axis1=1, axis2=2)
    rooms = np.concatenate([scene.limits.stretch_room, scene.limits.compress_room])
    return np.asarray(
        np.maximum(np.concatenate([strain.max(axis=0), -strain.min(axis=0)]), 0.0) / np.maximum(rooms, 1e-9)
    )

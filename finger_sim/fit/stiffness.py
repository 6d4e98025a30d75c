"""A scene's stiffness against force, k(F): for `finger_sim info SCENE --press`. It takes seconds."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from ..arrays import Floats
from ..console import table
from ..scene import Pose, Scene
from ..simulation.simulator import Simulator, Tell
from ..studies.at_rest import resting
from ..studies.fingertip.laws import FORCES, stiffness_line, tangent
from .checks import thickness_along
from .press import STEPS, FitError, orientation_of, touch_height
from .simulate import AT_REST

STEP = 5e-5
"""Between two depths [m]."""
SHARE = 0.8
"""Of the flesh between skin and bone: a press ends there at the latest."""
SHOWN = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
"""Normal forces that are told [N]."""


def press_curve(scene: Scene, direction: str, tell: Tell | None = None) -> tuple[Floats, Floats]:
    """Depths (n,) [m] and normal forces (n,) [N] at rest, pressed in a direction up to the last of FORCES.

    Raises FitError where the scene has no plane or no bone, or for an unknown direction.
    """
    if scene.plane is None or scene.driven is None:
        lacks = "plane" if scene.plane is None else "driven"
        raise FitError(f"{lacks}: the scene has none, allowed with --press: a finger on its bone, and a plane")
    turn = orientation_of(direction)
    simulator = Simulator(resting(scene, AT_REST), tell)
    touch = touch_height(scene, simulator.mesh, turn)
    deepest = SHARE * thickness_along(scene, simulator.mesh, turn)
    simulator.reset(Pose((0.0, 0.0, touch + STEP), turn))
    depth, force = [0.0], [0.0]
    while depth[-1] + STEP <= deepest and force[-1] < FORCES[1]:
        depth.append(depth[-1] + STEP)
        for _ in range(STEPS):
            out = simulator.step(Pose((0.0, 0.0, touch - depth[-1]), turn))
        force.append(float(out.contact_wrench[2]))
    return np.array(depth), np.array(force)


def stiffness_table(depth: Floats, force: Floats) -> Table:
    """k at SHOWN as far as the press went, and the line k = b + m F."""
    F, k = tangent(depth, force)
    rows = table("F [N]", "depth [mm]", "k [N/mm]")
    for shown in SHOWN:
        at = int(np.searchsorted(force, shown))
        if 0 < at < len(force):
            at_depth = np.interp(shown, force[at - 1 : at + 1], depth[at - 1 : at + 1])
            rows.add_row(f"{shown:g}", f"{1e3 * at_depth:.2f}", f"{1e-3 * np.interp(shown, F, k):.3f}")
    line = stiffness_line(depth, force)
    ends = f"{FORCES[0]:g} to {min(FORCES[1], float(force.max())):.3g} N"
    rows.add_row("k = b + m F", ends, str(line) if line else "too few forces for a line")
    return rows

"""A finger pressed flat and sheared, at rest: stiffness, contact area, tangential stiffness, area under shear."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Floats
from ...scene import Scene
from ..at_rest import ORIENTATIONS, Press, at_rest
from .laws import FORCES

SCENE, MESH = "finger_haptic", "finger_2000"
"""The everyday finger, on a finer mesh."""
STEP, DEEPEST = 5e-5, 3e-3
"""Between two points of the curve, and its end if no force of FORCES is reached before [m]."""
LOADS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
"""Normal forces at which tangential stiffness is taken [N]."""
UNLIMITED_LOADS = LOADS[:4]
"""Those at which it is taken without limits, too [N]: more, and the bone is on the table."""
SHEARED = (1.0, 4.0)
"""Normal forces that are held while the finger is sheared [N]."""
SHEAR_STEP, SHEAR_END = 1e-4, 2.5e-3
"""Way of the bone along the finger between two points, and its end [m]."""
HELD = 5e-3
"""Part by which a force that is held may be off."""

INK = 5e-5
"""Gap between skin and plane up to which it counts as contact, as in a print of the finger [m]."""

Meter = Callable[[float, float], None]


@dataclass(frozen=True)
class Shear:
    """A finger that is sheared under a normal force [N], with n points.

    way  : (n,) of the bone along the finger, towards its tip [m]
    force: (n,) tangential [N]
    area : (n,) of contact [m²]
    """

    load: float
    way: Floats
    force: Floats
    area: Floats


@dataclass(frozen=True)
class Fingertip:
    """What was measured of a scene's finger.

    depth, force : (n,) of a flat press [m], [N]
    area         : (n,) of contact [m²], see print_area
    loads, tangential : normal forces (k,) [N] and tangential stiffness there before anything slips (k,) [N/m]
    unlimited : the same stiffness without limits, at the first m of these forces (m,) [N/m]
    """

    friction: float
    depth: Floats
    force: Floats
    area: Floats
    loads: Floats
    tangential: Floats
    unlimited: Floats
    shears: list[Shear]


def measured(scene: Scene, progress: Meter) -> Fingertip:
    """All of it. Raises NotAtRestError where the finger does not come to rest, SceneError without a table."""
    without = at_rest(scene.with_values({"limits": None}))
    scene = at_rest(scene)
    press = Press(scene, ORIENTATIONS["flat"])
    rows: list[tuple[float, float, float]] = []
    while press.depth < DEEPEST - 1e-9 and (not rows or rows[-1][1] < 1.1 * FORCES[1]):
        force = press.to(STEP * (len(rows) + 1))
        rows.append((press.depth, force, print_area(press)))
        progress(0.3 * min(1.0, force / FORCES[1]), 1.0)
    depth, force, area = np.array(rows).T
    stiffness = _tangential(scene, LOADS, lambda done, total: progress(0.3 + 0.3 * done / total, 1.0))
    unlimited = _tangential(without, UNLIMITED_LOADS, lambda done, total: progress(0.6 + 0.1 * done / total, 1.0))
    shears = []
    for k, load in enumerate(SHEARED):
        shears.append(sheared(scene, load, depth, force))
        progress(0.7 + 0.3 * (k + 1) / len(SHEARED), 1.0)
    plane = scene.plane
    assert plane is not None  # at_rest's Press needs one
    return Fingertip(
        plane.friction, depth, force, area, np.array(LOADS), stiffness, unlimited, shears
    )  # fmt: skip


def _tangential(scene: Scene, loads: Sequence[float], progress: Meter) -> Floats:
    """Tangential stiffness at rising normal forces [N] of a flat press, (k,) [N/m]."""
    press, found = Press(scene, ORIENTATIONS["flat"]), []
    for load in loads:
        press.until(load)
        found.append(press.tangential())
        progress(len(found), len(loads))
    return np.array(found)


def print_area(press: Press) -> float:
    """Area of the skin, seen from the plane, that is nearer to it than INK [m²]; along an edge the gap grows evenly.

    A node that comes into contact does not make it jump, as it does the area of touching nodes (`Touch.area`).
    """
    simulator = press.simulator
    x, (a, b, c) = simulator.positions, simulator.mesh.surface.T
    over = x[:, 2] - INK
    seen = np.maximum(-0.5 * np.cross(x[b] - x[a], x[c] - x[a])[:, 2], 0.0)
    return float(seen @ part_below(np.stack([over[a], over[b], over[c]], axis=1)))


def part_below(values: Floats) -> Floats:
    """Part of each triangle (k,) where a linear function with these values at its corners (k, 3) is below 0."""
    low, middle, high = np.sort(values, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        corner = low**2 / ((low - middle) * (low - high))
        rest = 1.0 - high**2 / ((high - low) * (high - middle))
    return np.where(high <= 0.0, 1.0, np.where(low >= 0.0, 0.0, np.where(middle > 0.0, corner, rest)))


def sheared(scene: Scene, load: float, depth: Floats, force: Floats) -> Shear:
    """A finger that is pressed to a load, then moved along while the load is held; depth, force: of its flat press."""
    press = Press(scene, ORIENTATIONS["flat"])
    press.until(load)
    rate = float(np.interp(load, 0.5 * (force[1:] + force[:-1]), np.diff(force) / np.diff(depth)))
    rows = [(0.0, press.along(0.0), print_area(press))]
    while rows[-1][0] < SHEAR_END - 1e-9:
        way = rows[-1][0] + SHEAR_STEP
        sideways = press.along(way)
        for _ in range(12):
            missing = load - press.force
            if abs(missing) <= HELD * load:
                break
            press.to(press.depth + float(np.clip(0.7 * missing / rate, -5e-5, 5e-5)))
            sideways = press.along(way)
        rows.append((way, sideways, print_area(press)))
    way_, tangential, area = np.array(rows).T
    return Shear(load, way_, np.abs(tangential), area)

"""Directed cases of `finger_sim stress`: every extreme by itself, on a small block pressed on a table and slid.

Each runs with both solvers: `newton` with the `tensor` limit, `pgs` with the paper's `hyperbolic`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...scene import Pose, Scene, place
from . import motions
from .case import MESH_FILE, Case, RawMesh
from .motions import STILL, placed, pose

SIZE = (0.04, 0.02, 0.02)
"""Edges of the block [m]; its top is the bone."""
GAP, DEPTH, ALONG = 0.5e-3, 1.5e-3, 5e-3
"""Of the block over the table, how deep it is pressed and how far it is slid [m]."""
LIMITS = {"stretch": [1.05, 1.25, 1.1], "compress": [0.95, 0.75, 0.9], "stiffness": 30.0}
SOLVERS: dict[str, dict[str, Any]] = {
    "newton": {"limits": {"projection": "tensor"}, "solver": {"method": "newton", "max_iterations": 50}},
    "pgs": {"limits": {"projection": "hyperbolic"}, "solver": {"method": "pgs", "max_iterations": 200}},
}
"""What a scene is solved with."""
JUMP_FORCE = 1.2e3
"""What the finger's contact force must not exceed on a jump of the command [N]."""
JUMP_RECOVERS, SHAKE_RECOVERS = 0.1, 0.1
"""Time after the bone is back in which all is as if it had never been away [s]."""
CYCLES, LONG_CYCLES = 40, 2000
"""Of 500 steps each of press and slide: in every run, and a million steps in a long one."""


def extremes() -> Iterator[Case]:
    """All directed cases but the long one, in the order of the table."""
    yield from parameters()
    yield from bodies()
    yield from limits()
    yield from planes()
    yield from commands()
    yield from jumps()
    yield press_and_slide_for_long(CYCLES)


def block(solver: str, **values: Any) -> dict[str, Any]:
    """The block's scene with other values: a dict changes a block of the scene, anything else replaces it."""
    data: dict[str, Any] = {
        "mesh": {"beam": {"size": list(SIZE), "cells": [4, 2, 2]}},
        "driven": {"box": [[-1e4, -1e4, 0.999 * SIZE[2]], [1e4, 1e4, 1e4]]},
        "material": {"density": 1000.0, "young": 5e4, "poisson": 0.4, "damping": {"mass": 0.0, "stiffness": 0.002}},
        "limits": LIMITS | SOLVERS[solver]["limits"],
        "plane": {"point": [0.0, 0.0, -GAP], "friction": 0.5, "stiffness": 100.0},
        "solver": SOLVERS[solver]["solver"],
        "dt": 1e-3,
    }
    for key, value in values.items():
        changes = isinstance(value, dict) and key != "mesh"
        data[key] = (data.get(key) or {}) | value if changes else value
    return data


def press_and_slide(scale: float = 1.0) -> list[Pose]:
    """Down, held, along, and up again at `scale` times the block's size; 190 steps."""
    down, along = scale * (GAP + DEPTH), scale * ALONG
    low, end = pose((0, 0, -down)), pose((along, 0, -down))
    return [
        STILL, *motions.move(STILL, low, 50), *motions.hold(low, 20), *motions.move(low, end, 50),
        *motions.move(end, pose((along, 0, 0)), 30), *motions.hold(pose((along, 0, 0)), 40),
    ]  # fmt: skip


def _both(family: str, name: str, motion: list[Pose] | None = None, **values: Any) -> Iterator[Case]:
    """The case with each solver."""
    for solver in SOLVERS:
        yield Case(f"{name}_{solver}", family, block(solver, **values), tuple(motion or press_and_slide()))


def parameters() -> Iterator[Case]:
    """The ends of the ranges of time step and material."""
    for dt in (1e-6, 1e-4, 1e-2, 0.1):
        yield from _both("dt", f"dt_{dt:g}", dt=dt)
    for young in (1.0, 1e3, 1e8, 1e12):
        yield from _both("young", f"young_{young:g}", material={"young": young})
    for nu in (-0.9, 0.0, 0.49, 0.4999):
        yield from _both("poisson", f"poisson_{nu:g}", material={"poisson": nu})
    for density in (1.0, 1e5):
        yield from _both("density", f"density_{density:g}", material={"density": density})
    tight = {"stretch": [1.02] * 3, "compress": [0.98] * 3}
    yield from _both("locking", "locking_0.499", material={"poisson": 0.499}, limits=tight)
    for nu in (0.45, 0.4999):
        yield from _both("patches", f"patches_{nu:g}", material={"volumetric": "patch", "poisson": nu})
    for time in (1e-5, 0.05, 1e5):
        terms = [{"time": time, "share": 0.6}, {"time": 1.4, "share": 0.3}]
        yield from _both("relaxation", f"relaxation_{time:g}", material={"relaxation": terms})
    whole = {"relaxation": [{"time": 0.05, "share": 0.999}], "relaxes": "stress", "volumetric": "patch"}
    yield from _both("relaxation", "relaxation_of_all", material=whole)


def bodies() -> Iterator[Case]:
    """From a millimetre to ten metres, slivers, and a single tetrahedron."""
    for size in (1e-3, 10.0):
        scale = size / SIZE[0]
        mesh = {"beam": {"size": [scale * edge for edge in SIZE], "cells": [4, 2, 2]}}
        driven = {"box": [[-1e4, -1e4, 0.999 * scale * SIZE[2]], [1e4, 1e4, 1e4]]}
        plane = {"point": [0.0, 0.0, -scale * GAP]}
        motion = press_and_slide(scale)
        yield from _both("size", f"size_{size:g}_m", motion, mesh=mesh, driven=driven, plane=plane)
    corners = SIZE[2] * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    file = {"mesh": {"file": MESH_FILE}}
    for name, thin in (("single", 1.0), ("aspect_1e2", 1e-2), ("aspect_1e4", 1e-4), ("aspect_1e7", 1e-7)):
        mesh_of = RawMesh(corners * [1.0, thin, 1.0], np.array([[0, 1, 2, 3]]))
        for solver in SOLVERS:
            scene = block(solver, **file)
            yield Case(f"tet_{name}_{solver}", "one tetrahedron", scene, tuple(press_and_slide()), mesh=mesh_of)


def limits() -> Iterator[Case]:
    """No room along one axis, along all, on one side; free; and rigid as in the paper."""
    for name, stretch, compress in (
        ("one_axis", [1.0, 1.25, 1.1], [1.0, 0.75, 0.9]),
        ("all_axes", [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]),
        ("asymmetric", [1.5, 1.0, 1.001], [1.0, 0.2, 0.999]),
        ("free", [None, None, None], [None, None, None]),
        ("one_side", [None, None, None], [0.99, None, 0.99]),
        ("to_nothing", [1e3, None, 1e3], [0.0, 0.0, 0.0]),
    ):
        yield from _both("limits", f"limits_{name}", limits={"stretch": stretch, "compress": compress})
    for projection in ("isotropic", "orthogonal", "linear"):
        rooms = {"projection": projection, "stretch": [1.1] * 3, "compress": [0.9] * 3}
        yield from _both("limits", f"limits_{projection}", limits=rooms)
    for stiffness in (1e-3, 1e9):
        yield from _both("limits", f"limits_stiffness_{stiffness:g}", limits={"stiffness": stiffness})
    rigid = block("pgs", limits={"stiffness": None}, plane={"stiffness": None})
    yield Case("limits_rigid_pgs", "limits", rigid, tuple(press_and_slide()))


def planes() -> Iterator[Case]:
    """Slippery and rough, met at speed, overhead, and far away."""
    for mu in (0.0, 5.0, 100.0):
        yield from _both("friction", f"friction_{mu:g}", plane={"friction": mu})
    fast = [STILL, *motions.hold(pose((0, 0, -GAP - DEPTH)), 100)]
    for speed in (2.0, 100.0):
        yield from _both("plane", f"plane_at_{speed:g}_m_s", fast, coupling={"max_speed": speed})
    for degrees in (30, 90, 135, 180):
        yield from _placed(f"plane_tilted_{degrees}", placed(np.zeros(3), Rotation.from_euler("x", degrees, True)))
    yield from _placed("plane_1_km_away", pose((600.0, 0.0, 800.0)))


def _placed(name: str, frame: Pose) -> Iterator[Case]:
    """The whole scene but gravity carried to another frame."""
    turn = Rotation.from_quat(frame.orientation)
    point = (turn.apply([0.0, 0.0, -GAP]) + frame.position).tolist()
    plane = {"point": point, "normal": turn.apply([0.0, 0.0, 1.0]).tolist()}
    for solver in SOLVERS:
        motion = motions.carried(press_and_slide(), frame)
        yield Case(f"{name}_{solver}", "plane", block(solver, plane=plane), motion)


def commands() -> Iterator[Case]:
    """Quaternions of any length, none at all, and commands that are no numbers."""
    steps = press_and_slide()
    for name, norm in (("long", 1e6), ("short", 1e-6)):
        scaled = [Pose(p.position, (0.0, 0.0, 0.0, norm)) for p in steps]
        yield from _both("commands", f"quaternion_{name}", scaled)
    for name, bad in (
        ("zero_quaternion", Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))),
        ("nan_position", Pose((math.nan, 0.0, 0.0))),
        ("infinite_quaternion", Pose((0.0, 0.0, 0.0), (math.inf, 0.0, 0.0, 1.0))),
        ("far_position", Pose((1e300, 0.0, 0.0))),
    ):
        yield from _both("commands", f"command_{name}", [*steps[:60], bad, *steps[60:]])


def jumps() -> Iterator[Case]:
    """The shipped finger, its command 1 m or 180° away from one step to the next, and shaken at 100 Hz by 10 mm."""
    for name in ("finger_haptic", "finger"):
        scene = Scene.load(name)
        data, start, dt = scene.to_dict(), scene.initial_pose, scene.dt
        lowest = place(scene.load_mesh().points, start)[:, 2].min()
        x, y, z = start.position
        over = Pose((x, y, z - float(lowest) + 1e-3), start.orientation)
        pressed = Pose((x, y, z - float(lowest) - 1e-3), start.orientation)
        away = {
            "1_m_aside": _shifted(over, (1.0, 0.0, 0.0)),
            "1_m_up": _shifted(over, (0.0, 0.0, 1.0)),
            "1_m_down": _shifted(over, (0.0, 0.0, -1.0)),
            "180_degrees": _turned(over, (1.0, 0.0, 0.0)),
            "1_m_and_180_degrees": _turned(_shifted(over, (0.0, 0.6, 0.8)), (0.0, 1.0, 0.0)),
        }
        there, after = round(0.6 / dt), round(2.0 * JUMP_RECOVERS / dt)
        for way, far in away.items():
            if name == "finger" and way != "1_m_aside":
                continue  # `pgs` takes long
            motion = [over, *motions.hold(far, there), *motions.hold(over, there + after)]
            yield Case(
                f"jump_{way}_{name}", "jump", data, tuple(motion),
                disturbed=1 + 2 * there, recovers=JUMP_RECOVERS, force_limit=JUMP_FORCE,
            )  # fmt: skip
        down = [over, *motions.move(over, pressed, 100), *motions.hold(_shifted(pressed, (0.0, -1.0, 0.0)), 300)]
        yield Case(f"jump_while_pressed_{name}", "jump", data, tuple(down), force_limit=JUMP_FORCE)
        shaken = motions.shake((0.0, 0.006, 0.008), 100.0, dt, 200, over)
        yield Case(
            f"shake_{name}", "shake", data, (over, *shaken, *motions.hold(over, 300)),
            disturbed=1 + 200, recovers=SHAKE_RECOVERS, force_limit=JUMP_FORCE,
        )  # fmt: skip


def press_and_slide_for_long(cycles: int) -> Case:
    """The haptic finger pressed, slid there and back, and lifted, again and again: 500 steps a cycle."""
    scene = Scene.load("finger_haptic")
    lowest = place(scene.load_mesh().points, scene.initial_pose)[:, 2].min()
    x, y, z = scene.initial_pose.position
    over = Pose((x, y, z - float(lowest) + 0.2e-3), scene.initial_pose.orientation)
    low = _shifted(over, (0.0, 0.0, -1.2e-3))
    end = _shifted(low, (2e-3, 0.0, 0.0))
    motion = [
        *motions.move(over, low, 100), *motions.move(low, end, 100), *motions.move(end, low, 100),
        *motions.move(low, over, 100), *motions.hold(over, 100),
    ]  # fmt: skip
    return Case(f"press_and_slide_{500 * cycles}", "drift", scene.to_dict(), tuple(motion), cycles=cycles)


def _shifted(at: Pose, by: tuple[float, float, float]) -> Pose:
    return placed(np.array(at.position) + by, Rotation.from_quat(at.orientation))


def _turned(at: Pose, axis: tuple[float, float, float]) -> Pose:
    """By 180° about an axis of the world."""
    half = Rotation.from_rotvec(math.pi * np.array(axis))
    return placed(np.array(at.position), half * Rotation.from_quat(at.orientation))

"""Clocks of command and plane go on while a body sleeps; whatever moves is followed at a speed, never at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from physics_helpers import pose
from scipy.spatial.transform import Rotation
from small_fingers import small

from finger_sim import Pose, Simulator

FLAT = Rotation.from_euler("x", 90, degrees=True)
MS = 0.001


def finger(scene: str = "finger_haptic", height: float = 0.05, **values: Any) -> Simulator:
    """Hanging over the plane for a second, long enough to sleep where it may."""
    sim = Simulator(small(scene).with_values({k.replace("__", "."): v for k, v in values.items()}))
    sim.reset(pose((0, 0, height), FLAT))
    for _ in range(1000):
        sim.step()
    return sim


def heights(sim: Simulator, target: Pose, steps: int) -> list[float]:
    """Of the plane after each step that follows the target."""
    out = []
    for k in range(steps):
        sim.step(None, target if k == 0 else None)
        assert sim._ground is not None
        out.append(sim._ground.surface[1][2])
    return out


@pytest.mark.parametrize("sleeps", [False, True])
def test_a_plane_takes_as_long_whether_the_body_sleeps_or_not(sleeps: bool) -> None:
    """A second after its last target, one that moved nothing, it goes 15 mm in a tenth of a second: at 0.15 m/s."""
    sim = finger(solver__sleep=sleeps)
    heights(sim, pose((0, 0, -0.02)), 1000)
    heights(sim, pose((0, 0, -0.02)), 1000)
    assert sim.step().asleep == sleeps
    rising = heights(sim, pose((0, 0, -0.005)), 110)
    steps = np.diff([-0.02, *rising])
    assert_allclose(steps[:100], 0.15 * MS, rtol=1e-6)
    assert_allclose(steps[100:], 0.0, atol=1e-15)


def test_a_command_after_a_long_rest_is_as_fast_asleep_as_awake() -> None:
    """Under a virtual coupling: between two commands a second went by, however little of it was computed."""
    forces = []
    for sleeps in (False, True):
        sim = finger("finger_coupled", solver__sleep=sleeps)
        for k in range(3):  # a tremor too small to keep it awake
            sim.step(pose((0, 0, 0.05 + 1e-14 * (k + 1)), FLAT))
        for _ in range(1000):
            out = sim.step()
        assert out.asleep == sleeps
        forces.append([sim.step(pose((0, 0, 0.0519), FLAT)).device_wrench[2] for _ in range(30)])
    assert_allclose(forces[1], forces[0], atol=1e-4)
    assert max(np.abs(forces[0])) > 0.05


def test_the_speed_of_one_jump_ends() -> None:
    """After a long rest a jump counts as having taken a tenth of a second, and half as long again."""
    sim, moving = Simulator(small("finger_coupled").with_values({"coupling.following": "hold"})), []
    sim.reset(pose((0, 0, 0.05), FLAT))
    for k in range(1201):
        sim.step(pose((1e-3, 0, 0.05), FLAT) if k == 1000 else None)
        moving.append(sim._state.target[7])
    moving = moving[1000:]
    assert_allclose(moving[:150], 0.01, rtol=1e-9)
    assert moving[152:] == [0.0] * 49


def test_a_held_finger_settles_as_soon_asleep_as_awake() -> None:
    """How long a command has been held counts while the body sleeps, too: it settles in the step that wakes it."""
    sim = finger()
    assert sim.step().asleep
    sim.apply({"plane.friction": 0.4})
    sim.step()
    assert sim._state.held[0] > 0.9


def test_a_plane_moving_under_a_held_finger_is_no_rest() -> None:
    """Solved as a finger that moves over the plane is: to the scene's tolerance, linearised once."""
    work = []
    for plane_moves in (True, False):
        sim = finger(solver__sleep=False)
        for z in np.arange(0.05, 0.0058, -2e-4):
            sim.step(pose((0, 0, z), FLAT))
        for k in range(200):
            sim.step(None, pose((0, 0, 0)) if k == 0 else None)
        before, iterations = sim.work, 0
        for k in range(100):
            way = 2e-5 * (k + 1)
            here = None if plane_moves else pose((way, 0, z), FLAT)
            iterations += sim.step(here, pose((-way, 0, 0)) if plane_moves else None).iterations
        work.append({name: sim.work[name] - before[name] for name in ("linear steps", "factorisations")})
        work[-1]["iterations"] = iterations
    assert work[0]["linear steps"] == work[1]["linear steps"] == 100
    assert work[0]["factorisations"] <= 1.2 * work[1]["factorisations"] + 20
    assert work[0]["iterations"] <= 1.2 * work[1]["iterations"] + 20


def peak_rise(sim: Simulator, steps: int, **first: Any) -> tuple[float, float]:
    """Largest force, and largest change of it within one step, while the first step takes these arguments."""
    forces = [np.zeros(3)]
    for k in range(steps):
        forces.append((sim.step(None, **first) if k == 0 else sim.step()).contact_wrench[:3])
    return float(np.linalg.norm(forces, axis=1).max()), float(np.linalg.norm(np.diff(forces, axis=0), axis=1).max())


@pytest.mark.parametrize("how", ["first target", "target in the first step", "live value"])
def test_a_plane_comes_at_a_speed(how: str) -> None:
    """3 cm up under a hanging finger, which it then presses 2 mm: in a tenth of a second, not in one step."""
    touch = -float(FLAT.apply(np.array(Simulator(small("finger_haptic")).mesh.points))[:, 2].min())
    sim = finger(height=touch + 0.028)
    up: dict[str, Any] = {"plane": pose((0, 0, 0.03))}
    if how == "live value":
        sim.apply({"plane.point": [0, 0, 0.03]})
        up = {}
    elif how == "target in the first step":
        sim.reset()
    rising = []
    forces = []
    for k in range(150):
        out = sim.step(None, **(up if k == 0 else {}))
        assert sim._ground is not None
        rising.append(sim._ground.surface[1][2])
        forces.append(np.linalg.norm(out.contact_wrench[:3]))
    assert_allclose(np.diff([0.0, *rising[:100]]), 0.3 * MS, rtol=1e-6)
    assert rising[-1] == pytest.approx(0.03)
    assert forces[-1] > 1.0
    assert max(np.diff(forces)) < 2.5


def test_a_first_target_moves_only_what_it_changes() -> None:
    """Another origin in the plane and a turn about its normal are no motion: the finger on it is not dragged along."""
    sim = finger()
    for z in np.arange(0.05, 0.0058, -2e-4):
        sim.step(pose((0, 0, z), FLAT))
    for _ in range(300):
        before = sim.step().contact_wrench
    turned = Rotation.from_rotvec([0.0, 0.0, 2.0])
    for k in range(150):
        out = sim.step(None, pose((0.3, -0.2, 0.0), turned) if k == 0 else None)
    assert_allclose(out.contact_wrench, before, atol=1e-6)
    for k in range(150):
        out = sim.step(None, pose((0.3, -0.2, 1e-4), turned) if k == 0 else None)
    assert out.contact_wrench[2] > before[2] + 0.1


def test_reset_lets_the_plane_arrive() -> None:
    """Back to rest is back to rest for the plane as well: where it was wanted, or where the reset says."""
    sim = finger()
    sim.step(None, pose((0, 0, -0.02)))
    sim.reset()
    assert sim._ground is not None
    assert sim._ground.surface == ((0.0, 0.0, 1.0), (0.0, 0.0, -0.02))
    sim.reset(None, pose((0, 0, -0.01)))
    assert sim._ground.surface[1] == (0.0, 0.0, -0.01)
    sim.apply({"plane.point": [0, 0, 0.0]})
    sim.reset()
    assert sim._ground.surface[1] == (0.0, 0.0, 0.0)

"""At rest: a held body settles, sleeps, and wakes as if it had not; what a scene lacks is not entered, by count."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from physics_helpers import beam_scene, finger_scene, pose
from scipy.spatial.transform import Rotation

from finger_sim import Scene, Simulator
from finger_sim.simulator import STILL_TIME

FLAT = Rotation.from_euler("x", 90, degrees=True)


def haptic(**values: Any) -> Scene:
    return Scene.load("finger_haptic").with_values({k.replace("__", "."): v for k, v in values.items()})


def pressed(scene: Scene, depth: float) -> tuple[Simulator, Any]:
    """The finger lowered at 2 cm/s to so far beyond first touch, and the last command."""
    sim = Simulator(scene)
    touch = -float(FLAT.apply(np.array(sim.mesh.points))[:, 2].min())
    sim.reset(pose((0, 0, touch + 2e-4), FLAT))
    for height in np.arange(touch + 2e-4, touch - depth, -2e-5):
        sim.step(pose((0, 0, height), FLAT))
    return sim, pose((0, 0, touch - depth), FLAT)


@pytest.mark.parametrize("depth", [1.5e-3, 2e-3])
def test_a_held_press_settles(depth: float) -> None:
    """Beyond what all limits can hold, linearised once the press swings for ever; linearised twice it comes to rest."""
    for settle, restless in ((True, False), (False, True)):
        sim, hold = pressed(haptic(solver__settle=settle, solver__sleep=False), depth)
        for _ in range(300):
            sim.step(hold)
        fastest = [np.abs(sim.velocities).max() for _ in range(20) if sim.step(hold)]
        assert (max(fastest) > 1e-4) == restless
        assert (max(fastest) < 1e-12) == (not restless)


def test_a_moving_command_is_linearised_once() -> None:
    """`settle` costs a moving finger nothing: one linear step a step; two while the command holds and limits do."""
    sim, hold = pressed(haptic(solver__sleep=False), 1.5e-3)
    before = sim.work["linear steps"]
    for k in range(10):
        sim.step(pose(np.array(hold.position) + [1e-6 * (k + 1), 0, 0], FLAT))
    assert sim.work["linear steps"] == before + 10
    for _ in range(10):
        sim.step(None)
    assert sim.work["linear steps"] > before + 25


def test_it_falls_asleep_and_computes_nothing() -> None:
    """Results go on with time alone; nothing is counted as done."""
    sim, hold = pressed(haptic(), 1.5e-3)
    outs = [sim.step(hold) for _ in range(300)]
    asleep = [out.asleep for out in outs]
    first = asleep.index(True)
    assert first > STILL_TIME / sim.scene.dt
    assert all(asleep[first:])
    work, positions = sim.work, sim.positions.copy()
    out = sim.step(pose(hold.position, FLAT))
    assert out.asleep
    assert sim.work == work
    assert out.time == pytest.approx(outs[-1].time + sim.scene.dt)
    assert out.iterations == 0
    assert_allclose(out.contact_wrench, outs[first - 1].contact_wrench, rtol=0, atol=0)
    assert (sim.positions == positions).all()
    assert (sim.velocities == 0.0).all()
    outs[-1].contact_wrench[:] = 7.0
    assert sim.step(None).contact_wrench[2] < 2.0


def test_it_wakes_as_if_it_had_not_slept() -> None:
    """After the next command the wrench is that of a body that was computed all the time, to 1e-6 of it."""
    slept, hold = pressed(haptic(), 1.5e-3)
    awake, _ = pressed(haptic(solver__sleep=False), 1.5e-3)
    for _ in range(400):
        a, b = slept.step(hold), awake.step(hold)
    assert a.asleep
    assert not b.asleep
    for k in range(200):
        command = pose(np.array(hold.position) + [2e-5 * k, 0, 1e-5 * k], FLAT)
        a, b = slept.step(command), awake.step(command)
        assert k == 0 or not a.asleep
        assert_allclose(a.contact_wrench[:3], b.contact_wrench[:3], rtol=0, atol=1e-6)


@pytest.mark.parametrize("wake", ["command", "value", "state", "reset"])
def test_what_wakes(wake: str) -> None:
    """A new command, a live value, a set state, a reset."""
    sim, hold = pressed(haptic(), 1e-3)
    while not sim.step(hold).asleep:
        pass
    if wake == "command":
        assert not sim.step(pose(np.array(hold.position) + [0, 0, 1e-9], FLAT)).asleep
        return
    if wake == "value":
        sim.apply({"plane.friction": 0.4})
    elif wake == "state":
        sim.set_state(sim.positions, sim.velocities)
    else:
        sim.reset()
    assert not sim.step(None).asleep


def test_a_slow_start_is_no_rest() -> None:
    """Let go under little gravity in tiny steps a beam moves next to nothing at first: it is not put to sleep."""
    sim = Simulator(beam_scene(driven="base", gravity=[0, 0, -1e-3], dt=1e-5, damping=(0.0, 0.002)))
    assert not any(sim.step().asleep for _ in range(2000))


def test_a_free_body_sleeps_on_the_floor_but_not_in_flight() -> None:
    """At the top of its flight nothing moves either, for less than a step."""
    scene = beam_scene(plane={"point": [0, 0, -0.02]}, gravity=[0, 0, -9.81], damping=(0.0, 0.01))
    scene = scene.with_values({"solver.method": "newton", "solver.tolerance": 1e-6})
    sim = Simulator(scene)
    sim.set_state(sim.mesh.points, np.full(sim.mesh.points.shape, [0.0, 0.0, 0.981]))
    assert not any(sim.step().asleep for _ in range(250))
    assert any(sim.step().asleep for _ in range(3000))


def test_what_a_scene_lacks_is_not_entered() -> None:
    """Counters: no limits looked at without limits, no nodes without a plane or far from it, no decompositions."""
    sim = Simulator(haptic(limits=None, plane=None, solver__sleep=False))
    for k in range(20):
        sim.step(pose((0, 0, 0.02 - 1e-4 * k), FLAT))
    work = sim.work
    assert work["linear steps"] == work["matrices"] == work["factorisations"] == 20
    assert sum(work.values()) == 60

    sim = Simulator(haptic(solver__sleep=False))
    sim.reset(pose((0, 0, 0.03), FLAT))
    for k in range(20):
        sim.step(pose((0, 0, 0.03 - 1e-4 * k), FLAT))
    assert sim.work["nodes looked at for contact"] <= 2 * len(np.unique(sim.mesh.surface))
    assert sim.work["contact rows"] == sim.work["singular value decompositions"] == 0
    assert sim.work["limits looked at"] == 20 * 2 * len(sim.mesh.tets)

    one_side = haptic(limits__compress=[None] * 3, solver__sleep=False)
    sim = Simulator(one_side)
    for k in range(20):
        sim.step(pose((0, 0, 0.03 - 1e-4 * k), FLAT))
    assert sim.work["limits looked at"] == 20 * len(sim.mesh.tets)

    sim = Simulator(finger_scene(solver__sleep=False))
    sim.step(None)
    assert sim.work["singular value decompositions"] == len(sim.mesh.tets)


def test_a_plane_that_comes_near_is_met() -> None:
    """Nodes passed over while the plane is far are looked at again when it is moved, and when the body is."""
    sim = Simulator(haptic(solver__sleep=False))
    touch = -float(FLAT.apply(np.array(sim.mesh.points))[:, 2].min())
    sim.reset(pose((0, 0, touch + 0.05), FLAT))
    for _ in range(5):
        assert sim.step(None).contacts == 0
    sim.apply({"plane.point": [0, 0, 0.0502]})
    assert sim.step(None).contacts > 0
    sim.apply({"plane.point": [0, 0, 0]})
    sim.reset(pose((0, 0, touch + 0.05), FLAT))
    heights = np.arange(touch + 0.05, touch - 5e-4, -1.9e-3)
    contacts = [sim.step(pose((0, 0, z), FLAT)).contacts for z in [*heights, touch - 5e-4]]
    assert contacts[-1] > 0
    assert not any(contacts[:-3])

"""At rest: a held body settles, sleeps, and wakes as if it had not; what a scene lacks is not entered, by count."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from physics_helpers import beam_scene, finger_scene, pose
from scipy.spatial.transform import Rotation
from small_fingers import small

from finger_sim import Scene, Simulator, Status
from finger_sim.physics.step import CONTACTS, SPEED
from finger_sim.simulation.guard import GOES_ON, RESTORED, STILL_TIME, build_guard, judge, wake

FLAT = Rotation.from_euler("x", 90, degrees=True)


def haptic(**values: Any) -> Scene:
    return small("finger_haptic").with_values({k.replace("__", "."): v for k, v in values.items()})


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
    """Beyond what all limits can hold, linearised once the press swings a little; linearised twice it comes to rest."""
    for settle, restless in ((True, False), (False, True)):
        sim, hold = pressed(haptic(solver__settle=settle, solver__sleep=False), depth)
        for _ in range(300):
            sim.step(hold)
        fastest = [np.abs(sim.velocities).max() for _ in range(20) if sim.step(hold)]
        assert (max(fastest) > 1e-6) == restless
        assert (max(fastest) < 1e-9) == (not restless)


def test_a_moving_command_is_linearised_once() -> None:
    """`settle` costs a moving finger nothing: one linear step a step; two while the command holds and limits do."""
    sim, hold = pressed(haptic(solver__sleep=False), 1.5e-3)
    before = sim.work["linear steps"]
    for k in range(10):
        sim.step(pose(np.array(hold.position) + [1e-6 * (k + 1), 0, 0], FLAT))
    assert sim.work["linear steps"] == before + 10
    for _ in range(19):
        sim.step(None)
    assert sim.work["linear steps"] == before + 29
    for _ in range(11):
        sim.step(None)
    assert sim.work["linear steps"] > before + 45


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


@pytest.mark.parametrize("depth", [1.5e-3, 2e-3])
def test_what_the_solver_leaves_keeps_nothing_awake(depth: float) -> None:
    """The shipped finger, hundreds of tetrahedra at a limit, factors of an older step: asleep within 0.2 s."""
    sim, hold = pressed(Scene.load("finger_haptic"), depth)
    outs = [sim.step(hold) for _ in range(200)]
    assert outs[-1].asleep
    assert outs[-1].limited_tets > 300


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
    assert [sim.step(None).contacts > 0 for _ in range(101)][-1]
    sim.apply({"plane.point": [0, 0, 0]})
    sim.reset(pose((0, 0, touch + 0.05), FLAT))
    heights = np.arange(touch + 0.05, touch - 5e-4, -1.9e-3)
    contacts = [sim.step(pose((0, 0, z), FLAT)).contacts for z in [*heights, touch - 5e-4]]
    assert contacts[-1] > 0
    assert not any(contacts[:-3])


@pytest.mark.parametrize("how", ["torn", "inside out", "raging"])
def test_a_body_beyond_repair_is_restored_and_says_so(how: str) -> None:
    """Torn thirtyfold, at rest inside out, or raging beyond its limits for a quarter of a second: back to rest."""
    scene = beam_scene(
        (0.04, 0.02, 0.02),
        (4, 2, 2),
        young=5e4,
        poisson=0.4,
        damping=(0.0, 0.002),
        driven={"box": [[-1, -1, 0.01999], [1, 1, 1]]},
        limits={"projection": "tensor", "stretch": [1.05, 1.25, 1.1], "compress": [0.95, 0.75, 0.9]},
        solver={"method": "newton", "sleep": False},
    )
    sim = Simulator(scene)
    rest = sim.mesh.points.copy()
    free = np.setdiff1d(np.arange(len(rest)), scene.driven_nodes(sim.mesh))
    x, v = rest.copy(), np.zeros_like(rest)
    if how == "torn":
        x[free[0]] += [0.0, 0.0, -30.0]
    elif how == "inside out":
        x[free, 2] = 0.04 - x[free, 2]
    else:
        x[free] = [0.02, 0.01, 0.02] + 3.0 * np.random.default_rng(2).standard_normal((len(free), 3)) * 0.01
        v[free] = 20.0 * np.random.default_rng(3).standard_normal((len(free), 3))
    sim.set_state(x, v)
    said = Status.OK
    for _ in range(1500):
        said |= sim.step().status
    assert said & (Status.INVERTED | Status.LIMIT_EXCEEDED)
    assert_allclose(sim.positions, rest, rtol=0, atol=1e-6)
    if how == "torn":
        assert said & Status.RESTORED


def test_a_body_that_stays_inside_out_is_restored_however_slowly_it_swings() -> None:
    """After five seconds in a row in which nothing touches or moves it, and no sooner."""
    dt, result = 0.01, np.zeros(11)
    result[SPEED] = 0.1
    guard = build_guard(0.01, 1.0, driven=True, sleeps=True)
    inverted = int(Status.INVERTED | Status.LIMIT_EXCEEDED)

    def steps(count: int, status: int = inverted, moves: bool = False) -> list[int]:
        return [judge(guard, status, result, moves, False, dt) for _ in range(count)]

    for interrupted in ({"status": int(Status.LIMIT_EXCEEDED)}, {"moves": True}):
        assert set(steps(400) + steps(1, **interrupted) + steps(499)) == {GOES_ON}
        assert steps(1) == [RESTORED]
        wake(guard)
    result[CONTACTS] = 1.0
    assert set(steps(1000)) == {GOES_ON}


def test_a_press_beyond_all_limits_is_not_restored() -> None:
    """Contact holds it so: strained, not raging, and its force stays."""
    sim, hold = pressed(haptic(solver__sleep=False), 3e-3)
    outs = [sim.step(hold) for _ in range(600)]
    assert outs[-1].status & Status.LIMIT_EXCEEDED
    assert not any(out.status & Status.RESTORED for out in outs)
    assert outs[-1].contact_wrench[2] > 5.0


def test_a_bone_stops_at_the_plane() -> None:
    """Commanded a metre down, the mean of the driven nodes stays above it, and says so; back up it is free."""
    sim = Simulator(haptic())
    driven = sim.scene.driven_nodes(sim.mesh)
    start = sim.scene.initial_pose
    sim.reset(start)
    for _ in range(200):
        out = sim.step(pose((0, 0, -1.0), FLAT))
    assert sim.positions[driven, 2].mean() == pytest.approx(0.0, abs=1e-9)
    assert out.status & Status.COMMAND_LIMITED
    assert np.linalg.norm(out.contact_wrench[:3]) < 2e3
    for _ in range(500):
        out = sim.step(start)
    assert_allclose(sim.positions, FLAT.apply(np.array(sim.mesh.points)) + start.position, rtol=0, atol=2e-4)
    assert (out.contact_wrench == 0.0).all()


def test_a_free_body_in_a_long_flight_is_whole() -> None:
    """However far it has come from where it began: a body is torn by what it spans, not by where it is."""
    sim = Simulator(beam_scene(solver={"method": "newton"}))
    sim.set_state(sim.positions, np.broadcast_to([100.0, 0.0, 0.0], sim.positions.shape))
    for _ in range(500):
        out = sim.step()
        assert not out.status
    assert out.pose.position[0] == pytest.approx(50.0, rel=1e-6)

"""Momentum and energy of bodies that nothing holds."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, finger_scene, healthy, lumped_mass, run
from scipy.spatial.transform import Rotation

from finger_sim import Scene, Simulator

LIMITS = {"projection": "hyperbolic", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98], "stiffness": 100.0}


def free_finger(**blocks: object) -> Scene:
    data = finger_scene().to_dict()
    del data["driven"], data["plane"], data["initial_pose"]
    return Scene.from_dict(data | {"gravity": [0, 0, 0]} | blocks)


def bodies(limited: bool) -> dict[str, Scene]:
    blocks: dict[str, object] = {"limits": LIMITS} if limited else {"limits": None}
    return {"beam": beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, **blocks), "finger": free_finger(**blocks)}


@for_each("limited", [False, True])
@for_each("name", ["beam", "finger"])
@for_each("alpha", [0.0, 2.0])
def test_free_flight_keeps_momentum(name: str, limited: bool, alpha: float) -> None:
    """Linear momentum to 1e-12 a run; with gravity it is m g t; with α it decays as (1 + h α)^−n.

    The body starts strained, tumbling and vibrating; limits and stiffness damping are internal forces too.
    """
    scene = bodies(limited)[name].with_values({"material.damping.mass": alpha, "material.damping.stiffness": 0.002})
    for gravity in ([0.0, 0.0, 0.0], [1.0, 2.0, -9.81]):
        sim = Simulator(scene.with_values({"gravity": gravity}))
        mass = lumped_mass(scene, sim.mesh)
        points = np.array(sim.mesh.points)
        rng = np.random.default_rng(1)
        size = np.ptp(points, axis=0).max()
        x = points + 0.02 * size * rng.standard_normal(points.shape) / len(sim.mesh.tets) ** (1 / 3)
        spin = np.cross([3.0, -2.0, 5.0], x)
        v = np.array([0.4, -0.2, 0.3]) + spin + size * rng.standard_normal(x.shape)
        sim.set_state(x, v)
        p, h, steps = mass @ v, scene.dt, 300
        rows = 0
        for _ in range(steps):
            out = sim.step()
            rows = max(rows, out.limit_rows)
            p = (p + h * mass.sum() * np.array(gravity)) / (1.0 + h * alpha)
        assert healthy(out)
        assert (rows > 0) == limited
        carried = mass @ np.abs(v)
        assert_allclose(mass @ sim.velocities, p, rtol=0, atol=1e-12 * carried.max())


def test_free_fall_is_that_of_a_point() -> None:
    """Under gravity alone a body at rest falls undeformed by g h² n (n + 1) / 2 (backward Euler)."""
    scene = free_finger(gravity=[0.0, 0.0, -9.81])
    sim = Simulator(scene)
    points = np.array(sim.mesh.points)
    n = 100
    out = run(sim, n)
    drop = 9.81 * scene.dt**2 * n * (n + 1) / 2
    assert_allclose(sim.positions, points - [0, 0, drop], rtol=0, atol=1e-12)
    assert_allclose(sim.velocities, np.broadcast_to([0, 0, -9.81 * out.time], points.shape), rtol=1e-11, atol=1e-12)
    assert_allclose(out.pose.position, [0, 0, -drop], rtol=0, atol=1e-12)
    assert_allclose(out.pose.orientation, [0, 0, 0, 1], rtol=0, atol=1e-9)


def total_energy(body: naive.Body, sim: Simulator) -> float:
    return naive.energy_of_motion(body.mass, sim.velocities) + body.energy(sim.positions)


def energies(scene: Scene, x: Array, v: Array, steps: int) -> Array:
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    sim.set_state(x, v)
    values = [total_energy(body, sim)]
    for _ in range(steps):
        out = sim.step()
        assert healthy(out)
        values.append(total_energy(body, sim))
    return np.array(values)


@for_each("dt", [1e-4, 1e-3, 1e-2])
@for_each("amplitude", [1e-3, 0.03])
def test_vibration_never_gains_energy(dt: float, amplitude: float) -> None:
    """Kinetic plus elastic energy of a free vibrating body does not grow in any step, undamped, to roundoff."""
    scene = beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, dt=dt)
    points = np.array(scene.load_mesh().points)
    mode = np.sin(3.0 * points) @ np.random.default_rng(2).standard_normal((3, 3))
    values = energies(scene, points + amplitude * mode, np.zeros_like(points), 60)
    assert (np.diff(values) <= 1e-9 * values[0]).all()
    assert values[-1] < values[0]


@pytest.mark.parametrize("projection", ["isotropic", "hyperbolic"])
@pytest.mark.parametrize("stiffness", [None, 100.0])
@pytest.mark.parametrize("dt", [1e-4, 1e-3])
def test_limits_never_create_energy(projection: str, stiffness: float | None, dt: float) -> None:
    """A body that vibrates into its limits does not gain energy in any step.

    Rigid limits only take energy out; compliant ones store ½ κ E V C² a row, which is counted by LAPACK's C.
    """
    limits = {"projection": projection, "stretch": 1.05, "compress": 0.95, "stiffness": stiffness}
    young = 1e4
    scene = beam_scene(
        (0.4, 0.2, 0.2),
        (3, 2, 2),
        young=young,
        dt=dt,
        limits=limits,
        solver={"tolerance": 1e-6, "max_iterations": 20_000},
    )
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    v = np.sin(7.0 * body.points) @ np.random.default_rng(2).standard_normal((3, 3))
    sim.set_state(body.points, v - body.mass @ v / body.mass.sum())

    def energy() -> float:
        stored = 0.0
        for F, volume in zip(body.deformation(sim.positions), body.volume, strict=True):
            for C, *_ in naive.limit_rows(F, scene.limits) if stiffness else ():
                stored += 0.5 * (stiffness or 0.0) * young * volume * min(C, 0.0) ** 2
        return total_energy(body, sim) + stored

    values, rows = [energy()], 0
    for _ in range(60):
        out = sim.step()
        assert healthy(out)
        rows = max(rows, out.limit_rows)
        values.append(energy())
    assert rows >= 10
    assert np.diff(values).max() <= 1e-9 * values[0]


@for_each("rate", [1.0, 10.0, 40.0])
def test_spinning_gains_no_energy_but_that_of_its_linearisation(rate: float) -> None:
    """A free body set spinning loses energy over a few steps, and more and more over a turn.

    Single steps may gain: x + h v leaves the circle by (h ω)² / 2, a strain that forces linearised at the step's
    start do not see. The first step gains the elastic energy of that strain, (μ + λ) (h ω)⁴ V / 2, to 1 %; no later
    one more than three times that, and after ten steps the body has less than at the start.
    """
    scene = beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e5, poisson=0.3, dt=1e-3)
    points = np.array(scene.load_mesh().points)
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    v = rate * np.cross(axis, points - points.mean(axis=0))
    values = energies(scene, points, v, 150)
    body = naive.Body.of(scene, scene.load_mesh())
    strain = 0.5 * (rate * scene.dt) ** 2
    bound = (2.0 * body.lame_mu + 2.0 * body.lame_lambda) * strain**2 * body.volume.sum()
    assert values[1] - values[0] == pytest.approx(bound, rel=0.01)
    assert np.diff(values).max() <= 3.0 * bound
    assert values.max() - values[0] <= 5.0 * bound
    assert (values[10:] < values[0]).all()


def test_slow_spin_keeps_angular_momentum() -> None:
    """A slow spin (0.1° a step) loses less than 1 % of its angular momentum over a quarter of a turn."""
    scene = beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e5, dt=1e-3)
    sim = Simulator(scene)
    points = np.array(sim.mesh.points)
    mass = lumped_mass(scene, sim.mesh)
    centre = mass @ points / mass.sum()
    v = np.radians(100.0) * np.cross([0.0, 0.0, 1.0], points - centre)
    sim.set_state(points, v)

    def angular() -> Array:
        return mass @ np.cross(sim.positions - mass @ sim.positions / mass.sum(), sim.velocities)

    start = angular()
    for _ in range(900):
        out = sim.step()
    assert_allclose(angular(), start, rtol=0, atol=0.01 * np.linalg.norm(start))
    turned = Rotation.from_quat(out.pose.orientation).as_euler("xyz", degrees=True)
    assert_allclose(turned, [0.0, 0.0, 90.0], rtol=0, atol=1.0)


def test_damping_takes_energy_out() -> None:
    """Stiffness damping quiets a vibration faster than none, mass damping a flight."""
    points = np.array(beam_scene().load_mesh().points)
    mode = 0.01 * np.sin(5.0 * points[:, [1, 2, 0]])
    left = []
    for beta in (0.0, 0.02):
        scene = beam_scene(young=1e4, dt=1e-3, damping=(0.0, beta))
        values = energies(scene, points + mode, np.zeros_like(points), 200)
        left.append(values[-1] / values[0])
    assert left[1] < 0.5 * left[0] < 0.5

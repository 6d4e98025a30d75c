"""What a step is linearised about: anew where it ends (`relinearizations`), or only now and then (`level: lagged`)."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from physics_helpers import Array, beam_scene, pose
from scipy.spatial.transform import Rotation
from small_fingers import small

from finger_sim import Pose, Scene, Simulator, Status


def missing(scene: Scene) -> float:
    """The largest force [N] missing in backward Euler, f, K and damping at the end of a step, of a swinging beam."""
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    for _ in range(4):
        sim.step()
    v_before = sim.velocities.copy()
    sim.step(pose((0.001, 0.0, 0.002), Rotation.from_rotvec([0.0, 0.02, 0.0])))
    mass = np.repeat(body.mass, 3)
    v = sim.velocities.ravel()
    damping = body.beta * body.stiffness(sim.positions) @ v + body.alpha * mass * v
    force = body.forces(sim.positions).ravel() - damping + mass * np.tile(body.gravity, len(sim.positions))
    free = np.setdiff1d(np.arange(len(sim.positions)), sim.mesh.node_sets["base"])
    return float(np.abs((mass * (v - v_before.ravel()) / scene.dt - force).reshape(-1, 3)[free]).max())


@pytest.mark.parametrize("method", ["pgs", "newton"])
def test_relinearising_is_newtons_method_on_backward_euler(method: str) -> None:
    """Each time the force that is missing at the step's end falls quadratically, to round-off."""
    left = []
    for times in (0, 1, 2, 4, 8):
        solver = {"method": method, "relinearizations": times}
        scene = beam_scene((0.5, 0.1, 0.1), (5, 1, 1), driven="base", young=5e4, damping=(1.0, 0.003), dt=0.02,
                           gravity=[0, 0, -9.81], density=1000.0, solver=solver)  # fmt: skip
        left.append(missing(scene))
    assert left[0] > 0.1
    assert left[1] < 0.05 * left[0]
    assert left[2] < 0.05 * left[1]
    assert left[4] < 1e-10


def press_and_slide(level: str, **values: object) -> tuple[Array, int]:
    """Contact wrenches (steps, 6) of the shipped finger, pressed and slid, and all iterations."""
    scene = small("finger_haptic").with_values({"solver.level": level, "solver.tolerance": 1e-6} | values)
    sim = Simulator(scene)
    orientation = scene.initial_pose.orientation
    sim.reset(Pose((0.0, 0.0, 0.0085), orientation))
    wrenches, iterations = [], 0
    for k in range(220):
        out = sim.step(Pose((2e-5 * max(0, k - 150), 0.0, 0.0085 - 2e-5 * min(k, 150)), orientation))
        assert not out.status & (Status.NONFINITE | Status.ITERATION_LIMIT | Status.INVERTED)
        wrenches.append(out.contact_wrench)
        iterations += out.iterations
    return np.array(wrenches), iterations


def test_lagged_is_as_accurate_for_fewer_matrices() -> None:
    """A matrix until a tetrahedron has turned by 0.02 rad: the same wrench to 1 % of its peak, not the same bits."""
    standard, _ = press_and_slide("standard")
    lagged, _ = press_and_slide("lagged")
    apart = np.abs(lagged - standard)[:, :3].max()
    assert 0.0 < apart < 0.01 * np.abs(standard[:, :3]).max()
    assert np.abs(standard[:, 2]).max() > 0.5


def test_a_lagged_matrix_is_made_anew_where_it_has_changed() -> None:
    """A tetrahedron has turned by 0.02 rad since, or a limit force changed by 0.3 of the largest; factors, seldom.

    What resists turning follows in the next step. Where factors are due, as the step before took four iterations or
    more along old ones or found them poor, they come first, and A a step later.
    """
    scene = small("finger_haptic").with_values({"solver.level": "lagged", "material.volumetric": "patch"})
    sim, made, turned, changed, late, waited, found_poor, follows = Simulator(scene), 0, 0, 0, 0, 0, 0, True
    orientation = scene.initial_pose.orientation
    sim.reset(Pose((0.0, 0.0, 0.0085), orientation))
    then: tuple[Array, Array] | None = None
    for k in range(220):
        q, force = sim._state.quaternion.copy(), sim._state.limit_force.copy()
        angle = 2.0 * np.arccos(np.abs((q * then[0]).sum(axis=1)).min().clip(0.0, 1.0)) if then else np.inf
        change = np.abs(force - then[1]).max() - 0.3 * max(force.max(), then[1].max()) if then else 0.0
        before, factors = sim.work["matrices"], sim.work["factorisations"]
        spent, poor = int(sim._state.newton.spent[0]), bool(sim._state.newton.poor[0])
        turning = sim._state.turning_A.copy()
        sim.step(Pose((2e-5 * max(0, k - 150), 0.0, 0.0085 - 2e-5 * min(k, 150)), orientation))
        is_due = angle > 0.02 or change > 0.0
        waits = poor or spent >= (4 if is_due or follows else 5)
        found_poor += poor
        assert sim.work["matrices"] - before == (is_due and not waits), k
        assert not waits or sim.work["factorisations"] > factors
        waited += is_due and waits
        late += (sim._state.turning_A != turning).any()
        assert follows or (sim._state.turning_A == turning).all()
        if not waits:
            follows = then is not None and sim.work["matrices"] > before and not follows
        if sim.work["matrices"] > before:
            then, made = (q, force), made + 1
            turned, changed = turned + (angle > 0.02), changed + (angle <= 0.02)
    assert 20 < made < 150
    assert turned > 5
    assert changed > 5
    assert 10 < late <= made
    assert 5 < waited < made
    assert found_poor > 3
    assert sim.work["factorisations"] < 110


@pytest.mark.parametrize(
    "values",
    [
        {"solver.method": "pgs", "solver.tolerance": 1e-3, "solver.max_iterations": 10_000},
        {"solver.relinearizations": 1},
    ],
)
def test_lagged_is_standard_where_matrices_are_not_shared(values: dict[str, object]) -> None:
    """`pgs` factors A in every step, and what is linearised again is so to be exact: the same bits at both levels."""
    standard, _ = press_and_slide("standard", **values)
    lagged, _ = press_and_slide("lagged", **values)
    assert (lagged == standard).all()


def test_exceeded_limits_are_said() -> None:
    """A bone driven down until its pulp must exceed its limits: LIMIT_EXCEEDED exactly where strain/limit > 1.5."""
    scene = small("finger_haptic")
    sim = Simulator(scene)
    sim.reset(Pose((0.0, 0.0, 0.0085), scene.initial_pose.orientation))
    said = []
    for k in range(180):
        out = sim.step(Pose((0.0, 0.0, 0.0085 - 2e-5 * k), scene.initial_pose.orientation))
        said.append(bool(out.status & Status.LIMIT_EXCEEDED))
        assert said[-1] == (out.max_strain_ratio > 1.5)
    assert not said[0]
    assert said[-1]

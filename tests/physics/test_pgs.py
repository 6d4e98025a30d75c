"""One constrained step against an off-the-shelf QP solver (clarabel) and a dense Gauss-Seidel twin."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, healthy, pose, run
from scipy.spatial.transform import Rotation
from step_problem import LIMITS, PRECISE, check_against_qp, stepped

from finger_sim import Simulator
from finger_sim.physics import pgs


@pytest.mark.parametrize("stiffness", [None, 30.0])
@pytest.mark.parametrize("name", LIMITS)
def test_limits_of_a_shaken_beam_against_clarabel(name: str, stiffness: float | None) -> None:
    """Strain limits, rigid and compliant, on a soft hanging beam held at its base, jerked along and turned."""
    scene = beam_scene(
        (0.4, 0.2, 0.2),
        (3, 1, 1),
        young=5e3,
        poisson=0.3,
        damping=(0.0, 0.01),
        dt=0.005,
        gravity=[0, 0, -9.81],
        driven="base",
        limits=LIMITS[name] | {"stiffness": stiffness},
        solver=PRECISE,
    )
    sim = Simulator(scene)
    limited = 0
    for k in range(1, 25):
        turn = Rotation.from_euler("y", 0.01 * k)
        command = pose((0.002 * np.sin(0.4 * k), 0.0, 0.0), turn)
        if k % 4:
            assert healthy(sim.step(command))
            continue
        problem = stepped(sim, command)
        if problem.out.limit_rows >= 4:
            limited += 1
            check_against_qp(problem)
    assert limited >= 2


@pytest.mark.parametrize("stiffness", [None, 1000.0])
def test_frictionless_contact_against_clarabel(stiffness: float | None) -> None:
    """A soft block falling on its tilted plane: normal forces node by node."""
    scene = beam_scene(
        (0.2, 0.2, 0.1),
        (2, 2, 1),
        young=2e4,
        damping=(0.0, 0.002),
        dt=0.002,
        gravity=[0.5, 0.2, -9.81],
        plane={"point": [0, 0, -0.001], "normal": [0.02, 0.01, 1.0], "friction": 0.0, "stiffness": stiffness},
        solver=PRECISE,
    )
    sim = Simulator(scene)
    touched = 0
    for k in range(60):
        if k % 4:
            assert healthy(sim.step())
            continue
        problem = stepped(sim, None)
        if problem.out.contacts >= 2:
            touched += 1
            check_against_qp(problem)
    assert touched >= 3


@pytest.mark.parametrize("name", LIMITS)
def test_press_with_limits_against_clarabel(name: str) -> None:
    """Frictionless contact and compliant limits together: a driven block pressed on the plane, many tets limited."""
    scene = beam_scene(
        (0.04, 0.04, 0.02),
        (2, 2, 1),
        young=2e4,
        poisson=0.45,
        damping=(0.0, 0.002),
        dt=0.001,
        gravity=[0, 0, -9.81],
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
        plane={"point": [0, 0, 0], "friction": 0.0},
        limits=LIMITS[name] | {"stiffness": 30.0},
        solver=PRECISE,
    )
    sim = Simulator(scene)
    run(sim, 4, pose((0, 0, 1e-4)))
    rows = 0
    for k in range(1, 31):
        command = pose((0.0, 0.0, 1e-4 - 4e-5 * k))
        if k % 6:
            assert healthy(sim.step(command))
            continue
        problem = stepped(sim, command)
        if problem.out.contacts:
            rows = max(rows, problem.out.limit_rows)
            check_against_qp(problem)
    assert rows >= 8


def test_contact_and_limits_with_friction_against_a_dense_twin() -> None:
    """The whole complementarity problem with Coulomb's cone: dense W = h² J A⁻¹ Jᵀ, Gauss-Seidel to the last digit."""
    scene = beam_scene(
        (0.04, 0.04, 0.02),
        (2, 2, 1),
        young=2e4,
        poisson=0.45,
        damping=(0.0, 0.002),
        dt=0.001,
        gravity=[0, 0, -9.81],
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
        plane={"point": [0, 0, 0], "friction": 0.4},
        limits=LIMITS["isotropic"] | {"stiffness": 30.0},
        solver=PRECISE,
    )
    sim = Simulator(scene)
    run(sim, 4, pose((0, 0, 1e-4)))
    for k in range(1, 31):
        command = pose((4e-5 * k, 2e-5 * k, 1e-4 - 3e-5 * k))
        if k % 10:
            assert healthy(sim.step(command))
            continue
        problem = stepped(sim, command)
        J, h = problem.J, problem.h
        unconstrained = np.linalg.solve(problem.system.A, problem.system.b)
        inverse = np.linalg.solve(problem.system.A, h * J.T)
        g = problem.constant + h * J @ unconstrained
        lam = naive.gauss_seidel(h * J @ inverse, g, problem.rows.compliance, len(problem.nodes), 0.4, 20_000, 1e-13)
        v = unconstrained + inverse @ lam
        size = np.abs(v - unconstrained).max()
        assert_allclose(problem.v.ravel()[problem.system.free], v, rtol=0, atol=1e-6 * size)
    assert problem.out.contacts >= 5
    assert problem.out.limit_rows >= 5
    tangential = np.linalg.norm(problem.contact[:, :2], axis=1)
    assert (tangential > 0.39 * problem.contact[:, 2]).sum() > 2  # some nodes slip


def test_a_looser_tolerance_stays_within_its_promise() -> None:
    """The residual reported is at most the tolerance, and the wrench off by no more than a few times it.

    With limits of stiffness alone: the press asks for more than they allow, so that their stiffness is what multiplies
    a missing force into a wrench, and the bounds below were measured with this one.
    """
    wrenches = []
    for tolerance in (1e-2, 1e-3, 1e-9):
        scene = beam_scene(
            (0.04, 0.04, 0.02),
            (4, 4, 2),
            young=2e4,
            poisson=0.45,
            damping=(0.0, 0.002),
            driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
            plane={"point": [0, 0, 0], "friction": 0.4},
            limits=LIMITS["hyperbolic"] | {"stiffness": 30.0, "inertia": 0.0},
            solver={"tolerance": tolerance, "max_iterations": 20_000},
        )
        sim = Simulator(scene)
        for k in range(1, 41):
            out = sim.step(pose((1e-5 * k, 0.0, -2.5e-5 * k)))
            assert healthy(out)
            assert out.residual <= tolerance
        wrenches.append(out.contact_wrench)
    size = np.linalg.norm(wrenches[2][:3])
    assert np.abs(wrenches[0] - wrenches[2]).max() < 5e-2 * size
    assert np.abs(wrenches[1] - wrenches[2]).max() < 5e-3 * size


@for_each("seed", range(30))
def test_tangents_stay_in_the_disk_and_reduce_slip(seed: int) -> None:
    """`tangents`: the slip is stopped if the disk allows it; else the result lies on the rim; none without pressure."""
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((2, 2))
    W = G @ G.T + 0.1 * np.eye(2)
    lam, slip, bound = rng.standard_normal(2), rng.standard_normal(2), float(rng.uniform(0.1, 3.0))
    lam *= min(1.0, bound / np.linalg.norm(lam))
    got = np.array(pgs.tangents(bound, *lam, *slip, W[0, 0], W[1, 1], W[0, 1]))
    stick = lam - np.linalg.solve(W, slip)
    if np.linalg.norm(stick) <= bound:
        assert_allclose(got, stick, rtol=1e-10, atol=1e-12)
        assert_allclose(slip + W @ (got - lam), 0.0, rtol=0, atol=1e-12)
    else:
        assert np.linalg.norm(got) <= bound * (1.0 + 1e-12)

    def loss(l: Array) -> float:
        """What friction minimises at a fixed normal force: ½ lᵀ W l + lᵀ (slip − W λ)."""
        return float(0.5 * l @ W @ l + l @ (slip - W @ lam))

    assert loss(got) <= loss(lam) + 1e-12
    for _ in range(500):  # repeated, it ends at the minimum over the disk
        lam, slip = got, slip + W @ (got - lam)
        got = np.array(pgs.tangents(bound, *lam, *slip, W[0, 0], W[1, 1], W[0, 1]))
    best = min(
        (
            loss(r * bound * np.array([np.cos(a), np.sin(a)]))
            for a in np.linspace(0, 2 * np.pi, 721)
            for r in (1.0, 0.99)
        ),
        default=0.0,
    )
    assert loss(got) <= best + 1e-9
    assert tuple(pgs.tangents(0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0)) == (0.0, 0.0)

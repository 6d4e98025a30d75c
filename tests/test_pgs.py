"""One constrained step against an off-the-shelf QP solver (clarabel) and a dense Gauss-Seidel twin."""

from __future__ import annotations

import dataclasses
from typing import Any

import naive
import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, healthy, pose, run
from scipy.spatial.transform import Rotation

from finger_sim import Pose, Scene, Simulator
from finger_sim.physics import pgs
from finger_sim.physics.contact import _MARGIN as CONTACT_MARGIN
from finger_sim.physics.strain_limits import _MARGIN, _RIGID_MARGIN, SOLVER_GAP

clarabel = pytest.importorskip("clarabel")

PRECISE = {"tolerance": 1e-11, "max_iterations": 200_000}


@dataclasses.dataclass
class Problem:
    """A step as an optimisation over the free velocities: its matrix, rows, start and what the simulator made of it."""

    scene: Scene
    body: naive.Body
    system: naive.System
    rows: naive.Rows
    h: float
    before: Array  # positions at the start
    v: Array  # the simulator's velocities after the step (n, 3)
    lam_limits: dict[int, Array]  # tetrahedron → its row forces, sorted
    contact: Array  # (n, 3)
    out: Any

    @property
    def J(self) -> Array:
        """Rows over the free velocities."""
        return self.rows.J[:, self.system.free]

    @property
    def constant(self) -> Array:
        """C + h J v_driven: the rows' values when no free node moves."""
        return self.rows.C + self.h * self.rows.J @ self.system.given


def stepped(sim: Simulator, command: Pose | None) -> Problem:
    """One step of the simulator, and the same step set up from its positions and velocities by naive.py.

    Rows further from their limit than the documented margins, both now and after the unconstrained step, are left
    out, as the method does.
    """
    scene, h = sim.scene, sim.scene.dt
    body = naive.Body.of(scene, sim.mesh)
    x, v = sim.positions.copy(), sim.velocities.copy()
    driven = scene.driven_nodes(sim.mesh)
    out = sim.step(command)
    assert healthy(out)
    v_driven = (sim.positions[driven] - x[driven]) / h
    system = body.system(x, v, h, driven, v_driven)
    unconstrained = system.whole(np.linalg.solve(system.A, system.b)).ravel()

    parts = []
    if scene.plane is not None:
        surface = np.setdiff1d(np.unique(sim.mesh.surface), driven)
        contact = naive.normal_rows(body, x, scene, surface)
        ahead = contact.C + h * contact.J @ unconstrained
        parts.append(chosen(contact, np.minimum(contact.C, ahead) <= CONTACT_MARGIN * np.cbrt(body.volume.mean())))
    if scene.limits is not None:
        strain = naive.strain_rows(body, x, scene, SOLVER_GAP, system.free)
        ahead = strain.C + h * strain.J @ unconstrained
        margin = _MARGIN if scene.limits.stiffness else _RIGID_MARGIN
        parts.append(chosen(strain, np.minimum(strain.C, ahead) <= margin * rooms(body, x, scene, system.free)))
    forces = np.abs(sim._state.warm_limit)
    lam = {t: np.sort(forces[t][forces[t] > 0.0]) for t in range(len(body.tets)) if forces[t].any()}
    return Problem(
        scene, body, system, naive.joined(*parts), h, x, sim.velocities.copy(), lam, sim.contact_forces.copy(), out
    )


def rooms(body: naive.Body, x: Array, scene: Scene, free: Any) -> Array:
    """The room of each row of naive.strain_rows: its C at rest."""
    is_free = np.zeros(len(x), bool)
    is_free[np.unique(free // 3)] = True
    out = []
    for t, F in enumerate(body.deformation(x)):
        if is_free[body.tets[t]].any():
            for s in naive.signed_svd(F)[1]:
                bounds = scene.limits.stretch if s >= 1.0 else scene.limits.compress  # type: ignore[union-attr]
                axes = range(1 if scene.limits.projection == "isotropic" else 3)  # type: ignore[union-attr]
                out += [abs(bounds[j] - 1.0) for j in axes if bounds[j] is not None]  # type: ignore[operator]
    return np.array(out)


def chosen(rows: naive.Rows, keep: Array) -> naive.Rows:
    return naive.Rows(*(getattr(rows, f.name)[keep] for f in dataclasses.fields(rows)))


def solve_qp(problem: Problem) -> tuple[Array, Array]:
    """v (nf·3,) and λ of min ½ vᵀA v − bᵀv + Σ w²/2ε over C + h J v + w ≥ 0, by clarabel.

    In scaled unknowns, so that its tolerances mean something: y = Lᵀ v with A = L Lᵀ, rows of unit length.
    """
    system, h = problem.system, problem.h
    L = np.linalg.cholesky(system.A)
    B = np.linalg.solve(L, h * problem.J.T).T  # h J L⁻ᵀ
    compliance = problem.rows.compliance
    size = np.sqrt((B * B).sum(axis=1) + compliance)
    c = np.linalg.solve(L, system.b)
    m, n = B.shape
    scale = max(np.abs(problem.constant / size).max(), np.abs(c).max(), 1e-300)
    # Slack as further unknowns z = w / √ε: rows (h J L⁻ᵀ y + √ε z + C) / size ≥ 0.
    G = np.hstack([B, np.diag(np.sqrt(compliance))]) / size[:, None]
    P = scipy.sparse.identity(n + m, format="csc")
    q = -np.concatenate([c, np.zeros(m)]) / scale
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    solver = clarabel.DefaultSolver(
        P, q, scipy.sparse.csc_matrix(-G), problem.constant / size / scale, [clarabel.NonnegativeConeT(m)], settings
    )
    solution = solver.solve()
    assert "Solved" in str(solution.status), solution.status
    v = np.linalg.solve(L.T, scale * np.array(solution.x)[:n])
    return v, scale * np.array(solution.z) / size


def check_against_qp(problem: Problem, rtol: float = 1e-5) -> None:
    """v, λ, violation and complementarity of the simulator's step against clarabel's."""
    system, rows, h = problem.system, problem.rows, problem.h
    v_qp, lam_qp = solve_qp(problem)
    v = problem.v.ravel()[system.free]
    unconstrained = np.linalg.solve(system.A, system.b)
    change = np.abs(v_qp - unconstrained).max()
    assert_allclose(v, v_qp, rtol=0, atol=rtol * change)

    largest = lam_qp.max()
    contacts = rows.tet < 0
    if contacts.any():
        nodes = np.flatnonzero(contacts)
        normal = np.array(problem.scene.plane.normal)  # type: ignore[union-attr]
        normal /= np.linalg.norm(normal)
        at = rows.J[nodes].reshape(len(nodes), -1, 3) @ normal
        ours = problem.contact[at.argmax(axis=1)] @ normal
        assert_allclose(ours, lam_qp[nodes], rtol=0, atol=rtol * lam_qp[nodes].max())
        assert np.linalg.norm(problem.contact, axis=1).sum() == pytest.approx(ours.sum(), rel=1e-9)
    limits = np.flatnonzero(~contacts)
    if len(limits):
        # Row forces of a tetrahedron need not be unique with rigid limits: the generalised force is.
        by_qp = h * problem.J.T @ lam_qp
        by_ours = system.A @ (v - unconstrained)
        assert_allclose(by_ours, by_qp, rtol=0, atol=10 * rtol * np.abs(by_qp).max())
        if (rows.compliance[limits] > 0.0).all():
            for t in np.unique(rows.tet[limits]):
                theirs = np.sort(lam_qp[rows.tet == t])
                theirs = theirs[theirs > 1e-4 * largest]
                ours_t = problem.lam_limits.get(int(t), np.empty(0))
                assert_allclose(ours_t[ours_t > 1e-4 * largest], theirs, rtol=0, atol=10 * rtol * largest)

    # Violation and complementarity of our own v with clarabel's λ: g = C + h J v + ε λ ≥ 0, g λ = 0.
    g = problem.constant + h * problem.J @ v + rows.compliance * lam_qp
    reach = np.sqrt(((h * problem.J) * np.linalg.solve(system.A, h * problem.J.T).T).sum(axis=1) + rows.compliance)
    force = np.sqrt((lam_qp**2 * reach**2).max())
    assert (g / reach).min() >= -10 * rtol * force
    assert np.abs(g * lam_qp).max() <= 10 * rtol * force**2


LIMITS = {
    "hyperbolic": {"projection": "hyperbolic", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]},
    "free axis": {"projection": "hyperbolic", "stretch": [None, 1.04, 1.04], "compress": [None, 0.96, 0.96]},
    "isotropic": {"projection": "isotropic", "stretch": 1.04, "compress": 0.96},
}


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
        problem = stepped(sim, pose((0.002 * np.sin(0.4 * k), 0.0, 0.0), turn))
        if problem.out.limit_rows >= 4 and k % 4 == 0:
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
    for _ in range(60):
        problem = stepped(sim, None)
        if problem.out.contacts >= 2:
            touched += 1
            if touched % 4 == 1:
                check_against_qp(problem)
    assert touched > 10


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
        problem = stepped(sim, pose((0.0, 0.0, 1e-4 - 4e-5 * k)))
        if k % 6 == 0 and problem.out.contacts:
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
        problem = stepped(sim, command)
        if k % 10:
            continue
        normals = problem.rows.tet < 0
        J, g, compliance = [], [], []
        for row in np.flatnonzero(normals):
            J_n = problem.rows.J[row].reshape(-1, 3)
            for axis in ([0, 0, 1], [1, 0, 0], [0, 1, 0]):
                J.append((J_n[:, 2:] * np.array(axis)).ravel())
                g.append(problem.rows.C[row] if axis[2] else 0.0)
                compliance.append(problem.rows.compliance[row] if axis[2] else 0.0)
        J = np.vstack([np.array(J), problem.rows.J[~normals]])[:, problem.system.free]
        unconstrained = np.linalg.solve(problem.system.A, problem.system.b)
        g = np.concatenate([g, problem.constant[~normals]]) + problem.h * J @ unconstrained
        compliance = np.concatenate([compliance, problem.rows.compliance[~normals]])
        inverse = np.linalg.solve(problem.system.A, problem.h * J.T)
        lam = naive.gauss_seidel(problem.h * J @ inverse, g, compliance, int(normals.sum()), 0.4, 20_000, 1e-13)
        v = unconstrained + inverse @ lam
        size = np.abs(v - unconstrained).max()
        assert_allclose(problem.v.ravel()[problem.system.free], v, rtol=0, atol=1e-6 * size)
    assert problem.out.contacts >= 5
    assert problem.out.limit_rows >= 5
    tangential = np.linalg.norm(problem.contact[:, :2], axis=1)
    assert (tangential > 0.39 * problem.contact[:, 2]).sum() > 2  # some nodes slip


def test_a_looser_tolerance_stays_within_its_promise() -> None:
    """The residual reported is at most the tolerance, and the wrench off by no more than a few times it."""
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
            limits=LIMITS["hyperbolic"] | {"stiffness": 30.0},
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


@pytest.mark.parametrize("seed", range(30))
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

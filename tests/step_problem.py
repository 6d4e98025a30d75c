"""One step of a simulator as an optimisation problem, set up by naive.py and solved by clarabel."""

from __future__ import annotations

import dataclasses
from typing import Any

import naive
import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose
from physics_helpers import Array, healthy, pack

from finger_sim import Pose, Scene, Simulator

clarabel = pytest.importorskip("clarabel")

SOLVER_GAP = 0.03
"""Least |s_i² − s_k²| in a gradient."""
NEAR, COINCIDE = 0.85, 0.3
"""`tensor`: two strains of more than the first part of their limit, no further apart than the second, hold like one."""
CONTACT_MARGIN, MARGIN, RIGID_MARGIN = 0.03, 0.05, 0.15
"""A row is in the problem within so much of its room: of a contact, of a limit that gives, of one that does not."""

PRECISE = {"tolerance": 1e-11, "max_iterations": 200_000, "settle": False}

LIMITS: dict[str, dict[str, Any]] = {
    "hyperbolic": {"projection": "hyperbolic", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]},
    "free axis": {"projection": "hyperbolic", "stretch": [None, 1.04, 1.04], "compress": [None, 0.96, 0.96]},
    "isotropic": {"projection": "isotropic", "stretch": 1.04, "compress": 0.96},
    "tensor": {"projection": "tensor", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]},
    "linear": {"projection": "linear", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]},
}
ORTHOGONAL = {"projection": "orthogonal", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]}
"""Not among LIMITS: near rest its rows hang on the directions of singular values that are all but equal."""


@dataclasses.dataclass
class Problem:
    """A step as an optimisation over the free velocities: its matrix, rows, start and what the simulator made of it.

    Rows of contact come first: of each node its normal, and with friction two tangents.
    """

    scene: Scene
    body: naive.Body
    system: naive.System
    rows: naive.Rows
    nodes: np.ndarray[Any, np.dtype[np.int64]]  # of contact rows
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
        """C + shift + h J v_driven: the rows' values when no free node moves and no row carries a force."""
        return self.rows.C + self.rows.shift + self.h * self.rows.J @ self.system.given


def stepped(sim: Simulator, command: Pose | None, well: bool = True) -> Problem:
    """One step of the simulator, and the same step set up from its positions and velocities by naive.py.

    Rows further from their limit than the documented margins, both now and ahead, are left out, as the method does:
    ahead is after the unconstrained step with `pgs`, with `newton` after a step at the velocities of now.
    """
    scene, h, state = sim.scene, sim.scene.dt, sim._state
    body = naive.Body.of(scene, sim.mesh)
    x, v, force = sim.positions.copy(), sim.velocities.copy(), sim.contact_forces.copy()
    driven = scene.driven_nodes(sim.mesh)
    number = sim._model.tet_number
    limit_force = None
    if state.limit_force.size:
        limit_force = np.empty(len(body.tets))
        limit_force[number] = state.limit_force.ravel()[: len(body.tets)]
    state.row_tet[:] = NO_ROW = np.iinfo(np.int64).max
    out = sim.step(command)
    pack(sim)
    assert healthy(out) or not well
    v_driven = (sim.positions[driven] - x[driven]) / h
    viscosity = scene.limits.viscosity if scene.limits else 0.0
    resistance = body.resistance(x, scene.limits, scene.material.young)
    system = body.system(x, v, h, driven, v_driven, limit_force, viscosity, resistance)
    if scene.solver.method == "pgs":
        ahead = system.whole(np.linalg.solve(system.A, system.b)).ravel()
    else:
        ahead = v.copy()
        ahead[driven] = v_driven
        ahead = ahead.ravel()

    parts, nodes = [], np.empty(0, np.int64)
    if scene.plane is not None:
        tangents = scene.plane.friction > 0.0
        surface = np.setdiff1d(np.unique(sim.mesh.surface), driven)
        contact = naive.contact_rows(body, x, scene, surface, force, h, tangents)
        each = 3 if tangents else 1
        keep = np.repeat(near(contact, ahead, h, CONTACT_MARGIN)[::each], each)
        parts.append(chosen(contact, keep))
        nodes = surface[keep[::each]]
    if scene.limits is not None:
        strain = naive.strain_rows(body, x, scene, system.free, h, SOLVER_GAP, NEAR, COINCIDE)
        margin = MARGIN if scene.limits.stiffness else RIGID_MARGIN
        margin = 1.0 - NEAR if scene.limits.projection == "tensor" else margin
        parts.append(chosen(strain, near(strain, ahead, h, margin)))
    lam: dict[int, Array] = {}
    for t, size in zip(state.row_tet, state.lam, strict=True):
        if 0 <= t < NO_ROW and size > 0.0:
            lam[int(number[t])] = np.sort(np.append(lam.get(int(number[t]), np.empty(0)), size))
    return Problem(
        scene,
        body,
        system,
        naive.joined(*parts),
        nodes,
        h,
        x,
        sim.velocities.copy(),
        lam,
        sim.contact_forces.copy(),
        out,
    )


def near(rows: naive.Rows, ahead: Array, h: float, margin: float) -> Any:
    """Which rows have no more than this part of their room, now or after a step at velocities `ahead`."""
    return np.minimum(rows.C, rows.C + h * rows.J @ ahead) <= margin * rows.room


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
    """v, λ, violation and complementarity of the simulator's step, without friction, against clarabel's."""
    system, rows, h = problem.system, problem.rows, problem.h
    v_qp, lam_qp = solve_qp(problem)
    v = problem.v.ravel()[system.free]
    unconstrained = np.linalg.solve(system.A, system.b)
    change = np.abs(v_qp - unconstrained).max()
    assert_allclose(v, v_qp, rtol=0, atol=rtol * change)

    largest = lam_qp.max()
    contacts = rows.tet < 0
    if contacts.any():
        normal = np.array(problem.scene.plane.normal)  # type: ignore[union-attr]
        ours = problem.contact[problem.nodes] @ normal / np.linalg.norm(normal)
        assert_allclose(ours, lam_qp[contacts], rtol=0, atol=rtol * lam_qp[contacts].max())
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


def coulomb_solution(problem: Problem) -> tuple[Array, Array]:
    """v (nf·3,) and λ of the step with friction, by clarabel, if the simulator's normal forces are right.

    Coulomb's problem is no optimisation, but with the cone's radii held at μ λ_n it is one: a second-order cone program
    in λ, min ½ λᵀ (W + ε) λ + gᵀ λ. The simulator's λ is right exactly where its own radii give it back.
    """
    system, rows, h = problem.system, problem.rows, problem.h
    plane = problem.scene.plane
    assert plane is not None
    count = len(problem.nodes)
    free = np.linalg.solve(system.A, system.b)
    inverse = np.linalg.solve(system.A, h * problem.J.T)
    W = h * problem.J @ inverse + np.diag(rows.compliance)
    g = problem.constant + h * problem.J @ free
    unit = 1.0 / np.sqrt(np.diag(W))
    for c in range(count):
        unit[3 * c : 3 * c + 3] = unit[3 * c]
    scale = np.abs(unit * g).max()
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    radius = np.zeros(len(g))
    radius[0 : 3 * count : 3] = (
        plane.friction * (problem.contact[problem.nodes] @ normal) / unit[0 : 3 * count : 3] / scale
    )
    m, G, bounds, cones = len(g), [], [], []
    signs = [row for row in range(m) if row >= 3 * count or row % 3 == 0]
    G.append(-np.eye(m)[signs])
    bounds.append(np.zeros(len(signs)))
    cones.append(clarabel.NonnegativeConeT(len(signs)))
    for c in range(count):
        G.append(np.vstack([np.zeros(m), -np.eye(m)[3 * c + 1 : 3 * c + 3]]))
        bounds.append(np.array([max(radius[3 * c], 0.0), 0.0, 0.0]))
        cones.append(clarabel.SecondOrderConeT(3))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    P = scipy.sparse.triu(scipy.sparse.csc_matrix(unit[:, None] * W * unit)).tocsc()
    solver = clarabel.DefaultSolver(
        P, unit * g / scale, scipy.sparse.csc_matrix(np.vstack(G)), np.concatenate(bounds), cones, settings
    )
    solution = solver.solve()
    assert "Solved" in str(solution.status), solution.status
    lam = scale * unit * np.array(solution.x)
    return free + inverse @ lam, lam


def check_with_friction(problem: Problem, rtol: float = 3e-5) -> None:
    """v and every node's force of the simulator's step, with Coulomb's cone, against clarabel's."""
    v, lam = coulomb_solution(problem)
    system, count = problem.system, len(problem.nodes)
    change = np.abs(v - np.linalg.solve(system.A, system.b)).max()
    assert_allclose(problem.v.ravel()[system.free], v, rtol=0, atol=rtol * change)
    directions = problem.rows.J[: 3 * count].reshape(count, 3, -1, 3)[np.arange(count), :, problem.nodes]
    forces = np.einsum("ca,cak->ck", lam[: 3 * count].reshape(count, 3), directions)
    assert_allclose(problem.contact[problem.nodes], forces, rtol=0, atol=rtol * np.abs(forces).max())

"""Mean dilatation on patches: its energy, forces and matrix; limits on F̄ in both solvers; rest, and what it costs.

Oracles: naive.py and truth/ in plain NumPy, differences of energies and of row values, momentum, the other solver.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import meshio
import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, assembled, beam_scene, healthy, lumped_mass, nodal_forces, pack, pose, run
from scipy.spatial.transform import Rotation
from step_problem import LIMITS, ORTHOGONAL
from truth import linear, patches
from truth.problems import YOUNG, block
from truth.reference import ANSWERS

from finger_sim import Pose, Scene, Simulator

NEWTON = {"method": "newton", "tolerance": 1e-10, "max_iterations": 200, "settle": False}
PGS = {"method": "pgs", "tolerance": 1e-10, "max_iterations": 100_000}
ALL_LIMITS = LIMITS | {"orthogonal": ORTHOGONAL}
SOLVERS = {"newton": NEWTON, "pgs": PGS}
LEVELS = ("standard", "lagged")
FLAT = Rotation.from_euler("x", 90, degrees=True)


def patched(scene: Scene, **values: Any) -> Scene:
    """The same body with its volume strain in patches, dotted keys changed (dots written as __)."""
    changed = {"material.volumetric": "patch"} | {k.replace("__", "."): v for k, v in values.items()}
    return scene.with_values(changed)


def strained(points: Array, seed: int, part: float = 0.03) -> Array:
    """Points moved at random and turned, by so much of the body's size."""
    noise = np.random.default_rng(seed).standard_normal(points.shape)
    turned: Array = Rotation.from_rotvec([0.7, -1.1, 0.4]).apply(points + part * np.ptp(points) * noise)
    return turned


def test_forces_are_the_slope_of_the_energy() -> None:
    """f = −∂/∂x of Σ vol μ |dev E|² + Σ ½ K V_p θ_p², by differences along ten directions."""
    scene = patched(beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, poisson=0.45))
    body = naive.Body.of(scene, scene.load_mesh())
    assert 4 < len(np.unique(body.patch)) < len(body.tets) / 2
    x = strained(body.points, 0)
    forces, rng = nodal_forces(scene, x), np.random.default_rng(1)
    for _ in range(10):
        dx = 1e-6 * rng.standard_normal(x.shape)
        slope = (body.energy(x + dx) - body.energy(x - dx)) / 2.0
        assert -(forces * dx).sum() == pytest.approx(slope, rel=1e-5, abs=1e-8 * body.energy(x) * 1e-3)


@for_each("driven", [None, "base"])
def test_the_matrix_is_the_dense_one(driven: str | None) -> None:
    """A and b of a strained body, damped, against plain NumPy; A is symmetric and positive definite at ν 0.4999."""
    blocks = {"driven": driven} if driven else {}
    scene = patched(beam_scene((0.3, 0.2, 0.2), (3, 2, 2), young=1e4, poisson=0.4999, damping=(3.0, 0.004), **blocks))
    mesh = scene.load_mesh()
    body, held = naive.Body.of(scene, mesh), scene.driven_nodes(mesh)
    x = strained(body.points, 2, 0.01)
    A, b = assembled(scene, x, 0.01)
    system = body.system(x, np.zeros_like(x), 0.01, held, (body.points[held] - x[held]) / 0.01)
    assert_allclose(A, system.A, rtol=0, atol=1e-11 * np.abs(system.A).max())
    assert_allclose(b, system.b, rtol=0, atol=1e-10 * np.abs(system.b).max())
    assert_allclose(A, A.T, rtol=0, atol=1e-15 * np.abs(A).max())
    assert np.linalg.eigvalsh(A).min() >= 0.99 * body.mass.min()


def test_uniform_strain_costs_the_same_in_patches() -> None:
    """A body that is stretched, sheared and swollen alike everywhere pulls as with an element: patches see the mean."""
    scene = beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, poisson=0.49)
    x = np.array(scene.load_mesh().points) @ np.array([[1.1, 0.1, 0.0], [0.0, 1.05, -0.2], [0.1, 0.0, 1.2]])
    forces = nodal_forces(scene, x)
    assert_allclose(nodal_forces(patched(scene), x), forces, rtol=0, atol=1e-9 * np.abs(forces).max())


@for_each("poisson, most", [(0.45, 0.20), (0.49, 0.30)])
def test_a_bonded_block_is_free(poisson: float, most: float, tmp_path: Path) -> None:
    """160 tetrahedra between plates: the simulator's own matrix is the truth's, its force near the quadratic one."""
    problem = block()
    points, tets = problem.points, problem.tets.copy()
    corners = points[tets]
    inside_out = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    tets[inside_out, :2] = tets[inside_out, 1::-1]
    nodes, given = problem.prescribed()
    held = np.zeros(len(points))
    held[nodes] = 1.0
    meshio.write(tmp_path / "block.vtu", meshio.Mesh(points, [("tetra", tets)], point_data={"plates": held}))
    scene = Scene.from_dict(
        {
            "mesh": {"file": str(tmp_path / "block.vtu")},
            "driven": "plates",
            "material": {
                "density": 1.0,
                "young": YOUNG,
                "poisson": poisson,
                "damping": {"stiffness": 0.0},
                "volumetric": "patch",
            },
            "gravity": [0, 0, 0],
        }
    )
    h, free = 0.1, np.flatnonzero(held == 0.0)
    A, _ = assembled(scene, points, h)
    own = np.repeat(lumped_mass(scene, scene.load_mesh())[free], 3)
    labels = patches.freedoms(tets, held > 0.5)
    K = linear.stiffness(points, tets, YOUNG, poisson, labels).toarray()
    index = (3 * free[:, None] + np.arange(3)).ravel()
    ours = (A - np.diag(own)) / h**2
    assert_allclose(ours, K[np.ix_(index, index)], rtol=0, atol=1e-10 * np.abs(K).max())
    K[np.ix_(index, index)] = ours
    force = problem.answer(linear.reaction(K, nodes, given)[0])
    assert 0.0 < force / ANSWERS["block", poisson].force - 1.0 < most


class LimitRows(NamedTuple):
    """The limit rows of a step, dense: what they are of all velocities (3n)."""

    J: Array  # (m, 3n) with the part of the patch
    C: Array  # (m,) constant: C + h J v at the velocities they were formed with
    compliance: Array
    lam: Array
    tet: Any
    key: Any
    side: Array
    scale: Array


def limit_rows(sim: Simulator, step: Any) -> LimitRows:
    """Those of the step that `step` takes."""
    model, state = sim._model, sim._state
    state.row_tet[:] = NO_ROW = np.iinfo(np.int64).max
    step()
    pack(sim)
    found = np.flatnonzero((state.row_tet >= 0) & (state.row_tet < NO_ROW))
    own, J = model.patches, np.zeros((len(found), len(sim.positions), 3))
    for k, row in enumerate(found):
        t = state.row_tet[row]
        J[k, model.tets[t]] += state.J[row, :, :3] / (sim.scene.dt if sim.scene.solver.method == "pgs" else 1.0)
        p = own.lane[t // 8, t % 8]
        entries = slice(own.start[p], own.start[p + 1])
        J[k, own.node[entries]] += state.row_part[row] * state.G[entries, :3]
    return LimitRows(
        J.reshape(len(found), -1),
        *(values[found] for values in (state.constant, state.compliance, state.lam)),
        model.tet_number[state.row_tet[found]],
        state.row_key[found],
        state.row_side[found],
        state.scale[found],
    )


def values_of(F: Array, limits: Any, side: float) -> Array:
    """C of all rows of one side of a tetrahedron whose limits see F: (m,), by LAPACK. `tensor`: 1 − λ."""
    if limits.projection != "tensor":
        return np.array([C for C, _, other, _ in naive.limit_rows(F, limits, both=True) if other == side])
    bounds = limits.stretch if side > 0.0 else limits.compress
    A = np.diag([abs(bound - 1.0) ** -0.5 for bound in bounds])
    return 1.0 - np.linalg.eigvalsh(side * A @ naive.polar_strain(F)[0] @ A)


@for_each("name", ALL_LIMITS)
def test_rows_are_values_and_slopes_on_the_mean_strain(name: str) -> None:
    """strain/limit, C of each row and its gradient at all nodes of the patch, by LAPACK's C of F̄ and differences of it.

    Rows halfway between eigenvectors, and tetrahedra whose singular values all but coincide, are left out: there the
    step's gradients are bounded.
    """
    scene = patched(
        beam_scene((0.4, 0.2, 0.2), (2, 2, 1), poisson=0.45, limits=ALL_LIMITS[name], solver=NEWTON, dt=1e-4)
    )
    assert scene.limits is not None
    sim, body = Simulator(scene), naive.Body.of(scene, scene.load_mesh())
    x = strained(body.points, 3, 0.05)
    sim.set_state(x, np.zeros_like(x))
    ratios = sim.strain_ratio.copy()
    rows = limit_rows(sim, sim.step)
    stretches = np.array([naive.signed_svd(F)[1] for F in body.deformation(x)])
    apart = np.abs(np.diff(stretches**2)).min(axis=1) > 0.04
    known = apart[rows.tet] & ((rows.key < 6) | (name != "tensor"))
    assert known.sum() > 25
    rng = np.random.default_rng(4)
    dx = 1e-6 * rng.standard_normal((3, *x.shape))
    middle, ahead, back = body.bounded(x), [body.bounded(x + d) for d in dx], [body.bounded(x - d) for d in dx]
    for row in np.flatnonzero(known):
        t, side = rows.tet[row], rows.side[row]
        here = values_of(middle[t], scene.limits, side)
        size = 1.0
        if name == "tensor":  # C = (1 − λ) / |y|², |y| as it is at x
            bounds = scene.limits.stretch if side > 0.0 else scene.limits.compress
            A = np.diag([abs(float(bound or 0.0) - 1.0) ** -0.5 for bound in bounds])
            vectors = np.linalg.eigh(side * A @ naive.polar_strain(middle[t])[0] @ A)[1]
            sizes = ((A @ vectors) ** 2).sum(axis=0)
            which = int(np.abs(here / sizes - rows.C[row]).argmin())
            size = sizes[which]
        else:
            which = int(np.abs(here - rows.C[row]).argmin())
        assert here[which] / size == pytest.approx(rows.C[row], rel=1e-8, abs=1e-12)
        for d, F_ahead, F_back in zip(dx, ahead, back, strict=True):
            change = values_of(F_ahead[t], scene.limits, side) - values_of(F_back[t], scene.limits, side)
            largest = np.abs(rows.J[row]).max() * np.abs(d).max()
            assert rows.J[row] @ d.ravel() == pytest.approx(change[which] / size / 2.0, abs=1e-6 * largest)
    if name in ("tensor", "isotropic"):
        room = 1.0 if name == "tensor" else 0.04
        least = [min(values_of(f, scene.limits, side).min() for side in (1.0, -1.0)) / room for f in middle]
        assert_allclose(ratios, 1.0 - np.array(least), rtol=1e-9, atol=1e-9)


@for_each("name", ["hyperbolic", "tensor"])
@for_each("method", SOLVERS)
def test_a_step_is_the_dense_solution(method: str, name: str) -> None:
    """A v = b + h Jᵀ λ, and 0 ≤ λ ⊥ C + h J v + ε λ ≥ 0, of a shaken beam: A and b by NumPy, J at whole patches.

    So is what they give by and are judged by: κ E V, or the inertia behind J; |J|/√2, of `tensor` as if the patch had
    other nodes.
    """
    scene = patched(
        beam_scene(
            (0.4, 0.2, 0.2), (3, 1, 1), young=5e3, poisson=0.45, damping=(0.0, 0.01), dt=0.005, gravity=[0, 0, -9.81],
            driven="base", limits=LIMITS[name] | {"stiffness": 30.0, "inertia": 0.1}, solver=SOLVERS[method],
        )
    )  # fmt: skip
    sim, h = Simulator(scene), scene.dt
    body, held = naive.Body.of(scene, sim.mesh), scene.driven_nodes(sim.mesh)

    def command(k: int) -> Pose:
        return pose((0.002 * np.sin(0.4 * k), 0.0, 0.0), Rotation.from_euler("y", 0.01 * k))

    for k in range(1, 20):
        assert healthy(sim.step(command(k)))
    x, v = sim.positions.copy(), sim.velocities.copy()
    turning = sim._state.limit_force.ravel()[: len(body.tets)].copy() if name == "tensor" else None
    rows = limit_rows(sim, lambda: sim.step(command(20)))
    v_held = (sim.positions[held] - x[held]) / h
    assert scene.limits is not None
    resistance = body.resistance(x, scene.limits, scene.material.young)
    system = body.system(x, v, h, held, v_held, turning, scene.limits.viscosity, resistance)
    formed = system.whole(np.linalg.solve(system.A, system.b)) if method == "pgs" else v.copy()
    formed[held] = v_held
    J, now = h * rows.J, sim.velocities.ravel()
    left = system.A @ now[system.free] - system.b - J.T[system.free] @ rows.lam
    assert (rows.lam > 0.0).sum() >= 4
    assert_allclose(left, 0.0, rtol=0, atol=1e-7 * np.abs(J.T @ rows.lam).max())
    g = rows.C + J @ (now - formed.ravel()) + rows.compliance * rows.lam
    assert rows.lam.min() >= 0.0
    given = (rows.compliance * rows.lam).max()
    assert g.min() >= -1e-7 * given
    assert np.abs(g * rows.lam).max() <= 1e-7 * given * rows.lam.max()
    J = rows.J[:, system.free]
    apart = J * J
    if name == "tensor":
        swells = np.zeros((body.patch.max() + 1, len(x), 3))
        for t, F in enumerate(body.deformation(x)):
            swells[body.patch[t], body.tets[t]] += body.volume[t] * body.gradients[t] @ naive.rotation_of(F).T
        swells /= np.bincount(body.patch, body.volume)[:, None, None]
        whole = rows.side[:, None] / -3.0 * swells[body.patch[rows.tet]].reshape(len(J), -1)[:, system.free]
        apart = (J - whole) ** 2 + whole**2
    assert_allclose(rows.scale, np.sqrt(0.5 * apart.sum(axis=1)), rtol=1e-9)
    if name == "tensor":  # what turns with a tetrahedron: its own rows, and its share of what presses its patch
        turns = np.bincount(rows.tet, rows.lam, len(body.tets))
        shared = np.bincount(body.patch, turns / 3.0) / np.bincount(body.patch, body.volume)
        found = sim._state.limit_force.ravel()[: len(body.tets)]
        expected = (turns + body.volume * shared[body.patch])[sim._model.tet_number]
        assert_allclose(found, expected, rtol=1e-12, atol=1e-15 * turns.max())
    if name == "hyperbolic":  # rows of `tensor` may have a share of their limit's stiffness
        stiff = 30.0 * scene.material.young * body.volume[rows.tet]
        inertia = 0.1 / (h * h * (J * J / np.repeat(body.mass, 3)[system.free]).sum(axis=1))
        assert 0 < (stiff > inertia).sum() < len(stiff)
        assert_allclose(rows.compliance, 1.0 / np.maximum(stiff, inertia), rtol=1e-12)


@for_each("name", ["hyperbolic", "tensor"])
@for_each("method", SOLVERS)
def test_a_free_body_keeps_its_momentum(method: str, name: str) -> None:
    """Strained, tumbling and at its limits in space: to 1e-12 a hundred steps."""
    scene = patched(
        beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, poisson=0.45, damping=(0.0, 0.002), limits=LIMITS[name]),
        solver__method=method,
    )
    sim = Simulator(scene)
    mass, points = lumped_mass(scene, sim.mesh), np.array(sim.mesh.points)
    v = np.array([0.4, -0.2, 0.3]) + np.cross([3.0, -2.0, 5.0], points)
    v = v + 0.4 * np.random.default_rng(5).standard_normal(points.shape)
    sim.set_state(strained(points, 6, 0.01), v)
    out = run(sim, 100)
    assert out.limit_rows > 0
    assert_allclose(mass @ sim.velocities, mass @ v, rtol=0, atol=1e-12 * (mass @ np.abs(v)).max())


def test_a_vibration_never_gains_energy() -> None:
    """Undamped, at ν 0.49: the energy of motion and of deviators and patches does not grow in any step."""
    scene = patched(beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, poisson=0.49, dt=1e-3))
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    mode = np.sin(3.0 * body.points) @ np.random.default_rng(2).standard_normal((3, 3))
    sim.set_state(body.points + 0.01 * mode, np.zeros_like(mode))
    energies = [body.energy(sim.positions)]
    for _ in range(60):
        sim.step()
        energies.append(naive.energy_of_motion(body.mass, sim.velocities) + body.energy(sim.positions))
    assert np.diff(energies).max() <= 1e-9 * energies[0]
    assert energies[-1] < energies[0]


def pad(name: str, **values: Any) -> Scene:
    """A soft block whose top is driven, over a plane, in patches."""
    limits = ALL_LIMITS[name] | {"stiffness": 30.0}
    scene = beam_scene(
        (0.04, 0.04, 0.02), (3, 3, 2), young=2e4, poisson=0.45, damping=(0.0, 0.002), gravity=[0, 0, -9.81],
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]}, plane={"point": [0, 0, 0], "friction": 0.4}, limits=limits,
    )  # fmt: skip
    return patched(scene, **values)


def pressed(sim: Simulator, steps: int = 45) -> tuple[Array, int]:
    """The wrench after a press of 20 steps and a slide, and the most limit rows."""
    most = 0
    for k in range(steps):
        along = 4e-5 * max(0, k - 20)
        out = sim.step(pose((along, 0.5 * along, 1e-4 - 3e-5 * min(k, 20))))
        assert healthy(out)
        most = max(most, out.limit_rows)
    return out.contact_wrench, most


@for_each("name", ["hyperbolic", "tensor", "isotropic"])
def test_both_solvers_press_alike(name: str) -> None:
    """Pressed into its limits and slid, each step to 1e-10: the same wrench, to what rows differ by that are formed
    ahead of different velocities."""
    (a, rows), (b, _) = (pressed(Simulator(pad(name, solver=solver))) for solver in SOLVERS.values())
    assert rows > 10
    assert_allclose(a, b, rtol=0, atol=2e-3 * np.abs(a[:3]).max())


def test_a_held_press_sleeps() -> None:
    """At its limits it comes to rest, falls asleep, and its bone, at rest, carries what the plane does."""
    sim = Simulator(pad("tensor", solver__method="newton"))
    for k in range(60):
        sim.step(pose((0, 0, 1e-4 - 1.5e-5 * min(k, 40))))
    for _ in range(600):
        out = sim.step()
        if out.asleep:
            break
    assert out.asleep
    assert out.limit_rows > 5
    assert (sim.velocities == 0.0).all()
    body = naive.Body.of(sim.scene, sim.mesh)
    free = np.setdiff1d(np.arange(len(body.points)), sim.scene.driven_nodes(sim.mesh))
    rest = body.forces(sim.positions)[free] + sim.contact_forces[free] + body.mass[free, None] * body.gravity
    assert np.abs(rest).max() > 1e-3  # limits carry the rest,
    assert_allclose(rest.sum(axis=0), 0.0, atol=2.0 * np.abs(rest).max() * len(free))


def test_lagged_presses_alike() -> None:
    """A matrix for four steps: the same wrench to 1 %."""
    newton = pad("tensor", solver__method="newton")
    standard, lagged = (pressed(Simulator(newton.with_values({"solver.level": level})))[0] for level in LEVELS)
    assert 0.0 < np.abs(lagged - standard)[:3].max() < 0.01 * np.abs(standard[:3]).max()


@for_each("name", ["hyperbolic", "isotropic"])
def test_no_row_ahead_is_passed_over(name: str) -> None:
    """A tetrahedron has as many rows as come within a twentieth of their room in the step, by differences along v.

    A single node moves: what others of its patches are bounded by changes, though they do not strain themselves.
    """
    scene = patched(beam_scene((0.4, 0.2, 0.2), (2, 2, 1), poisson=0.45, limits=LIMITS[name], solver=NEWTON, dt=1e-3))
    assert scene.limits is not None
    sim, body, rng = Simulator(scene), naive.Body.of(scene, scene.load_mesh()), np.random.default_rng(7)
    x, formed = strained(body.points, 8, 0.01), 0
    beside = 0
    F = body.deformation(x)
    stretches = np.array([naive.signed_svd(f)[1] for f in F])
    apart = np.abs(np.diff(stretches**2)).min(axis=1) > 0.04
    for node in range(len(x)):
        v = np.zeros_like(x)
        v[node] = 60.0 * rng.standard_normal(3)
        sim.set_state(x, v)
        rows = limit_rows(sim, sim.step)
        here, ahead = body.bounded(x), body.bounded(x + 1e-7 * v)
        for t in np.flatnonzero(apart):
            now, later = naive.limit_rows(here[t], scene.limits), naive.limit_rows(ahead[t], scene.limits)
            rates = [(b[0] - a[0]) / 1e-7 for a, b in zip(now, later, strict=True)]
            least = [min(C, C + scene.dt * rate) / room for (C, _, _, room), rate in zip(now, rates, strict=True)]
            assert (rows.tet == t).sum() == (np.array(least) <= 0.05).sum()
            formed += int((rows.tet == t).sum())
            beside += int((rows.tet == t).sum()) * (node not in body.tets[t])
    assert formed > 20
    assert beside > 5


def test_a_bone_that_yields_balances() -> None:
    """Pressed and slid on its spring, patches across bone and pulp: few iterations a step, and the last step's forces.

    Dense: nothing is left at free nodes, and what is at the driven ones adds up to the spring's pull and the weight.
    """
    scene = pad("tensor").with_values(
        {
            "limits.stiffness": 1000.0,
            "solver": NEWTON | {"max_iterations": 40},
            "coupling": {"type": "virtual", "stiffness": 2e4, "damping": 20.0, "rotational_stiffness": 10.0},
        }
    )
    sim, h, iterations = Simulator(scene), scene.dt, 0
    body, held = naive.Body.of(scene, sim.mesh), scene.driven_nodes(sim.mesh)
    assert scene.limits is not None

    def command(k: int) -> Pose:
        return pose((3e-5 * max(0, k - 20), 0.0, 1e-4 - 4e-5 * min(k, 20)))

    for k in range(40):
        out = sim.step(command(k))
        iterations += out.iterations
        assert healthy(out)
    assert iterations < 40 * 16
    assert sim.work["factorisations"] < 40 * 4
    state = sim._state
    x, v, origin = sim.positions.copy(), sim.velocities.copy(), state.bone[7:10].copy()
    turning = body.turning(state.limit_force.ravel()[: len(body.tets)].copy(), scene.limits.viscosity)
    turning += body.resistance(x, scene.limits, scene.material.young)
    rows = limit_rows(sim, lambda: sim.step(command(40)))
    at_bone = np.isin(body.tets[rows.tet[rows.lam > 0.0]], held).any(axis=1)
    assert at_bone.sum() > 3
    K, m = body.stiffness(x), np.repeat(body.mass, 3)
    A = (1.0 + h * body.alpha) * np.diag(m) + h * (h + body.beta) * K + h * h * turning
    b = m * v.ravel() + h * (m * np.tile(body.gravity, len(x)) + body.forces(x).ravel())
    left = b - A @ sim.velocities.ravel() + h * (rows.J.T @ rows.lam + sim.contact_forces.ravel())
    left = left.reshape(-1, 3) / h
    largest = np.abs(rows.J.T @ rows.lam).max()
    free = np.setdiff1d(np.arange(len(x)), held)
    assert_allclose(left[free], 0.0, rtol=0, atol=1e-6 * largest)
    weight = body.mass.sum() * body.gravity
    assert_allclose(left[held].sum(axis=0), weight - state.coupling[:3], rtol=0, atol=1e-6 * largest)
    torque = np.cross(x[held] - origin, left[held]).sum(axis=0) - np.cross(body.mass @ (x - origin), body.gravity)
    assert_allclose(torque, -state.coupling[3:], rtol=0, atol=1e-6 * largest * 0.04)


@for_each("method", SOLVERS)
@for_each("name", ["hyperbolic", "tensor"])
def test_a_scene_without_patches_pays_nothing(name: str, method: str) -> None:
    """No array of patches has an entry, what limits bound is the strain itself, A has the blocks of the tetrahedra."""
    scene = pad(name, solver__method=method, material__volumetric="element")
    sim = Simulator(scene)
    model, state = sim._model, sim._state
    of_state = ("theta", "pressure", "G", "patch_rate", "patch_size", "patch_force", "patch_cross", "row_part")
    own = {"row_rate": state.pgs, "local_patch": state.pgs, "touched_patch": state.pgs}
    for name_of, record in {**dict.fromkeys(of_state, state), **own}.items():
        assert getattr(record, name_of).size == 0, name_of
    for name_of in ("volume", "lane", "tet_place", "tet_share", "node", "slot", "assembly", "place"):
        assert getattr(model.patches, name_of).size == 0, name_of
    assert state.limit_strain is state.E
    assert state.principal.bounded is state.principal.s
    slots = model.slot[sim.mesh.tets]
    pairs = np.sort(np.concatenate([slots[:, [a, b]] for a in range(4) for b in range(a)]), axis=1)
    assert len(state.A) == len(model.free) + len(np.unique(pairs[pairs.max(axis=1) < len(model.free)], axis=0))
    assert len(patched(scene).load_mesh().tets) > 0
    assert len(Simulator(patched(scene))._state.A) > len(state.A)

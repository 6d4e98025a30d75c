"""`newton`: one step against clarabel and against `pgs`, friction, creep, what it does when cut short."""

from __future__ import annotations

from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, finger_scene, healthy, pack, pose, run
from scipy.spatial.transform import Rotation
from step_problem import LIMITS, ORTHOGONAL, Problem, check_against_qp, check_with_friction, stepped

from finger_sim import Pose, Scene, SceneError, Simulator, Status
from finger_sim.physics import workspace
from finger_sim.physics.ready import ready
from finger_sim.physics.rotations import matrix
from finger_sim.physics.strain_limits import SOLVER_GAP
from finger_sim.scene.finger_shape import first_touch
from finger_sim.studies.at_rest import at_rest
from finger_sim.studies.mesh_error import finger_on

EXACT = {"method": "newton", "tolerance": 1e-10, "max_iterations": 200, "settle": False}
BOTH = pytest.mark.parametrize("projection", ["hyperbolic", "tensor"])
MORE = pytest.mark.parametrize("projection", ["hyperbolic", "tensor", "linear"])
FLAT = Rotation.from_euler("x", 90, degrees=True)


def block(cells: Any = (3, 3, 2), friction: float = 0.4, **blocks: Any) -> Scene:
    """A soft block whose top is driven, over a plane."""
    return beam_scene(
        (0.04, 0.04, 0.02),
        cells,
        young=2e4,
        poisson=0.45,
        damping=(0.0, 0.002),
        gravity=[0, 0, -9.81],
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
        plane={"point": [0, 0, 0], "friction": friction},
        **({"solver": EXACT} | blocks),
    )


def limits(projection: str, inertia: float = 0.0) -> dict[str, Any]:
    return LIMITS[projection] | {"stiffness": 30.0, "inertia": inertia}


def sliding(k: int, down: float = 3e-5, along: float = 4e-5) -> Pose:
    """A command that presses for 20 steps, then slides."""
    return pose((along * max(0, k - 20), 0.5 * along * max(0, k - 20), 1e-4 - down * min(k, 20)))


# (mesh, how far a step presses, tetrahedra at a limit in the steps that are checked, at least and at most)
CROWDS = [
    pytest.param((2, 2, 1), 2.3e-5, 1, 4, id="about 1"),
    pytest.param((3, 3, 2), 1.9e-5, 5, 20, id="about 10"),
    pytest.param((4, 4, 2), 2.6e-5, 60, 150, id="about 100"),
    pytest.param((2, 2, 1), 2e-4, 20, 20, id="all"),
]


def checked(sim: Simulator, command: Any, check: Any, least: int, most: int, steps: int) -> int:
    """Check up to three steps, two apart, that follow one with so many tetrahedra at a limit; how many those were."""
    count, wait, limited = 0, 0, 0
    for k in range(1, steps + 1):
        wait -= 1
        if least <= limited <= most and wait <= 0 and count < 3:
            problem = stepped(sim, command(k))
            check(problem)
            count, wait, limited = count + 1, 2, problem.out.limited_tets
        else:
            out = sim.step(command(k))
            assert healthy(out)
            limited = out.limited_tets
    return count


@for_each("coupling", [{}, {"coupling": {"type": "virtual", "stiffness": 2e3, "damping": 2.0}}])
def test_directions_in_single_precision_lead_to_the_same(coupling: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A press and a slide of a body that counts as a large one, of a driven bone and of one that yields."""
    scene, forces, work = block(limits=limits("tensor"), **coupling), [], []
    for most in (workspace.MANY_BLOCKS, 0):
        monkeypatch.setattr(workspace, "MANY_BLOCKS", most)
        sim = Simulator(scene)
        assert (sim._state.L_single.shape[0] > 0) == (most == 0)
        outs = [sim.step(sliding(k)) for k in range(60)]
        assert all(healthy(out) for out in outs)
        forces.append([out.contact_wrench[:3] for out in outs])
        work.append(sum(out.iterations for out in outs))
        if most == 0:
            assert_allclose(sim._state.L_single, sim._state.L_lower, rtol=1e-6, atol=1e-30)
    one, other = np.array(forces)
    assert_allclose(other, one, rtol=0, atol=1e-8 * np.abs(one).max())
    assert work[1] < 1.1 * work[0]


@MORE
@pytest.mark.parametrize(("cells", "down", "least", "most"), CROWDS)
def test_a_press_without_friction_against_clarabel(
    projection: str, cells: Any, down: float, least: int, most: int
) -> None:
    """v, λ, violation and complementarity of steps with a tetrahedron or so at its limit, ten, a hundred, and all.

    Pressed askew, so that they come to it one by one.
    """
    sim = Simulator(block(cells, 0.0, limits=limits(projection)))

    def command(k: int) -> Pose:
        return pose((0, 0, 1e-4 - down * min(k, 20)), Rotation.from_rotvec([-3e-4 * min(k, 20), 2e-4 * min(k, 20), 0]))

    assert checked(sim, command, check_against_qp, least, most, 30) > 0


@BOTH
@pytest.mark.parametrize("friction", [0.1, 0.4])
@pytest.mark.parametrize(("cells", "down", "least", "most"), CROWDS)
def test_sliding_against_clarabel(
    projection: str, cells: Any, down: float, least: int, most: int, friction: float
) -> None:
    """The same with Coulomb's cone, sticking and sliding: v and the force on every node."""
    sim = Simulator(block(cells, friction, limits=limits(projection)))
    cone = np.zeros(2, int)

    def check(problem: Problem) -> None:
        check_with_friction(problem)
        pressed = problem.contact[problem.contact[:, 2] > 0.0]
        across = np.linalg.norm(pressed[:, :2], axis=1) / pressed[:, 2]
        cone[:] += [(across < 0.999 * friction).sum(), (across > 0.99999 * friction).sum()]

    run(sim, 1, sliding(0))
    assert checked(sim, lambda k: sliding(k, down), check, least, most, 45) > 0
    assert cone[1 if friction < 0.2 else 0] > 0


@BOTH
def test_at_rest_against_clarabel(projection: str) -> None:
    """Two hundred steps into a press that keeps tetrahedra at their limits: still the solution, and nothing moves."""
    sim = Simulator(block((2, 2, 1), limits=limits(projection)))
    for k in range(40):
        sim.step(pose((0, 0, -1.5e-5 * k)))
    run(sim, 200)
    problem = stepped(sim, None)
    assert problem.out.limited_tets >= 4
    check_with_friction(problem)
    assert np.abs(sim.velocities).max() < 1e-6


def test_limits_that_are_stiff_against_inertia_against_clarabel() -> None:
    """With the default `limits.inertia`, in a press that its limits allow."""
    sim = Simulator(block((2, 2, 1), limits=limits("tensor", 100.0)))
    seen = 0
    for k in range(1, 41):
        command = sliding(k, 2.6e-5, 5e-6)
        if k not in (20, 22, 30, 40):
            assert healthy(sim.step(command))
            continue
        problem = stepped(sim, command)
        seen = max(seen, problem.out.limited_tets)
        check_with_friction(problem)
    assert seen >= 1


# --- the two methods ---


def copied(sim: Simulator, other: Simulator) -> None:
    """The state of `sim` into `other`, what a step starts from included."""
    other.set_state(sim.positions.copy(), sim.velocities.copy())
    for name in ("contact_force", "limit_force", "held_tets"):
        getattr(other._state, name)[:] = getattr(sim._state, name)
    other._state.tensor.bound[:], other._state.tensor.near[:] = sim._state.tensor.bound, sim._state.tensor.near
    other._place(sim.pose)


@pytest.mark.parametrize("method", ["newton", "pgs"])
@pytest.mark.parametrize("projection", [*LIMITS, "orthogonal"])
def test_a_crumpled_block_against_clarabel(projection: str, method: str) -> None:
    """A step from a state of large strain, singular values well apart: every projection, both solvers."""
    solver = EXACT | {"method": method, "max_iterations": 200_000}
    which = LIMITS.get(projection, ORTHOGONAL) | {"stiffness": 30.0, "inertia": 30.0}
    top = {"box": [[-1, -1, 0.0199], [1, 1, 1]]}
    sim = Simulator(beam_scene((0.04, 0.04, 0.02), (2, 2, 1), young=2e4, driven=top, limits=which, solver=solver))
    rng, X = np.random.default_rng(5), sim.mesh.points
    body = naive.Body.of(sim.scene, sim.mesh)
    moves = np.setdiff1d(np.arange(len(X)), sim.scene.driven_nodes(sim.mesh))
    while True:
        x = X.copy()
        x[moves] += 0.003 * rng.standard_normal((len(moves), 3))
        s = np.array([naive.signed_svd(F)[1] for F in body.deformation(x)])
        if np.abs(np.diff(s**2, axis=1))[np.ptp(s, axis=1) > 1e-9].min() > SOLVER_GAP and s.min() > 0.3:
            break
    sim.set_state(x, 0.1 * rng.standard_normal(x.shape))
    problem = stepped(sim, None)
    assert problem.out.limit_rows > 15
    check_against_qp(problem)


def test_a_first_touch_takes_few_factorisations() -> None:
    """Of `finger_haptic` at 0.03 and 0.1 m/s: a search that ended anywhere near its zero made up to 26 in one step."""
    sim = Simulator(Scene.load("finger_haptic"))
    for speed, most, all_of_them in ((0.03, 13, 130), (0.1, 15, 90)):
        path = [pose((0.0, 0.0, 0.0085 - 1e-3 * speed * k), FLAT) for k in range(int(2.5 / speed))]
        sim.reset(path[0])
        made = []
        for place in path:
            before = sim.work["factorisations"]
            assert sim.step(place).residual <= 1e-3
            made.append(sim.work["factorisations"] - before)
        assert max(made) <= most
        assert sum(made) <= all_of_them


@MORE
def test_both_methods_take_the_same_step(projection: str) -> None:
    """From the same state `newton` and `pgs` go to the same velocities and forces to 1e-6: free, stuck and sliding.

    Where they form the same rows: `pgs` looks for them after the unconstrained step, `newton` at the velocities of now.
    """
    scene = block((2, 2, 1), limits=limits(projection))
    newton = Simulator(scene)
    pgs = Simulator(
        scene.with_values({"solver.method": "pgs", "solver.tolerance": 1e-10, "solver.max_iterations": 10**5})
    )
    most = same = 0
    for k in range(1, 41):
        copied(newton, pgs)
        for sim in (newton, pgs):
            sim._state.row_tet[:] = 2**40
        a, b = newton.step(sliding(k)), pgs.step(sliding(k))
        assert healthy(a)
        assert healthy(b)
        if (np.bincount(rows_of(newton), minlength=20) != np.bincount(rows_of(pgs), minlength=20)).any():
            continue
        same += 1
        most = max(most, a.limited_tets)
        assert_allclose(newton.velocities, pgs.velocities, rtol=0, atol=1e-6 * np.abs(pgs.velocities).max())
        force = np.abs(pgs.contact_forces).max()
        assert_allclose(newton.contact_forces, pgs.contact_forces, rtol=0, atol=1e-6 * force)
    assert same >= 30
    assert most >= 5
    assert a.contacts >= 4


def rows_of(sim: Simulator) -> Any:
    """Tetrahedra of the limit rows of the last step."""
    pack(sim)
    tets = sim._state.row_tet
    return tets[(tets >= 0) & (tets < 2**40)]


def test_without_rows_both_methods_are_one() -> None:
    """No limits and no plane: `newton` is one linear solve, as `pgs`, to round-off."""
    blocks: dict[str, Any] = {"driven": "base", "gravity": [1, -2, -9.81], "damping": (1.0, 0.01), "young": 1e4}
    newton = Simulator(beam_scene((0.3, 0.2, 0.2), (3, 2, 2), solver={"method": "newton"}, **blocks))
    pgs = Simulator(beam_scene((0.3, 0.2, 0.2), (3, 2, 2), **blocks))
    for k in range(50):
        command = pose((1e-4 * k, 0, 0), Rotation.from_rotvec([0, 0.002 * k, 0]))
        a, b = newton.step(command), pgs.step(command)
        assert (a.iterations, a.residual, a.status) == (b.iterations, b.residual, b.status) == (0, 0.0, 0)
    assert_allclose(newton.velocities, pgs.velocities, rtol=0, atol=1e-11 * np.abs(pgs.velocities).max())
    assert_allclose(newton.positions, pgs.positions, rtol=0, atol=1e-12)


# --- friction ---


@for_each("mu", [0.2, 0.5, 1.0])
@for_each("towards", [0.0, 0.7, 3.0])
def test_full_slip_is_on_the_cone(mu: float, towards: float) -> None:
    """Slid along in any direction, |F_t| = μ F_n against the motion to 0.5 %, at the tolerance of every day."""
    solver = {"method": "newton", "tolerance": 1e-3, "max_iterations": 50}
    sim = Simulator(block((2, 2, 1), mu, solver=solver))
    along = np.array([np.cos(towards), np.sin(towards)])
    run(sim, 30, pose((0, 0, -2e-4)))
    for k in range(1, 401):
        out = sim.step(pose((*(2e-5 * k * along), -2e-4)))
        assert healthy(out)
    force = out.contact_wrench[:3]
    assert force[2] > 0.05
    assert np.linalg.norm(force[:2]) == pytest.approx(mu * force[2], rel=5e-3)
    assert_allclose(force[:2] / np.linalg.norm(force[:2]), -along, rtol=0, atol=0.01)


def test_many_nodes_come_down_at_once() -> None:
    """A stiff pad with friction, 0.3 mm a step of 10 ms: every step is solved, its forces within Coulomb's cone.

    Without limits, which would let fewer nodes down at once.
    """
    meant = finger_on("finger", limits=False)
    scene = at_rest(meant).with_values({"solver.max_iterations": 200})
    sim, down = Simulator(scene), first_touch(matrix(FLAT.as_quat()))
    sim.reset(pose((0, 0, down + 1e-4), FLAT))
    for k in range(1, 8):
        for _ in range(5):
            out = sim.step(pose((0, 0, down + 1e-4 - 3e-4 * k), FLAT))
            assert out.status == Status.OK
            assert out.residual <= scene.solver.tolerance
            forces, mu = sim.contact_forces, meant.plane.friction
            assert (np.hypot(forces[:, 0], forces[:, 1]) <= mu * forces[:, 2] * (1.0 + 1e-9) + 1e-15).all()
        assert out.contacts >= 4
    assert out.contact_wrench[2] > 0.5


@for_each("share", [0.5, 0.95])
def test_a_stuck_contact_does_not_creep(share: float) -> None:
    """A block under a constant side load within its cone moves by less than 1 µm in a second."""
    g, mu = 9.81, 0.5
    scene = beam_scene(
        (0.2, 0.2, 0.1),
        (2, 2, 1),
        young=1e6,
        damping=(0.0, 0.01),
        gravity=[share * mu * g, 0, -g],
        plane={"point": [0, 0, 0], "friction": mu},
        solver={"method": "newton", "tolerance": 1e-6, "max_iterations": 50},
    )
    sim = Simulator(scene)
    run(sim, 300)
    start = sim.positions.copy()
    out = run(sim, 1000)
    assert healthy(out)
    assert np.abs(sim.positions - start).max() < 1e-6
    assert out.contact_wrench[0] == pytest.approx(-share * mu * out.contact_wrench[2], rel=1e-3)


# --- cut short ---


def missing_force(problem: Problem, velocities: Array) -> float:
    """The largest force [N] missing at any node at these velocities, from the formula."""
    system, rows, h = problem.system, problem.rows, problem.h
    v = velocities.ravel()[system.free]
    g = problem.constant + h * problem.J @ v
    lam = np.zeros(len(g))
    for row in range(len(g)):
        if rows.tet[row] >= 0 or row % 3 == 0:
            lam[row] = max(0.0, -g[row] / rows.compliance[row])
    for c in range(len(problem.nodes)):
        tangents = -g[3 * c + 1 : 3 * c + 3] / rows.compliance[3 * c]
        size, cone = np.linalg.norm(tangents), problem.scene.plane.friction * lam[3 * c]
        lam[3 * c + 1 : 3 * c + 3] = tangents * min(1.0, cone / size) if size else 0.0
    missing = (system.b - system.A @ v + h * problem.J.T @ lam).reshape(-1, 3)
    return float(np.linalg.norm(missing, axis=1).max() / h)


def test_a_capped_step_is_no_worse_than_none() -> None:
    """One iteration a step: ITERATION_LIMIT where it is not enough, and never more force missing than at the start."""
    values = {"solver.max_iterations": 1, "solver.tolerance": 1e-9}
    sim = Simulator(block((3, 3, 2), limits=limits("tensor")).with_values(values))
    capped = 0
    for k in range(1, 61):
        start = sim.velocities.copy()
        if k % 5:
            out = sim.step(sliding(k))
        else:
            problem = stepped(sim, sliding(k), well=False)
            out = problem.out
            assert missing_force(problem, sim.velocities) <= missing_force(problem, start) * (1 + 1e-6) + 1e-9
            capped += bool(out.status & Status.ITERATION_LIMIT)
        assert out.iterations <= 1
        assert bool(out.status & Status.ITERATION_LIMIT) == (out.residual > 1e-9)
        assert not out.status & (Status.NONFINITE | Status.STEP_REJECTED)
    assert capped >= 5


def test_a_deadline() -> None:
    """A microsecond a step: an iteration is made, no more are begun, ITERATION_LIMIT says so, all stays finite."""
    values = {"solver.deadline": 1e-6, "solver.tolerance": 1e-9}
    sim, patient = (Simulator(block((3, 3, 2), limits=limits("tensor")).with_values(v)) for v in (values, {}))
    late = 0
    for k in range(1, 61):
        out, full = sim.step(sliding(k)), patient.step(sliding(k))
        assert healthy(full)
        assert out.iterations <= 1
        assert np.isfinite(sim.positions).all()
        assert np.isfinite([*out.contact_wrench, out.residual, out.max_strain_ratio]).all()
        assert not out.status & (Status.NONFINITE | Status.STEP_REJECTED)
        late += bool(out.status & Status.ITERATION_LIMIT)
    assert late > 10
    sim.apply({"solver.deadline": 1.0})
    assert healthy(run(sim, 60))


@pytest.mark.parametrize("method", ["newton", "pgs"])
def test_forces_are_solved_no_finer_than_relative_to_the_least_force(method: str) -> None:
    """While they are small that saves iterations, and they are off by what was allowed; where they are large, nothing.

    The forces are those of runs to 1e-9; a contact force may lack as much as each of its nodes.
    """
    scene = block((3, 3, 2), limits=limits("tensor"))
    solver = {"method": method, "tolerance": 1e-4, "max_iterations": 2000}
    exact, relative, absolute, fine = (
        Simulator(scene.with_values({f"solver.{name}": value for name, value in (solver | more).items()}))
        for more in (
            {"method": "newton", "tolerance": 1e-9}, {}, {"least_force": 10.0}, {"least_force": 1e-5}
        )
    )  # fmt: skip
    saved = lightest = heaviest = 0.0
    for k in range(40):
        truth, own, loose, same = (sim.step(sliding(k)) for sim in (exact, relative, absolute, fine))
        assert np.linalg.norm((loose.contact_wrench - truth.contact_wrench)[:3]) <= 32 * 1e-3
        assert (same.contact_wrench == own.contact_wrench).all()
        saved += own.iterations - loose.iterations
        force = float(np.linalg.norm(truth.contact_wrench[:3]))
        lightest, heaviest = min(lightest or force, force or lightest), max(heaviest, force)
    assert lightest < 0.2 * heaviest
    assert saved > 20


def test_nan_inside_a_step_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """A right-hand side that is not a number, while rows hold: NONFINITE, not a step that looks like any other."""
    sim = Simulator(block((2, 2, 1), limits=limits("tensor")))
    assert [sim.step(sliding(k)) for k in range(30)][-1].contacts > 0
    broken = sim._model._replace(gravity=np.array([np.nan, 0.0, 0.0]))
    monkeypatch.setattr(sim, "compiled", sim.compiled._replace(model=ready(broken, sim._state).model))
    out = sim.step()
    assert out.status & Status.NONFINITE
    assert out.status & Status.STEP_REJECTED
    assert np.isfinite(sim.positions).all()


# --- determinism, memory, scenes ---


def test_a_repeated_run_is_bit_identical() -> None:
    """The same commands give the same bits, again after reset and in another simulator."""
    scene = block((3, 3, 2), limits=limits("tensor"), solver={"method": "newton", "tolerance": 1e-3})
    first, second = Simulator(scene), Simulator(scene)
    records: list[list[bytes]] = [[], [], []]
    for record, sim in zip(records, (first, second, first), strict=True):
        sim.reset(sliding(0))
        for k in range(40):
            out = sim.step(sliding(k))
            record.append(b"".join(a.tobytes() for a in (sim.positions, sim.velocities, sim.contact_forces)))
            record.append(repr((out.residual, out.iterations, out.max_strain_ratio, out.contact_wrench)).encode())
    assert records[0] == records[1] == records[2]
    assert out.limited_tets > 5


def test_a_step_allocates_nothing() -> None:
    """Two hundred pressed steps of the finger ask for as much memory as taking the arguments of as many calls does."""
    from numba.core.runtime import _nrt_python, rtsys

    from finger_sim.physics.ready import advance

    _nrt_python.memsys_enable_stats()
    sim = Simulator(finger_scene(solver__method="newton", limits__projection="tensor"))
    sim.reset(pose((0.0, 0.0, 0.006), FLAT))
    assert [sim.step() for _ in range(120)][-1].limit_rows > 20

    def allocations(targets: Array) -> int:
        before = rtsys.get_allocation_stats().alloc
        for _ in range(200):
            advance(sim._ready, targets, 1e-3)
        return int(rtsys.get_allocation_stats().alloc - before)

    pressed = allocations(np.array(sim.positions[sim._model.driven]))
    sim.reset(pose((0.0, 0.0, 0.1), FLAT))
    assert sim.step().limit_rows == 0
    assert pressed == allocations(np.array(sim.positions[sim._model.driven])) <= 200  # the argument


@for_each("key", ["limits.stiffness", "plane.stiffness"])
def test_rigid_rows_are_refused(key: str) -> None:
    """Only `pgs` can be rigid: SceneError names what would have to be a number."""
    scene = block((2, 2, 1), limits=limits("hyperbolic"))
    with pytest.raises(SceneError) as error:
        scene.with_values({key: None})
    assert error.value.key == key
    assert scene.with_values({key: None, "solver.method": "pgs"}).solver.method == "pgs"

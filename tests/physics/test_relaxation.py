"""Stress that fades: its rule, forces and matrix; closed forms of relaxation and creep; energy; rest and resets.

Oracles: naive.py, the hereditary integral summed over all of a history, closed forms of the standard linear solid, the
balance of energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, assembled, beam_scene, healthy, pose, run
from scipy.spatial.transform import Rotation

from finger_sim import Scene, SceneError, Simulator, Status
from finger_sim.physics.apart import needed_by
from finger_sim.physics.relaxation import BEGIN, END, MOVED, relax
from finger_sim.simulation.build import build_model
from finger_sim.simulation.guard import RELAXED

FINGERS = ("finger_haptic", "finger_relaxing")
TERMS = [{"time": 0.004, "share": 0.25}, {"time": 0.07, "share": 0.4}]
NEWTON = {"method": "newton", "tolerance": 1e-10, "max_iterations": 200, "settle": False, "sleep": False}


def fading(scene: Scene, terms: Any = TERMS, **values: Any) -> Scene:
    """The same body with stress that relaxes, dotted keys changed (dots written as __)."""
    return scene.with_values({"material.relaxation": terms} | {k.replace("__", "."): v for k, v in values.items()})


def overstrain(sim: Simulator) -> Array:
    """y of each term and tetrahedron, as matrices (terms, T, 3, 3)."""
    terms, count = len(sim.scene.material.relaxation), len(sim.mesh.tets)
    y = np.empty((count, terms, 6))
    y[sim._model.tet_number] = np.moveaxis(sim._state.relaxing.overstrain.reshape(-1, terms, 6, 8), 3, 1).reshape(
        -1, terms, 6
    )[:count]
    return np.moveaxis(y[..., [0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(count, terms, 3, 3), 1, 0)


def give(sim: Simulator, y: Array) -> None:
    """Make overstrains (terms, T, 3, 3) those of a simulator."""
    lanes = sim._state.relaxing.overstrain.reshape(-1, y.shape[0], 6, 8)
    for c, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]):
        padded = np.zeros((y.shape[0], 8 * len(lanes)))
        padded[:, : y.shape[1]] = y[:, sim._model.tet_number, i, j]
        lanes[:, :, c] = np.moveaxis(padded.reshape(y.shape[0], -1, 8), 0, 1)


def past_of(body: naive.Body, sim: Simulator) -> naive.Past:
    """The past of a body that is where the simulator is, with the overstrains that it has."""
    e = body.relaxing(body.strains(sim.positions))
    return naive.Past(e, e - overstrain(sim))


def strained(points: Array, seed: int, part: float = 0.01) -> Array:
    noise = np.random.default_rng(seed).standard_normal(points.shape)
    turned: Array = Rotation.from_rotvec([0.7, -1.1, 0.4]).apply(points + part * np.ptp(points) * noise)
    return turned


@for_each("relaxes", ["deviator", "stress"])
def test_straight_strains_are_exact(relaxes: str) -> None:
    """40 steps of random strains and lengths, 1e-5 to 100 times τ: y is the hereditary integral over all of them.

    And the stress of what the elastic part is told to feel, with the step's moduli, is that of the series.
    """
    scene = fading(beam_scene(cells=(2, 1, 1)), material__relaxes=relaxes, solver__method="newton")
    sim = Simulator(scene)
    body, state, ready = naive.Body.of(scene, sim.mesh), sim._state, sim._ready
    rng = np.random.default_rng(0)
    lengths = 10.0 ** rng.uniform(-7, -0.4, 40)
    strains = np.concatenate([np.zeros((1, 6)), rng.standard_normal((40, 6))])
    state.E[:] = 0.0
    give(sim, np.zeros((2, len(sim.mesh.tets), 3, 3)))
    index = [0, 5, 4, 5, 1, 3, 4, 3, 2]
    for step, h in enumerate(lengths):
        relax(ready.model, ready.state, h, BEGIN)
        state.E[:] = strains[step + 1][None, :, None]
        relax(ready.model, ready.state, h, MOVED)
        felt, moduli = state.felt_strain[0, :, 0].copy(), state.relaxing.moduli.copy()
        relax(ready.model, ready.state, h, END)
        taken, full = lengths[: step + 1], strains[: step + 2, index].reshape(-1, 3, 3)
        e, since = body.relaxing(full), np.cumsum(taken[::-1])[::-1] - taken
        y = []
        for term in TERMS:
            weights = term["time"] / taken * np.exp(-since / term["time"]) * -np.expm1(-taken / term["time"])
            y.append(np.einsum("k,kij->ij", weights, np.diff(e, axis=0)))
        assert_allclose(overstrain(sim)[:, 0], y, rtol=0, atol=1e-12 * np.abs(strains).max())
        lasting = 1.0 - sum(term["share"] for term in TERMS)
        shares = [term["share"] for term in TERMS]
        relaxed = lasting * e[-1] + np.einsum("k,kij->ij", shares, y)
        bulk = body.lame_lambda + 2.0 / 3.0 * body.lame_mu
        trace, stayed = np.trace(relaxed), np.trace(full[-1])
        wanted = 2.0 * body.lame_mu * (relaxed - trace / 3.0 * np.eye(3))
        wanted += bulk * (trace if relaxes == "stress" else stayed) * np.eye(3)
        own = felt[index].reshape(3, 3)
        got = 2.0 * moduli[1] * own + moduli[0] * np.trace(own) * np.eye(3)
        assert_allclose(got, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


@for_each("driven", [None, "base"])
@for_each("volumetric", ["element", "patch"])
@for_each("relaxes", ["deviator", "stress"])
def test_the_system_is_the_dense_one(driven: str | None, volumetric: str, relaxes: str) -> None:
    """A and b of a strained, damped body with any past, against plain NumPy; A is symmetric and positive definite."""
    blocks = {"driven": driven} if driven else {}
    scene = fading(
        beam_scene((0.3, 0.2, 0.2), (3, 2, 2), young=1e4, poisson=0.45, damping=(3.0, 0.004), **blocks),
        material__volumetric=volumetric,
        material__relaxes=relaxes,
    )
    mesh = scene.load_mesh()
    body, held = naive.Body.of(scene, mesh), scene.driven_nodes(mesh)
    x = strained(body.points, 2)
    y = 0.1 * np.random.default_rng(3).standard_normal((2, len(mesh.tets), 3, 3))
    y = np.array([body.relaxing(part + np.swapaxes(part, 1, 2)) for part in y])
    past = naive.Past(body.relaxing(body.strains(x)), body.relaxing(body.strains(x)) - y)
    A, b = assembled(scene, x, 0.01, lambda sim: give(sim, y))
    system = body.system(x, np.zeros_like(x), 0.01, held, (body.points[held] - x[held]) / 0.01, past=past)
    assert_allclose(A, system.A, rtol=0, atol=1e-11 * np.abs(system.A).max())
    assert_allclose(b, system.b, rtol=0, atol=1e-10 * np.abs(system.b).max())
    assert_allclose(A, A.T, rtol=0, atol=1e-15 * np.abs(A).max())
    assert np.linalg.eigvalsh(A).min() >= 0.99 * body.mass.min()
    assert np.abs(A - assembled(fading(scene, []), x, 0.01)[0]).max() > 0.01 * np.abs(A).max()


@for_each("method", ["pgs", "newton"])
def test_relinearised_steps_are_backward_euler(method: str) -> None:
    """Linearised anew until nothing changes, the force missing at the step's end is round-off, past and all."""
    solver = {"method": method, "relinearizations": 8}
    scene = fading(
        beam_scene((0.5, 0.1, 0.1), (5, 1, 1), driven="base", young=5e4, dt=0.02, gravity=[0, 0, -9.81], solver=solver)
    )
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    run(sim, 4)
    v, past = sim.velocities.copy(), past_of(body, sim)
    sim.step(pose((0.001, 0.0, 0.002), Rotation.from_rotvec([0.0, 0.02, 0.0])))
    force = body.forces(sim.positions, None, past, scene.dt) + body.mass[:, None] * body.gravity
    missing = body.mass[:, None] * (sim.velocities - v) / scene.dt - force
    free = np.setdiff1d(np.arange(len(v)), scene.driven_nodes(sim.mesh))
    assert np.abs(missing[free]).max() < 1e-10
    after = body.after(past, body.strains(sim.positions), scene.dt)
    assert_allclose(overstrain(sim), after.strains - after.yielded, rtol=0, atol=1e-14)


class Column(NamedTuple):
    """A column that stands on a plane without friction and bears a weight: uniaxial stress, alike everywhere."""

    sim: Simulator
    rest: Array

    def load(self, pressure: float) -> None:
        """The weight that presses its cross-section by so much [Pa]."""
        self.sim._model.gravity[:] = [-pressure * AREA / TOP_MASS, 0.0, 0.0]

    def begin(self, axial: float, lateral: float) -> None:
        self.sim.set_state(self.rest * (1.0 + np.array([axial, lateral, lateral])), np.zeros_like(self.rest))

    @property
    def strain(self) -> tuple[float, float]:
        """Along it and across, the mean."""
        at, centre = self.sim.positions, self.rest - self.rest.mean(axis=0)
        moved = at - at.mean(axis=0)
        return tuple(float((moved[:, k] @ centre[:, k]) / (centre[:, k] @ centre[:, k]) - 1.0) for k in (0, 1))  # type: ignore[return-value]


YOUNG, POISSON, AREA, TOP_MASS = 1e5, 0.4, 0.01, 1e-6
SHEAR, BULK = YOUNG / (2.0 * (1.0 + POISSON)), YOUNG / (3.0 * (1.0 - 2.0 * POISSON))
SHARE, TIME, PRESSURE = 0.6, 0.05, 1e3


def column(relaxes: str, dt: float) -> Column:
    """Its top face has all its mass, spread so that each triangle of the face is pressed alike."""
    scene = fading(
        beam_scene((0.2, 0.1, 0.1), (2, 1, 1), young=YOUNG, poisson=POISSON, solver=NEWTON, dt=dt,
                   plane={"normal": [1, 0, 0], "friction": 0.0}),
        [{"time": TIME, "share": SHARE}],
        material__relaxes=relaxes,
    )  # fmt: skip
    sim = Simulator(scene)
    model, rest = sim._model, np.array(sim.mesh.points)
    mass = np.full(len(rest), 1e-9 * TOP_MASS)
    for nodes in sim.mesh.surface:
        a, b, c = rest[nodes]
        if (rest[nodes, 0] > 0.2 - 1e-9).all():
            mass[nodes] += TOP_MASS * np.linalg.norm(np.cross(b - a, c - a)) / 6.0 / AREA
    model.mass[:] = mass
    model.mobility[:] = np.append(1.0 / mass[model.free], np.zeros(len(model.mobility) - len(model.free)))
    model.lane_mobility[:] = model.mobility[model.lane_slot]
    return Column(sim, rest)


def creep(relaxes: str, t: float) -> tuple[float, float]:
    """Strain along and across under PRESSURE, put on at 0: shear yields by J(t), of one term."""
    left = 1.0 - SHARE
    grown = 1.0 / left - SHARE / left * math.exp(-left * t / TIME)
    shear, bulk = grown / SHEAR, (grown if relaxes == "stress" else 1.0) / BULK
    return -PRESSURE * (bulk / 9.0 + shear / 3.0), -PRESSURE * (bulk / 9.0 - shear / 6.0)


def held(relaxes: str, t: float) -> tuple[float, float]:
    """Over the strain along it that is held from 0 on: stress and strain across (Laplace transform of 9KG/(3K+G))."""
    left = 1.0 - SHARE
    if relaxes == "stress":
        return YOUNG * (left + SHARE * math.exp(-t / TIME)), -POISSON
    time = TIME * (3.0 * BULK + SHEAR) / (3.0 * BULK + left * SHEAR)
    end = 9.0 * BULK * left * SHEAR / (3.0 * BULK + left * SHEAR)
    stress = end + (YOUNG - end) * math.exp(-t / time)
    return stress, (stress / (3.0 * BULK) - 1.0) / 2.0


@for_each("relaxes", ["deviator", "stress"])
def test_creep_is_the_closed_form(relaxes: str) -> None:
    """Under a weight strain grows as the compliance says, to 5e-6 at 1 ms; a quarter of the error at half the step.

    Not in the first two steps, in which the contact takes up the weight.
    """
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        stand = column(relaxes, dt)
        stand.load(PRESSURE)
        stand.begin(*creep(relaxes, 0.0))
        worst = 0.0
        run(stand.sim, 2)
        for _ in range(round(0.3 / dt)):
            out = stand.sim.step()
            assert healthy(out)
            along, across = creep(relaxes, out.time)
            worst = max(worst, *(abs(a - b) / abs(along) for a, b in zip(stand.strain, (along, across), strict=True)))
        errors.append(worst)
    assert errors[-1] < 5e-6
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


@for_each("relaxes, most", [("deviator", 5e-6), ("stress", 1e-6)])
def test_relaxation_is_the_closed_form(relaxes: str, most: float) -> None:
    """The stress of the closed form, put on as a weight, holds the strain that it is of, from 1 to 6 time constants."""
    stand, strain = column(relaxes, 1e-3), -0.01
    stand.begin(strain, strain * held(relaxes, 0.0)[1])
    for k in range(300):
        stress, across = held(relaxes, 1e-3 * (k + 1))
        stand.load(-stress * strain)
        assert healthy(stand.sim.step())
        if k < 2:  # the contact takes up the weight
            continue
        assert_allclose(stand.strain, (strain, strain * across), rtol=0, atol=most * abs(strain))
    assert stress < 0.45 * YOUNG


def test_a_rotated_body_relaxes_alike() -> None:
    """The same bodies, one turned by 2 rad: overstrains in material axes are the same."""
    turn = Rotation.from_rotvec([1.2, -1.4, 0.8])
    seen = []
    for R in (Rotation.identity(), turn):
        sim = Simulator(fading(beam_scene((0.4, 0.2, 0.2), (3, 2, 2), young=1e4, solver=NEWTON)))
        points = np.array(sim.mesh.points)
        sim.set_state(R.apply(strained(points, 5, 0.02)), np.zeros_like(points))
        run(sim, 30)
        seen.append(overstrain(sim))
    assert np.abs(seen[0]).max() > 1e-3
    assert_allclose(seen[1], seen[0], rtol=0, atol=1e-10)


@for_each("relaxes", ["deviator", "stress"])
@for_each("dt", [1e-4, 1e-3, 1e-2])
def test_free_motion_never_gains_energy(relaxes: str, dt: float) -> None:
    """Kinetic and stored energy, that of every term's spring too, falls in every step, further than without terms."""
    scene = beam_scene((0.4, 0.2, 0.2), (2, 1, 1), young=1e4, dt=dt)
    left = []
    for terms in ([], TERMS):
        body_scene = fading(scene, terms, material__relaxes=relaxes)
        sim = Simulator(body_scene)
        body, points = naive.Body.of(body_scene, sim.mesh), np.array(sim.mesh.points)
        mode = np.sin(3.0 * points) @ np.random.default_rng(2).standard_normal((3, 3))
        sim.set_state(points + 0.01 * mode, np.zeros_like(points))
        values = []
        for _ in range(60):
            values.append(stored(body, sim))
            assert healthy(sim.step())
        assert (np.diff(values) <= 1e-9 * values[0]).all()
        left.append(values[-1] / values[0])
    assert left[1] < left[0]


def stored(body: naive.Body, sim: Simulator) -> float:
    """Energy of motion, and what is stored in flesh [J]."""
    motion = naive.energy_of_motion(body.mass, sim.velocities)
    return motion + (body.stored(sim.positions, past_of(body, sim)) if body.terms else body.energy(sim.positions))


@for_each("dt", [1e-3, 1e-2])
def test_random_loads_never_give_energy_back(dt: float) -> None:
    """A held beam shaken by forces that change at random in every step: what they do is at least what is stored.

    Over a cycle of loads and their opposite, with rest behind it, flesh has taken work up and gives none.
    """
    scene = fading(beam_scene((0.4, 0.2, 0.2), (2, 1, 1), young=1e5, dt=dt, driven="base", solver={"sleep": False}))
    sim = Simulator(scene)
    body, rng = naive.Body.of(scene, sim.mesh), np.random.default_rng(4)
    before, done = stored(body, sim), 0.0
    for k in range(150):
        load = rng.standard_normal(3) * (5.0 if k < 100 else 0.0)
        sim._model.gravity[:] = load
        start = sim.positions.copy()
        assert healthy(sim.step())
        work = float(body.mass @ ((sim.positions - start) @ load))
        now = stored(body, sim)
        assert now - before <= work + 1e-9 * abs(done)
        before, done = now, done + work
    assert 0.0 <= now < 0.9 * done


@for_each("projection", ["tensor", "hyperbolic"])
def test_limits_bound_strain_alone(projection: str) -> None:
    """A beam that hangs in its limits stays in them while its stress fades."""
    limits = {"projection": projection, "stretch": 1.03, "compress": 0.97, "stiffness": 100.0, "inertia": 30.0}
    scene = fading(
        beam_scene((0.4, 0.1, 0.1), (4, 1, 1), young=5e3, damping=(0.0, 0.002), driven="base",
                   gravity=[0, 0, -9.81], limits=limits, solver=NEWTON | {"tolerance": 1e-6}),
    )  # fmt: skip
    sim = Simulator(scene)
    run(sim, 100)
    assert run(sim, 700).limited_tets > 0
    assert sim.strain_ratio.max() < 1.2


def held_beam(**values: Any) -> tuple[Simulator, Any]:
    """A beam that its held end has just bent by a jump, and that command."""
    scene = fading(
        beam_scene((0.04, 0.02, 0.02), (3, 1, 1), young=5e4, damping=(0.0, 0.002), driven="base",
                   solver={"method": "newton"}, plane={"point": [0, 0, -0.0005]}),
        **values,
    )  # fmt: skip
    return Simulator(scene), pose((0, 0, -0.001), Rotation.from_rotvec([0.0, 0.05, 0.0]))


def test_it_sleeps_once_the_slowest_term_has_settled() -> None:
    """Later than the same beam without terms; what fades afterwards is a 1e-4 part of the force."""
    sleeps, forces = [], []
    for terms in ([], TERMS):
        sim, hold = held_beam(terms=terms)
        outs = [sim.step(hold) for _ in range(2500)]
        sleeps.append([out.asleep for out in outs].index(True))
        forces.append(outs[-1].contact_wrench[2])
        if terms:
            assert sim._state.relaxing.rate[0] <= RELAXED
            awake, hold = held_beam(terms=terms, solver__sleep=False)
            assert run(awake, 4000, hold).contact_wrench[2] == pytest.approx(forces[-1], rel=1e-4)
    assert sleeps[1] - sleeps[0] > 8 * TERMS[1]["time"] / 1e-3
    assert forces[1] < 0.6 * forces[0]


def test_a_body_that_cannot_move_does_not_sleep_while_its_stress_fades() -> None:
    """All nodes but one driven and that one by symmetry at rest: speed says nothing, the overstrain does."""
    sim = Simulator(fading(beam_scene((0.2, 0.2, 0.2), (2, 2, 2), driven={"box": [[-1, -1, -1], [0.15, 1, 1]]})))
    points = np.array(sim.mesh.points)
    state = sim._state
    assert sim.step().asleep or run(sim, 50).asleep
    sim.set_state(points, np.zeros_like(points))
    give(sim, np.zeros((2, len(sim.mesh.tets), 3, 3)) + 1e-12)
    state.relaxing.overstrain[:] = 0.0
    driven = sim._model.driven
    y = np.zeros((2, len(sim.mesh.tets), 3, 3))
    inner = np.isin(sim.mesh.tets, driven).all(axis=1)
    assert inner.any()
    y[1, inner] = np.diag([0.02, -0.01, -0.01])
    give(sim, y)
    outs = [sim.step().asleep for _ in range(800)]
    first = outs.index(True)
    assert 0.02 / 0.07 * math.exp(-first * 1e-3 / 0.07) < 1.1 * RELAXED


def test_a_reset_forgets_and_repeats_bit_by_bit() -> None:
    """Runs from a reset, from another one after a press, and of a new simulator are the same to the last bit."""

    def course(sim: Simulator, hold: Any) -> bytes:
        sim.reset(pose())
        return b"".join(sim.step(hold).contact_wrench.tobytes() + sim.positions.tobytes() for _ in range(40))

    sim, hold = held_beam()
    first = course(sim, hold)
    assert overstrain(sim).any()
    sim.reset(pose())
    assert np.abs(overstrain(sim)).max() < 1e-14
    assert course(sim, hold) == first == course(*held_beam())


def test_a_rejected_step_lets_stress_fade_on() -> None:
    """The body goes rigidly with its bone, deformed as it was: its overstrains are those of a held strain."""
    sim, hold = held_beam(solver__sleep=False)
    run(sim, 20, hold)
    before = overstrain(sim)
    sim._state.v[:, 0] = np.nan
    out = sim.step(hold)
    assert out.status & Status.STEP_REJECTED
    faded = [math.exp(-1e-3 / term["time"]) for term in TERMS]
    assert_allclose(overstrain(sim), np.array(faded)[:, None, None, None] * before, rtol=0, atol=1e-12)


def test_without_terms_there_is_nothing() -> None:
    """No array, no kernel, no other strain: the elastic part reads E itself."""
    sim = Simulator(beam_scene(solver={"method": "newton"}))
    assert sim._state.felt_strain is sim._state.E
    assert sum(array.nbytes for array in sim._state.relaxing) == 0
    assert sim._model.relax_at == 0
    assert "relax_at" not in needed_by(sim._model)
    assert "relax_at" in needed_by(Simulator(fading(sim.scene))._model)


def test_what_locks_is_what_does_in_the_end() -> None:
    """The relaxing finger's volume is as good as kept, like the everyday one's, though ν is small at first."""
    strains = [build_model(scene, scene.load_mesh()).isochoric_strain for scene in map(Scene.load, FINGERS)]
    assert np.isfinite(strains[0]).any()
    assert_allclose(strains[1], strains[0], rtol=1e-12)


def test_it_is_refused_while_it_runs() -> None:
    """As young and all of the material: a new Simulator has it."""
    sim, _ = held_beam()
    for key, value in (("material.relaxation", []), ("material.relaxes", "stress")):
        with pytest.raises(SceneError, match=key):
            sim.apply({key: value})


def course_of(scene: Scene, tell: Callable[[int], Any]) -> Array:
    sim = Simulator(scene)
    return np.array([sim.step(tell(k)).contact_wrench[2] for k in range(60)])


def test_both_solvers_agree() -> None:
    """A press of the same body by `pgs` and `newton`: forces within a thousandth of the largest."""
    scene, hold = held_beam()[0].scene, held_beam()[1]
    forces = [
        course_of(scene.with_values({"solver.method": method, "solver.tolerance": 1e-8, "solver.max_iterations": 5000}),
                  lambda k: hold)
        for method in ("pgs", "newton")
    ]  # fmt: skip
    assert forces[0].max() > 0.01
    assert_allclose(forces[0], forces[1], rtol=0, atol=1e-3 * forces[0].max())

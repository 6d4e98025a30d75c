"""Strain limits: values against Eq. 9-12 and 19-22 by LAPACK, gradients against differences, in the hard places too."""

from __future__ import annotations

from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from physics_helpers import Array, assert_derivative, beam_scene, finger_scene, healthy, pose, random_F, rotations, run

from finger_sim import Scene, Simulator
from finger_sim.physics.strain_limits import SOLVER_GAP, evaluate
from finger_sim.scene import Limits

PAPER = Limits("hyperbolic", (1.05, 1.25, 1.02), (0.95, 0.75, 0.98))
FREE_AXIS = Limits("hyperbolic", (None, 1.04, 1.1), (0.9, None, 0.96))
ISOTROPIC = Limits("isotropic", (1.04,) * 3, (0.93,) * 3)
ONE_SIDED = Limits("isotropic", (1.04,) * 3, (None,) * 3)
ORTHOGONAL = Limits("orthogonal", (1.05, 1.25, 1.02), (0.95, 0.75, 0.98))
ORTHOGONAL_FREE = Limits("orthogonal", (None, 1.04, 1.1), (0.9, None, 0.96))
LINEAR = Limits("linear", (1.05, 1.25, 1.02), (0.95, 0.75, 0.98))
LINEAR_FREE = Limits("linear", (None, 1.04, 1.1), (0.9, None, 0.96))
ALL = {
    "paper": PAPER,
    "free axis": FREE_AXIS,
    "isotropic": ISOTROPIC,
    "one-sided": ONE_SIDED,
    "orthogonal": ORTHOGONAL,
    "orthogonal, free axis": ORTHOGONAL_FREE,
    "linear": LINEAR,
    "linear, free axis": LINEAR_FREE,
}
each = for_each("limits", ALL.values())

seeds = st.integers(0, 2**32 - 1)


def spread(rng: np.random.Generator, low: float = 0.5, high: float = 1.6, apart: float = 0.1) -> Array:
    """Three singular values at least `apart` from each other and 0.02 from the kink at 1."""
    while True:
        s = rng.uniform(low, high, 3)
        if min(abs(s[0] - s[1]), abs(s[1] - s[2]), abs(s[0] - s[2])) > apart and np.abs(s - 1.0).min() > 0.02:
            return s


def away_from_kinks(F: Array) -> bool:
    """Whether |V_ji| is far enough from its kink at zero for differences to mean anything."""
    return bool(np.abs(naive.signed_svd(F)[2]).min() > 0.02)


def smooth_F(seed: int, s: Any) -> Array:
    """An F with singular values s, V away from the axes."""
    rng = np.random.default_rng(seed)
    while True:
        F = random_F(rng, s)
        if away_from_kinks(F):
            return F


def matched(C: Array, rows: Array, C_naive: Array, rows_naive: Array) -> tuple[Array, Array]:
    """Both row sets in one order: rows carry no names, and singular values may come in any order."""
    a, b = np.argsort(C), np.argsort(C_naive)
    return rows[a], rows_naive[b]


@each
@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_values_are_the_paper_s(limits: Limits, seed: int) -> None:
    """Every C of Eq. 9-12, 19-22, by numpy.linalg.svd, inverted tetrahedra included; and the count of rows."""
    F = np.random.default_rng(seed).standard_normal((3, 3)) * 0.3 + np.eye(3)
    C, gradients = evaluate(F, limits)
    expected = sorted(value for value, *_ in naive.limit_rows(F, limits))
    assert_allclose(np.sort(C), expected, rtol=0, atol=1e-12)
    assert gradients.shape == (len(C), 3, 3)


@for_each(
    "F, expected",
    [
        (np.diag([1.1, 0.8, 1.0]), [0.05 - 0.1, 0.25, 0.02, 0.05, 0.25 - 0.2, 0.02, 0.05, 0.25, 0.02]),
        (np.eye(3), [0.05, 0.25, 0.02] * 3),
    ],
)
def test_values_along_the_axes_by_hand(F: Array, expected: list[float]) -> None:
    """With V = I, axis j bounds s_j alone, and the whole room of the other rows is left."""
    C, _ = evaluate(F, PAPER)
    assert_allclose(np.sort(C), np.sort(expected), rtol=0, atol=1e-14)


def test_orthogonal_has_no_room_across_its_axes() -> None:
    """Eq. 19-20 with V = I: s_i may be no other than 1 as long as another axis is limited (the paper, Section 5.2)."""
    C, _ = evaluate(np.diag([1.01, 1.0, 1.0]), Limits("orthogonal", (None, 1.05, None), (None, 0.95, None)))
    assert_allclose(np.sort(C), [-0.01, 0.0, 0.05], rtol=0, atol=1e-14)


def test_linear_is_no_ellipsoid() -> None:
    """Eq. 21-22 as printed: |diag(s) v|, more than where the direction v meets the ellipsoid, 1 / |v / s|."""
    limits = Limits("linear", (1.05, 2.0, 1.05), (None,) * 3)
    v = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    C, _ = evaluate(np.eye(3) + 0.1 * np.outer(v, v), limits)
    assert C[0] == pytest.approx(np.sqrt((1.05**2 + 2.0**2) / 2.0) - 1.1, abs=1e-12)
    assert C[0] + 1.1 > 1.0 / np.sqrt((1.05**-2 + 2.0**-2) / 2.0) + 0.2


def test_linear_bounds_nothing_next_to_a_free_axis() -> None:
    """A principal axis that a free one has the least part in may stretch without end, but not shrink so."""
    limits = Limits("linear", (None, 1.05, 1.05), (None, 0.95, 0.95))
    v = np.array([1e-6, 1.0, 0.0])
    v /= np.linalg.norm(v)
    along = np.outer(v, v)
    assert evaluate(np.eye(3) + 9.0 * along, limits)[0].min(initial=0.0) >= -1e-9
    assert evaluate(np.eye(3) - 0.06 * along, limits)[0].min() == pytest.approx(-0.01, abs=1e-6)
    assert evaluate(np.diag([1.0, 1.06, 1.0]), limits)[0].min() == pytest.approx(-0.01, abs=1e-12)


def test_number_of_rows() -> None:
    """Nine rows hyperbolic, three isotropic, none for a free axis on its free side, none at all without limits."""
    stretched, squeezed = np.diag([1.3, 1.2, 1.1]), np.diag([0.7, 0.8, 0.9])
    for F in (stretched, squeezed):
        assert evaluate(F, PAPER)[0].shape == (9,)
        assert evaluate(F, ISOTROPIC)[0].shape == (3,)
        assert evaluate(F, FREE_AXIS)[0].shape == (6,)
    assert evaluate(stretched, ONE_SIDED)[0].shape == (3,)
    assert evaluate(squeezed, ONE_SIDED)[0].shape == (0,)
    assert evaluate(squeezed, ONE_SIDED)[1].shape == (0, 3, 3)
    assert evaluate(stretched, Limits())[0].shape == (0,)


@for_each("limits", [v for k, v in ALL.items() if not k.startswith("orthogonal")])
def test_inside_is_positive_and_outside_negative(limits: Limits) -> None:
    """C ≥ 0 within the tightest room in every direction; C < 0 where a limited axis is passed along itself."""
    for seed in range(30):
        F = random_F(np.random.default_rng(seed), np.random.default_rng(seed).uniform(0.981, 1.019, 3))
        assert (evaluate(F, limits)[0] >= 0.0).all()
    for j in range(3):
        if limits.stretch[j] is not None:
            assert evaluate(np.diag(1.0 + (limits.stretch[j] - 1.0 + 0.01) * np.eye(3)[j]), limits)[0].min() < -0.009
        if limits.compress[j] is not None:
            assert evaluate(np.diag(1.0 + (limits.compress[j] - 1.0 - 0.01) * np.eye(3)[j]), limits)[0].min() < -0.009


@for_each("F", [np.eye(2), np.full((3, 3), np.nan), np.diag([1.0, np.inf, 1.0]), np.zeros(9), "F"])
def test_an_F_that_is_none_is_refused(F: Any) -> None:
    """Wrong shapes and numbers that are not finite: ValueError."""
    with pytest.raises(ValueError):  # noqa: PT011
        evaluate(F, PAPER)


def values_by_lapack(F: Array, limits: Limits) -> Array:
    """C of every row, singular values in descending order of magnitude."""
    return np.array([value for value, *_ in naive.limit_rows(F, limits)])


def check_gradients(F: Array, limits: Limits, step: float, rtol: float, atol: float = 1e-9) -> None:
    """evaluate's dC_dF against differences of C by LAPACK, rows matched by their value at F."""
    C, gradients = evaluate(F, limits)
    gradients = gradients[np.argsort(C)][np.argsort(np.argsort(values_by_lapack(F, limits)))]
    assert_derivative(lambda G: values_by_lapack(G, limits), gradients, F, step=step, rtol=rtol, atol=atol)


def test_row_order_is_continuous() -> None:
    """While no singular values cross, rows keep their places: differences of `evaluate` are row by row."""
    from scipy.spatial.transform import Rotation

    for limits in (PAPER, ISOTROPIC):
        before = None
        for angle in np.linspace(0.1, 1.5, 1401):
            V = Rotation.from_euler("z", angle).as_matrix() @ Rotation.from_euler("x", 0.3).as_matrix()
            C, _ = evaluate(V @ np.diag([1.3, 1.15, 0.8]) @ V.T, limits)
            if before is not None:
                assert np.abs(C - before).max() < 2e-3, f"rows changed places at {np.degrees(angle):.1f}°"
            before = C


@each
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_gradients_at_random(limits: Limits, seed: int) -> None:
    """∂C/∂F (Eq. 13, 17, 18) at random F with separate singular values, to 1e-8."""
    check_gradients(smooth_F(seed, spread(np.random.default_rng(seed))), limits, 1e-3, 1e-6)
    check_gradients(smooth_F(seed, spread(np.random.default_rng(seed))), limits, 2e-4, 1e-8, 1e-10)


@each
@for_each("inverted", [-0.3, -0.05])
@for_each("seed", range(3))
def test_gradients_of_inverted_tetrahedra(limits: Limits, seed: int, inverted: float) -> None:
    """A negative singular value is a compression past zero, differentiated as such."""
    check_gradients(smooth_F(seed, (1.3, 0.8, inverted)), limits, 2e-4, 1e-7)


@each
@for_each("gap", [1e-2, 1e-3, 1e-4])
@for_each("seed", range(3))
def test_gradients_of_near_equal_singular_values(limits: Limits, seed: int, gap: float) -> None:
    """V turns faster as 1/gap; its exact derivative is followed down to a gap of 1e-4."""
    for s in [(1.2 + gap, 1.2, 0.8), (1.3, 0.7, 0.7 - gap)]:
        check_gradients(smooth_F(seed, s), limits, 0.003 * gap, 1e-5, 1e-9 / gap)


@each
@for_each("flat", [1e-3, 1e-5, 1e-8])
@for_each("seed", range(3))
def test_gradients_of_flattened_tetrahedra(limits: Limits, seed: int, flat: float) -> None:
    """One singular value nearly zero: no loss of accuracy (an SVD by way of FᵀF would have it)."""
    check_gradients(smooth_F(seed, (1.2, 0.8, flat)), limits, 2e-4, 1e-7)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_gradients_are_those_of_perturbation_theory(seed: int) -> None:
    """With the step's clamp on the denominators too, dC_dF is the derivative of FᵀF's eigenvectors, clamped."""
    rng = np.random.default_rng(seed)
    for apart, gap in ((0.1, 1e-12), (0.001, SOLVER_GAP)):
        F = smooth_F(seed, spread(rng, 0.8, 1.25, apart))
        C, gradients = evaluate(F, PAPER, gap)
        rows = naive.limit_rows(F, PAPER, gap)
        C_naive, rows_naive = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
        if np.diff(np.sort(C_naive)).min() < 1e-6:
            continue
        ours, theirs = matched(C, gradients, C_naive, rows_naive)
        assert_allclose(ours, theirs, rtol=0, atol=1e-9 * max(1.0, np.abs(theirs).max()))


def test_the_clamp_bounds_gradients() -> None:
    """Where singular values cross, and where s_i = −s_k, the gradients stay finite and below room / gap."""
    for s in [(1.2, 1.2, 1.2), (1.1, 1.1, 0.9), (0.5, 0.3, -0.3), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)]:
        for seed in range(5):
            F = random_F(np.random.default_rng(seed), s)
            assert np.isfinite(evaluate(F, PAPER)[1]).all()
            assert np.abs(evaluate(F, PAPER, SOLVER_GAP)[1]).max() < 3.0 / SOLVER_GAP


# --- limits inside a step ---


def ratios(sim: Simulator) -> Array:
    """strain/limit of every tetrahedron by LAPACK and the definition: 1 + (used − room) / room at the worst row."""
    limits, body = sim.scene.limits, naive.Body.of(sim.scene, sim.mesh)
    worst = []
    for F in body.deformation(sim.positions):
        _, s, V = naive.signed_svd(F)
        values = [0.0]
        for i in range(3):
            for j in range(3):
                bound = limits.stretch[j] if s[i] >= 1.0 else limits.compress[j]
                if bound is not None:
                    share = abs(V[j, i]) if limits.projection == "hyperbolic" else 1.0
                    values.append(share * abs(s[i] - 1.0) / abs(bound - 1.0))
        worst.append(max(values))
    return np.array(worst)


LIMITED: dict[str, Any] = {
    "limits": {
        "projection": "hyperbolic",
        "stretch": [1.05, 1.25, 1.02],
        "compress": [0.95, 0.75, 0.98],
        "stiffness": 100.0,
    }
}


@for_each("index", range(6))
def test_limits_move_with_the_body(index: int) -> None:
    """A strained body, rotated with its motion: the same strain ratios, rows, and velocities turned along."""
    turn = rotations(3, seed=11)[index]
    scene = beam_scene((0.4, 0.2, 0.2), (2, 1, 1), **LIMITED)
    sim = Simulator(scene)
    x = sim.mesh.points + 0.01 * np.random.default_rng(12).standard_normal(sim.mesh.points.shape)
    v = 0.1 * np.random.default_rng(13).standard_normal(x.shape)
    sim.set_state(x, v)
    reference = sim.step()
    ratio, velocities = sim.strain_ratio.copy(), sim.velocities.copy()
    assert reference.limit_rows >= 5
    sim.set_state(turn.apply(x) + [1.0, -2.0, 0.5], turn.apply(v))
    out = sim.step()
    assert (out.limit_rows, out.limited_tets) == (reference.limit_rows, reference.limited_tets)
    assert_allclose(sim.strain_ratio, ratio, rtol=1e-4)
    assert_allclose(sim.velocities, turn.apply(velocities), rtol=0, atol=1e-4 * np.abs(velocities).max())


def test_strain_ratio_is_one_at_the_limit() -> None:
    """`strain_ratio` is strain over room at the worst row of each tetrahedron; the result has the largest."""
    scene = beam_scene((0.4, 0.2, 0.2), (2, 1, 1), **LIMITED)
    sim = Simulator(scene)
    x = sim.mesh.points * np.array([1.05, 1.0, 1.0])
    sim.set_state(x, np.zeros_like(x))
    assert_allclose(sim.strain_ratio, 1.0, rtol=0, atol=1e-10)
    x = sim.mesh.points + 0.01 * np.random.default_rng(12).standard_normal(x.shape)
    sim.set_state(x, np.zeros_like(x))
    assert_allclose(sim.strain_ratio, ratios(sim), rtol=1e-9)
    out = sim.step()
    assert_allclose(sim.strain_ratio, ratios(sim), rtol=1e-9)
    assert out.max_strain_ratio == sim.strain_ratio.max()


def test_rigid_limits_hold_a_hanging_beam() -> None:
    """A soft beam that its own weight would stretch by half is held within 1 % of an isotropic 4 % limit."""
    limits = {"projection": "isotropic", "stretch": 1.04, "compress": 0.96, "stiffness": None}
    blocks: dict[str, Any] = {"driven": "base", "gravity": [9.81, 0, 0], "damping": (0.0, 0.05)}
    free = Simulator(beam_scene((1.0, 0.2, 0.2), (5, 1, 1), young=1e4, dt=0.01, **blocks))
    held = Simulator(beam_scene((1.0, 0.2, 0.2), (5, 1, 1), young=1e4, dt=0.01, limits=limits, **blocks))
    run(free, 300)
    out = run(held, 300)
    assert np.ptp(free.positions[:, 0]) > 1.3
    assert 1.02 < np.ptp(held.positions[:, 0]) < 1.041
    assert out.max_strain_ratio < 1.01
    assert out.limited_tets >= 10


def test_compliant_limits_approach_rigid_ones() -> None:
    """Overshoot falls with κ: each tenfold stiffness leaves at most a third of it (stiffness alone: no inertia)."""
    overshoot = [overshoot_at_rest(stiffness, 0.0) for stiffness in (3.0, 30.0, 300.0)]
    assert overshoot[0] > 0.1
    assert overshoot[1] < overshoot[0] / 3.0
    assert overshoot[2] < overshoot[1] / 3.0


def test_limits_are_stiff_against_inertia() -> None:
    """However soft κ is, a limit is as stiff as `limits.inertia` asks: overshoot falls as its inverse, apart from κ."""
    overshoot = [overshoot_at_rest(1e-3, inertia) for inertia in (10.0, 30.0, 100.0)]
    assert 0.01 < overshoot[0] < 0.2
    assert overshoot[1] == pytest.approx(overshoot[0] / 3.0, rel=0.15)
    assert overshoot[2] == pytest.approx(overshoot[0] / 10.0, rel=0.15)
    assert overshoot_at_rest(0.1, 30.0) == pytest.approx(overshoot[1], rel=1e-6)
    assert overshoot_at_rest(1e5, 30.0) < 0.1 * overshoot[1]


def overshoot_at_rest(stiffness: float, inertia: float) -> float:
    """strain/limit − 1 of a hanging beam that its own weight would stretch by half."""
    limits = {
        "projection": "isotropic",
        "stretch": 1.04,
        "compress": 0.96,
        "stiffness": stiffness,
        "inertia": inertia,
    }
    sim = Simulator(
        beam_scene(
            (1.0, 0.2, 0.2),
            (5, 1, 1),
            young=1e4,
            dt=0.01,
            limits=limits,
            driven="base",
            gravity=[9.81, 0, 0],
            damping=(0.0, 0.05),
            solver={"tolerance": 1e-6, "max_iterations": 20_000},
        )
    )
    return run(sim, 300).max_strain_ratio - 1.0


def test_a_free_axis_stretches_and_a_limited_one_does_not() -> None:
    """Limits on the axes across leave a hanging beam its length; limits on the length leave it its breadth."""

    def length_at_rest(stretch: list[float | None]) -> float:
        limits = {"projection": "hyperbolic", "stretch": stretch, "compress": [None, None, None], "stiffness": None}
        sim = Simulator(
            beam_scene(
                (1.0, 0.2, 0.2),
                (5, 1, 1),
                young=1e4,
                dt=0.01,
                limits=limits,
                driven="base",
                gravity=[9.81, 0, 0],
                damping=(0.0, 0.05),
            )
        )
        run(sim, 300)
        return float(np.ptp(sim.positions[:, 0]))

    assert length_at_rest([None, 1.04, 1.04]) > 1.3
    assert length_at_rest([1.04, None, None]) < 1.045


def test_a_scene_without_limits_or_plane_forms_no_rows() -> None:
    """No rows arrays, no rows, no sweeps: what is left out costs nothing; it moves as with limits never reached."""
    blocks: dict[str, Any] = {"driven": "base", "gravity": [0, 0, -9.81], "damping": (0.0, 0.01)}
    sim = Simulator(beam_scene(**blocks))
    wide = Simulator(beam_scene(limits={"stretch": 900.0, "compress": 0.0, "projection": "isotropic"}, **blocks))
    state = sim._state
    rows = ("J", "lam", "best", "constant", "compliance", "scale", "row_slot", "row_tet", "row_key", "row_side")
    own = ("diagonal", "cross", "has_column", "row_local", "touched", "u", "S", "Z")
    for record, names in ((state, rows), (state.pgs, own)):
        for name in names:
            assert getattr(record, name).size == 0, name
    assert state.lam.size == 0
    for _ in range(50):
        out, other = sim.step(), wide.step()
        assert (out.iterations, out.limit_rows, out.contacts, out.limited_tets) == (0, 0, 0, 0)
        assert (out.residual, out.max_strain_ratio, out.max_penetration) == (0.0, 0.0, 0.0)
        assert (other.iterations, other.limit_rows) == (0, 0)
    assert_allclose(sim.positions, wide.positions, rtol=0, atol=0)
    assert (sim.contact_forces == 0.0).all()
    assert (sim.strain_ratio == 0.0).all()
    assert (out.contact_wrench == 0.0).all()


def test_plane_alone_makes_only_contact_rows() -> None:
    """A scene with a plane and no limits has room for three rows a free surface node, and no limit rows."""
    sim = Simulator(beam_scene(plane={"point": [0, 0, 0]}, gravity=[0, 0, -9.81], damping=(0.0, 0.01)))
    assert sim._state.lam.size == 3 * len(np.unique(sim.mesh.surface))
    out = run(sim, 20)
    assert out.limit_rows == 0
    assert out.contacts > 0


def test_finger_is_softer_pad_down_than_on_its_side() -> None:
    """The paper's Figure 3: the same press is far stiffer on the side (2 % room) than flat (25 %)."""
    from scipy.spatial.transform import Rotation

    forces = {}
    for name, turn in {"flat": Rotation.from_euler("x", 90, degrees=True), "side": Rotation.identity()}.items():
        sim = Simulator(finger_scene(gravity=[0.0, 0.0, 0.0]))
        surface = turn.apply(np.array(sim.mesh.points))[:, 2].min()
        sim.reset(pose((0, 0, -surface + 1e-4), turn))
        for depth in np.linspace(0.0, 8e-4, 80):
            out = sim.step(pose((0, 0, -surface - depth), turn))
        out = run(sim, 20)
        assert healthy(out)
        forces[name] = out.contact_wrench[2]
    assert forces["side"] > 2.0 * forces["flat"] > 0.0


def test_scene_with_isotropic_limits_has_the_directions_alike() -> None:
    """Isotropic limits bound every direction alike: a tetrahedron stretched along any direction has one ratio."""
    scene: Scene = beam_scene(limits={"projection": "isotropic", "stretch": 1.04, "compress": 0.96})
    sim = Simulator(scene)
    for turn in rotations(3, seed=14):
        R = turn.as_matrix()
        x = sim.mesh.points @ (R @ np.diag([1.02, 1.0, 1.0]) @ R.T)
        sim.set_state(x, np.zeros_like(x))
        assert_allclose(sim.strain_ratio, 0.5, rtol=1e-9)

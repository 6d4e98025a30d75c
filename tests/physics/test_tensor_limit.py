"""The `tensor` limit: values by LAPACK, gradients by differences, and what it is for: no direction is favoured."""

from __future__ import annotations

import itertools
from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from physics_helpers import Array, assert_derivative, beam_scene, finger_scene, healthy, pack, random_F
from scipy.spatial.transform import Rotation

from finger_sim import Simulator
from finger_sim.physics.compile import kernel
from finger_sim.physics.jacobi import load_symmetric
from finger_sim.physics.lanes import store8
from finger_sim.physics.strain_limits import evaluate
from finger_sim.physics.tensor_limit import NEAR, upper_bound
from finger_sim.scene import Limits

PAPER = Limits("tensor", (1.05, 1.25, 1.02), (0.95, 0.75, 0.98))
FREE_AXIS = Limits("tensor", (None, 1.04, 1.1), (0.9, None, 0.96))
EQUAL = Limits("tensor", (1.04,) * 3, (0.93,) * 3)
ONE_SIDED = Limits("tensor", (1.03, 1.2, 1.1), (None,) * 3)
SINGLE = Limits("tensor", (None, 1.04, None), (None, 0.9, None))
ALL = {"paper": PAPER, "free axis": FREE_AXIS, "equal": EQUAL, "one-sided": ONE_SIDED, "single": SINGLE}
each = for_each("limits", ALL.values())
seeds = st.integers(0, 2**32 - 1)


def values(F: Array, limits: Limits) -> Array:
    """1 − λ of every eigenvalue by LAPACK, in rising order."""
    return np.sort([C for C, *_ in naive.tensor_rows(F, limits)])


def size_of(limits: Limits) -> float:
    """The largest strain/limit that a unit of strain can make."""
    return max(1.0 / abs(b - 1.0) for b in (*limits.stretch, *limits.compress) if b is not None)


@each
@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_values_are_those_of_lapack(limits: Limits, seed: int) -> None:
    """1 − eigenvalues of A⁺EA⁺ and −A⁻EA⁻ in rising order, three a side with a limit; inverted tetrahedra included."""
    F = np.random.default_rng(seed).standard_normal((3, 3)) * 0.3 + np.eye(3)
    s = naive.signed_svd(F)[1]
    C, gradients = evaluate(F, limits)
    assert len(C) == (3 if limits is ONE_SIDED else 6)
    assert gradients.shape == (len(C), 3, 3)
    tolerance = 1e-13 * size_of(limits) / min(1.0, max(s[1] + s[2], 1e-3))
    assert_allclose(C, values(F, limits), rtol=0, atol=tolerance)


@for_each("room", [1e-4, 1e-2, 1.0])
@for_each("strain", [1e-4, 1e-3, 1e-2, 0.1, 0.6])
@for_each("seed", range(2))
def test_gradients_against_differences_over_decades(seed: int, strain: float, room: float) -> None:
    """dC/dF by sixth-order differences of LAPACK's values, for strains and rooms from 1e-4 to 1."""
    rng = np.random.default_rng(seed)
    limits = Limits("tensor", tuple(1.0 + room * rng.uniform(0.5, 2, 3)), tuple(1.0 - room * rng.uniform(0.2, 0.9, 3)))
    while True:
        F = random_F(rng, 1.0 + strain * rng.uniform(-1, 1, 3))
        C = values(F, limits)
        if np.diff(C).min() > 0.03 * np.ptp(C):
            break
    got, gradients = evaluate(F, limits)
    assert_allclose(got, C, rtol=0, atol=1e-12 * size_of(limits))
    step = 2e-3 * strain
    assert_derivative(
        lambda G: values(G, limits), gradients, F, step=step, rtol=2e-8 + 1e-13 / step, atol=1e-13 * size_of(limits)
    )


@each
@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_gradients_are_those_of_perturbation_theory(limits: Limits, seed: int) -> None:
    """dλ = yᵀ dU y with U dU + dU U = d(FᵀF), inverted tetrahedra included, where the eigenvalues are apart."""
    rng = np.random.default_rng(seed)
    F = random_F(rng, rng.uniform([1.0, 0.6, -0.3], [1.6, 1.2, 0.6]))
    s = naive.signed_svd(F)[1]
    rows = sorted(naive.tensor_rows(F, limits), key=lambda row: row[0])
    C, gradients = evaluate(F, limits)
    for k, (value, expected, size, _) in enumerate(rows):
        others = np.abs(np.delete([row[0] for row in rows], k) - value)
        if others.min() < 1e-3 * size_of(limits) or size == 0.0:
            continue  # two eigenvectors turn into each other
        assert C[k] == pytest.approx(value, abs=1e-12 * size_of(limits))
        assert_allclose(gradients[k], expected, rtol=0, atol=1e-10 * size_of(limits) / max(s[1] + s[2], 0.1))


@settings(max_examples=100, deadline=None)
@given(seed=seeds)
def test_equal_limits_are_the_isotropic_limit(seed: int) -> None:
    """Equal rooms: strain/limit is that of the worst singular value, whatever its direction; the gradient u vᵀ."""
    rng = np.random.default_rng(seed)
    F = random_F(rng, rng.uniform(0.8, 1.2, 3))
    U, s, V = naive.signed_svd(F)
    C, gradients = evaluate(F, EQUAL)
    expected = np.sort(np.concatenate([1.0 - (s - 1.0) / 0.04, 1.0 - (1.0 - s) / 0.07]))
    assert_allclose(C, expected, rtol=0, atol=1e-12)
    i = np.argmax((s - 1.0) / 0.04)
    if np.abs(np.delete(s, i) - s[i]).min() > 1e-3:
        k = np.argmin(np.abs(C - (1.0 - (s[i] - 1.0) / 0.04)))
        if np.abs(np.delete(C, k) - C[k]).min() > 1e-3:
            assert_allclose(gradients[k], -np.outer(U[:, i], V[:, i]) / 0.04, rtol=0, atol=1e-9)


@for_each("axis", range(3))
@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_a_single_limited_axis_bounds_its_own_strain(axis: int, seed: int) -> None:
    """One limited axis: C = 1 − E_jj / a and 1 + E_jj / a exactly, E = RᵀF − I; the other eigenvalues are 0."""
    bounds = [[b if j == axis else None for j in range(3)] for b in (1.05, 0.8)]
    limits = Limits("tensor", tuple(bounds[0]), tuple(bounds[1]))  # type: ignore[arg-type]
    rng = np.random.default_rng(seed)
    F = random_F(rng, rng.uniform(0.5, 1.5, 3))
    strain = naive.polar_strain(F)[0][axis, axis]
    C, _ = evaluate(F, limits)
    expected = np.sort([1.0 - strain / 0.05, 1.0 + strain / 0.2, 1.0, 1.0, 1.0, 1.0])
    assert_allclose(C, expected, rtol=0, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(seed=seeds)
def test_shear_is_bounded(seed: int) -> None:
    """At the limit, E_jk² ≤ (a_j − E_jj)(a_k − E_kk) for every pair of axes; equal for strain in their plane."""
    rng = np.random.default_rng(seed)
    room = rng.uniform(0.01, 0.3, 3)
    limits = Limits("tensor", tuple(1.0 + room), (None,) * 3)
    E = np.zeros((3, 3))
    j, k = rng.choice(3, 2, replace=False)
    E[np.ix_([j, k], [j, k])] = rng.standard_normal((2, 2))
    for planar in (True, False):
        E = E if planar else rng.standard_normal((3, 3))
        E = 0.5 * (E + E.T)
        E /= np.abs(E).max()
        used = 1.0 - evaluate(np.eye(3) + 1e-3 * E, limits)[0][0]
        if used < 1e-5:
            continue  # compressed all round
        at_limit = E * 1e-3 / used  # λ is linear in the strain
        if np.linalg.eigvalsh(at_limit)[0] < -0.5:
            continue  # nearly or wholly inside out
        assert evaluate(np.eye(3) + at_limit, limits)[0][0] == pytest.approx(0.0, abs=1e-9)
        left = room - np.diag(at_limit)
        for a, b in itertools.combinations(range(3), 2):
            assert at_limit[a, b] ** 2 <= left[a] * left[b] + 1e-12
        if planar:
            assert at_limit[j, k] ** 2 == pytest.approx(left[j] * left[k], rel=1e-6, abs=1e-10)


def test_rooms_of_the_two_sides_by_hand() -> None:
    """Stretched by 5 % of 10 along e1, squeezed by 20 of 25 along e2, e3 as it was; free axes use up nothing."""
    limits = Limits("tensor", (1.1, None, 1.02), (0.9, 0.75, None))
    C, gradients = evaluate(np.diag([1.05, 0.8, 1.0]), limits)
    assert_allclose(C, [1.0 - 0.8, 1.0 - 0.5, 1.0, 1.0, 1.0, 1.5], rtol=0, atol=1e-13)
    assert_allclose(gradients[0], np.diag([0.0, 1.0, 0.0]) / 0.25, rtol=0, atol=1e-12)
    assert_allclose(gradients[1], np.diag([-1.0, 0.0, 0.0]) / 0.1, rtol=0, atol=1e-12)


def test_free_axes() -> None:
    """A side that is free has no rows; along a free axis, and in shear with it, anything goes."""
    assert evaluate(np.eye(3), ONE_SIDED)[0].shape == (3,)
    assert evaluate(np.eye(3), Limits("tensor"))[0].shape == (0,)
    assert evaluate(np.eye(3), Limits("tensor"))[1].shape == (0, 3, 3)
    limits = Limits("tensor", (None, 1.1, 1.1), (None,) * 3)
    stretched = np.diag([3.0, 1.0, 1.0])
    sheared = np.array([[1.2, 0.4, 0.0], [0.4, 1.05, 0.0], [0.0, 0.0, 1.0]])
    for F, expected in ((stretched, [1.0, 1.0, 1.0]), (sheared, [0.5, 1.0, 1.0])):
        assert_allclose(evaluate(F, limits)[0], expected, rtol=0, atol=1e-12)


def test_no_room_is_a_millionth() -> None:
    """A room of zero counts as 1e-6: at rest nothing is used up, and all is finite."""
    limits = Limits("tensor", (1.0, 1.2, None), (1.0, 1.0, 1.0))
    C, gradients = evaluate(np.eye(3), limits)
    assert_allclose(C, 1.0, rtol=0, atol=1e-9)
    assert np.isfinite(gradients).all()
    C, gradients = evaluate(np.diag([1.0 + 3e-6, 1.1, 1.0 - 2e-6]), limits)
    assert_allclose(C, [1.0 - 3.0, 1.0 - 2.0, 1.0 - 0.5, 1.0, 1.0 + 3.0, 1.0 + 1e5], rtol=1e-8, atol=1e-8)
    assert np.isfinite(gradients).all()


def allowed(limits: Limits, d: Array, sign: float) -> float:
    """Largest |strain| along the unit vector d that `evaluate` lets pass, nothing across, by bisection."""
    low, high = 0.0, 0.5
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = evaluate(np.eye(3) + sign * middle * np.outer(d, d), limits)[0].min() >= 0.0
        low, high = (middle, high) if inside else (low, middle)
    return low


@for_each("sign, room", [(1.0, 0.05), (-1.0, 0.08)])
def test_isotropy(sign: float, room: float) -> None:
    """Equal limits, a stretch along any direction: `tensor` lets pass the limit, `hyperbolic` √3 of it at (1, 1, 1)."""
    limits = {name: Limits(name, (1.05,) * 3, (0.92,) * 3) for name in ("tensor", "hyperbolic", "isotropic")}  # type: ignore[arg-type]
    directions = np.random.default_rng(3).standard_normal((20, 3))
    directions = np.concatenate([directions, np.eye(3), [[1, 1, 1], [1, -1, 1], [1, 1, 0]]])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    over = {name: np.array([allowed(l, d, sign) for d in directions]) / room for name, l in limits.items()}
    assert_allclose(over["tensor"], 1.0, rtol=0, atol=1e-9)
    assert_allclose(over["isotropic"], 1.0, rtol=0, atol=1e-9)
    assert_allclose(over["hyperbolic"], 1.0 / np.abs(directions).max(axis=1), rtol=0, atol=1e-9)
    assert over["hyperbolic"].max() == pytest.approx(np.sqrt(3.0), abs=1e-9)


@for_each("seed", range(5))
def test_gradients_do_not_care_where_singular_values_cross(seed: int) -> None:
    """s₁ − s₂ from 1e-2 to 1e-10: `tensor`'s gradient moves with it by so little; `hyperbolic`'s grows as 1/gap."""
    U, V = Rotation.random(2, random_state=seed).as_matrix()

    def gradients(limits: Limits, gap: float) -> Array:
        return evaluate(U @ np.diag([1.04 + gap, 1.04, 0.97]) @ V.T, limits)[1]

    hyperbolic = Limits("hyperbolic", PAPER.stretch, PAPER.compress)
    crossed = gradients(PAPER, 0.0)
    assert np.abs(crossed).max() < 2.0 * size_of(PAPER)
    gaps = [1e-2, 1e-4, 1e-6, 1e-8]
    for gap in gaps:
        assert np.abs(gradients(PAPER, gap) - crossed).max() < 50.0 * size_of(PAPER) * gap + 1e-9
    grows = [np.abs(gradients(hyperbolic, gap)).max() for gap in gaps[1:]]
    assert_allclose(np.array(grows[1:]) / grows[:-1], 100.0, rtol=0.2)


def test_the_clamp_bounds_gradients() -> None:
    """Where s_a = −s_b, and of nothing at all: finite."""
    for s in [(0.5, 0.3, -0.3), (1.0, 1.0, -1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 1.0, 0.0)]:
        for seed in range(5):
            C, gradients = evaluate(random_F(np.random.default_rng(seed), s), PAPER)
            assert np.isfinite(C).all()
            assert np.isfinite(gradients).all()


@kernel
def bound_of(B: Array) -> Any:
    """`upper_bound` of eight symmetric matrices (1, 6, 8)."""
    out = np.empty((1, 8))
    store8(out, 0, 0, upper_bound(load_symmetric(B, 0)))
    return out[0]


@settings(max_examples=200, deadline=None)
@given(seed=seeds, exponent=st.floats(-12, 12), rank=st.integers(1, 3))
def test_the_bound_misses_no_eigenvalue(seed: int, exponent: float, rank: int) -> None:
    """tr/3 + √(2/3) |dev| is never below the largest eigenvalue, and is it for one stretched apart from two equal."""
    rng = np.random.default_rng(seed)
    B = np.empty((1, 6, 8))
    largest, exact = np.empty(8), np.zeros(8, bool)
    for l in range(8):
        G = rng.standard_normal((3, rank))
        M = G @ np.diag(rng.choice([-1.0, 1.0], rank)) @ G.T + rng.choice([0.0, 1.0]) * rng.standard_normal() * np.eye(
            3
        )
        M *= 10.0**exponent
        w = np.linalg.eigvalsh(M)
        largest[l], exact[l] = w[2], rank == 1 and w[2] - w[1] > w[1] - w[0]
        B[0, :, l] = M[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    bound, size = bound_of(B), np.abs(B).max()
    assert (bound >= largest - 4e-15 * size).all()
    assert_allclose(bound[exact], largest[exact], rtol=0, atol=1e-13 * size)


# --- in a step ---


def ratios(sim: Simulator) -> Array:
    """strain/limit of every tetrahedron by LAPACK."""
    body = naive.Body.of(sim.scene, sim.mesh)
    F = body.deformation(sim.positions)
    return np.array([max(0.0, *(1.0 - C for C, *_ in naive.tensor_rows(f, sim.scene.limits))) for f in F])


@for_each("size", [1e-5, 1e-4, 3e-4])
def test_strain_ratio_on_the_finger(size: float) -> None:
    """`strain_ratio` and the result's largest are those of LAPACK, also where no tetrahedron is near its limit."""
    sim = Simulator(finger_scene(limits__projection="tensor"))
    rng = np.random.default_rng(1)
    x = sim.positions + size * rng.standard_normal(sim.positions.shape)
    sim.set_state(x, np.zeros_like(x))
    expected = ratios(sim)
    assert_allclose(sim.strain_ratio, expected, rtol=0, atol=1e-9 * max(1.0, expected.max()))
    out = sim.step()
    expected = ratios(sim)
    assert_allclose(sim.strain_ratio, expected, rtol=0, atol=1e-9 * max(1.0, expected.max()))
    assert out.max_strain_ratio == pytest.approx(expected.max(), rel=1e-9)


@for_each("seed", range(5))
@pytest.mark.slow
def test_no_tetrahedron_near_its_limit_is_passed_over(seed: int) -> None:
    """Every side of every tetrahedron with strain/limit above NEAR is among those looked at."""
    sim = Simulator(finger_scene(limits__projection="tensor"))
    x = sim.positions + 1e-4 * np.random.default_rng(seed).standard_normal(sim.positions.shape)
    sim.set_state(x, np.zeros_like(x))
    near, number = sim._state.tensor.near, sim._model.tet_number.tolist()
    seen = {2 * number[8 * b + l] + side for b, side, l in np.argwhere(near > 0.0).tolist()}
    limits, found = sim.scene.limits, 0
    for t, F in enumerate(naive.Body.of(sim.scene, sim.mesh).deformation(x)):
        for side, one in enumerate((Limits("tensor", limits.stretch), Limits("tensor", (None,) * 3, limits.compress))):  # type: ignore[union-attr]
            if values(F, one)[0] < 1.0 - NEAR:
                found += 1
                assert 2 * t + side in seen, (t, side)
    assert found > 20
    assert found < 2 * len(sim.mesh.tets)


@pytest.mark.parametrize("method", ["pgs", "newton"])
def test_near_equal_eigenvalues_have_a_row_each(method: str) -> None:
    """A row for every eigenvalue near its limit; where two coincide two more, halfway between their eigenvectors."""
    limits = {"projection": "tensor", "stretch": [1.04, 1.04, 1.04], "compress": [None, None, None]}
    scene = beam_scene((0.4, 0.2, 0.2), (2, 1, 1), limits=limits, solver={"method": method})
    for strain, rows in (
        ((0.038, 0, 0), 1),
        ((0.0352, 0.048, 0), 2),
        ((0.038, 0.0382, 0), 4),
        ((0.038, 0.038, 0.038), 9),
    ):
        sim = Simulator(scene)
        x = sim.mesh.points * (1.0 + np.array(strain))
        sim.set_state(x, np.zeros_like(x))
        sim._state.row_tet[:] = NO_ROW = np.iinfo(np.int64).max
        assert healthy(sim.step())
        pack(sim)
        tets = sim._state.row_tet[sim._state.row_tet < NO_ROW]
        assert (np.bincount(tets, minlength=len(sim.mesh.tets)) == rows).all()

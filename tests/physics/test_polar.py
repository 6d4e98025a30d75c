"""The rotation of a deformation gradient: against LAPACK's SVD, inverted, flat, turned half round and stale."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, random_F
from scipy.spatial.transform import Rotation

from finger_sim.physics import polar
from finger_sim.physics.compile import kernel
from finger_sim.physics.kinematics import kinematics
from finger_sim.physics.lanes import load8, store8
from finger_sim.physics.ready import ready
from finger_sim.physics.workspace import build_state
from finger_sim.simulation.build import build_model

ROUND_OFF = 1e-14
CORNER = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])


class Tetrahedra:
    """So many tetrahedra apart from each other, each of which can have any deformation gradient."""

    def __init__(self, count: int) -> None:
        points = np.concatenate([CORNER + [2.0 * t, 0.0, 0.0] for t in range(count)])
        self.count, self.tets = count, np.arange(4 * count).reshape(-1, 4)
        axes = np.broadcast_to(np.eye(3), (count, 3, 3))
        mesh: Any = SimpleNamespace(points=points, tets=self.tets, axes=axes, surface=self.tets[:, :3], node_sets={})
        self.model = build_model(beam_scene(), mesh)
        self.state = build_state(self.model, points)
        self.both = ready(self.model, self.state)

    def decompose(self, F: Any, start: Rotation | None = None) -> tuple[Array, Array]:
        """R and E (T, 3, 3) of F (T, 3, 3), from the rotations left by the last call or those of `start`."""
        state = self.state
        if start is not None:
            by_tet = np.tile(start.as_quat(), (len(state.quaternion) * 8, 1))[: len(state.quaternion) * 8]
            state.quaternion[:] = by_tet.reshape(-1, 8, 4).swapaxes(1, 2)
        state.x[:, :3] = 0.0
        state.x[self.tets[:, :3], :3] = np.swapaxes(F, 1, 2)
        kinematics(self.both.model, self.both.state)
        R = np.moveaxis(state.R, 1, 2).reshape(-1, 3, 3)[: self.count]
        e = np.moveaxis(state.E, 1, 2).reshape(-1, 6)[: self.count]
        return R.copy(), e[:, [0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(-1, 3, 3)


TETS = Tetrahedra(21)  # two batches of eight and a part of one


def check(F: Array, R: Array) -> None:
    """R is a rotation, no other has a larger tr(RᵀF), and where it is unique it is LAPACK's, to round-off.

    The turn about axis i moves R by round-off over (s_j + s_k): the condition.
    """
    for one, got in zip(F, R, strict=True):
        assert_allclose(got.T @ got, np.eye(3), rtol=0, atol=ROUND_OFF)
        assert np.linalg.det(got) == pytest.approx(1.0, abs=ROUND_OFF)
        s = naive.signed_svd(one)[1]
        size = np.abs(s).max()
        assert np.trace(got.T @ one) >= s.sum() - ROUND_OFF * size
        pair = s[1] + s[2]
        if pair > 1e-13 * size:
            assert_allclose(got, naive.rotation_of(one), rtol=0, atol=ROUND_OFF * size / pair)


def several(seed: int, s: Any) -> Array:
    rng = np.random.default_rng(seed)
    return np.array([random_F(rng, s) for _ in range(TETS.count)])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), exponent=st.floats(-9, 6))
def test_random_matrices_over_decades_of_scale(seed: int, exponent: float) -> None:
    """Any F, half of them inverted, of any size, from any start."""
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((TETS.count, 3, 3)) * 10.0**exponent
    check(F, TETS.decompose(F, Rotation.random(TETS.count, random_state=rng))[0])


@for_each(
    "s",
    [
        (1.0, 1.0, 1.0),
        (1.2, 1.2, 0.8),
        (1.0, 1.0, 0.0),
        (1.0, 0.5, 1e-9),
        (2.0, 1e-3, 1e-3),
        (1.0, 1e-6, -1e-7),
        (1.5, 0.7, -0.3),
        (1.0, 0.3, -0.299999),
        (1.0, 1.0, -0.9999),
        (1e6, 1.0, 1e-3),
        (1.0, 1.0, -1.0),
        (1.0, 0.0, 0.0),
        (1.0, 1e-20, 1e-30),
        (2.0, 1.0, -1.0),
        (0.0, 0.0, 0.0),
    ],
)
@for_each("seed", range(3))
def test_flat_inverted_and_collapsed_tetrahedra(s: tuple[float, ...], seed: int) -> None:
    """Repeated, vanishing and negative singular values; with s₂ = −s₃ any of the best rotations will do."""
    F = several(seed, s)
    check(F, TETS.decompose(F, Rotation.random(TETS.count, random_state=seed))[0])
    check(F, TETS.decompose(F)[0])  # again from what was found
    check(F, TETS.decompose(F, Rotation.identity())[0])


def test_exact_zeros() -> None:
    """Nothing, single entries, whole rows and columns, reflections and half turns: all exact."""
    F = np.zeros((TETS.count, 3, 3))
    for k in range(9):
        F[1 + k].flat[k] = 1.0
    F[10], F[11], F[12] = np.diag([1, 1, -1.0]), -np.eye(3), np.diag([1.0, -1.0, -1.0])
    F[13], F[14], F[15] = np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0]), np.ones((3, 3))
    F[16] = np.diag([1.0, 0.0, 0.0]) + np.diag([1.0, 0.0], 1)
    for start in (Rotation.identity(), Rotation.random(TETS.count, random_state=1)):
        check(F, TETS.decompose(F, start)[0])


@for_each("short", [0.0, 1e-16, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0])
@for_each("s", [(1.0, 1.0, 1.0), (1.3, 1.0, 0.8), (1.2, 0.9, -0.2)])
def test_a_stale_start_half_round(s: tuple[float, ...], short: float) -> None:
    """Turned by 180° less a little about any axis since the last call: a minimum of tr(RᵀF) is no maximum."""
    rng = np.random.default_rng(7)
    F = several(8, s)
    before, _ = TETS.decompose(F, Rotation.identity())
    axes = rng.standard_normal((TETS.count, 3))
    axes[:3] = np.eye(3)
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    turned = Rotation.from_rotvec((np.pi - short) * axes).as_matrix()
    after, _ = TETS.decompose(turned @ F)
    check(turned @ F, after)
    assert_allclose(after, turned @ before, rtol=0, atol=1e-13)


@for_each("s", [(1.0, 1.0, -1.0), (1.0, 0.7, -0.7), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_of_many_rotations_the_nearest(s: tuple[float, ...]) -> None:
    """A mirror image, a line, a point: all rotations about an axis are as good; each tetrahedron keeps that it had."""
    rng = np.random.default_rng(4)
    at = Rotation.random(random_state=5)
    before = at * Rotation.from_rotvec([0.3, 0.0, 0.0])
    F = at.as_matrix() @ np.diag(s) + 1e-16 * max(s) * rng.normal(size=(TETS.count, 3, 3))
    R, _ = TETS.decompose(F, before)
    check(F, R)
    for got in R:
        assert_allclose(got, before.as_matrix() if s[1] + s[2] == 0.0 else at.as_matrix(), rtol=0, atol=1e-9)


def test_the_strain_is_symmetric_and_that_of_lapack() -> None:
    """E = U − I in the order 00 11 22 12 02 01, and `inverted` says that a tetrahedron is inside out."""
    F = several(9, (1.3, 0.9, 0.7))
    F += 0.1 * np.random.default_rng(10).standard_normal(F.shape)
    R, E = TETS.decompose(F, Rotation.identity())
    assert TETS.state.inverted[0] == 0
    for one, strain in zip(F, E, strict=True):
        assert_allclose(strain, naive.polar_strain(one)[0], rtol=0, atol=ROUND_OFF)
    F[20] = F[20] @ np.diag([1.0, 1.0, -1.0])
    R, E = TETS.decompose(F)
    assert TETS.state.inverted[0] == 1
    assert_allclose(R[20] @ (E[20] + np.eye(3)), F[20], rtol=0, atol=ROUND_OFF)


def test_a_nan_is_forgotten() -> None:
    """A start that is not a number does not stay: the next F has its rotation."""
    F = several(11, (1.2, 1.0, 0.8))
    TETS.decompose(F, Rotation.identity())
    TETS.state.quaternion[:, :, ::2] = np.nan
    check(F, TETS.decompose(F)[0])


@kernel
def iterate(F: Array, quaternion: Array) -> tuple[int, int]:
    """One iteration of Newton on eight lanes: which of them are lost, and which far."""
    q = load8(quaternion, 0, 0), load8(quaternion, 0, 1), load8(quaternion, 0, 2), load8(quaternion, 0, 3)
    (x, y, z, w), lost, far = polar.newton(polar.load_matrix(F, 0), q, polar._EXACT)
    store8(quaternion, 0, 0, x)
    store8(quaternion, 0, 1, y)
    store8(quaternion, 0, 2, z)
    store8(quaternion, 0, 3, w)
    return lost, far


@for_each("s", [(1.0, 1.0, 1.0), (1.3, 1.0, 0.7), (1.1, 0.8, -0.2)])
def test_a_warm_start_converges_cubically(s: tuple[float, ...]) -> None:
    """An iteration from an error θ leaves θ³ / 2 of it or less: 0.1 rad, a step's worth at 100 rad/s, takes two."""
    rng = np.random.default_rng(12)
    for theta in (0.3, 0.1, 0.03, 1e-3, 1e-5):
        F = np.array([random_F(rng, s) for _ in range(8)])
        exact = Rotation.from_matrix(np.array([naive.rotation_of(one) for one in F]))
        axes = rng.standard_normal((8, 3))
        start = exact * Rotation.from_rotvec(theta * axes / np.linalg.norm(axes, axis=1)[:, None])
        quaternion = np.ascontiguousarray(start.as_quat().T[None])
        error = theta
        for _ in range(4):
            lost, far = iterate(np.ascontiguousarray(F.reshape(8, 9).T[None]), quaternion)
            assert lost == 0
            left = (exact.inv() * Rotation.from_quat(quaternion[0].T)).magnitude().max()
            assert left <= 0.5 * error**3 + 1e-14
            assert (far == 0) or error > 0.9e-6
            error = left
            if far == 0:
                break
        assert error < 1e-14

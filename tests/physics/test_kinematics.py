"""Deformation gradient, signed singular value decomposition, and the quaternions that move the bone."""

from __future__ import annotations

import math
from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from physics_helpers import Array, finger_scene, random_F
from scipy.spatial.transform import Rotation

from finger_sim.physics import rotations, svd


def decomposed(F: Array) -> tuple[Array, Array, Array]:
    return svd.signed_svd(np.asarray(F, dtype=np.float64))


def check_decomposition(F: Array) -> Array:
    """Everything Eq. 4 asks of a signed SVD; returns s."""
    U, s, V = decomposed(F)
    scale = max(np.abs(F).max(), 1e-300)
    assert_allclose((U * s) @ V.T / scale, F / scale, rtol=0, atol=2e-14)
    for Q in (U, V):
        assert_allclose(Q.T @ Q, np.eye(3), rtol=0, atol=1e-13)
        assert np.linalg.det(Q) == pytest.approx(1.0, abs=1e-13)
    assert_allclose(np.sort(np.abs(s)), np.sort(np.linalg.svd(F, compute_uv=False)), rtol=1e-13, atol=3e-15 * scale)
    negative = np.abs(s[s < 0.0])
    assert len(negative) <= 1
    assert (negative <= np.abs(s).min() + 1e-14 * scale).all(), "only the one of least magnitude may be negative"
    return s


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), exponent=st.floats(-9, 9))
def test_svd_of_random_matrices_over_decades_of_scale(seed: int, exponent: float) -> None:
    """Reconstruction, rotations, sign of det F on the least singular value; U and V scale-free."""
    F = np.random.default_rng(seed).standard_normal((3, 3)) * 10.0**exponent
    s = check_decomposition(F)
    assert np.sign(s.prod()) == np.sign(np.linalg.det(F / 10.0**exponent))


REFLECTIONS = [np.diag([1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, 1.0]), -np.eye(3), np.diag([2.0, -3.0, 0.5])]


@for_each("F", REFLECTIONS)
def test_svd_of_reflections(F: Array) -> None:
    """det F < 0: exactly one singular value is negative, the least one."""
    assert (check_decomposition(F) < 0).sum() == 1
    assert (check_decomposition(Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix() @ F) < 0).sum() == 1


@for_each("seed", range(5))
@for_each(
    "s",
    [
        (0, 0, 0),
        (1, 0, 0),
        (2, 1, 0),
        (1, 1, 1),
        (2, 2, 1),
        (2, 1, 1),
        (1, 1, 0),
        (1, 1, -1),
        (3, 1e-9, 1e-9),
        (1, 1e-3, -1e-3),
        (1, 1 - 1e-12, 1 - 2e-12),
        (1e8, 1.0, 1e-8),
        (1, 1e-8, -1e-12),
    ],
)
def test_svd_of_degenerate_matrices(s: tuple[float, ...], seed: int) -> None:
    """Rank 0, 1, 2, repeated and widely spread singular values still give rotations and a reconstruction."""
    got = check_decomposition(random_F(np.random.default_rng(seed), s))
    assert_allclose(np.sort(np.abs(got)), np.sort(np.abs(s)), rtol=1e-12, atol=1e-15 * max(np.abs(s)))


@for_each("axis", range(3))
def test_svd_of_matrices_with_zero_columns(axis: int) -> None:
    """Exact zeros, where a column of F has collapsed to nothing."""
    one = np.zeros((3, 3))
    one[(axis + 1) % 3, axis] = 2.0
    check_decomposition(one)
    check_decomposition(one.T)
    check_decomposition(np.ones((3, 3)) - np.outer(np.ones(3), np.eye(3)[axis]))


def test_columns_stay_with_the_axes_they_are_nearest_to() -> None:
    """A stretch along the axes gives V = I in that order whatever the order of the sizes: keys do not jump."""
    for s in [(0.9, 1.0, 1.1), (1.1, 0.9, 1.0), (1.0, 1.1, 0.9)]:
        _, got, V = decomposed(Rotation.from_rotvec([0.4, 0.1, -0.2]).as_matrix() @ np.diag(s))
        assert_allclose(V, np.eye(3), rtol=0, atol=1e-14)
        assert_allclose(got, s, rtol=1e-14)


def test_deformation_gradient_of_every_tetrahedron() -> None:
    """F = ∂x/∂X in material axes: against barycentric coordinates, on the finger's mesh, at random positions."""
    scene = finger_scene()
    mesh = scene.load_mesh()
    turned = np.array([Rotation.random(random_state=k).as_matrix() for k in range(len(mesh.tets))])
    mesh = type(mesh).from_arrays(mesh.points, mesh.tets, mesh.node_sets, turned)
    from finger_sim.simulation.build import build_model

    model = build_model(scene, mesh)
    x = mesh.points + 1e-3 * np.random.default_rng(1).standard_normal(mesh.points.shape)
    F = np.empty((len(mesh.tets), 3, 3))
    svd.deformation_gradient(model.tets, model.gradients, x, F)
    number = model.tet_number
    assert_allclose(F, naive.Body.of(scene, mesh).deformation(x)[number], rtol=0, atol=1e-11)
    svd.deformation_gradient(model.tets, model.gradients, np.array(mesh.points), F)
    assert_allclose(F, np.swapaxes(turned, 1, 2)[number], rtol=0, atol=1e-12)  # at rest: its columns are the axes


def as_rotation(q: Any) -> Rotation:
    return Rotation.from_quat(q)


@for_each("seed", range(20))
def test_quaternions_against_scipy(seed: int) -> None:
    """matrix, angle and slerp agree with scipy's rotations, whichever of q and −q stands for the orientation."""
    a, b = Rotation.random(2, random_state=seed)
    qa, qb = tuple(a.as_quat()), tuple(b.as_quat())
    minus = tuple(-c for c in qb)
    assert_allclose(rotations.matrix(qa), a.as_matrix(), rtol=0, atol=1e-14)
    assert_allclose(rotations.matrix(minus), b.as_matrix(), rtol=0, atol=1e-14)
    relative = a.inv() * b
    for end in (qb, minus):
        assert rotations.angle(qa, end) == pytest.approx(relative.magnitude(), abs=1e-12)
        for fraction in (0.0, 0.3, 1.0):
            expected = a * Rotation.from_rotvec(fraction * relative.as_rotvec())
            assert (expected.inv() * as_rotation(rotations.slerp(qa, end, fraction))).magnitude() < 1e-7
            got = rotations.slerp(qa, end, fraction)
            assert math.hypot(*got) == pytest.approx(1.0, abs=1e-14)


@for_each("turn", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, math.pi - 1e-9, math.pi])
def test_small_and_half_turns(turn: float) -> None:
    """angle resolves turns far below the square root of roundoff (an acos would not); slerp stays unit there."""
    q = (0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn))
    assert rotations.angle((0.0, 0.0, 0.0, 1.0), q) == pytest.approx(turn, rel=1e-7, abs=1e-15)
    half = rotations.slerp((0.0, 0.0, 0.0, 1.0), q, 0.5)
    assert rotations.angle((0.0, 0.0, 0.0, 1.0), half) == pytest.approx(0.5 * turn, rel=1e-6, abs=1e-15)
    assert math.hypot(*half) == pytest.approx(1.0, abs=1e-14)

"""Properties of kernels and of whole steps that hold for any input: finite everywhere, and the same in any frame,
order and units."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from physics_helpers import Array, loaded, random_F
from scipy.spatial.transform import Rotation

from finger_sim import Pose, Scene, Simulator
from finger_sim.haptics.coupling import between, device_wrench, follow
from finger_sim.physics import linear_solver
from finger_sim.physics.contact import plane_frame
from finger_sim.physics.rotations import angle, matrix, normalised
from finger_sim.physics.strain_limits import evaluate
from finger_sim.physics.svd import signed_svd
from finger_sim.scene import Coupling, Limits
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.meshing import beam

PROJECTIONS = ("hyperbolic", "isotropic", "tensor", "orthogonal", "linear")

seeds = st.integers(0, 2**32 - 1)
sizes = st.one_of(
    st.sampled_from([0.0, 1e-9, 0.5, 1.0, 1.0 + 1e-9, 2.0, 1e6]), st.floats(-30.0, 6.0).map(lambda e: 10.0**e)
)
entries = st.builds(lambda size, sign: sign * size, sizes, st.sampled_from([1.0, -1.0]))
matrices = st.lists(entries, min_size=9, max_size=9).map(lambda values: np.array(values).reshape(3, 3))
special = st.builds(
    lambda seed, s, sign: random_F(np.random.default_rng(seed), np.array(s) * [1.0, 1.0, sign]),
    seeds,
    st.one_of(st.tuples(sizes, sizes, sizes), sizes.map(lambda s: (s, s, s))),
    st.sampled_from([1.0, -1.0]),
)
rooms = st.one_of(st.none(), st.sampled_from([0.0, 1e-9, 1.0]), st.floats(0.0, 1.0))


@st.composite
def any_limits(draw: Any, projection: str) -> Limits:
    """Limits of the projection, free on some axes, without room on others."""
    if projection == "isotropic":
        stretch, compress = [draw(rooms)] * 3, [draw(rooms)] * 3
    else:
        stretch, compress = [draw(rooms) for _ in range(3)], [draw(rooms) for _ in range(3)]
    return Limits(
        projection,  # type: ignore[arg-type]
        tuple(None if a is None else 1.0 + a for a in stretch),  # type: ignore[arg-type]
        tuple(None if a is None else 1.0 - a for a in compress),  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("projection", PROJECTIONS)
@settings(max_examples=120, deadline=None)
@given(data=st.data(), F=st.one_of(matrices, special))
def test_limit_rows_are_finite(projection: str, data: Any, F: Array) -> None:
    """C and dC/dF of any F up to 1e6, collapsed, inverted or with equal singular values, under any limits."""
    C, dC_dF = evaluate(F, data.draw(any_limits(projection)))
    assert np.isfinite(C).all()
    assert np.isfinite(dC_dF).all()
    assert dC_dF.shape == (len(C), 3, 3)


def apart(seed: int) -> Array:
    """F with singular values that are well apart from each other, from 1, and from the kinks of V."""
    rng = np.random.default_rng(seed)
    while True:
        F = random_F(rng, [1.6, 1.25, rng.choice([0.7, -0.7])])
        if np.abs(np.linalg.svd(F)[2]).min() > 0.05:
            return F


@for_each("projection", PROJECTIONS)
@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_limit_rows_turn_with_the_body(projection: str, seed: int) -> None:
    """C(Q F) = C(F), and its gradient is Q times that at F, for any rotation Q."""
    limits = ANISOTROPIC if projection != "isotropic" else ((1.1,) * 3, (0.9,) * 3)
    limit, F = Limits(projection, *limits), apart(seed)  # type: ignore[arg-type]
    Q = Rotation.random(random_state=seed).as_matrix()
    C, gradients = evaluate(F, limit)
    C_turned, gradients_turned = evaluate(Q @ F, limit)
    assert_allclose(C_turned, C, rtol=1e-9, atol=1e-11)
    assert_allclose(gradients_turned, Q @ gradients, rtol=0, atol=1e-9 * np.abs(gradients).max())


ANISOTROPIC = ((1.05, 1.2, 1.1), (0.9, 0.8, 0.95))


@for_each("projection", PROJECTIONS)
@settings(max_examples=30, deadline=None)
@given(seed=seeds, order=st.sampled_from([[1, 2, 0], [2, 0, 1]]))
def test_no_axis_is_special(projection: str, seed: int, order: list[int]) -> None:
    """The same rows when material axes and their limits are numbered from another one."""
    limits = ANISOTROPIC if projection != "isotropic" else ((1.1,) * 3, (0.9,) * 3)
    F = apart(seed)
    other = Limits(projection, *(tuple(side[j] for j in order) for side in limits))  # type: ignore[arg-type]
    C, _ = evaluate(F, Limits(projection, *limits))  # type: ignore[arg-type]
    C_other, _ = evaluate(F[:, order], other)
    assert_allclose(np.sort(C_other), np.sort(C), rtol=1e-9, atol=1e-11)


@settings(max_examples=200, deadline=None)
@given(F=st.one_of(matrices, special), exponent=st.integers(-50, 50))
def test_svd_is_finite_and_right_over_100_decades(F: Array, exponent: int) -> None:
    """Rotations and a reconstruction, for matrices of any rank and any size."""
    F = F * 10.0**exponent
    U, s, V = signed_svd(F)
    size = np.abs(F).max()
    assert np.isfinite(U).all()
    assert np.isfinite(V).all()
    assert_allclose(V.T @ V, np.eye(3), rtol=0, atol=1e-13)
    assert_allclose(U.T @ U, np.eye(3), rtol=0, atol=1e-13)
    assert np.linalg.det(U) > 0.0
    assert np.linalg.det(V) > 0.0
    assert_allclose((U * s) @ V.T, F, rtol=0, atol=1e-13 * size + 1e-290)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, stiff=st.floats(0.0, 7.0))
def test_solves_lose_no_more_digits_than_stiffness_has(seed: int, stiff: float) -> None:
    """A x − y is round-off of |A| |x| times how much stiffer than others some directions of a node are."""
    rng = np.random.default_rng(seed)
    nodes = 12
    edges = [(a, b) for a in range(nodes) for b in range(a) if rng.random() < 0.3]
    A = np.zeros((nodes, 3, nodes, 3))
    for a, b in edges:
        d = rng.standard_normal(3)
        spring = 10.0**stiff * np.outer(d, d)
        A[a, :, a] += spring
        A[b, :, b] += spring
        A[a, :, b] -= spring
        A[b, :, a] -= spring
    A = A.reshape(3 * nodes, 3 * nodes) + np.eye(3 * nodes)
    pattern, blocks, lower, inverse = loaded(np.array(edges, np.int64).reshape(-1, 2)[:, ::-1], A)
    assert linear_solver.factor(pattern, blocks, inverse)
    y = np.zeros((nodes, 4))
    y[:, :3] = rng.standard_normal((nodes, 3))
    given_y = y[pattern.slot, :3].ravel().copy()
    linear_solver.solve(pattern, lower, inverse, y)
    x = y[pattern.slot, :3].ravel()
    bound = (1e-14 + 1e-15 * 10.0**stiff) * (np.abs(A) @ np.abs(x) + np.abs(given_y)).max()
    assert_allclose(A @ x, given_y, rtol=0, atol=bound)


@settings(max_examples=200, deadline=None)
@given(normal=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda n: math.hypot(*n) > 1e-6))
def test_plane_frames_are_right_handed(normal: tuple[float, float, float]) -> None:
    """n, t₁, t₂ are orthonormal and right-handed for any normal."""
    frame = np.empty((3, 3))
    plane_frame(np.array(normal) / math.hypot(*normal), frame)
    assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0)


positions = st.tuples(*[st.floats(-1e4, 1e4)] * 3)
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 1e-3).map(normalised)
poses = st.builds(Pose, positions, quaternions)


@settings(max_examples=300, deadline=None)
@given(start=poses, command=poses, dt=st.floats(1e-6, 0.1), speed=st.floats(1e-6, 1e4), rate=st.floats(1e-6, 1e5))
def test_a_command_is_followed_no_faster_than_allowed(
    start: Pose, command: Pose, dt: float, speed: float, rate: float
) -> None:
    """Within both speeds, on the way there, and said when it is not there yet."""
    coupling = Coupling(max_speed=speed, max_angular_speed=rate)
    pose, limited = follow(coupling, start, command, dt)
    round_off = 1e-11 * (1.0 + math.hypot(*start.position) + math.hypot(*command.position))
    went, turned = math.dist(start.position, pose.position), angle(start.orientation, pose.orientation)
    assert went <= speed * dt * (1.0 + 1e-9) + round_off
    assert turned <= rate * dt * (1.0 + 1e-9) + 1e-7
    assert math.hypot(*pose.orientation) == pytest.approx(1.0, abs=1e-12)
    assert limited == (pose != command)
    left = math.dist(pose.position, command.position)
    assert left <= math.dist(start.position, command.position) + round_off


@settings(max_examples=100, deadline=None)
@given(a=poses, b=poses, fraction=st.floats(0.0, 1.0))
def test_between_is_on_the_way(a: Pose, b: Pose, fraction: float) -> None:
    """Position on the line, orientation on the shorter arc: its angles to both ends add up."""
    middle = between(a, b, fraction)
    scale = 1.0 + math.hypot(*a.position) + math.hypot(*b.position)
    assert math.dist(a.position, middle.position) + math.dist(middle.position, b.position) == pytest.approx(
        math.dist(a.position, b.position), abs=1e-9 * scale
    )
    total = angle(a.orientation, middle.orientation) + angle(middle.orientation, b.orientation)
    assert total == pytest.approx(angle(a.orientation, b.orientation), abs=1e-6)
    assert_allclose(matrix(middle.orientation) @ matrix(middle.orientation).T, np.eye(3), rtol=0, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(wrench=st.lists(entries, min_size=6, max_size=6), force=sizes, torque=sizes)
def test_device_wrenches_are_clamped_along_themselves(wrench: list[float], force: float, torque: float) -> None:
    """Never beyond the limits, unchanged within them, and never turned."""
    given_wrench = np.array(wrench)
    out = device_wrench(Coupling(force_limit=force, torque_limit=torque), given_wrench)
    for part, limit in ((slice(0, 3), force), (slice(3, 6), torque)):
        size, before = math.hypot(*out[part]), math.hypot(*given_wrench[part])
        assert size <= limit * (1.0 + 1e-12)
        if before <= limit:
            np.testing.assert_array_equal(out[part], given_wrench[part])
        assert_allclose(np.cross(out[part], given_wrench[part]), 0.0, atol=1e-12 * size * before + 1e-100)


SIZE, GAP, DEPTH = np.array([0.4, 0.2, 0.2]), 0.005, 0.02
STEPS = 40


def pressed(
    *,
    method: str,
    projection: str,
    turn: Rotation | None = None,
    length: float = 1.0,
    mass: float = 1.0,
    time: float = 1.0,
    mesh: Path | None = None,
) -> tuple[Array, Array]:
    """Positions (n, 3) and contact wrench (6,) of a block pressed on a table and slid.

    The whole world is turned, and measured in units of so many metres, kilograms and seconds.
    """
    Q = (turn or Rotation.identity()).as_matrix()
    force = mass * length / time**2
    rooms = {"stretch": [1.02] * 3, "compress": [0.98] * 3}
    if projection != "isotropic":
        rooms = {"stretch": [1.02, 1.05, 1.03], "compress": [0.97, 0.95, 0.98]}
    block = {"file": str(mesh)} if mesh else {"beam": {"size": (length * SIZE).tolist(), "cells": [2, 1, 1]}}
    data = {
        "mesh": block,
        "driven": {"box": [[-100.0, -100.0, 0.19 * length], [100.0, 100.0, 100.0]]},
        "material": {
            "density": 1000.0 * mass / length**3,
            "young": 1e5 * force / length**2,
            "poisson": 0.3,
            "damping": {"mass": 0.0, "stiffness": 0.002 * time},
        },
        "limits": {"projection": projection, "stiffness": 30.0} | rooms,
        "plane": {"point": (Q @ [0.0, 0.0, -GAP * length]).tolist(), "normal": Q[:, 2].tolist(), "friction": 0.5},
        "gravity": (length / time**2 * Q @ [0.0, 0.0, -9.81]).tolist(),
        "solver": {"method": method, "tolerance": 1e-11, "max_iterations": 20_000, "sleep": False},
        "coupling": {"max_speed": 1e4, "max_angular_speed": 1e5},
        "dt": 0.002 * time,
    }
    sim = Simulator(Scene.from_dict(data))
    q = tuple((turn or Rotation.identity()).as_quat().tolist())
    sim.reset(Pose(orientation=q))  # type: ignore[arg-type]
    for k in range(1, STEPS + 1):
        down, along = min(k / 20, 1.0) * (GAP + DEPTH), max(k - 20, 0) / 20 * DEPTH
        at = length * Q @ [along, 0.0, -down]
        out = sim.step(Pose(tuple(at.tolist()), q))  # type: ignore[arg-type]
    assert out.limit_rows > 0
    assert out.contacts > 0
    x = sim.positions @ Q / length
    wrench = np.concatenate([out.contact_wrench[:3] @ Q / force, out.contact_wrench[3:] @ Q / (force * length)])
    return x, wrench


KINDS = [("newton", "tensor"), ("newton", "isotropic"), ("pgs", "hyperbolic")]


def alike(got: tuple[Array, Array], expected: tuple[Array, Array], tolerance: float) -> None:
    assert_allclose(got[0], expected[0], rtol=0, atol=tolerance * 0.2)
    assert_allclose(got[1], expected[1], rtol=0, atol=tolerance * np.abs(expected[1]).max())


@for_each("method, projection", KINDS)
def test_the_world_has_no_direction(method: str, projection: str) -> None:
    """A press and slide in a world turned as a whole: the same positions and wrench, turned."""
    expected = pressed(method=method, projection=projection)
    for turn in Rotation.random(3, random_state=1):
        alike(pressed(method=method, projection=projection, turn=turn), expected, 1e-5)


@for_each("method, projection", KINDS)
@for_each("length, mass, time", [(0.25, 1.0, 1.0), (1.0, 0.5, 1.0), (1.0, 1.0, 0.5), (8.0, 64.0, 4.0)])
def test_units_do_not_matter(method: str, projection: str, length: float, mass: float, time: float) -> None:
    """The same press measured in other units of length, mass and time: no constant of the method has a dimension."""
    expected = pressed(method=method, projection=projection)
    alike(pressed(method=method, projection=projection, length=length, mass=mass, time=time), expected, 1e-6)


@for_each("method, projection", KINDS)
@for_each("seed", [0, 1])
def test_numbering_does_not_matter(method: str, projection: str, seed: int, tmp_path: Path) -> None:
    """Nodes and tetrahedra in another order, and a tetrahedron's nodes turned: the same press."""
    mesh = beam(tuple(SIZE), (2, 1, 1))
    rng = np.random.default_rng(seed)
    nodes = rng.permutation(len(mesh.points))
    number = np.argsort(nodes)
    turned = np.array([np.roll(tet[:3], rng.integers(3)).tolist() + [tet[3]] for tet in number[mesh.tets]])
    other = TetMesh.from_arrays(mesh.points[nodes], turned[rng.permutation(len(turned))])
    other.save(tmp_path / "other.vtu")
    expected = pressed(method=method, projection=projection)
    x, wrench = pressed(method=method, projection=projection, mesh=tmp_path / "other.vtu")
    alike((x[number], wrench), expected, 1e-5)

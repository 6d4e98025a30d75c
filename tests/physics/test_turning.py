"""How limits resist the turning of their eigenvectors (turning.py): as the second derivative of their energy says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cases import for_each
from physics_helpers import Array, assembled, beam_scene
from scipy.spatial.transform import Rotation

from finger_sim import Scene, Simulator
from finger_sim.physics.compile import kernel
from finger_sim.physics.elasticity import ALL_OF_A, ELASTIC, TURNING, assemble

ROOM, STIFFNESS, YOUNG, STEP = 0.1, 50.0, 1e4, 1e-2
FREE = {"limits.stretch": [None] * 3, "limits.compress": [None] * 3}


def limited(**values: object) -> Scene:
    """A free block of patches with the same room in every direction."""
    limits = {"projection": "tensor", "stretch": [1.0 + ROOM] * 3, "compress": [1.0 - ROOM] * 3}
    scene = beam_scene((0.2, 0.1, 0.1), (2, 1, 1), young=YOUNG, poisson=0.45, limits=limits)
    fixed = {"limits.stiffness": STIFFNESS, "limits.inertia": 0.0, "limits.viscosity": 0.0}
    return scene.with_values({"material.volumetric": "patch"} | fixed | values)


def energy(F: Array, volume: float) -> float:
    """Of passed limits in a body that is strained alike everywhere; F is symmetric and positive definite.

    They count as passed from 0.95 on.
    """
    passed = np.abs(np.linalg.eigvalsh(F - np.eye(3))) / ROOM - 0.95
    return float(0.5 * STIFFNESS * YOUNG * volume * ROOM**2 * (np.maximum(passed, 0.0) ** 2).sum())


@for_each("strains", [(1.6, 1.2, -0.4), (-1.6, -1.2, 0.4), (2.5, 1.3, 0.8), (1.5, 0.3, -0.7), (1.4, -2.0, 0.0)])
@for_each("volumetric", ["patch", "element"])
def test_shear_between_two_eigenvectors(volumetric: str, strains: tuple[float, float, float]) -> None:
    """Its resistance is the second derivative of their energy, which rows have nothing of, also of two far apart."""
    Q = Rotation.from_rotvec([0.3, -0.7, 0.5]).as_matrix()
    F = np.eye(3) + ROOM * Q @ np.diag(strains) @ Q.T
    shear = Q @ np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) @ Q.T
    scene = limited().with_values({"material.volumetric": volumetric})
    mesh = scene.load_mesh()
    points, volume, small = np.array(mesh.points), float(mesh.volumes.sum()), 1e-4
    turn = Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix()
    x, moves = points @ (turn @ F).T, (points @ (turn @ shear).T).ravel()
    found = assembled(scene, x, STEP)[0] - assembled(scene.with_values(FREE), x, STEP)[0]
    changes = [energy(F + e * small * shear, volume) for e in (-1.0, 0.0, 1.0)]
    assert moves @ found @ moves / STEP**2 == pytest.approx(np.diff(changes, 2)[0] / small**2, rel=1e-4)
    assert np.abs(found - found.T).max() < 1e-9 * np.abs(found).max()
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.abs(found).max()


@kernel
def assembled_by(model: Any, state: Any, parts: int) -> None:
    """A with so much of it formed anew (elasticity.ELASTIC, TURNING)."""
    state.stale[0] = parts
    assemble(model, state, STEP, False)


def test_parts_of_A_by_themselves_make_the_whole() -> None:
    """A step forms what is elastic, the next one what turns, with what it turns by now: A is that of both at once."""
    scene = limited().with_values({"solver.level": "lagged", "solver.method": "newton"})
    first = np.array(scene.load_mesh().points) @ (np.eye(3) + ROOM * np.diag([1.6, 1.2, -1.4]))
    x = first @ Rotation.from_rotvec([0.3, -0.7, 0.5]).as_matrix().T
    sim = Simulator(scene)
    model, state = sim._ready.model, sim._ready.state
    sim.set_state(first, np.zeros_like(first))
    assembled_by(model, state, ALL_OF_A)
    before = sim._state.A.copy()
    sim.set_state(x, np.zeros_like(x))
    assembled_by(model, state, ELASTIC)
    between = sim._state.A.copy()
    assembled_by(model, state, TURNING)
    parts = sim._state.A.copy()
    assembled_by(model, state, 0)
    assert (parts == sim._state.A).all()
    assembled_by(model, state, ALL_OF_A)
    whole = sim._state.A.copy()
    size = np.abs(whole).max()
    assert np.abs(parts - whole).max() < 1e-12 * size
    for one, other in ((before, between), (between, parts)):
        assert np.abs(one - other).max() > 0.05 * size


def test_limits_that_are_not_passed_resist_nothing() -> None:
    """A is, to the last bit, that of a body without limits."""
    scene = limited()
    x = np.array(scene.load_mesh().points) @ (np.eye(3) + ROOM * np.diag([0.9, 0.8, -0.5]))
    assert (assembled(scene, x, STEP)[0] == assembled(scene.with_values(FREE), x, STEP)[0]).all()


def test_a_driven_face_that_moves_along_is_not_held_back() -> None:
    """A strained block on a driven face moves with it at one velocity: nothing turns, so nothing resists."""
    scene = limited(dt=STEP).with_values({"driven": "base", "solver.method": "newton"})
    sim = Simulator(scene)
    points = np.array(sim.mesh.points)
    F = np.eye(3) + ROOM * np.diag([1.6, 1.2, -0.4])
    forces = []
    for velocity in (0.0, 0.3):
        sim.reset()
        sim.set_state(points @ F, np.broadcast_to([0.0, velocity, 0.0], points.shape))
        model, state = sim._model, sim._state
        pose = sim.pose
        sim.step(type(pose)((0.0, velocity * STEP, 0.0), pose.orientation))
        forces.append(np.array(state.v[model.free, :3]) - [0.0, velocity, 0.0])
    np.testing.assert_allclose(forces[1], forces[0], rtol=0, atol=1e-6 * np.abs(forces[0]).max())

"""The independent press: force, energy and matrix belong together, and the stored answers are what it gives."""

from __future__ import annotations

import numpy as np
import pytest
from truth.press import ANSWERS, BY_MESH, DEPTHS, YOUNG, HalfFinger, skin_bottom

from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.resources import shipped


def half(mesh: str, poisson: float = 0.45) -> HalfFinger:
    """A shipped mesh's half."""
    return HalfFinger(TetMesh.load(shipped("config") / "meshes" / f"{mesh}.vtu"), YOUNG, poisson)


def test_force_and_matrix_are_the_energy_s_derivatives() -> None:
    """By central differences, bent and pressed: a step of a micrometre, forces to 1e-4 and the matrix to 1e-3."""
    body, random = half("finger_500"), np.random.default_rng(5)
    table = skin_bottom() + 0.5e-3
    bend = 1e-4 * np.sin(np.arange(body.count) * 0.37)
    way, small = random.standard_normal(body.count), 1e-7
    ends = [bend + small * way, bend - small * way]
    force, matrix, _ = body.linearised(bend, table)
    above, below = (body.energy(u, table) for u in ends)
    assert (above - below) / (2.0 * small) == pytest.approx(force @ way, rel=1e-4)
    above, below = (body.linearised(u, table)[0] for u in ends)
    slope = (above - below) / (2.0 * small)
    assert np.linalg.norm(slope - matrix @ way) < 1e-3 * np.linalg.norm(slope)


@pytest.mark.slow
def test_the_stored_press_is_what_it_gives() -> None:
    """On the default mesh, the first of the depths, to the last digit that is stored."""
    assert half("finger").press(DEPTHS[:1])[0] == pytest.approx(BY_MESH["finger", 0.45][0], abs=1e-5)


@pytest.mark.parametrize("poisson", sorted(ANSWERS))
def test_answers_lie_beyond_the_finest_mesh(poisson: float) -> None:
    """Each mesh is nearer than the one before, and the finest is as near as the answer's error says."""
    for k, answer in enumerate(ANSWERS[poisson]):
        presses = [forces[k] for (_, nu), forces in BY_MESH.items() if nu == poisson]
        gaps = [abs(force - answer.force) for force in presses]
        assert gaps == sorted(gaps, reverse=True)
        assert gaps[-1] <= answer.error

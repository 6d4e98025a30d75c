"""Over-constraint: limits against volume by brute force, rows against freedoms by hand, and what a step says of it."""

from __future__ import annotations

import itertools
import math
from typing import Any

import naive
import numpy as np
import pytest
from numpy.testing import assert_allclose
from physics_helpers import beam_scene

from finger_sim import Simulator, Status
from finger_sim.pictures.info import info
from finger_sim.scene import Limits, Material
from finger_sim.scene.locking import bulk_to_shear, count, isochoric_strain, volume_at_limit

PAPER = Limits("hyperbolic", (1.05, 1.25, 1.02), (0.95, 0.75, 0.98))
FREE = Limits("tensor", (None, 1.04, 1.04), (None, 0.96, 0.96))
EQUAL = Limits("isotropic", (1.04,) * 3, (0.96,) * 3)
ONE = Limits("tensor", (None, 1.05, None), (None, 0.95, None))


def searched(limits: Limits, axis: int, side: int) -> float:
    """Largest |s − 1| along an axis among stretches of product 1 within the other two limits, on a fine grid."""
    others = [j for j in range(3) if j != axis]
    grids = [
        np.linspace(
            0.02 if limits.compress[j] is None else limits.compress[j],
            50.0 if limits.stretch[j] is None else limits.stretch[j],
            401,
        )
        for j in others
    ]
    s = 1.0 / (grids[0][:, None] * grids[1])
    return float(s.max() - 1.0 if side == 0 else 1.0 - s.min())


@pytest.mark.parametrize("limits", [PAPER, FREE, EQUAL, ONE], ids=["paper", "free", "equal", "one"])
def test_isochoric_strain_is_what_a_search_finds(limits: Limits) -> None:
    """Where it is finite it is the search's end; where not, the search goes past the axis's own limit."""
    strain = isochoric_strain(limits)
    for side, axis in itertools.product(range(2), range(3)):
        own = (limits.stretch, limits.compress)[side][axis]
        found = searched(limits, axis, side)
        if math.isfinite(strain[side, axis]):
            assert strain[side, axis] == pytest.approx(found, rel=1e-9)
            assert own is None or strain[side, axis] < abs(own - 1.0)
        else:
            assert found >= (0.9 if own is None else abs(own - 1.0) - 1e-12)


def test_the_paper_s_finger_by_hand() -> None:
    """0.75 · 1.05 · 1.02 = 0.803: e2 cannot come to its limit at constant volume; nor stretched, 1.25 · 0.95 · 0.98."""
    volume = volume_at_limit(PAPER)
    assert_allclose(volume[1], [1.0, 0.75 * 1.05 * 1.02, 1.0])
    assert_allclose(volume[0], [1.0, 1.25 * 0.95 * 0.98, 1.0])
    assert_allclose(volume_at_limit(EQUAL), 1.0)
    assert np.isnan(volume_at_limit(ONE)[:, [0, 2]]).all()


@pytest.mark.parametrize(("poisson", "ratio"), [(0.0, 2.0 / 3.0), (0.25, 5.0 / 3.0), (0.4, 14.0 / 3.0)])
def test_bulk_to_shear(poisson: float, ratio: float) -> None:
    """K/μ of textbooks."""
    assert bulk_to_shear(Material(poisson=poisson)) == pytest.approx(ratio, rel=1e-12)


def test_rows_against_freedoms() -> None:
    """Nine rows on six strains, or on the three of a tetrahedron with one free node; none with none."""
    free_nodes = np.array([4, 3, 2, 1, 0])
    assert count(PAPER, free_nodes, 7) == (9, 4, 4, 21)
    assert count(EQUAL, free_nodes, 7)[:2] == (3, 0)
    assert count(FREE, free_nodes, 7)[:2] == (2, 0)
    assert count(Limits("hyperbolic", FREE.stretch, FREE.compress), free_nodes, 7)[:2] == (6, 1)
    assert count(Limits("orthogonal", ONE.stretch, ONE.compress), free_nodes, 7)[:2] == (3, 0)
    assert count(Limits(), free_nodes, 7) == (0, 0, 0, 21)


def pressed(poisson: float, compression: float) -> tuple[Simulator, Any]:
    """A cube of five tetrahedra squeezed along e2 and stretched to the other limits, after one short step."""
    limits = {"projection": "tensor", "stretch": list(PAPER.stretch), "compress": list(PAPER.compress)}
    sim = Simulator(beam_scene((0.1,) * 3, (1, 1, 1), poisson=poisson, young=1e4, dt=1e-5, limits=limits))
    x = sim.mesh.points * np.array([1.06, 1.0 - compression, 1.025])
    sim.set_state(x, np.zeros_like(x))
    return sim, sim.step()


def test_a_step_says_where_limits_and_volume_contradict() -> None:
    """Beyond 1 − 1/(1.05 · 1.02) along e2, at a limit, with a stiff bulk: counted and flagged; short of it not."""
    sim, out = pressed(0.45, 0.1)
    body = naive.Body.of(sim.scene, sim.mesh)
    E = np.array([naive.polar_strain(F)[0] for F in body.deformation(sim.positions)])
    assert out.limited_tets > 0
    assert out.locked_tets == (E[:, 1, 1] < 1.0 / (1.05 * 1.02) - 1.0).sum() == 5
    assert out.status & Status.LOCKED
    for poisson, compression in ((0.45, 0.05), (0.3, 0.1)):
        sim, out = pressed(poisson, compression)
        assert out.limited_tets > 0
        assert out.locked_tets == 0
        assert not out.status & Status.LOCKED


def test_info_tells_before_a_run() -> None:
    """`finger_sim info` has the paper's finger lock along e2, and says nothing of beams but what they may."""

    def told(name: str) -> str:
        for title, table in info(name):
            if title == "over-constraint":
                return " ".join(str(cell) for column in table.columns for cell in column.cells)
        return ""

    finger = told("finger_paper")
    assert "up to 9 rows" in finger
    assert "s2 = 0.9337" in finger
    assert "V/V₀ = 0.8033" in finger
    assert "every limit can be met" in told("beam_isotropic")
    assert "no limit of its own" in told("beam_anisotropic")
    assert told("beam_stiff") == ""

"""The linear elements against closed forms and scikit-fem."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from numpy.testing import assert_allclose
from skfem.helpers import ddot, div, eye, sym_grad
from truth import linear, patches, quadratic
from truth.problems import (
    POISSONS,
    TOUCH,
    YOUNG,
    Hold,
    Problem,
    block,
    boundary,
    cook,
    cubes,
    even,
    finger,
    moved,
    of_nodes,
)

MESH = Path(__file__).parents[2] / "config" / "meshes" / "finger_paper.vtu"


def irregular() -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of a box of 40 tetrahedra, 4 × 2 × 2 mm, with its nodes moved at random."""
    points, tets = cubes(4e-3 * even(2), 2e-3 * even(2), 2e-3 * even(2))
    return points + np.random.default_rng(3).uniform(-2e-4, 2e-4, points.shape), tets


@pytest.mark.parametrize("problem", [block(), cook(), finger(MESH)], ids=lambda problem: problem.name)
def test_element_is_that_of_scikit_fem(problem: Problem) -> None:
    """The same force with scikit-fem's linear tetrahedra: facets held, axes left free and all."""
    for poisson in (POISSONS[0], POISSONS[-1]):
        other = quadratic.force(problem, poisson, skfem.ElementTetP1())
        assert linear.force(problem, poisson) == pytest.approx(other, rel=1e-6)


def test_patches_are_a_mixed_form_s() -> None:
    """scikit-fem's deviator, and pressures that are constant on a patch, eliminated: the same matrix."""
    points, tets = irregular()
    patch = patches.stars(tets, np.zeros(len(points), bool))
    mu, bulk = YOUNG / 2.0 / 1.49, YOUNG / 3.0 / 0.02
    mesh = skfem.MeshTet(points.T, tets.T)
    u = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()))
    p = u.with_element(skfem.ElementTetP0())

    @skfem.BilinearForm
    def shear(u: Any, v: Any, w: Any) -> Any:
        return 2.0 * mu * ddot(sym_grad(u) - eye(div(u) / 3.0, 3), sym_grad(v))

    deviator = shear.assemble(u)
    swell = skfem.BilinearForm(lambda u, q, w: div(u) * q).assemble(u, p)
    volume = skfem.BilinearForm(lambda p, q, w: p * q).assemble(p)
    sums = sp.csr_matrix((np.ones(len(tets)), (patch, np.arange(len(tets)))))
    swell, volume = sums @ swell, sums @ volume @ sums.T
    expected = (deviator + bulk * swell.T @ sp.diags(1.0 / volume.diagonal()) @ swell).toarray()
    order = u.nodal_dofs.T.ravel()
    ours = linear.stiffness(points, tets, YOUNG, 0.49, patch).toarray()
    assert_allclose(ours, expected[np.ix_(order, order)], rtol=0, atol=1e-9 * np.abs(expected).max())
    assert np.abs(ours - linear.stiffness(points, tets, YOUNG, 0.49).toarray()).max() > 0.01 * np.abs(ours).max()


def test_uniform_strain_costs_what_hooke_says() -> None:
    """½ V σ : ε of any uniform strain, on patches or not; turning and moving costs nothing, all else something."""
    points, tets = irregular()
    volume = linear.gradients(points, tets)[1].sum()
    slope = np.random.default_rng(4).standard_normal((3, 3))
    strain = (slope + slope.T) / 2.0
    spin = np.cross([1.0, 2.0, 3.0], points)
    for poisson in POISSONS:
        lame = YOUNG * poisson / (1.0 + poisson) / (1.0 - 2.0 * poisson)
        stress = YOUNG / (1.0 + poisson) * strain + lame * np.trace(strain) * np.eye(3)
        for patch in (None, np.zeros(len(tets), int), patches.faces(tets, np.zeros(len(points), bool))):
            matrix = linear.stiffness(points, tets, YOUNG, poisson, patch)
            u = (points @ slope.T + 1.0 + spin).ravel()
            assert u @ matrix @ u / 2.0 == pytest.approx(volume * (stress * strain).sum() / 2.0, rel=1e-9)
            values = np.linalg.eigvalsh(matrix.toarray())
            assert_allclose(values[:6], 0.0, atol=1e-9 * values[-1])
            assert values[6] > 1e-6 * values[-1]


def test_a_bar_is_pulled_by_e_a() -> None:
    """E A Δl / l, on patches too, where the ends may become thinner; a free axis bears no force; both ends the same."""
    length, pull = 4e-3, 1e-5
    even_points, tets = cubes(4e-3 * even(2), 2e-3 * even(2), 2e-3 * even(2))
    middle = np.ptp(even_points, axis=0) / 2.0
    inner = np.isclose(even_points, middle).all(1)
    points = even_points + 2e-4 * inner[:, None]
    x, y, z = points.T
    facets = boundary(tets)
    holds = (
        Hold(of_nodes(facets, z < TOUCH), moved(np.nan, np.nan, 0.0)),
        Hold(of_nodes(facets, y < TOUCH), moved(np.nan, 0.0, np.nan)),
        Hold(of_nodes(facets, x < TOUCH), moved(0.0, np.nan, np.nan)),
        Hold(of_nodes(facets, x > length - TOUCH), moved(pull, np.nan, np.nan)),
    )
    bar = Problem("bar", points, tets, holds, np.array([1.0, 0.0, 0.0]))
    patch = patches.stars(tets, np.zeros(len(points), bool))
    for poisson in POISSONS:
        expected = YOUNG * 4e-6 * pull / length
        assert linear.force(bar, poisson) == pytest.approx(expected, rel=1e-9)
        assert linear.force(bar, poisson, patch) == pytest.approx(expected, rel=1e-9)
        assert quadratic.force(bar, poisson) == pytest.approx(expected, rel=1e-6)
    nodes, given = bar.prescribed()
    where = points[nodes] == 0.0
    assert (given[where] == 0.0).all()
    assert (np.isfinite(given) == where | (points[nodes] == [length, -1.0, -1.0])).all()
    forces, u = linear.reaction(linear.stiffness(points, tets, YOUNG, 0.45, patch), nodes, given)
    assert (forces[np.isnan(given)] == 0.0).all()
    assert_allclose(u[nodes][np.isfinite(given)], given[np.isfinite(given)])
    assert_allclose(forces.sum(0), 0.0, atol=1e-9 * expected)

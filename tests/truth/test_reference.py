"""The quadratic reference converges, to what is written down, and each element at its own rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from truth import linear, patches, quadratic
from truth.problems import (
    POISSONS,
    YOUNG,
    Floats,
    Hold,
    Problem,
    block,
    boundary,
    cantilever,
    cook,
    cook_of,
    cubes,
    even,
)
from truth.reference import ANSWERS, beyond, block_part, cantilever_part, cook_part, order

PARTS = {"block": (block_part, 4), "cook": (cook_part, 4), "cantilever": (cantilever_part, 1)}
"""Name → the part of the body that stands for it, and the cells of the coarsest mesh."""


def test_richardson_s_limit_by_hand() -> None:
    """1 + 3 h² at 1, ½, ¼ leads to 1, over 3/16; forces that swing lead nowhere; 3 h² has the order 2."""
    assert beyond([4.0, 1.75, 1.1875]) == pytest.approx((1.0, 0.1875))
    with pytest.raises(ValueError, match="no convergence"):
        beyond([1.0, 2.0, 1.0])
    assert order([1.0, 0.5, 0.25], [3.0, 0.75, 0.1875]) == pytest.approx(2.0)


def test_a_slender_cantilever_bends_as_beams_do() -> None:
    """Timoshenko's beam, 3 E I / l³ and its shear, to 3 %: what clamping adds by lateral contraction is left."""
    for poisson, (force, _) in ((nu, ANSWERS["cantilever", nu]) for nu in POISSONS):
        bending = 0.1**3 / (3.0 * YOUNG * 0.01**4 / 12.0)
        shear = 0.1 * (12.0 + 11.0 * poisson) / (10.0 * (1.0 + poisson)) * 2.0 * (1.0 + poisson) / (YOUNG * 0.01**2)
        assert 1.0 < force / (1e-3 / (bending + shear)) < 1.03


def test_a_part_stands_for_the_whole() -> None:
    """Cut at its planes of symmetry a body answers the same, to what other tetrahedra in its cells make."""
    pairs = [
        (block(4), block_part(2, even)),
        (cook_of(even(4), even(4), even(2)), cook_of(even(4), even(4), even(1), half=True)),
        (cantilever(2), cantilever_part(2, even)),
    ]
    for whole, part in pairs:
        assert quadratic.force(part, 0.45) == pytest.approx(quadratic.force(whole, 0.45), rel=0.02)


def test_refining_poses_the_same_problem() -> None:
    """Eight tetrahedra for one, all of an eighth of its volume; the energy, and so the force of a plate, falls."""
    coarse = block(2)
    fine = coarse.refined()
    volumes = linear.gradients(fine.points, fine.tets)[1].reshape(-1, 8)
    assert volumes / volumes.sum(1, keepdims=True) == pytest.approx(1.0 / 8.0)
    assert volumes.sum(1) == pytest.approx(linear.gradients(coarse.points, coarse.tets)[1])
    areas = [len(hold.facets) for hold in fine.holds]
    assert areas == [4 * len(hold.facets) for hold in coarse.holds]
    answer = ANSWERS["block", 0.45].force
    assert quadratic.force(coarse, 0.45) > quadratic.force(fine, 0.45) > answer
    assert linear.force(coarse, 0.45) > linear.force(fine, 0.45) > quadratic.force(fine, 0.45)


@pytest.mark.parametrize("name", PARTS)
def test_reference_converges_to_the_answer(name: str) -> None:
    """Two meshes lead to what is written down, from above: their distance from it shrinks at an order of 2 or more."""
    part, cells = PARTS[name]
    for poisson in (POISSONS[0], POISSONS[-1]):
        answer = ANSWERS[name, poisson]
        errors = [quadratic.force(part(n), poisson) / answer.force - 1.0 for n in (cells, 2 * cells)]
        assert 0.0 < errors[1] < 0.012
        assert order([1.0, 0.5], errors) > 1.9


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTS)
def test_answers_are_those_of_the_finest_mesh(name: str) -> None:
    """Two refinements, the last two within 1 %, and Richardson's limit: each of the numbers written down."""
    part, cells = PARTS[name]
    for poisson in POISSONS:
        forces = [quadratic.force(part(n), poisson) for n in (cells, 2 * cells, 4 * cells)]
        assert forces[2] == pytest.approx(forces[1], rel=0.01)
        limit, answer = beyond(forces), ANSWERS[name, poisson]
        assert limit.force == pytest.approx(answer.force, abs=0.01 * answer.error + 1e-5 * answer.force)
        assert limit.error == pytest.approx(answer.error, rel=0.05)


def test_orders_where_all_is_smooth() -> None:
    """2 for the linear elements' displacements and 4 for the quadratic one's energy, in a cube held all over its skin.

    They are ∇φ of a harmonic φ = cos x cos y cosh √2 z: of no divergence, so in balance at any ν.
    """
    root = np.sqrt(2.0)

    def gradient(points: Floats) -> Floats:
        x, y, z = points.T
        wave = np.cosh(root * z)
        slopes = [-np.sin(x) * np.cos(y) * wave, -np.cos(x) * np.sin(y) * wave]
        return np.stack([*slopes, root * np.cos(x) * np.cos(y) * np.sinh(root * z)], axis=1)

    def errors(n: int) -> list[float]:
        """Root mean square of each linear element's displacements of inner nodes [m]; of the quadratic one's energy."""
        points, tets = cubes(even(n), even(n), even(n))
        cube = Problem("cube", points, tets, (Hold(boundary(tets), gradient),), np.zeros(3))
        found = []
        for patch in (None, patches.freedoms(tets, cube.driven())):
            matrix = linear.stiffness(points, tets, YOUNG, 0.45, patch)
            u = linear.reaction(matrix, *cube.prescribed())[1]
            inner = ~cube.driven()
            found.append(np.sqrt(((u - gradient(points))[inner] ** 2).mean()))
        forces, u, _ = quadratic.solve(cube, 0.45)
        return [*found, forces @ u / exact - 1.0]

    # ∫ 2 μ |∇∇φ|², by Gauss' rule.
    at, weights = np.polynomial.legendre.leggauss(12)
    x, y, z = np.meshgrid(*3 * [(at + 1.0) / 2.0], indexing="ij")
    w = np.einsum("i,j,k->ijk", *3 * [weights / 2.0])
    cx, cy, ch = np.cos(x), np.cos(y), np.cosh(root * z)
    sx, sy, sh = np.sin(x), np.sin(y), np.sinh(root * z)
    straight = 6.0 * (cx * cy * ch) ** 2
    mixed = 2.0 * (sx * sy * ch) ** 2 + 4.0 * (sx * cy * sh) ** 2 + 4.0 * (cx * sy * sh) ** 2
    exact = YOUNG / (1.0 + 0.45) * float((w * (straight + mixed)).sum())
    sizes = (4, 6, 8)
    table = np.array([errors(n) for n in sizes])
    found = [order([1.0 / n for n in sizes], column) for column in table.T]
    assert found == pytest.approx([2.0, 2.0, 4.0], abs=0.3)


@pytest.mark.parametrize(
    ("whole", "cells", "expected"),
    [
        (block, (4, 6, 8), (2.0, 2.4, 1.4)),
        (cook, (4, 8, 12), (1.65, 1.7, 1.6)),
        (cantilever, (1, 2, 3), (1.9, 1.8, 1.8)),
    ],
    ids=["block", "cook", "cantilever"],
)
def test_observed_orders(
    whole: Callable[[int], Problem], cells: tuple[int, ...], expected: tuple[float, float, float]
) -> None:
    """On even cells the edges of held faces hold all back; element, patches and quadratic come from above, in order.

    Orders of these three, fitted to three meshes at ν 0.45, to 0.2.
    """
    problems = [whole(n) for n in cells]
    answer = ANSWERS[problems[0].name, 0.45].force
    element = [linear.force(p, 0.45) / answer - 1.0 for p in problems]
    patch = [linear.force(p, 0.45, patches.freedoms(p.tets, p.driven())) / answer - 1.0 for p in problems]
    second = [quadratic.force(p, 0.45) / answer - 1.0 for p in problems]
    for coarse, better, best in zip(element, patch, second, strict=True):
        assert coarse > better > best > 0.0
    found = [order([1.0 / n for n in cells], errors) for errors in (element, patch, second)]
    assert found == pytest.approx(expected, abs=0.2)

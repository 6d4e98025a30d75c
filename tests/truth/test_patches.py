"""Partitions into patches: whole, of one piece, of the promised sizes; and how far they free the element."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from truth import linear, patches, quadratic
from truth.problems import Ints, Problem, block, cook, finger
from truth.reference import ANSWERS

MESHES = Path(__file__).parents[2] / "config" / "meshes"
PROBLEMS = [block(), cook(), finger(MESHES / "finger.vtu")]


def shared(tets: Ints, at_least: int) -> np.ndarray:
    """Which pairs of tetrahedra have so many nodes in common, by brute force. (T, T)"""
    return (tets[:, None, :, None] == tets[None, :, None, :]).sum((2, 3)) >= at_least


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
@pytest.mark.parametrize(
    ("way", "nodes", "smallest", "largest"),
    [
        (patches.freedoms, 3, 1, 16),
        (patches.stars, 1, 2, 8),
        (lambda tets, driven: patches.stars(tets, driven, 8), 1, 4, 16),
        (patches.faces, 1, 2, 8),
    ],
    ids=["freedoms", "stars", "stars of 8", "faces"],
)
def test_partition(problem: Problem, way: Callable[..., Ints], nodes: int, smallest: int, largest: int) -> None:
    """Each tetrahedron is in one patch of the promised size and of one piece, which hangs together over so many nodes.

    Those without a free node are alone. Nodes with other numbers, in the same order, change nothing.
    """
    driven = problem.driven()
    label = way(problem.tets, driven)
    assert label.shape == (len(problem.tets),)
    sizes = np.bincount(label)
    assert (sizes > 0).all()
    rigid = driven[problem.tets].all(1)
    alone = np.unique(label[rigid])
    assert (sizes[alone] == 1).all()
    others = np.delete(sizes, alone)
    assert smallest <= others.min()
    assert others.max() <= largest
    touching = shared(problem.tets, nodes)
    pieces = connected_components(touching & (label[:, None] == label))[0]
    assert pieces == len(sizes)
    wide = np.insert(driven, np.zeros(7, int), False)
    assert (way(problem.tets + 7, wide) == label).all()


def test_freedoms_gives_each_patch_its_share() -> None:
    """Free nodes, each shared out among the patches at it, make 1.25 a patch; or no neighbour has room left."""
    problem = cook()
    driven = problem.driven()
    label = patches.freedoms(problem.tets, driven)
    of = [np.unique(problem.tets[label == patch]) for patch in range(label.max() + 1)]
    at = np.bincount(np.concatenate(of), minlength=len(driven))
    shares = np.array([(~driven[nodes] / at[nodes]).sum() for nodes in of])
    sizes, beside = np.bincount(label), shared(problem.tets, 3)
    for patch in np.flatnonzero(shares < 1.25 - 1e-6):
        near = np.setdiff1d(label[beside[label == patch].any(0)], patch)
        assert (sizes[patch] + sizes[near] > 16).all()
    assert (shares > 1.25 - 1e-6).mean() > 0.9


def test_patches_free_the_block() -> None:
    """160 tetrahedra between plates: 19 and 29 % too stiff at ν 0.45 and 0.49, where the element is 64 and 375 %."""
    problem = block()
    label = patches.freedoms(problem.tets, problem.driven())
    for poisson, most, locked in ((0.45, 0.20, 0.6), (0.49, 0.30, 3.5)):
        answer = ANSWERS["block", poisson].force
        assert linear.force(problem, poisson) / answer - 1.0 > locked
        assert 0.0 < linear.force(problem, poisson, label) / answer - 1.0 < most


def test_patches_free_the_finger() -> None:
    """A dented pad at ν 0.49, against quadratic tetrahedra: a third of the element's error at most."""
    problem = finger(MESHES / "finger_2000.vtu")
    label = patches.freedoms(problem.tets, problem.driven())
    truth = quadratic.force(problem, 0.49)
    locked = linear.force(problem, 0.49) / truth - 1.0
    assert locked > 0.3
    assert abs(linear.force(problem, 0.49, label) / truth - 1.0) < locked / 3.0

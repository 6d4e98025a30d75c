"""What the problems' answers are: quadratic tetrahedra on finer and finer meshes, and what lies beyond the finest.

A part of each body stands for the whole, cut at its planes of symmetry. Its cells shrink towards the edges of held
faces: there the exact stress is infinite, and on even cells no element converges faster than the singularity lets it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from truth.problems import TOUCH, Floats, Hold, Problem, boundary, cook_of, cubes, even, moved, of_nodes

GRADING = 2.0
"""Power with which cells shrink towards an end: quadratic elements then lose little to the singular edges."""


class Answer(NamedTuple):
    """A converged force and how far off it may be."""

    force: float  # [N]
    error: float  # [N]


ANSWERS: dict[tuple[str, float], Answer] = {
    ("block", 0.3): Answer(0.0636118, 0.0000033),
    ("block", 0.45): Answer(0.0807538, 0.0000357),
    ("block", 0.49): Answer(0.0904527, 0.0001002),
    ("cook", 0.3): Answer(0.00716231, 0.00000294),
    ("cook", 0.45): Answer(0.00715283, 0.00000680),
    ("cook", 0.49): Answer(0.00716187, 0.00001064),
    ("cantilever", 0.3): Answer(3.496334e-5, 0.000396e-5),
    ("cantilever", 0.45): Answer(3.525567e-5, 0.001196e-5),
    ("cantilever", 0.49): Answer(3.536713e-5, 0.001902e-5),
}
"""(Problem's name, ν) → its answer: `beyond` of the parts of 4, 8 and 16 cells, of the cantilever's of 1, 2 and 4."""


def to_end(n: int) -> Floats:
    """n + 1 numbers from 0 to 1, ever closer towards 1."""
    return 1.0 - (1.0 - even(n)) ** GRADING


def to_ends(n: int) -> Floats:
    """n + 1 numbers from 0 to 1, n even, ever closer towards both."""
    half = to_end(n // 2)
    return np.concatenate([(1.0 - half[::-1]) / 2.0, (1.0 + half[1:]) / 2.0])


def block_part(n: int, spacing: Callable[[int], Floats] = to_end) -> Problem:
    """An eighth of `block`, n × n × n/2 cells: from its middle to one plate, which moves half the way."""
    points, tets = cubes(10e-3 * spacing(n), 10e-3 * spacing(n), 5e-3 * spacing(n // 2))
    facets = boundary(tets)
    planes = [
        Hold(of_nodes(facets, points[:, k] == 0.0), moved(*np.where(np.arange(3) == k, 0.0, np.nan))) for k in range(3)
    ]
    plate = Hold(of_nodes(facets, points[:, 2] > 5e-3 - TOUCH), moved(0.0, 0.0, -0.5e-4))
    return Problem("block", points, tets, (*planes, plate), np.array([0.0, 0.0, -4.0]))


def cook_part(n: int) -> Problem:
    """Half of `cook`, n × n × n/4 cells."""
    return cook_of(to_ends(n), to_ends(n), to_end(n // 4), half=True)


def cantilever_part(n: int, spacing: Callable[[int], Floats] = to_end) -> Problem:
    """A quarter of `cantilever`, 10 n × n × n cells.

    It lies above the plane that does not stretch and beside the plane of symmetry.
    """
    along = 1.0 - spacing(10 * n)[::-1]
    points, tets = cubes(100e-3 * along, 5e-3 * spacing(n), 5e-3 * spacing(n))
    facets, (x, y, z) = boundary(tets), points.T
    holds = (
        Hold(of_nodes(facets, z == 0.0), moved(np.nan, np.nan, 0.0)),
        Hold(of_nodes(facets, y == 0.0), moved(0.0, np.nan, 0.0)),
        Hold(of_nodes(facets, x == 0.0), moved(0.0, 0.0, 0.0)),
        Hold(of_nodes(facets, x > 100e-3 - TOUCH), moved(np.nan, 1e-3, np.nan)),
    )
    return Problem("cantilever", points, tets, holds, np.array([0.0, 4.0, 0.0]))


def beyond(forces: Sequence[float]) -> Answer:
    """Richardson's limit of three answers on meshes each half as coarse as the one before; its way there is the error.

    The order is what the three show; raises ValueError where they show none.
    """
    first, second = forces[-3] - forces[-2], forces[-2] - forces[-1]
    if not first / second > 1.0:
        raise ValueError(f"no convergence: {forces}")
    way = second / (first / second - 1.0)
    return Answer(forces[-1] - way, abs(way))


def order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """p of the best fit errors ~ sizes^p."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])

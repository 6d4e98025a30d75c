"""What a file of a mesh holds, before anything of it is checked."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


class Contents(NamedTuple):
    """Nodes, the cells that fill space, and what is named, as a file has them.

    points    : (n, 3), or (n, 2) where the file is flat [m]
    solids    : kind of cell in meshio's words ("tetra", "tetra10", "hexahedron") and nodes of each cell (m, k), k ≥ 4,
                the corners first
    others    : kinds of cells that fill no space, and how many there are of each
    node_sets : name -> node indices, in any order, some perhaps more than once
    axes      : material axes of every solid, blocks of (m, 9) as in `solids`; None where the file has none
    notes     : what the user should know about how the file was read
    """

    points: NDArray[Any]
    solids: list[tuple[str, Indices]]
    others: dict[str, int]
    node_sets: dict[str, Indices]
    axes: list[NDArray[Any]] | None = None
    notes: tuple[str, ...] = ()

"""Mesh generators: the paper's beam, and the verb's way to all of them. Fingers are made in files of their own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import MeshError
from .mesh import TetMesh

# A cube's corners are numbered i + 2 j + 4 k; its five tets, positive, the middle one last.
_CUBE = np.array([[1, 0, 2, 4], [1, 3, 7, 2], [1, 5, 4, 7], [2, 6, 7, 4], [1, 2, 7, 4]])


def beam(size: Sequence[float] = (1.0, 0.2, 0.2), cells: Sequence[int] = (10, 2, 2)) -> TetMesh:
    """Box of `size` [m] along x y z with a corner at the origin, in `cells` bricks of five tets each.

    Neighbouring bricks are mirrored so that their faces match. Node sets: `base` (x = 0) and `tip`.
    Raises MeshError when a size is not positive or a cell count is not a whole number of 1 or more.
    """
    if len(size) != 3 or not all(math.isfinite(s) and s > 0.0 for s in size):
        raise MeshError(f"beam size: got {size!r}, allowed: three lengths > 0 m")
    if len(cells) != 3 or not all(int(c) == c and c >= 1 for c in cells):
        raise MeshError(f"beam cells: got {cells!r}, allowed: three whole numbers >= 1")
    nx, ny, nz = (int(c) for c in cells)
    ticks = (np.linspace(0.0, s, n + 1) for s, n in zip(size, (nx, ny, nz), strict=True))
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)

    corner = np.arange(8)
    tets = []
    for cell in itertools.product(range(nx), range(ny), range(nz)):
        i, j, k = (c + (corner >> axis & 1) for axis, c in enumerate(cell))
        node = (i * (ny + 1) + j) * (nz + 1) + k
        tets.append(node[_CUBE] if sum(cell) % 2 == 0 else node[_CUBE ^ 1][:, [1, 0, 2, 3]])
    x = points[:, 0]
    ends = {"base": np.flatnonzero(x == 0.0), "tip": np.flatnonzero(x == x[-1])}
    return TetMesh.from_arrays(points, np.concatenate(tets), ends)


def write_mesh(
    kind: str,
    out: str | Path,
    *,
    tets: int | None = None,
    distal: bool = False,
    size: Sequence[float] = (1.0, 0.2, 0.2),
    cells: Sequence[int] = (10, 2, 2),
) -> TetMesh:
    """Make the mesh of `kind` and write it to `out`; `tets`: left out, as many as the kind has by itself.

    finger       soft tissue around the bones; `distal`: its last 28 mm alone
    solid-finger tets through skin and bones
    beam         bricks, of `size` [m] and `cells`

    Raises MeshError on another kind, on arguments that the generators refuse, and when `out` is not .vtu.
    """
    from .finger_mesh import FINGER_TETS, finger
    from .finger_solid import SOLID_TETS, solid_finger

    match kind:
        case "finger":
            mesh = finger(FINGER_TETS if tets is None else tets, distal=distal)
        case "solid-finger":
            mesh = solid_finger(SOLID_TETS if tets is None else tets)
        case "beam":
            mesh = beam(size, cells)
        case _:
            raise MeshError(f"mesh kind: got {kind!r}, allowed: finger, solid-finger, beam")
    mesh.save(out)
    return mesh

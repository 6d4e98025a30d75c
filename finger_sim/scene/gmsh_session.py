"""gmsh, as the generators of finger meshes use it: one thread, sizes from a callback alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..errors import MissingExtraError

Indices = NDArray[np.int64]

_TETRA = 4  # gmsh's number for a 4-node tetrahedron
_OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.Optimize": 1,
    "Mesh.OptimizeThreshold": 0.5,
}


@contextmanager
def gmsh_session(options: Mapping[str, float]) -> Iterator[Any]:
    """gmsh, started and set up, with `options` of its own names; closed at the end unless it was in use before.

    Raises MissingExtraError when it is not installed.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MissingExtraError("making a finger mesh", "mesh") from error
    in_use = gmsh.isInitialized()
    if not in_use:
        gmsh.initialize(interruptible=False)
    gmsh.model.add("finger_sim")
    try:
        for name, value in (_OPTIONS | dict(options)).items():
            gmsh.option.setNumber(name, value)
        yield gmsh
    finally:
        gmsh.model.mesh.removeSizeCallback()
        gmsh.model.remove()
        if not in_use:
            gmsh.finalize()


def tetrahedra(gmsh: Any, surfaces: Sequence[Sequence[int]] = ()) -> tuple[Floats, Indices, list[NDArray[np.bool_]]]:
    """Nodes (n, 3) and tets (T, 4) of the mesh of now, in VTK's order, and which nodes lie on groups of surfaces."""
    tags, flat, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType(_TETRA)
    order = np.argsort(tags)
    used, tets = np.unique(_found(tags, order, nodes), return_inverse=True)
    on = []
    for group in surfaces:
        mask = np.zeros(len(tags), dtype=np.bool_)
        for surface in group:
            mask[_found(tags, order, gmsh.model.mesh.getNodes(2, surface, includeBoundary=True)[0])] = True
        on.append(mask[used])
    points = np.asarray(flat, dtype=np.float64).reshape(-1, 3)
    return points[used], tets.reshape(-1, 4), on


def _found(tags: Indices, order: Indices, wanted: Indices) -> Indices:
    """Where `wanted` are in `tags`, which `order` sorts."""
    places: Indices = order[np.searchsorted(tags, wanted, sorter=order)]
    return places

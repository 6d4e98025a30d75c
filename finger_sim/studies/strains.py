"""Strain of every tetrahedron of a mesh at given node positions, by LAPACK: what studies look at, apart from a step."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from ..scene.mesh import TetMesh


def deformation(mesh: TetMesh, points: Floats) -> Floats:
    """F of each tetrahedron at node positions (n, 3) [m], columns along its material axes e1, e2, e3. (T, 3, 3)"""
    rest, now = (np.moveaxis(x[mesh.tets[:, :3]] - x[mesh.tets[:, 3:]], 1, 2) for x in (mesh.points, points))
    return np.asarray(now @ np.linalg.inv(rest) @ np.swapaxes(mesh.axes, 1, 2))


def stretches(F: Floats) -> tuple[Floats, Floats]:
    """Signed principal stretches s (T, 3) and axes V (T, 3, 3), in columns, of F (T, 3, 3)."""
    _, s, Vt = np.linalg.svd(F)
    s[:, 2] *= np.sign(np.linalg.det(F))
    return s, np.swapaxes(Vt, 1, 2)


def biot_strain(mesh: TetMesh, points: Floats) -> Floats:
    """E = U − I of each tetrahedron in its material axes, U = V diag(s) Vᵀ. (T, 3, 3)"""
    s, V = stretches(deformation(mesh, points))
    return np.asarray(V * s[:, None, :] @ np.swapaxes(V, 1, 2) - np.eye(3))

"""The mesh as the page is told of it, with what only the scene knows: tetrahedra, node sets, axes, limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import FingerSimError
from ..scene import Scene
from .protocol import BASE, BONE, NAIL, PAD, Topology

_SAME = 1e-6
"""Distance up to which a node of a message is that of a mesh [m]: messages hold float64, some viewers' float32."""
_SETS = {"bone": BONE, "nail": NAIL, "pad": PAD, "base": BASE}


def topology_of(message: Any) -> Topology:
    """What a shape_msgs/Mesh of the node tells. Raises ValueError for a mesh that is none."""
    rest = np.array([(v.x, v.y, v.z) for v in message.vertices], np.float64).reshape(-1, 3)
    triangles = np.array([t.vertex_indices for t in message.triangles], np.int32).reshape(-1, 3)
    if len(rest) < 4 or not np.isfinite(rest).all() or not (triangles >= 0).all() or not (triangles < len(rest)).all():
        raise ValueError("a mesh that is none")
    return Topology(rest, triangles)


def with_scene(heard: Topology, scene: Scene) -> Topology:
    """What was heard, and what the scene knows of it, where its mesh can be had here and is the same."""
    try:
        mesh = scene.load_mesh()
        driven = scene.driven_nodes(mesh)
    except FingerSimError:
        return heard
    if mesh.points.shape != heard.rest.shape or not np.allclose(mesh.points, heard.rest, rtol=0.0, atol=_SAME):
        return heard
    flags = np.zeros(len(mesh.points), np.uint8)
    for name, nodes in mesh.node_sets.items():
        flags[nodes] |= _SETS.get(name, 0)
    if driven.size:
        flags[driven] |= BONE
    limits = np.full((3, 2), np.nan)
    if scene.limits is not None:
        for column, ends in enumerate((scene.limits.stretch, scene.limits.compress)):
            limits[:, column] = [np.nan if end is None else end for end in ends]
    return Topology(heard.rest, heard.triangles, mesh.tets, flags, mesh.axes, limits)

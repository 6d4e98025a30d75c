"""Better tets by small changes: edges that are cut in two, and nodes that move to where angles are wider.

Tets are in VTK's order here: det(x2 - x1, x3 - x1, x4 - x1) > 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from .mesh import FACES

Indices = NDArray[np.int64]

PAIRS = np.array(list(itertools.combinations(range(4), 2)))
"""Corners that each edge of a tet joins; also the faces that meet in an edge."""
STEPS = (0.2, 0.07, 0.02)
"""How far a node is moved on trial, over the mean length of its edges."""
PASSES = 12
"""Times that all nodes of narrow tets are moved, at most."""
WORTH = 1e-4
"""Growth of the narrowest angle that makes a move worth it [rad]: less would go on for long."""

_AROUND = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_DIRECTIONS = _AROUND / np.linalg.norm(_AROUND, axis=1, keepdims=True)


def narrowest(corners: Floats) -> Floats:
    """Smallest dihedral angle of tets with `corners` (…, 4, 3), (…) [rad]; -1 where one is flat or inside out."""
    a, b, c = (corners[..., i, :] - corners[..., 0, :] for i in (1, 2, 3))
    x = corners[..., FACES, :]
    normals = np.cross(x[..., 1, :] - x[..., 0, :], x[..., 2, :] - x[..., 0, :])
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)
    cosines = -(normals[..., PAIRS[:, 0], :] * normals[..., PAIRS[:, 1], :]).sum(axis=-1)
    angles = np.arccos(np.clip(cosines, -1.0, 1.0)).min(axis=-1)
    upright = (np.cross(a, b) * c).sum(axis=-1) > 0.0
    out: Floats = np.where(upright, angles, -1.0)
    return out


def edges_of(tets: Indices) -> Indices:
    """Each edge once, (E, 2), lower node first."""
    return np.unique(np.sort(tets[:, PAIRS].reshape(-1, 2), axis=1), axis=0)


def cut_edges(points: Floats, tets: Indices, edges: Iterable[tuple[int, int]]) -> tuple[Floats, Indices, Indices]:
    """The mesh with a new node in the middle of each of `edges`, and the ends of the edge of each new node (k, 2)."""
    ends = np.array(sorted(set(edges)), dtype=np.int64).reshape(-1, 2)
    nodes = list(points)
    for a, b in ends:
        nodes.append(0.5 * (nodes[a] + nodes[b]))
        cut = (tets == a).any(axis=1) & (tets == b).any(axis=1)
        halves = [np.where(tets[cut] == end, len(nodes) - 1, tets[cut]) for end in (a, b)]
        tets = np.concatenate([tets[~cut], *halves])
    return np.array(nodes), tets, ends


def widened(points: Floats, tets: Indices, allowed: Callable[[int, Floats], Floats], aim: float) -> Floats:
    """Nodes moved so that the narrowest angles about them grow, until none is below `aim` [rad] or nothing helps.

    `allowed` takes a node and places tried for it (m, 3), and gives the places that it may have instead.
    """
    x = points.copy()
    star: list[list[int]] = [[] for _ in x]
    for tet, nodes in enumerate(tets.tolist()):
        for node in nodes:
            star[node].append(tet)
    for _ in range(PASSES):
        narrow = narrowest(x[tets]) < aim
        moved = [_move(x, tets[star[node]], node, allowed) for node in np.unique(tets[narrow]).tolist()]
        if not any(moved):
            break
    return x


def _move(x: Floats, star: Indices, node: int, allowed: Callable[[int, Floats], Floats]) -> bool:
    """Puts a node where the narrowest angle of its tets is widest of all places tried; whether it moved."""
    corners = x[star]
    own: NDArray[np.bool_] = star == node
    reach = float(np.linalg.norm(corners - x[node], axis=-1)[~own].mean())
    now = narrowest(corners).min()
    for step in STEPS:
        tried = allowed(node, x[node] + step * reach * _DIRECTIONS)
        trials = np.broadcast_to(corners, (len(tried), *corners.shape)).copy()
        trials[:, own] = tried[:, None, :]
        found = narrowest(trials).min(axis=1)
        if found.max() > now + WORTH:
            x[node] = tried[found.argmax()]
            return True
    return False

"""Files of meshes: what they hold made into 4-node tets and their nodes, with notes on what was left out."""

from __future__ import annotations

import io
import re
import stat
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MeshError
from .abaqus import read_abaqus
from .mesh_contents import Contents, Indices
from .mesh_failures import FILL, format_of, why
from .mesh_sets import is_numbered, node_sets
from .meshio_reader import read_with_meshio, warnings_of

AS_TETS = "take them apart into tetrahedra (in ParaView: the filter Tetrahedralize), or mesh the body with tetrahedra"
IN_NO_GROUP = "gmsh leaves groups out of format 2.2 where it saves all elements: save as 4.1, or without Mesh.SaveAll"
LISTED = 5
"""Sets that one note names."""


def read(path: Path) -> Contents:
    """Points, tets (one block, 4 nodes each), node sets and axes of a file; nodes that no tet has are left out.

    Tets of higher order are taken by their corners. Nothing else is checked. Raises MeshError where there are no tets.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise MeshError("file not found") from None
    except (OSError, ValueError) as error:
        raise MeshError(f"cannot be opened: {error}") from error
    if stat.S_ISDIR(status.st_mode):
        raise MeshError("is a folder, not a mesh file")
    if status.st_size == 0:
        raise MeshError("empty file")
    contents = _contents(path)
    _require_tets(contents)
    return _used_only(_once(_corners(contents)), _between_corners(contents))


def _contents(path: Path) -> Contents:
    """What a file holds. Raises MeshError that says which format it was taken for and what is wrong with it."""
    said = io.StringIO()
    try:
        if format_of(path) == "Abaqus":
            return read_abaqus(path)
        mesh = read_with_meshio(path, said)
        return _of_meshio(mesh, warnings_of(said.getvalue()))
    except (Exception, SystemExit) as error:
        raise MeshError(f"unreadable{why(path, error, said.getvalue())}") from error


def _of_meshio(mesh: Any, notes: tuple[str, ...]) -> Contents:
    solid = [i for i, block in enumerate(mesh.cells) if block.dim == 3 and len(block.data)]
    others: Counter[str] = Counter()
    for block in mesh.cells:
        if block.dim < 3:
            others[block.type] += len(block.data)
    axes = mesh.cell_data.get("axes")
    sets = node_sets(mesh)
    empty = [name for name, pair in mesh.field_data.items() if np.shape(pair) == (2,) and name not in sets]
    if empty:
        notes += (f"no cell is in the groups {', '.join(empty[:LISTED])}, which the file names; {IN_NO_GROUP}",)
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2:
        raise MeshError("it has no nodes")
    return Contents(
        points,
        [(mesh.cells[i].type, mesh.cells[i].data) for i in solid],
        dict(others),
        sets,
        None if axes is None else [np.asarray(axes[i]) for i in solid],
        notes,
    )


def _require_tets(contents: Contents) -> None:
    """Raises MeshError where space is filled by anything but tets, or by nothing."""
    foreign: Counter[str] = Counter()
    for kind, cells in contents.solids:
        if not re.fullmatch(r"tetra\d*|VTK_LAGRANGE_TETRAHEDRON", kind):
            foreign[kind] += len(cells)
        elif np.ndim(cells) != 2 or np.shape(cells)[1] < 4:
            raise MeshError(f"cells of the kind {kind} do not have 4 nodes or more each: the file is damaged")
    if foreign:
        named = ", ".join(f"{count} {kind}" for kind, count in foreign.items())
        raise MeshError(f"cells that are not 4-node tetrahedra: {named}; {AS_TETS}")
    if contents.points.shape[1] == 2:
        raise MeshError(f"no tets: the points are two-dimensional; {FILL}")
    if not contents.solids:
        others = ", ".join(f"{count} {kind}" for kind, count in contents.others.items())
        raise MeshError("no tets: " + (f"it holds {others} alone; {FILL}" if others else "it holds no cells"))


def _between_corners(contents: Contents) -> Indices:
    """Nodes of tets of higher order that are no corners. Raises MeshError where they are corners of other tets."""
    n = len(contents.points)
    inner = np.unique(np.concatenate([np.asarray(cells)[:, 4:].ravel() for _, cells in contents.solids]))
    inner = inner[(inner >= 0) & (inner < n)].astype(np.int64)
    hanging = np.intersect1d(inner, np.concatenate([np.asarray(cells)[:, :4].ravel() for _, cells in contents.solids]))
    if len(hanging):
        listed = ", ".join(map(str, hanging[:LISTED])) + (", …" if len(hanging) > LISTED else "")
        raise MeshError(
            f"tets of higher order have corners of other tets between their own ({listed}), so "
            "that their corners alone leave gaps; mesh the body with tets of one order"
        )
    return inner


def _corners(contents: Contents) -> Contents:
    """The same with all tets in one block, by their corners."""
    tets = np.concatenate([np.asarray(cells)[:, :4] for _, cells in contents.solids]).astype(np.int64)
    axes = None if contents.axes is None else [np.concatenate(contents.axes)]
    curved = sum(len(cells) for _, cells in contents.solids if np.shape(cells)[1] > 4)
    note = f"{_count(curved, 'tet')} of higher order taken by the corners, with straight edges"
    notes = (*contents.notes, note) if curved else contents.notes
    return contents._replace(solids=[("tetra", tets)], axes=axes, notes=notes)


def _once(contents: Contents) -> Contents:
    """The same without tets that occur again: gmsh's format 2.2 repeats them for each group that they are in."""
    tets = contents.solids[0][1]
    first = np.sort(np.unique(np.sort(tets, axis=1), axis=0, return_index=True)[1])
    if len(first) == len(tets):
        return contents
    note = f"{_count(len(tets) - len(first), 'duplicate tet')} left out, as written for a second group"
    axes = None if contents.axes is None else [contents.axes[0][first]]
    return contents._replace(solids=[("tetra", tets[first])], axes=axes, notes=(*contents.notes, note))


def _used_only(contents: Contents, between: Indices) -> Contents:
    """The same without nodes that no tet has; unchanged where there is a number that no node has.

    between : nodes between the corners of tets, which go without being counted as unused
    """
    n, (kind, tets) = len(contents.points), contents.solids[0]
    numbers = np.concatenate([tets.ravel(), *contents.node_sets.values()])
    if numbers.min() < 0 or numbers.max() >= n:
        return contents
    keep = np.zeros(n, dtype=np.bool_)
    keep[tets] = True
    if keep.all():
        return contents
    index = np.cumsum(keep) - 1
    sets, notes = {}, []
    for name, nodes in contents.node_sets.items():
        left = nodes[keep[nodes]]
        if len(left) or not len(nodes) or not is_numbered(name):
            sets[name] = index[left]
        lost = len(np.setdiff1d(nodes[~keep[nodes]], between))
        if lost and name in sets:
            notes.append(f"node set {name} loses {lost} of its {len(nodes)}")
    unused = n - int(np.count_nonzero(keep)) - len(between)
    if unused:
        more = [f"{_count(len(notes) - LISTED, 'more set')} lose some"] if len(notes) > LISTED else []
        first = f"{_count(unused, 'unreferenced node')} left out: in no tet, like the centre of an arc"
        notes = ["; ".join([first, *notes[:LISTED], *more])]
    return contents._replace(
        points=contents.points[keep], solids=[(kind, index[tets])], node_sets=sets, notes=(*contents.notes, *notes)
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"

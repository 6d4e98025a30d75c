"""Node sets of a file that meshio read: of point sets, cell sets, physical groups, masks and tags.

Names that a file gives are kept as they are. What has a number only is called by its kind, its datum and the number:
"surface medit:ref=3" are the nodes of all triangles whose reference is 3.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .mesh_contents import Indices

KINDS = ("point", "line", "surface", "volume")
"""Words for cells of 0, 1, 2 and 3 dimensions."""
MOST_TAGS = 100
"""Values that cell data may have to be tags; more are numbers of something, not names."""
NAMED_TAGS = ("gmsh:physical", "netgen:index")
"""Cell data whose values have names in the file's field data."""
OF_FORMATS = re.compile(r"(avsucd|flac3d|gmsh|medit|nastran|netgen|su2|tetgen):")
"""Data that meshio calls so are the formats' own numbers, of which 0 is none."""
NOT_NAMES = ("gmsh:bounding_entities", "gmsh:dim_tags")
"""What meshio keeps beside the sets that is none."""


def node_sets(mesh: Any) -> dict[str, Indices]:
    """Name -> node indices of all sets of a `meshio.Mesh`; nodes named themselves go before those of named cells."""
    own = dict(_merged(_of_points(mesh)))
    taken = {name.casefold() for name in own}
    return own | {name: nodes for name, nodes in _merged(_of_cells(mesh)).items() if name.casefold() not in taken}


def is_numbered(name: str) -> bool:
    """Whether a set got its name here, for want of one in the file."""
    return re.fullmatch(rf"({'|'.join(KINDS)}) .+=-?\d+", name) is not None


def _merged(found: Iterator[tuple[str, Indices]]) -> dict[str, Indices]:
    out: dict[str, Indices] = {}
    for name, nodes in found:
        out[name] = np.union1d(out[name], nodes) if name in out else np.unique(nodes)
    return out


def _of_points(mesh: Any) -> Iterator[tuple[str, Indices]]:
    """Sets of points, point data of zeros and ones, and reference numbers of points."""
    for number, (name, nodes) in enumerate(mesh.point_sets.items(), start=1):
        yield str(name) or f"node set {number}", _indices(nodes)
    for name, data in mesh.point_data.items():
        values = _flat(data)
        if values is None or name in NOT_NAMES:
            continue
        if name == "point_tags":  # of MED: numbers of families, which have names
            for tag, names in getattr(mesh, "point_tags", {}).items():
                yield from ((given, np.flatnonzero(values == tag)) for given in names)
        elif OF_FORMATS.match(name):
            for tag in filter(None, _tags(values)):
                yield f"{KINDS[0]} {name}={tag}", np.flatnonzero(values == tag)
        elif np.isin(values, (0, 1)).all():
            yield name, np.flatnonzero(values)


def _of_cells(mesh: Any) -> Iterator[tuple[str, Indices]]:
    """Nodes of the cells that are in a set, a group, or bear a mark."""
    for name, blocks in mesh.cell_sets.items():
        if name not in NOT_NAMES:
            chosen = [_indices(cells) for cells in blocks]
            yield name, _nodes(mesh, chosen)
    physical = [np.any(block) for block in mesh.cell_data.get("gmsh:physical", ())]
    grouped = any(physical) or any(name not in NOT_NAMES for name in mesh.cell_sets)
    for name, blocks in mesh.cell_data.items():
        values = [_flat(block) for block in blocks]
        if name in ("axes", *(("gmsh:geometrical",) if grouped else ())) or any(block is None for block in values):
            continue
        flat = [block for block in values if block is not None]
        together = np.concatenate(flat) if flat else np.empty(0)
        if not OF_FORMATS.match(name) and np.isin(together[~np.isnan(together)], (0, 1)).all():
            yield name, _nodes(mesh, [np.flatnonzero(block == 1) for block in flat])
        else:
            yield from _tagged(mesh, name, flat, _tags(together))


def _tagged(mesh: Any, name: str, blocks: list[NDArray[Any]], tags: list[int]) -> Iterator[tuple[str, Indices]]:
    """A set for each tag, by the names that the file has for it; tags of cells of other dimensions are others."""
    names: dict[tuple[int, int], list[str]] = {}
    if name in NAMED_TAGS:
        for given, pair in mesh.field_data.items():
            if np.shape(pair) == (2,):
                names.setdefault((int(pair[1]), int(pair[0])), []).append(given)
    families = getattr(mesh, "cell_tags", {}) if name == "cell_tags" else {}
    for tag in tags:
        if tag == 0 and OF_FORMATS.match(name):
            continue
        for dimension, kind in enumerate(KINDS):
            of_kind = [
                np.flatnonzero((block == tag) & (cells.dim == dimension))
                for block, cells in zip(blocks, mesh.cells, strict=True)
            ]
            if any(len(cells) for cells in of_kind):
                called = names.get((dimension, tag)) or families.get(tag) or [f"{kind} {name}={tag}"]
                for one in called:
                    yield one, _nodes(mesh, of_kind)


def _tags(values: NDArray[Any]) -> list[int]:
    """The whole numbers that occur; none where there are too many, or other values."""
    if values.dtype.kind not in "iub":
        return []
    found = np.unique(values)
    return [int(tag) for tag in found] if len(found) <= MOST_TAGS else []


def _nodes(mesh: Any, chosen: list[Indices]) -> Indices:
    """Nodes of chosen cells, given by block."""
    blocks = [
        np.asarray(cells.data)[which].ravel()
        for cells, which in zip(mesh.cells, chosen, strict=False)
        if len(which) and not cells.type.startswith("poly")
    ]
    return np.concatenate([np.empty(0, dtype=np.int64), *blocks]).astype(np.int64)


def _flat(data: Any) -> NDArray[Any] | None:
    """Numbers, one for each point or cell; None for what is no such data."""
    values = np.asarray(data)
    values = values.reshape(-1) if values.ndim == 2 and values.shape[1] == 1 else values
    return values if values.ndim == 1 and values.dtype.kind in "iubf" else None


def _indices(cells: Any) -> Indices:
    return np.empty(0, dtype=np.int64) if cells is None else np.asarray(cells).reshape(-1).astype(np.int64)

"""Files of meshes: what they hold made into nodes and 4-node tets, and why one cannot be read, in words.

meshio reads all formats but Abaqus' (see abaqus.py). It reports by printing, by leaving the process and by whatever a
parser stumbles over; here all of that becomes one MeshError.
"""

from __future__ import annotations

import contextlib
import io
import re
import stat
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..errors import MeshError
from .abaqus import read_abaqus
from .mesh_contents import Contents, Indices
from .mesh_sets import is_numbered, node_sets

FORMATS = {
    "VTU": (".vtu",), "legacy VTK": (".vtk",), "gmsh": (".msh",), "Abaqus": (".inp",), "Medit": (".mesh", ".meshb"),
    "Netgen": (".vol",), "NASTRAN": (".bdf", ".nas", ".fem"), "Exodus": (".e", ".exo", ".ex2"), "Salome MED": (".med",),
    "XDMF": (".xdmf", ".xmf"), "CGNS": (".cgns",), "TetGen": (".node", ".ele"), "SU2": (".su2",), "AVS-UCD": (".avs",),
}  # fmt: skip
"""Formats and how names of their files end; meshio reads a few more."""
LOOKS = (
    (rb"\s*\$MeshFormat", "gmsh"), (rb"(?s).{0,200}<VTKFile", "VTU"), (rb"# vtk DataFile", "legacy VTK"),
    (rb"\s*MeshVersionFormatted", "Medit"), (rb"\s*mesh3d", "Netgen"), (rb"(?s).{0,200}<Xdmf", "XDMF"),
    (rb"(?si)(\*\*[^\n]*\n)*\*(heading|node|part)\b", "Abaqus"),
    (rb"(?s).{0,500}\b(BEGIN BULK|GRID[ ,*])", "NASTRAN"), (rb"CDF[\x01\x02\x05]", "Exodus"),
    (rb"\x1f\x8b|PK\x03\x04|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd", "compressed"),
    (rb"version https://git-lfs", "git-lfs"), (rb"(?i)\s*<(!doctype )?html", "web page"),
)  # fmt: skip
"""How files begin, and what they are then."""
OF_NO_MESH = {
    "compressed": "it is compressed: unpack it first",
    "git-lfs": "it only stands for a file that git lfs keeps: git lfs pull",
    "web page": "it is a web page, not the file that was to be downloaded",
}
GEOMETRY = {".step", ".stp", ".iges", ".igs", ".brep", ".geo", ".stl", ".obj", ".ply", ".off"}
"""How the names of files end that describe a surface or a body, which has yet to be filled with tets."""

AS_TETS = "take them apart into tetrahedra (in ParaView: the filter Tetrahedralize), or mesh the body with tetrahedra"
FILL = "fill the body with tetrahedra first: in gmsh, a Volume inside of the surface, then gmsh -3 FILE.geo -o FILE.msh"
SAVE_ANEW = "gmsh, where it reads the file, saves it anew: gmsh FILE -save -format msh41 -o NEW.msh"
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
    suffix = path.suffix.lower()
    said = io.StringIO()
    try:
        if suffix == ".inp":
            return read_abaqus(path)
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), _groups_may_be_partial():
            mesh = meshio.read(*_source(path))
        return _of_meshio(mesh, _warnings(said.getvalue()))
    except (Exception, SystemExit) as error:
        raise MeshError(f"unreadable{_why(path, error, said.getvalue())}") from error


def _source(path: Path) -> tuple[Any, ...]:
    """What meshio is to read: the file, or NASTRAN's bulk data alone under the headline that it must have."""
    if _format(path.suffix.lower()) != "NASTRAN":
        return (path,)
    text = path.read_text(encoding="utf-8", errors="replace").rstrip() + "\n"
    if re.search(r"(?m)^GRID[ ,*]", text) and not re.search(r"(?m)^BEGIN BULK", text):
        text = f"BEGIN BULK\n{text}" + ("" if re.search(r"(?m)^ENDDATA", text) else "ENDDATA\n")
    return io.StringIO(text), "nastran"


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
    return Contents(
        np.asarray(mesh.points, dtype=np.float64),
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
    if foreign:
        named = ", ".join(f"{count} {kind}" for kind, count in foreign.items())
        raise MeshError(f"cells that are not 4-node tetrahedra: {named}; {AS_TETS}")
    if contents.points.ndim == 2 and contents.points.shape[1] == 2:
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
        first = f"{_count(unused, 'unreferenced node')} left out, in no tet, as centres of arcs are"
        notes = ["; ".join([first, *notes[:LISTED], *more])]
    return contents._replace(
        points=contents.points[keep], solids=[(kind, index[tets])], node_sets=sets, notes=(*contents.notes, *notes)
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


@contextlib.contextmanager
def _groups_may_be_partial() -> Iterator[None]:
    """While this holds, meshio reads gmsh files with cells in no physical group, for which it has no tag.

    gmsh writes such files with "save all elements" (Mesh.SaveAll). The names of groups are read all the same.
    """
    from meshio.gmsh import _gmsh40, _gmsh41

    def tolerant(points: Any, cells: Any, cell_data: Mapping[str, Any] | None = None, **more: Any) -> Any:
        whole = {name: blocks for name, blocks in (cell_data or {}).items() if len(blocks) == len(cells)}
        return meshio.Mesh(points, cells, cell_data=whole, **more)

    modules = (_gmsh40, _gmsh41)
    for module in modules:
        module.Mesh = tolerant
    try:
        yield
    finally:
        for module in modules:
            module.Mesh = meshio.Mesh


def _warnings(said: str) -> tuple[str, ...]:
    """What meshio warns of while it reads. Raises MeshError where that is that the file is not whole."""
    found = re.findall(r"Warning: (.+?)(?= (?:Warning|Error|Info): |$)", " ".join(said.split()))
    for text in found:
        if "not closed by" in text or "End-of-file" in text:
            raise MeshError(f"the file was cut off: {text}")
    return tuple(f"meshio says: {text}" for text in dict.fromkeys(found))


def _why(path: Path, error: BaseException, said: str) -> str:
    """What is wrong with a file that cannot be read, after "unreadable": what it was taken for, and a remedy."""
    suffix = path.suffix.lower()
    known = _format(suffix)
    found = _looks(path)
    if not known:
        what = f"the ending {path.suffix!r}" if suffix else "a name without ending"
        read = ", ".join(f"{name} ({', '.join(endings)})" for name, endings in FORMATS.items())
        text = f": {what} belongs to no format that is read: {read}"
    elif found == known == "gmsh" and not _ends_whole(path):
        return f" as {known}: it ends within a section: it was cut off"
    elif isinstance(error, SystemExit) and not _words(said, path):
        strange = "it holds something that is not known here"
        text = f" as {known}: {strange if found == known else 'it does not begin as such files do'}"
    else:
        text = f" as {known}: {_reason(error, said, path)}"
    if found in OF_NO_MESH:
        return f"{text}; {OF_NO_MESH[found]}"
    if found and found != known:
        return f"{text}; it looks like {found}: end its name in {FORMATS[found][0]}"
    if suffix in GEOMETRY:
        return f"{text}; {FILL}"
    return f"{text}; {SAVE_ANEW}" if found == "gmsh" or not known else text


def _format(suffix: str) -> str:
    """The format that a file is taken for by how its name ends; "" where there is none."""
    named = (name for name, endings in FORMATS.items() if suffix in endings)
    return next(named, "/".join(meshio.extension_to_filetypes.get(suffix, ())))


def _looks(path: Path) -> str:
    """What a file is, by how it begins; "" for what is not recognised."""
    try:
        with path.open("rb") as file:
            head = file.read(1000)
    except OSError:
        return ""
    return next((name for looks, name in LOOKS if re.match(looks, head)), "")


def _ends_whole(path: Path) -> bool:
    """Whether a gmsh file ends with the end of a section that it begins."""
    text = path.read_bytes()
    end = re.search(rb"\$End(\w+)\s*$", text[-200:])
    return end is not None and re.search(rb"\$" + end[1] + rb"\s", text) is not None


def _words(said: str, path: Path) -> str:
    """What meshio printed, without its last words that it could not read the file."""
    words = re.sub(r"Error: Couldn't read file .*$|Warning: ", "", " ".join(said.split()))
    return words.replace(str(path), path.name).strip(" .")


def _reason(error: BaseException, said: str, path: Path) -> str:
    """What a parser stumbled over, for someone who does not know the parser."""
    found = " ".join(str(error).split())
    match error:
        case MeshError():
            return found
        case ModuleNotFoundError():
            return f"that needs the Python package {error.name}: pip install {error.name}"
        case OSError():
            return error.strerror or "it cannot be opened"
        case KeyError():
            return f"it names {error.args[0]}, a node, cell or kind of cell that it does not have or is not known here"
        case UnicodeDecodeError():
            return "it is not text, as such files are"
        case ET.ParseError():
            return f"it is not XML, or was cut off: {found}"
        case MemoryError():
            return "it announces more than the memory holds: it is damaged"
        case SystemExit():
            return _words(said, path)
    if type(error).__name__ == "ReadError" and found:
        return found
    return "it was cut off, is damaged, or holds what is not known here"  # the parser's own words tell nothing

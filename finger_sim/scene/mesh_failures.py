"""Why a mesh cannot be read or used, in words: what a file was taken for, what is wrong with it, what to do.

meshio reports by printing, by leaving the process, and by whatever a parser stumbles over.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import meshio

from ..errors import MeshError

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
READ_BY_GMSH = {"gmsh", "Salome MED", "Medit", "NASTRAN", "legacy VTK"}
"""Formats of which gmsh may read what meshio does not."""
GEOMETRY = {".step", ".stp", ".iges", ".igs", ".brep", ".geo", ".stl", ".obj", ".ply", ".off"}
"""How the names of files end that describe a surface or a body, which has yet to be filled with tets."""

REMEDIES = {
    "unreferenced node": "leave out what no tet has",
    "duplicate node": "merge nodes at one place into one (gmsh: Coherence Mesh)",
    "duplicate tet": "keep one of each",
    "zero-volume tet": "take it out of the surface, or mesh again (gmsh: Optimize 3D)",
    "inverted tet": "number the nodes of all tets alike (swap two), or mesh again where the body is folded",
    "non-manifold face": "keep two of the tets at a face: bodies overlap, or were meshed twice",
    "disconnected piece": "keep one body, or join them by merging the nodes where they touch (gmsh: Coherence Mesh)",
    "not-orthonormal axes triad": "cell data axes are three unit vectors, at right angles, row by row",
    "left-handed axes triad": "reverse one axis of each",
}
"""What to do about defects of a mesh that was read, by their names."""

SAVE_ANEW = "gmsh, where it reads the file, saves it anew: gmsh FILE -save -format msh41 -o NEW.msh"
FILL = "fill the body with tetrahedra first: in gmsh, a Volume inside of the surface, then gmsh -3 FILE.geo -o FILE.msh"


def why(path: Path, error: BaseException, said: str) -> str:
    """What is wrong with a file that cannot be read, after "unreadable": what it was taken for, and a remedy."""
    suffix = path.suffix.lower()
    known = format_of(path)
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
    return f"{text}; {SAVE_ANEW}" if not known or (known in READ_BY_GMSH and found in ("", known)) else text


def format_of(path: Path) -> str:
    """The format that a file is taken for by how its name ends; "" where there is none."""
    suffix = path.suffix.lower()
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
        case KeyError() if len(found.split()) == 1:
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

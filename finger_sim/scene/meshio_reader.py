"""Files read by meshio, where its readers stop at the end of a file and take all files that gmsh writes."""

from __future__ import annotations

import contextlib
import io
import re
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import meshio
from meshio import _files as meshio_files
from meshio.gmsh import _gmsh40, _gmsh41
from meshio.tetgen import _tetgen

from ..errors import MeshError
from .mesh_failures import format_of

_ONE_AT_A_TIME = threading.Lock()
PATIENCE = 1000
"""Reads at the end of a file after which its reader is taken to go on for ever."""


def read_with_meshio(path: Path, said: io.StringIO) -> Any:
    """A meshio.Mesh; what meshio prints goes to `said`. Raises whatever meshio raises, SystemExit too."""
    with _ONE_AT_A_TIME, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), _mended():
        return meshio.read(*_source(path))


def warnings_of(said: str) -> tuple[str, ...]:
    """What meshio warns of while it reads. Raises MeshError where that is that the file is not whole."""
    found = re.findall(r"Warning: (.+?)(?= (?:Warning|Error|Info): |$)", " ".join(said.split()))
    for text in found:
        if "not closed by" in text or "End-of-file" in text:
            raise MeshError(f"the file was cut off: {text}")
    return tuple(f"meshio says: {text}" for text in dict.fromkeys(found))


def _source(path: Path) -> tuple[Any, ...]:
    """What meshio is to read: the file, or NASTRAN's bulk data between the lines that it must have.

    Without the last of them meshio would read on for ever.
    """
    if format_of(path) != "NASTRAN":
        return (path,)
    text = path.read_text(encoding="utf-8", errors="replace").rstrip() + "\n"
    begin = re.search(r"(?m)^BEGIN BULK", text)
    if begin is None and re.search(r"(?m)^GRID[ ,*]", text):
        text = f"BEGIN BULK\n{text}" + ("" if re.search(r"(?m)^ENDDATA", text) else "ENDDATA\n")
    elif begin is None or not re.search(r"(?m)^ENDDATA", text[begin.end() :]):
        raise MeshError("there is no BEGIN BULK with an ENDDATA after it: it was cut off, or is no NASTRAN file")
    return io.StringIO(text), "nastran"


class _Bytes(io.BufferedReader):
    """A file that is not read at its end for ever, as some readers do."""

    _empty = 0

    def readline(self, size: int | None = -1, /) -> bytes:
        return self._counted(super().readline(size))

    def read(self, size: int | None = -1, /) -> bytes:
        return self._counted(super().read(size))

    def _counted(self, found: bytes) -> bytes:
        self._empty = 0 if found else self._empty + 1
        if self._empty > PATIENCE:
            raise MeshError("it was cut off, or is damaged")
        return found


class _Text(io.TextIOWrapper):
    """The same for text."""

    _empty = 0

    def readline(self, size: int = -1, /) -> str:  # type: ignore[override]
        found = super().readline(size)
        self._empty = 0 if found else self._empty + 1
        if self._empty > PATIENCE:
            raise MeshError("it was cut off, or is damaged")
        return found


def _open(path: str | Path, mode: str = "r") -> IO[Any]:
    """As `open`; what is opened to be read is not read at its end for ever."""
    if mode not in ("r", "rb"):
        return open(path, mode)
    file = _Bytes(io.FileIO(path, "r"))
    return file if mode == "rb" else _Text(file)


def _mesh(points: Any, cells: Any, cell_data: Mapping[str, Any] | None = None, **more: Any) -> Any:
    """A meshio.Mesh without the cell data that some blocks of cells lack.

    gmsh writes cells of no physical group with "save all elements" (Mesh.SaveAll); meshio has no tag for these, and
    refuses the file. The names of the groups are in its cell sets all the same.
    """
    whole = {name: blocks for name, blocks in (cell_data or {}).items() if len(blocks) == len(cells)}
    return meshio.Mesh(points, cells, cell_data=whole, **more)


@contextlib.contextmanager
def _mended() -> Iterator[None]:
    """While this holds, meshio's readers open files by `_open`, and those of gmsh make their mesh by `_mesh`."""
    for module in (meshio_files, _tetgen):
        module.open = _open
    for module in (_gmsh40, _gmsh41):
        module.Mesh = _mesh
    try:
        yield
    finally:
        for module in (meshio_files, _tetgen):
            del module.open
        for module in (_gmsh40, _gmsh41):
            module.Mesh = meshio.Mesh

"""What may be fetched: the files of the page, and recordings that were made. Nothing else is looked for on a disk."""

from __future__ import annotations

import re
import tempfile
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import IO

PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/index.html": ("index.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/licences.txt": ("licences.txt", "text/plain; charset=utf-8"),
}
"""Path of a request: file of the bundle, and its type."""
RECORDINGS = "/recordings/"
_UNUSUAL = re.compile(r"[^A-Za-z0-9._-]")


def page_file(path: str) -> tuple[bytes, str] | None:
    """Content and type of a file of the page; None where there is none."""
    if path not in PAGE:
        return None
    name, kind = PAGE[path]
    try:
        return (files("finger_sim.view") / "bundle" / name).read_bytes(), kind
    except OSError:
        return None


class Recordings:
    """Recordings that can be fetched, by the name of their file."""

    def __init__(self) -> None:
        self._folders: dict[str, Path] = {}

    def add(self, folder: Path) -> tuple[str, int] | None:
        """Offers a finished recording: name of its file and its size [byte]; None where it is not on this machine.

        The file is the only one of the recording that holds messages, or a zip archive of the folder.
        """
        parts = sorted(folder.glob("*.mcap*")) if folder.is_dir() else []
        if not parts:
            return None
        stem = _UNUSUAL.sub("_", folder.name)
        name = f"{stem}{''.join(parts[0].suffixes)}" if len(parts) == 1 else f"{stem}.zip"
        self._folders[name] = folder
        size = sum(part.stat().st_size for part in parts)
        return name, size

    def open(self, name: str) -> IO[bytes] | None:
        """The file of that name, to be read and closed; None where there is none. Making an archive takes a while."""
        folder = self._folders.get(name)
        if folder is None:
            return None
        try:
            if not name.endswith(".zip"):
                return next(iter(sorted(folder.glob("*.mcap*")))).open("rb")
            archive = tempfile.TemporaryFile()  # noqa: SIM115
            with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as packed:
                for part in sorted(folder.iterdir()):
                    packed.write(part, f"{folder.name}/{part.name}")
            archive.seek(0)
            return archive
        except (OSError, StopIteration):
            return None

"""What a file or a message is by its first bytes, whatever its name says; and what is compressed, unpacked."""

from __future__ import annotations

import shutil
import tempfile
import weakref
import zlib
from pathlib import Path
from typing import Any, Literal, NamedTuple

from ..errors import BagError

Kind = Literal["mcap", "sqlite3", "ros1", "zstd", "lz4", "gzip"]
MCAP_MAGIC = b"\x89MCAP0\r\n"
_MAGICS: dict[bytes, Kind] = {
    MCAP_MAGIC: "mcap",
    b"SQLite format 3\0": "sqlite3",
    b"#ROSBAG V": "ros1",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x04\x22\x4d\x18": "lz4",
    b"\x1f\x8b": "gzip",
}
PACKED: tuple[Kind, ...] = ("zstd", "lz4", "gzip")
"""Kinds that hold another, compressed. No message in CDR begins as one of them does."""
_BLOCK = 1 << 14
"""Compressed bytes that are unpacked at once: of a damaged file, so many are lost before the damage [byte]."""
_SLICE = 1 << 10
"""Compressed bytes of a chunk that are unpacked before it is asked how many they became [byte]."""


class PackingError(Exception):
    """Compressed bytes that are not whole."""


class Stored(NamedTuple):
    """A file of a bag."""

    name: Path
    """What a user knows it by."""
    path: Path
    """Where its bytes are, unpacked."""
    kind: Kind | None
    damage: str | None = None
    """Why it is not whole, if it is known already."""


class Scratch:
    """A folder for unpacked files, made when it is needed; it goes with this object, or with the process."""

    def __init__(self) -> None:
        self._folder: Path | None = None

    def place(self, name: str) -> Path:
        """A new path for a file of that name."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="finger_sim_bag_"))
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        return Path(tempfile.mkdtemp(dir=self._folder)) / name


def kind_of(head: bytes) -> Kind | None:
    """What begins with these bytes; None for anything else."""
    return next((kind for magic, kind in _MAGICS.items() if head.startswith(magic)), None)


def kind_of_file(path: Path) -> Kind | None:
    """What a file is. Raises OSError when it cannot be read."""
    with path.open("rb") as stream:
        return kind_of(stream.read(max(map(len, _MAGICS))))


def stored(path: Path, scratch: Scratch) -> Stored:
    """A file of a bag, unpacked if it is compressed: as far as it can be. Raises OSError and BagError."""
    kind = kind_of_file(path)
    if kind not in PACKED:
        return Stored(path, path, kind)
    inside = scratch.place(path.stem)
    damage = None
    try:
        _unpack(path, inside, kind)
    except PackingError as error:
        damage = f"{path}: {error}"
    except OSError as error:
        raise BagError(f"{path}: cannot be unpacked to {inside.parent} (see TMPDIR): {error.strerror}") from None
    held = kind_of_file(inside)
    if held not in ("mcap", "sqlite3"):
        what = damage or f"{path}: holds no MCAP and no sqlite3 file, compressed as {kind}"
        raise BagError(f"{what}; nothing can be read")
    return Stored(path, inside, held, damage)


def inflated(data: bytes, kind: Kind, most: int | None = None) -> bytes:
    """The bytes that are compressed in others. Raises PackingError where these are not whole, or more than `most`."""
    parts: list[bytes] = []
    at = size = 0
    engine: Any = None
    while at < len(data):
        engine = engine or _engine(kind)
        block = data[at : at + _SLICE]
        parts.append(_fed(engine, block, kind))
        at, size = at + len(block), size + len(parts[-1])
        if most is not None and size > most:
            raise PackingError(f"{kind} data of more than the {most} bytes that it should have")
        if engine.eof:
            at, engine = at - len(engine.unused_data or b""), None
    if engine is not None:
        raise PackingError(f"{kind} data that is cut off")
    return b"".join(parts)


def _unpack(source: Path, target: Path, kind: Kind) -> None:
    """Unpacks a file, block by block: what comes before a damaged place is in `target` when PackingError is raised."""
    engine: Any = None
    with source.open("rb") as packed, target.open("wb") as out:
        while block := packed.read(_BLOCK):
            while block:
                engine = engine or _engine(kind)
                out.write(_fed(engine, block, kind))
                block = b""
                if engine.eof:
                    block, engine = engine.unused_data or b"", None
    if engine is not None:
        raise PackingError(f"{kind} data that is cut off")


def _engine(kind: Kind) -> Any:
    """A decompressor of one frame: `decompress`, `eof`, `unused_data`."""
    if kind == "zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompressobj()
    if kind == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor()
    return zlib.decompressobj(zlib.MAX_WBITS | 16)


def _fed(engine: Any, data: bytes, kind: Kind) -> bytes:
    try:
        out: bytes = engine.decompress(data)
    except Exception as error:  # each library has its own, and none that both have
        raise PackingError(f"damaged {kind} data ({str(error) or type(error).__name__})") from None
    return out

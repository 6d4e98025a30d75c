"""Changes of a file's bytes, as disks, transfers and people make them, and as nobody but a tester does."""

from __future__ import annotations

from typing import NamedTuple

from .damage import MAGIC, chunks, records
from .formats import CODECS

BOMB = 1 << 29
"""Bytes that a compressed chunk turns out to have."""


KINDS = ("flip", "byte", "cut", "zero", "delete", "insert", "double", "number", "text", "splice")
NUMBERS = (0, 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63, 2**64 - 1)
"""What stands where a length or a count should be."""
TEXTS = (
    "", "null", "[]", "{}", "-1", "1e999", "9" * 5000, "2026-13-45", "!!python/object:os.system x", "*a", "&a [*a]",
    '"\\ud800"', "yes", "\x00", "[" * 3000, ".nan", "0x", "? a", "'", "../../etc/passwd", "recording_0.mcap", "zstd",
    "FILE", "MESSAGE", "sqlite3", "mcap",
)  # fmt: skip
"""What stands for a value in a metadata.yaml."""


class Change(NamedTuple):
    """One change of a file's bytes; `at`, `length` and `value` are taken as far as they fit."""

    kind: str
    at: int
    length: int
    value: int


def changed(data: bytes, change: Change, other: bytes) -> bytes:
    """The bytes after a change; `other` are those that are spliced in."""
    at = change.at % (len(data) + 1)
    length = 1 + change.length % max(1, len(data))
    head, rest = data[:at], data[at:]
    if change.kind == "number":
        places = marks(data)
        at, width = places[change.at % len(places)]
        number = NUMBERS[change.value % len(NUMBERS)] & ((1 << 8 * width) - 1)
        order = "big" if data.startswith(b"SQLite") else "little"
        return data[:at] + number.to_bytes(width, order) + data[at + width :]
    if change.kind == "bomb":
        return with_bomb(data, change.at)
    if change.kind == "text":
        lines = data.split(b"\n")
        line = lines[change.at % len(lines)]
        text = TEXTS[change.value % len(TEXTS)].encode(errors="surrogatepass")
        lines[change.at % len(lines)] = line.partition(b":")[0] + b": " + text if b":" in line else text
        return b"\n".join(lines)
    return {
        "flip": head + bytes([rest[0] ^ 1 << change.value % 8] if rest else []) + rest[1:],
        "byte": head + bytes([change.value] if rest else []) + rest[1:],
        "cut": head,
        "zero": head + bytes(len(rest[:length])) + rest[length:],
        "delete": head + rest[length:],
        "insert": head + bytes((change.value + 37 * i) % 256 for i in range(length)) + rest,
        "double": head + rest[:length] + rest,
        "splice": head + other[at:],
    }[change.kind]


def with_bomb(data: bytes, number: int) -> bytes:
    """An MCAP file one of whose chunks is of many zeros, and says that it has few bytes."""
    chunk = chunks(data)[number]
    name = data[chunk.begin + 41 : chunk.inside - 8]
    zeros = bytes(BOMB >> 3)
    body = b"".join([CODECS["zstd" if name == b"zstd" else "lz4"](zeros)] * 8)
    head = data[chunk.begin + 9 : chunk.inside - 8] + len(body).to_bytes(8, "little")
    record = b"\x06" + (len(head) + len(body)).to_bytes(8, "little") + head + body
    return data[: chunk.begin] + record + data[chunk.end :]


def marks(data: bytes) -> list[tuple[int, int]]:
    """Where lengths and counts stand in a file, and how many bytes they have."""
    found: list[tuple[int, int]] = []
    if data.startswith(MAGIC):
        found += [(record.begin + 1, 8) for record in records(data)]
        for chunk in chunks(data):
            found += [(chunk.begin + 25, 8), (chunk.begin + 33, 4), (chunk.begin + 37, 4), (chunk.inside - 8, 8)]
        found += [(record.begin + 9 + i, 4) for record in records(data) if record.opcode in (3, 4) for i in (2, 4, 8)]
    elif data.startswith(b"SQLite"):
        found += [(16, 2), (20, 1), *((place, 4) for place in (24, 28, 32, 36, 40, 44, 52, 56, 60))]
        for page in range(0, len(data), 4096):
            head = page or 100
            found += [(head + place, 2) for place in (1, 3, 5, 8, 10, 12, 14)] + [(head + 8, 4), (page + 4090, 4)]
    found += [(place, 4) for place in range(0, 36, 4)]
    return [(at, width) for at, width in found if at + width <= len(data)] or [(0, 0)]

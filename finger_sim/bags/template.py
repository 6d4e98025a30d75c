"""Messages whose shape does not change: serialised once, filled many times.

The places of a message's numbers are found by marks; each time stamp and numbers are written into its bytes, which are
published and recorded as they are. That costs a fifth of filling and serialising the message, and a number can only
ever be written as the float64 or float32 that the field is.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bytes, Floats

_STAMP = struct.Struct("<iI")
STAMP_OFFSET = 4
"""Where a message that begins with a header or a time has its stamp: after the 4 bytes that name the encoding."""


class Template:
    """The CDR bytes of a message whose numbers change and whose shape does not.

    data   : the message, which holds the `marks`
    marks  : bytes of each block of numbers as the message holds it, each found exactly once
    stamps : where it has stamps, which are all filled with the same time

    bytes  : (n,) the message as it was filled last; whoever writes here fills it too
    blocks : where each block of numbers begins
    """

    def __init__(self, data: bytes, *marks: bytes, stamps: Sequence[int] = (STAMP_OFFSET,)) -> None:
        assert data[:2] == b"\x00\x01", "little-endian CDR"
        assert all(data.count(mark) == 1 for mark in marks), "marks that occur once"
        self._bytes = bytearray(data)
        self.bytes: Bytes = np.frombuffer(self._bytes, np.uint8)
        self._stamps = tuple(stamps)
        self._places = [slice(at := data.index(mark), at + len(mark)) for mark in marks]
        self.blocks = tuple(place.start for place in self._places)

    def fill(self, stamp: int, *blocks: bytes) -> bytes:
        """The message at `stamp` [ns] with its blocks replaced by others of the same length."""
        time = divmod(stamp, 1_000_000_000)
        for at in self._stamps:
            _STAMP.pack_into(self._bytes, at, *time)
        for place, block in zip(self._places, blocks, strict=True):
            if len(block) != place.stop - place.start:
                raise ValueError(f"a block of {len(block)} bytes where {place.stop - place.start} belong")
            self._bytes[place] = block
        return bytes(self._bytes)


def doubles(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Numbers as the bytes of float64 fields."""
    return np.asarray(values, dtype="<f8").tobytes()


def marks(count: int) -> Floats:
    """Numbers that no field has by default, all different."""
    return 1e9 + np.arange(1.0, count + 1.0) * 1024.0


def stamp_bytes(stamp: int) -> bytes:
    """A time [ns] as messages hold it."""
    return _STAMP.pack(*divmod(stamp, 1_000_000_000))

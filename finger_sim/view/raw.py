"""Numbers out of the CDR bytes of the node's messages, without a message object for each."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bags.layout import FLOAT, FLOAT32, POINT_FIELDS, POINT_NAMES, POINT_STEP
from ..bags.template import STAMP_OFFSET
from ..errors import FingerSimError

_STAMP = struct.Struct("<iI")
_WORD = struct.Struct("<I")
_LITTLE = b"\x00\x01"
_WRENCH = struct.Struct("<6d")


class Cloud(NamedTuple):
    """Points of the mesh at a moment."""

    stamp: int
    """[ns]"""
    points: NDArray[np.float32]
    """(n, 10) columns as POINT_NAMES: position [m], displacement [m], contact force [N], strain / limit."""


class CloudReader:
    """Reads clouds; how the messages of one node are laid out is found once."""

    def __init__(self) -> None:
        self._length, self._at, self._bytes = -1, 0, 0

    def read(self, data: bytes) -> Cloud:
        """The cloud in a PointCloud2 of the node. Raises FingerSimError for any other."""
        if len(data) != self._length:
            self._at, self._bytes = _points_of(data)
            self._length = len(data)
        points = np.frombuffer(data, FLOAT, self._bytes // FLOAT.itemsize, self._at)
        return Cloud(stamp_of(data), points.reshape(-1, len(POINT_NAMES)))


def stamp_of(data: bytes) -> int:
    """Stamp of a message that begins with a header [ns]."""
    seconds, nanoseconds = _STAMP.unpack_from(data, STAMP_OFFSET)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def read_wrench(data: bytes) -> tuple[str, tuple[float, ...]]:
    """frame_id, and force and torque (6,) [N, N m], of a WrenchStamped. Raises FingerSimError for what is none."""
    try:
        if data[:2] != _LITTLE:
            raise ValueError
        name, at = _string(data, STAMP_OFFSET + _STAMP.size)
        return name, _WRENCH.unpack_from(data, at + (STAMP_OFFSET - at) % 8)
    except (struct.error, ValueError):
        raise FingerSimError(f"{len(data)} bytes that are no WrenchStamped") from None


def _points_of(data: bytes) -> tuple[int, int]:
    """Where in a PointCloud2 the points begin, and how many bytes they are."""
    try:
        if data[:2] != _LITTLE:
            raise ValueError
        _, at = _string(data, STAMP_OFFSET + _STAMP.size)
        at = _aligned(at)
        _, _, count = struct.unpack_from("<3I", data, at)
        at += 12
        fields = []
        for _ in range(min(count, len(POINT_FIELDS) + 1)):
            name, at = _string(data, _aligned(at))
            offset, kind, _ = struct.unpack_from("<IB3xI", data, at := _aligned(at))
            fields.append((name, offset, kind))
            at += 12
        (big,) = struct.unpack_from("<B", data, at)
        step, _, length = struct.unpack_from("<3I", data, at := _aligned(at + 1))
        wanted = [(name, offset, FLOAT32) for name, offset in POINT_FIELDS]
        if big or fields != wanted or step != POINT_STEP or length % step or at + 12 + length > len(data):
            raise ValueError
    except (struct.error, ValueError):
        raise FingerSimError(f"mesh_points: {len(data)} bytes that are no cloud of finger_sim's node") from None
    return at + 12, length


def _string(data: bytes, at: int) -> tuple[str, int]:
    """A string at a multiple of four, and where it ends."""
    (length,) = _WORD.unpack_from(data, at)
    end = at + 4 + length
    if end > len(data):
        raise ValueError
    return bytes(data[at + 4 : end]).partition(b"\0")[0].decode(errors="replace"), end


def _aligned(at: int) -> int:
    """The next multiple of four, counted as all CDR here from byte 4 on."""
    return at + -at % 4

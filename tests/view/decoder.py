"""Binary messages of the page's server, read from their bytes as the protocol says: no code of finger_sim."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass
class DecodedTopology:
    """Kind 1."""

    generation: int
    rest: Any
    triangles: Any
    tets: Any
    flags: list[int]
    known: int
    axes: Any
    limits: Any


@dataclass
class DecodedFrame:
    """Kind 2."""

    generation: int
    seq: int
    time: float
    status: int
    flags: int
    floats: tuple[float, ...]
    positions: Any
    strain: list[int]
    contacts: list[tuple[Any, ...]]
    samples: list[tuple[float, ...]]

    @property
    def pose(self) -> tuple[float, ...]:
        return self.floats[0:7]

    @property
    def force(self) -> tuple[float, ...]:
        return self.floats[21:24]


def kind_of(data: bytes) -> int:
    return int(struct.unpack_from("<I", data)[0])


def decode_topology(data: bytes) -> DecodedTopology:
    kind, generation, n, f, t, known, zero, also = struct.unpack_from("<8I", data)
    assert (kind, zero, also) == (1, 0, 0)
    at = 32
    rest = np.array(struct.unpack_from(f"<{3 * n}f", data, at)).reshape(n, 3)
    at += 12 * n
    triangles = np.array(struct.unpack_from(f"<{3 * f}I", data, at)).reshape(f, 3)
    at += 12 * f
    tets = np.array(struct.unpack_from(f"<{4 * t}I", data, at)).reshape(t, 4)
    at += 16 * t
    flags = list(data[at : at + n])
    at += n + -n % 4
    axes = limits = None
    if known & 2:
        axes = np.array(struct.unpack_from(f"<{9 * t}f", data, at)).reshape(t, 3, 3)
        limits = np.array(struct.unpack_from("<6f", data, at + 36 * t)).reshape(3, 2)
        at += 36 * t + 24
    assert at == len(data)
    return DecodedTopology(generation, rest, triangles, tets, flags, known, axes, limits)


def decode_frame(data: bytes) -> DecodedFrame:
    kind, generation, seq, n, time, c, s, status, flags = struct.unpack_from("<4Id4I", data)
    assert kind == 2
    floats = struct.unpack_from("<38f", data, 40)
    assert data[40 + 4 * 38 : 256] == bytes(256 - 40 - 4 * 38)
    at = 256
    positions = np.array(struct.unpack_from(f"<{3 * n}f", data, at)).reshape(n, 3)
    at += 12 * n
    strain = list(data[at : at + n])
    at += n + -n % 4
    contacts = []
    for k in range(c):
        node, x, y, z, slips = struct.unpack_from("<I3fI", data, at + 20 * k)
        contacts.append((node, (x, y, z), slips))
    at += 20 * c
    samples = [struct.unpack_from("<5f", data, at + 20 * k) for k in range(s)]
    assert at + 20 * s == len(data)
    return DecodedFrame(generation, seq, time, status, flags, floats, positions, strain, contacts, samples)

"""Binary messages to the page: topology and frames, little-endian. What is not known is NaN, or has no flag."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

VERSION = 2
"""Of what page and server say to each other."""
TOPOLOGY, FRAME = 1, 2
"""First word of each kind."""
NODE_FLAGS_KNOWN, AXES_KNOWN = 1, 2
"""Flags of a topology."""
BONE, NAIL, PAD, BASE = 1, 2, 4, 8
"""Flags of a node."""
COMMAND_KNOWN, PLANE_KNOWN, DEVICE_KNOWN, VIRTUAL, RESTART = 1, 2, 4, 8, 16
"""Flags of a frame; RESTART: its samples replace all that came before."""
FRAME_HEADER = 256
AT_LIMIT = 128
"""What a byte of strain says for a strain at its limit."""

_TOPOLOGY = struct.Struct("<8I")
_FRAME = struct.Struct("<4Id4I")
_FLOATS = struct.Struct(f"<38f{FRAME_HEADER - _FRAME.size - 4 * 38}x")
_UNKNOWN = [math.nan] * 7

CONTACT = np.dtype([("node", "<u4"), ("force", "<f4", 3), ("slips", "<u4")])
"""A node in contact: force of the plane on it [N], world; 0 sticks, 1 slips."""
NO_CONTACT = np.zeros(0, CONTACT)
SAMPLE = np.dtype([(name, "<f4") for name in ("time", "normal", "tangential", "device", "depth")])
"""Forces [N] at a time [s] relative to the frame's, and depth [mm]."""


@dataclass
class Topology:
    """A mesh at rest, finger frame.

    rest       : (N, 3) nodes [m]
    triangles  : (F, 3) its surface, counter-clockwise seen from outside
    tets       : (T, 4)
    node_flags : (N,) BONE and so on; None: not known
    axes       : (T, 3, 3) rows e1 e2 e3 of each tetrahedron; None: not known
    limits     : (3, 2) largest and smallest stretch along each; NaN: free
    """

    rest: NDArray[np.float64]
    triangles: NDArray[np.int32]
    tets: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 4), np.int32))
    node_flags: NDArray[np.uint8] | None = None
    axes: NDArray[np.float64] | None = None
    limits: NDArray[np.float64] = field(default_factory=lambda: np.full((3, 2), np.nan))


@dataclass
class Picture:
    """The finger at one moment, world axes, SI.

    time       : of its stamp [s]; of a recording: since its start
    positions  : (N, 3) float32, little-endian
    strain     : (N,) strain / limit
    pose       : (7,) of the finger frame, as command and plane: position and x y z w; None: not known
    wrench     : (6,) force and torque of the plane on the finger, about the finger frame's origin
    device     : (6,) force and torque that a device renders
    centre     : (3,) centre of pressure; None: nothing touches
    These few numbers are plain ones: arrays of them take longer to make than to send.
    depth      : how far the undeformed finger is below the plane, ≥ 0
    contacts   : (C,) of CONTACT
    status     : bits of `physics.step.Status`
    """

    time: float
    positions: NDArray[np.float32]
    strain: NDArray[np.float32]
    pose: Sequence[float] | None = None
    command: Sequence[float] | None = None
    plane: Sequence[float] | None = None
    wrench: Sequence[float] | None = None
    device: Sequence[float] | None = None
    centre: Sequence[float] | None = None
    friction: float = np.nan
    depth: float = 0.0
    contacts: NDArray[np.void] = field(default_factory=lambda: NO_CONTACT)
    status: int = 0
    virtual: bool = False


def pack_topology(generation: int, mesh: Topology) -> bytes:
    """Message of kind TOPOLOGY."""
    flags = (NODE_FLAGS_KNOWN if mesh.node_flags is not None else 0) | (AXES_KNOWN if mesh.axes is not None else 0)
    nodes, triangles, tets = len(mesh.rest), len(mesh.triangles), len(mesh.tets)
    node_flags = np.zeros(nodes, np.uint8) if mesh.node_flags is None else mesh.node_flags
    parts = [
        _TOPOLOGY.pack(TOPOLOGY, generation, nodes, triangles, tets, flags, 0, 0),
        mesh.rest.astype("<f4").tobytes(),
        mesh.triangles.astype("<u4").tobytes(),
        mesh.tets.astype("<u4").tobytes(),
        _padded(node_flags.astype(np.uint8).tobytes()),
    ]
    if mesh.axes is not None:
        parts += [mesh.axes.astype("<f4").tobytes(), mesh.limits.astype("<f4").tobytes()]
    return b"".join(parts)


class Frame:
    """One picture as a message of kind FRAME: made once, sent to each client with the samples that it lacks."""

    def __init__(self, generation: int, seq: int, picture: Picture) -> None:
        self.generation, self.seq, self.picture = generation, seq, picture
        parts = (
            (picture.pose, 7), (picture.command, 7), (picture.plane, 7), (picture.wrench, 6), (picture.device, 6),
            (picture.centre, 3),
        )  # fmt: skip
        floats: list[float] = []
        for values, count in parts:
            floats.extend(_UNKNOWN[:count] if values is None else values)
        self._floats = _FLOATS.pack(*floats, picture.friction, picture.depth)
        strain = np.minimum(picture.strain * AT_LIMIT + 0.5, 255.0).astype(np.uint8)
        self._body = b"".join((picture.positions.tobytes(), _padded(strain.tobytes()), picture.contacts.tobytes()))
        self._flags = (
            (COMMAND_KNOWN if picture.command is not None else 0)
            | (PLANE_KNOWN if picture.plane is not None else 0)
            | (DEVICE_KNOWN if picture.device is not None else 0)
            | (VIRTUAL if picture.virtual else 0)
        )

    def message(self, samples: bytes, restart: bool = False) -> bytes:
        """The frame with the bytes of samples (S,) of SAMPLE; restart: they replace all that came before."""
        picture = self.picture
        head = _FRAME.pack(
            FRAME, self.generation, self.seq, len(picture.positions), picture.time, len(picture.contacts),
            len(samples) // SAMPLE.itemsize, picture.status, self._flags | (RESTART if restart else 0),
        )  # fmt: skip
        return b"".join((head, self._floats, self._body, samples))


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)

"""Binary messages to the page: topology and frames, little-endian. What is not known is NaN, or has no flag."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

VERSION = 1
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
_FLOATS = 38

CONTACT = np.dtype([("node", "<u4"), ("force", "<f4", 3), ("slips", "<u4")])
"""A node in contact: force of the plane on it [N], world; 0 sticks, 1 slips."""
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
    positions  : (N, 3) float32
    strain     : (N,) strain / limit
    pose       : (7,) of the finger frame, as command and plane: position and x y z w; None: not known
    wrench     : (6,) force and torque of the plane on the finger, about the finger frame's origin
    device     : (6,) force and torque that a device renders
    centre     : (3,) centre of pressure; None: nothing touches
    depth      : how far the undeformed finger is below the plane, ≥ 0
    contacts   : (C,) of CONTACT
    status     : bits of `physics.step.Status`
    """

    time: float
    positions: NDArray[np.float32]
    strain: NDArray[np.float32]
    pose: NDArray[np.float64] | None = None
    command: NDArray[np.float64] | None = None
    plane: NDArray[np.float64] | None = None
    wrench: NDArray[np.float64] | None = None
    device: NDArray[np.float64] | None = None
    centre: NDArray[np.float64] | None = None
    friction: float = np.nan
    depth: float = 0.0
    contacts: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, CONTACT))
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
        floats = np.full(_FLOATS, np.nan, "<f4")
        parts = (
            (picture.pose, 0, 7), (picture.command, 7, 14), (picture.plane, 14, 21), (picture.wrench, 21, 27),
            (picture.device, 27, 33), (picture.centre, 33, 36),
        )  # fmt: skip
        for values, begin, end in parts:
            if values is not None:
                floats[begin:end] = values
        floats[36], floats[37] = picture.friction, picture.depth
        self._floats = floats.tobytes().ljust(FRAME_HEADER - _FRAME.size, b"\0")
        strain = np.clip(picture.strain * AT_LIMIT + 0.5, 0.0, 255.0).astype(np.uint8)
        self._body = b"".join(
            (picture.positions.astype("<f4").tobytes(), _padded(strain.tobytes()), picture.contacts.tobytes())
        )
        self._flags = (
            (COMMAND_KNOWN if picture.command is not None else 0)
            | (PLANE_KNOWN if picture.plane is not None else 0)
            | (DEVICE_KNOWN if picture.device is not None else 0)
            | (VIRTUAL if picture.virtual else 0)
        )

    def message(self, samples: NDArray[np.void], restart: bool = False) -> bytes:
        """The frame with these samples (S,) of SAMPLE; restart: they replace all that came before."""
        picture = self.picture
        head = _FRAME.pack(
            FRAME, self.generation, self.seq, len(picture.positions), picture.time, len(picture.contacts),
            len(samples), picture.status, self._flags | (RESTART if restart else 0),
        )  # fmt: skip
        return b"".join((head, self._floats, self._body, samples.tobytes()))


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)

"""The numbers in messages: what they measure, and how far two of them are apart."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..errors import BagError
from . import cdr
from .layout import POINT_DTYPE, POINT_NAMES


class Value(NamedTuple):
    """The numbers of one message, by quantity, each (n, d)."""

    frame: str
    parts: tuple[Floats, ...]


class Kind(NamedTuple):
    """Quantities in a type of message, with their units, and how to get at them."""

    quantities: tuple[tuple[str, str], ...]
    value: Callable[[Any], Value]


def _wrench(message: Any) -> Value:
    f, t = message.wrench.force, message.wrench.torque
    return Value(message.header.frame_id, (np.array([[f.x, f.y, f.z]]), np.array([[t.x, t.y, t.z]])))


def _pose(message: Any) -> Value:
    p, q = message.pose.position, message.pose.orientation
    return Value(message.header.frame_id, (np.array([[p.x, p.y, p.z]]), np.array([[q.x, q.y, q.z, q.w]])))


def _cloud(message: Any) -> Value:
    names = [field.name for field in message.fields]
    if names != list(POINT_NAMES) or message.point_step != POINT_DTYPE.itemsize:
        raise BagError(f"point fields {', '.join(names)} cannot be compared, allowed: {', '.join(POINT_NAMES)}")
    points = message.data.view("<f4").reshape(-1, len(POINT_NAMES)).astype(np.float64)
    return Value(message.header.frame_id, (points[:, 0:3], points[:, 3:6], points[:, 6:9], points[:, 9:]))


def _mesh(message: Any) -> Value:
    vertices = np.array([[v.x, v.y, v.z] for v in message.vertices]).reshape(-1, 3)
    triangles = np.array([t.vertex_indices for t in message.triangles], dtype=np.float64).reshape(-1, 3)
    return Value("", (vertices, triangles))


TURN = ("orientation", "rad")
KINDS = {
    cdr.WRENCH_STAMPED: Kind((("force", "N"), ("torque", "N·m")), _wrench),
    cdr.POSE_STAMPED: Kind((("position", "m"), TURN), _pose),
    cdr.POINT_CLOUD: Kind((("points", "m"), ("displacement", "m"), ("force", "N"), ("strain/limit", "1")), _cloud),
    cdr.MESH: Kind((("vertices", "m"), ("triangles", "1")), _mesh),
}


@np.errstate(all="ignore")  # numbers of recordings may be any: what is none is infinitely far away
def apart_by(one: Value, low: Value, high: Value, share: float, i: int, turn: bool) -> Floats:
    """(n,) distances of part i of `one` from what lies between `low` and `high`; inf where there is none."""
    a, b, c = one.parts[i], low.parts[i], high.parts[i]
    if not (a.shape == b.shape == c.shape and one.frame == low.frame == high.frame):
        return np.full(max(len(a), 1), np.inf)
    if turn:
        a, b, c = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b, c))
        c = np.where((b * c).sum(axis=1, keepdims=True) < 0.0, -c, c)
    between = (1.0 - share) * b + share * c if share > 0.0 else b
    if turn:
        chord = np.minimum(np.linalg.norm(a - between, axis=1), np.linalg.norm(a + between, axis=1))
        apart = 4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    else:
        apart = np.linalg.norm(a - between, axis=1)
    return np.where(np.isnan(apart), np.inf, apart)


@np.errstate(all="ignore")
def largest_of(part: Floats, turn: bool) -> float:
    """Length of the longest row; of a turn its angle from the identity [rad]."""
    if turn:
        vector, scalar = np.linalg.norm(part[:, :3], axis=1), np.abs(part[:, 3])
        return float(2.0 * np.arctan2(vector, scalar).max(initial=0.0))
    return float(np.linalg.norm(part, axis=1).max(initial=0.0))

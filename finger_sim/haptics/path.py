"""A path through poses: straight between them, and its mean over a window of time.

What it is made of lies in a record of arrays (`Path`), and compiled code works on that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..physics.compile import formula, stage
from ..physics.turns import Quaternion, angle, normalised, slerp
from ..scene import Pose

Numbers = tuple[float, float, float, float, float, float, float]
"""Position [m] and quaternion x y z w of a pose."""

FINE_TURN = 0.2
"""Turns above this are split [rad]: straight lines between the quaternions are then slerp to 1e-4 rad."""

SHORT = 1e-6
"""Time in which no turn is split [s]."""
KNOTS = 4096
"""Most that a path holds, a power of two: those of 0.25 s at 10 kHz, with room for turns that are split."""
_FINE = math.cos(0.5 * FINE_TURN)


class Path(NamedTuple):
    """Poses at times that grow; before the first and after the last it stands.

    Quaternions are averaged as numbers, each on the side of the one before: over a window they are near to each other.
    Knots are numbered; number k lies in row k % KNOTS. A path that is full forgets its last knot when another is
    appended: it goes straight from the one before to the new one.

    time : (KNOTS,) of each knot [s]
    at   : (KNOTS, 7) numbers of its pose, the quaternion on the side of the one before
    side : (KNOTS,) 1; -1 where the quaternion is that of the pose times -1
    kept : (2,) number of the first knot, and the number that the next will have
    """

    time: Floats
    at: Floats
    side: Floats
    kept: Ints


def build_path() -> Path:
    """One without knots; `set_out` gives it the first."""
    return Path(np.zeros(KNOTS), np.zeros((KNOTS, 7)), np.ones(KNOTS), np.zeros(2, np.int64))


def numbers(pose: Pose) -> Numbers:
    """Position and quaternion of a pose."""
    return (*pose.position, *pose.orientation)


def pose_of(at: Floats) -> Pose:
    """The pose of seven numbers."""
    x, y, z, a, b, c, d = at.tolist()
    return Pose((x, y, z), (a, b, c, d))


@stage
def turn(at: Numbers) -> Quaternion:
    """The quaternion among the numbers of a pose."""
    return at[3], at[4], at[5], at[6]


@stage
def on_side(at: Numbers, side: float) -> Numbers:
    """The same orientation by q, or by -q."""
    return at[0], at[1], at[2], side * at[3], side * at[4], side * at[5], side * at[6]


@stage
def side_near(at: Numbers, near: Numbers) -> float:
    """1; -1 where -q is nearer than q to the quaternion of `near`."""
    return -1.0 if at[3] * near[3] + at[4] * near[4] + at[5] * near[5] + at[6] * near[6] < 0.0 else 1.0


@stage
def mix(a: Numbers, b: Numbers, share: float) -> Numbers:
    """On the straight line from a to b, whose quaternions are near to each other; not normalised."""
    return (
        a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2]),
        a[3] + share * (b[3] - a[3]), a[4] + share * (b[4] - a[4]), a[5] + share * (b[5] - a[5]),
        a[6] + share * (b[6] - a[6]),
    )  # fmt: skip


@stage
def distance(a: Numbers, b: Numbers) -> float:
    """Between the seven numbers of two poses."""
    return math.hypot(
        a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5], a[6] - b[6]
    )  # fmt: skip


@stage
def with_unit_turn(at: Numbers) -> Numbers:
    """With a unit quaternion."""
    x, y, z, w = normalised(turn(at))
    return at[0], at[1], at[2], x, y, z, w


@formula
def read(row: Floats) -> Numbers:
    """The seven numbers in a row."""
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6]


@formula
def write(row: Floats, at: Numbers) -> None:
    """Seven numbers into a row."""
    row[0], row[1], row[2], row[3], row[4], row[5], row[6] = at


@stage
def keep_among(heard: Floats, kept: int, time: float, at: Numbers) -> int:
    """A pose and its time after `kept` rows of `heard` (…, 8); where these are all, the first goes. How many then."""
    if kept == heard.shape[0]:
        kept -= 1
        for k in range(kept):
            write(heard[k], read(heard[k + 1]))
            heard[k, 7] = heard[k + 1, 7]
    write(heard[kept], at)
    heard[kept, 7] = time
    return kept + 1


@formula
def clear(row: Floats) -> None:
    """Seven zeros into a row."""
    for i in range(7):
        row[i] = 0.0


@stage
def set_out(path: Path, time: float, pose: Numbers) -> None:
    """Nothing but one pose, at a time [s]."""
    path.kept[0] = 0
    path.kept[1] = 0
    _put(path, time, pose, 1.0)


@stage
def pass_by(path: Path, time: float, before: Numbers, pose: Numbers, dt: float, window: float) -> None:
    """One whose mean over a window up to a time [s] is at `pose`, as fast as from `before` there in `dt` [s]."""
    was = on_side(before, side_near(before, pose))
    ahead = 0.5 * window / dt
    set_out(path, time - window, with_unit_turn(mix(pose, was, ahead)))
    append(path, time, with_unit_turn(mix(pose, was, -ahead)))


@formula
def end_of(path: Path) -> float:
    """Time of the last knot [s]."""
    time: float = path.time[(path.kept[1] - 1) % KNOTS]
    return time


@stage
def last_numbers(path: Path) -> Numbers:
    """Of the last pose, on the side of the one before."""
    return _at(path, path.kept[1] - 1)


@stage
def last_pose(path: Path) -> Numbers:
    """The last pose, as it was appended."""
    return _pose(path, path.kept[1] - 1)


@stage
def append(path: Path, time: float, pose: Numbers) -> None:
    """On to a pose at a time [s]; knots from then on are replaced."""
    first, last = path.kept[0], path.kept[1] - 1
    while last > first and (path.time[last % KNOTS] >= time or last - first == KNOTS - 1):
        last -= 1
    before, near = path.time[last % KNOTS], _at(path, last)
    side = side_near(pose, near)
    at = on_side(pose, side)
    path.kept[1] = last + 1
    if before >= time:
        path.kept[1] = last
        _put(path, time, at, side)
    elif _pose(path, last) == pose:
        if last > first and _pose(path, last - 1) == pose:
            path.kept[1] = last
        _put(path, time, near, path.side[last % KNOTS])
    else:
        parts = 1
        if near[3] * at[3] + near[4] * at[4] + near[5] * at[5] + near[6] * at[6] < _FINE and time - before > SHORT:
            parts = min(math.ceil(angle(turn(near), turn(at)) / FINE_TURN), KNOTS - 1 - (last - first))
        for i in range(1, parts):
            share = i / parts
            x, y, z, _, _, _, _ = mix(near, at, share)
            a, b, c, d = slerp(turn(near), turn(at), share)
            _put(path, before + share * (time - before), (x, y, z, a, b, c, d), 1.0)
        _put(path, time, at, side)


@stage
def stand(path: Path, time: float) -> None:
    """At its last pose until a later time [s]."""
    if time > end_of(path):
        append(path, time, last_pose(path))


@stage
def forget(path: Path, time: float) -> None:
    """What was before a time [s] is no longer asked for."""
    first = path.kept[0]
    while first + 1 < path.kept[1] and path.time[(first + 1) % KNOTS] <= time:
        first += 1
    path.kept[0] = first


@stage
def stands(path: Path, begin: float, end: float) -> bool:
    """Whether it stands all the time from `begin` to `end` [s]."""
    low, high = _around(path, begin, end)
    return _same(path, low, high)


@stage
def mean(path: Path, begin: float, end: float, out: Floats) -> None:
    """Its mean from `begin` to `end` [s]; where it is, if they are the same. out: (7,) numbers of a pose."""
    low, high = _around(path, begin, end)
    first, last = path.kept[0], path.kept[1] - 1
    if _same(path, low, high):
        write(out, _pose(path, max(low, first)))
        return
    if begin == end:
        share = (end - path.time[low % KNOTS]) / (path.time[high % KNOTS] - path.time[low % KNOTS])
        write(out, with_unit_turn(mix(_at(path, low), _at(path, high), share)))
        return
    clear(out)
    later = 0.0
    for k in range(low, high):  # a straight piece counts by its ends, as far as it lies in the window
        since, until = path.time[k % KNOTS] if k >= first else begin, path.time[(k + 1) % KNOTS] if k < last else end
        enters, leaves = max(begin, since), min(end, until)
        share = (leaves - enters) / (end - begin)
        before, later = later, 0.5 * share * (enters + leaves - 2.0 * since) / (until - since)
        _add(out, before + (share - later), path.at[max(k, first) % KNOTS])
    _add(out, later, path.at[min(high, last) % KNOTS])
    write(out, with_unit_turn(read(out)))


@stage
def _around(path: Path, begin: float, end: float) -> tuple[int, int]:
    """Numbers of the last knot up to `begin`, and of the first from `end` on; one less or more where there is none."""
    first, k = path.kept[0], path.kept[1] - 1
    high = k + 1
    while k >= first:
        time = path.time[k % KNOTS]
        if time >= end:
            high = k
        if time <= begin:
            break
        k -= 1
    return k, high


@stage
def _same(path: Path, low: int, high: int) -> bool:
    """Whether the knots from one number to another have one pose; before the first and after the last it stands."""
    for k in range(max(low, path.kept[0]), min(high, path.kept[1] - 1)):  # noqa: SIM110
        if _pose(path, k) != _pose(path, k + 1):
            return False
    return True


@formula
def _add(out: Floats, weight: float, at: Floats) -> None:
    for i in range(7):
        out[i] += weight * at[i]


@formula
def _at(path: Path, k: int) -> Numbers:
    """Numbers of knot k."""
    return read(path.at[k % KNOTS])


@formula
def _pose(path: Path, k: int) -> Numbers:
    """Pose of knot k."""
    return on_side(read(path.at[k % KNOTS]), path.side[k % KNOTS])


@formula
def _put(path: Path, time: float, at: Numbers, side: float) -> None:
    """The next knot."""
    row = path.kept[1] % KNOTS
    path.time[row] = time
    path.side[row] = side
    write(path.at[row], at)
    path.kept[1] += 1

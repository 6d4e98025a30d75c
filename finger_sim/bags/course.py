"""A course of poses in figures: where it goes, how regularly and how fast, how deep; and what in it no finger does."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from .gaps import GAP_ALLOWED, GAP_TOLD

FARTHEST_REACH = 1.5
"""Longest way along an axis that a hand goes without its owner walking [m]."""
FASTEST_HAND = 5.0
"""Speed of a hand that strikes [m/s]."""
SLOWEST_RATE, FASTEST_RATE = 5.0, 20_000.0
"""Poses a second that devices and trackers send, at least and at most [Hz]."""
DEEPEST = 0.01
"""Depth from which on the pulp, some 10 mm thick, would be pressed through [m]."""
GAP = 3.0
"""An interval that many times longer than the median one is a gap."""
USUAL_SHARE = 90
"""Percent of the intervals that lie within the jitter of the median one."""
_AT_ONCE = 4096
"""Poses whose nodes are placed at once: some megabytes."""


@dataclass(frozen=True)
class Course:
    """Poses in the order of time."""

    time: NDArray[np.int64]
    """(n,) [ns], never falling."""
    position: Floats
    """(n, 3) origin of the finger frame [m]."""
    orientation: Floats
    """(n, 4) quaternions xyzw of any length but zero."""

    def __len__(self) -> int:
        return len(self.time)

    def last_of_each_time(self) -> Course:
        """Of poses with the same time the last, so that time rises."""
        kept = np.append(np.diff(self.time) > 0, True)
        return Course(self.time[kept], self.position[kept], self.orientation[kept])


@dataclass(frozen=True)
class Moment:
    """A value, and when it was taken [s] after the first pose."""

    value: float
    at: float


@dataclass(frozen=True)
class Figures:
    """What a course of poses is like. Speeds are those between poses of different times."""

    poses: int
    duration: float
    """[s]"""
    rate: float
    """Poses a second, from the median interval [Hz]; 0 where time stands still."""
    jitter: float
    """USUAL_SHARE percent of the intervals are that near to the median one [s]."""
    gaps: int
    """Intervals longer than GAP times the median one."""
    longest_gap: Moment
    """Longest interval [s], and when it begins."""
    repeated_stamps: int
    """Poses with the time of the one before."""
    sign_flips: int
    """Steps from a quaternion to about its negative."""
    low: tuple[float, float, float]
    """Smallest x, y and z of the finger frame's origin [m]."""
    high: tuple[float, float, float]
    """Largest ones [m]."""
    median_speed: float
    """Of the finger frame's origin [m/s]."""
    top_speed: Moment
    """[m/s]"""
    top_turning: Moment
    """Largest angular speed [rad/s]."""
    plane: float
    """Height of the plane z = constant [m]."""
    depth: Moment
    """How far the shipped finger, undeformed, is below the plane at most [m]; negative where it never touches."""
    touching: float
    """Share of the poses in which it is below the plane."""


def figures(course: Course, plane: float = 0.0) -> Figures:
    """Figures of a course of at least one pose; `plane` is the height of the plane [m]."""
    seconds = (course.time - course.time[0]) * 1e-9
    intervals = np.diff(course.time) * 1e-9
    moved = intervals[intervals > 0.0]
    usual = float(np.median(moved)) if len(moved) else 0.0
    near = np.percentile(np.abs(moved - usual), USUAL_SHARE) if len(moved) else 0.0
    rising = course.last_of_each_time()
    begins, steps = (rising.time[:-1] - course.time[0]) * 1e-9, np.diff(rising.time) * 1e-9
    speed = np.linalg.norm(np.diff(rising.position, axis=0), axis=1) / steps
    depth = plane - course.position[:, 2] - _lowest(course.orientation)
    q = course.orientation
    return Figures(
        poses=len(course),
        duration=float(seconds[-1]),
        rate=1.0 / usual if usual else 0.0,
        jitter=float(near),
        gaps=int((intervals > GAP * usual).sum()) if usual else 0,
        longest_gap=_largest(intervals, seconds),
        repeated_stamps=int((intervals == 0.0).sum()),
        sign_flips=int((np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0).sum()),
        low=_three(course.position.min(axis=0)),
        high=_three(course.position.max(axis=0)),
        median_speed=float(np.median(speed)) if len(speed) else 0.0,
        top_speed=_largest(speed, begins),
        top_turning=_largest(_angles(rising.orientation) / steps, begins),
        plane=plane,
        depth=_largest(depth, seconds),
        touching=float((depth > 0.0).mean()),
    )


def rows(found: Figures) -> dict[str, str]:
    """The figures in words, for a table."""
    usual = 1.0 / found.rate if found.rate else 0.0
    spread = f", {USUAL_SHARE} % of intervals within {100.0 * found.jitter / usual:.2g} % of that" if usual else ""
    gap = found.longest_gap
    out = {
        "duration": f"{found.duration:.3f} s, {found.poses} poses",
        "rate": f"{found.rate:.4g} Hz{spread}",
        "gaps": f"{found.gaps}, longest interval {gap.value:.3g} s at {gap.at:.3f} s",
        "repeated stamps": str(found.repeated_stamps),
        "sign flips": str(found.sign_flips),
    }
    for axis, low, high in zip("xyz", found.low, found.high, strict=True):
        out[axis] = f"{low:.4f} … {high:.4f} m"
    out["speed"] = (
        f"median {found.median_speed:.3g} m/s, largest {found.top_speed.value:.3g} m/s at {found.top_speed.at:.3f} s, "
        f"turning at up to {found.top_turning.value:.3g} rad/s"
    )
    depth = found.depth
    out["depth"] = (
        f"shipped finger, undeformed, {1e3 * depth.value:.2f} mm below the plane z = {found.plane:g} m "
        f"at {depth.at:.3f} s; {100.0 * found.touching:.3g} % of the poses touch"
        if depth.value > 0.0
        else f"never touches the plane z = {found.plane:g} m: shipped finger {-1e3 * depth.value:.2f} mm above it "
        f"at {depth.at:.3f} s"
    )
    return out


def doubts(found: Figures) -> list[str]:
    """What in a course cannot be a finger's, each with what may be the matter."""
    said = []
    spans = [high - low for low, high in zip(found.low, found.high, strict=True)]
    axis, span = max(zip("xyz", spans, strict=True), key=lambda pair: pair[1])
    far, fast = span > FARTHEST_REACH, found.top_speed.value > FASTEST_HAND
    if far:
        said.append(f"moves {span:.3g} m along {axis}, farther than a hand reaches: millimetres? import --scale 0.001")
    if fast:
        top, jump = found.top_speed, found.median_speed < 0.1 * FASTEST_HAND
        why = "a jump in the recording?" if jump else "millimetres (import --scale 0.001), or another --time-unit?"
        usually = f"median {found.median_speed:.3g} m/s"
        said.append(f"moves at {top.value:.3g} m/s at {top.at:.3f} s ({usually}), faster than a hand: {why}")
    if found.rate and not SLOWEST_RATE <= found.rate <= FASTEST_RATE:
        said.append(f"{found.rate:.3g} poses a second: times in another unit? import --time-unit")
    if (gap := found.longest_gap).value > GAP_TOLD:
        what = f"no pose for {gap.value:.9g} s from {gap.at:.3f} s on: a clock that was set, or stray poses?"
        ways = " run and play need --start, --duration or --allow-gaps"
        said.append(what + (ways if gap.value > GAP_ALLOWED else ""))
    if not far and found.depth.value <= 0.0:
        said.append(f"never touches: import --offset z={found.depth.value:.4f} brings the lowest pose to the plane")
    if not far and found.depth.value > DEEPEST:
        deep = f"presses {1e3 * found.depth.value:.3g} mm into the plane, more than the pulp has"
        said.append(f"{deep}: import --offset z={found.depth.value:.4f} brings the deepest pose to the plane")
    return said


@functools.cache
def _skin() -> Floats:
    """Nodes (n, 3) [m] of the shipped finger that may touch: all but those that follow the command."""
    from ..scene.mesh import TetMesh
    from ..scene.resources import shipped

    mesh = TetMesh.load(shipped("config") / "meshes" / "finger.vtu")
    return np.delete(mesh.points, mesh.node_sets["bone"], axis=0)


def _lowest(orientation: Floats) -> Floats:
    """Height (n,) [m] of the shipped finger's lowest node over its frame's origin, by orientation (n, 4)."""
    x, y, z, w = (orientation / np.linalg.norm(orientation, axis=1, keepdims=True)).T
    up = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    parts = (up[begin : begin + _AT_ONCE] @ _skin().T for begin in range(0, len(up), _AT_ONCE))
    return np.concatenate([part.min(axis=1) for part in parts])


def _angles(orientation: Floats) -> Floats:
    """Angle (n - 1,) [rad] of the shorter turn from each orientation to the next."""
    q = orientation / np.linalg.norm(orientation, axis=1, keepdims=True)
    apart, opposite = (np.linalg.norm(q[1:] - sign * q[:-1], axis=1) for sign in (1.0, -1.0))
    angles: Floats = 4.0 * np.arctan2(np.minimum(apart, opposite), np.maximum(apart, opposite))
    return angles


def _largest(values: Floats, times: Floats) -> Moment:
    """The largest of values, and its time; 0 at 0 where there is none."""
    if not len(values):
        return Moment(0.0, 0.0)
    i = int(values.argmax())
    return Moment(float(values[i]), float(times[i]))


def _three(values: Sequence[float] | Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z

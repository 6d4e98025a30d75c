"""What a recording of the node holds: force and depth over time, the moment of peak force, its reports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Ints
from ..bags import cdr
from ..bags.layout import POINT_DTYPE
from ..bags.reader import BagReader, commands_of
from ..errors import BagError
from ..physics.rotations import matrix, normalised
from ..scene import Plane

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@dataclass(frozen=True)
class Moment:
    """The deformed body at one instant, world axes."""

    time: float
    """Since the first command [s]."""
    points: Floats
    """(n, 3) nodes [m]."""
    triangles: Ints
    """(k, 3) surface, counter-clockwise seen from outside."""
    forces: Floats
    """(n, 3) force of the plane on each node [N]."""
    strain: Floats
    """(n,) strain / limit, the largest of the tetrahedra around each node; 1 = at the limit."""


@dataclass(frozen=True)
class Recorded:
    """A recorded touch. Times count from the first command [s]; without a plane, it is z = 0 that counts."""

    plane: Plane | None
    start: int
    """Log time of the first command [ns]."""
    command_time: Floats
    """(m,)"""
    depth: Floats
    """(m,) how far the undeformed skin at the commanded pose reaches below the plane [m]; negative: above."""
    wrench_time: Floats
    """(n,)"""
    normal: Floats
    """(n,) contact force along the plane's normal [N]; positive pushes the finger away."""
    tangential: Floats
    """(n,) contact force along the plane [N]."""
    peak: Moment
    """The recorded cloud of the largest contact force."""

    @property
    def force(self) -> Floats:
        """(n,) magnitude of the contact force [N]."""
        return np.hypot(self.normal, self.tangential)


def read_recording(bag: str | Path, plane: Plane | None) -> Recorded:
    """The touch in a bag of the node or of `replay.run`, with wrenches in world axes.

    Raises BagError naming the topic that is missing or empty.
    """
    reader = BagReader(bag)
    commands = commands_of(reader, allow_gaps=True)
    normal = (plane or Plane()).unit_normal
    point = np.array((plane or Plane()).point)

    topology = _first(reader, cdr.MESH)
    vertices = np.array([[v.x, v.y, v.z] for v in topology.vertices])
    triangles = np.array([t.vertex_indices for t in topology.triangles], dtype=np.int64).reshape(-1, 3)
    skin = vertices[np.unique(triangles)]
    lowest = [
        float(((skin @ matrix(normalised(q.tolist())).T) @ normal).min() + (p - point) @ normal)
        for p, q in zip(commands.position, commands.orientation, strict=True)
    ]

    wrenches = [(logged, m.wrench.force) for logged, m in _of_type(reader, cdr.WRENCH_STAMPED, "contact_wrench")]
    forces = np.array([[f.x, f.y, f.z] for _, f in wrenches])
    along = forces @ normal
    return Recorded(
        plane=plane,
        start=commands.start,
        command_time=commands.receipt,
        depth=-np.array(lowest),
        wrench_time=_seconds([logged for logged, _ in wrenches], commands.start),
        normal=along,
        tangential=np.linalg.norm(forces - along[:, None] * normal, axis=1),
        peak=_peak(reader, triangles, commands.start),
    )


@dataclass(frozen=True)
class Health:
    """How the node fared, of its reports on /diagnostics: counts, worst values, times of the last 4096 steps."""

    step_median: float
    """Time to compute and send a step [s]."""
    step_p99: float
    """[s]"""
    real_time_factor: float
    """Simulated time per wall time since the node was ready."""
    steps: int
    late: int
    """Steps not done when the next one was due."""
    overruns: int
    """Steps skipped because of that."""
    limited_tets: int
    """Most tetrahedra at a limit in one step."""
    max_strain_ratio: float
    max_penetration: float
    """[m]"""
    refused: int
    dropped: int
    """Messages that the recorder could not take."""
    troubled: int
    """Steps with a status bit set."""
    status: str
    """The status bits that were set, or OK."""


def read_health(bag: str | Path, begin: int | None = None, end: int | None = None) -> Health:
    """The node's own reports in a recording, of the time from `begin` to `end` (log times [ns]; all if left out).

    They come once a second: the time taken begins with the last one before `begin` and ends with the first after `end`.
    Raises BagError when there is none of a running node.
    """
    reader = BagReader(bag)
    before: dict[str, str] | None = None
    reports: list[dict[str, str]] = []
    for logged, report in _of_type(reader, DIAGNOSTICS):
        for status in report.status:
            values = {item.key: item.value for item in status.values}
            if "step time p50 [ms]" in values:
                if begin is not None and logged <= begin:
                    before = values
                else:
                    reports.append(values)
        if reports and end is not None and logged >= end:
            break
    if not reports:
        raise BagError(f"{reader.path}: no report of a running simulation on /diagnostics")
    last = reports[-1]

    def worst(key: str) -> float:
        return max(float(report[key]) for report in reports)

    def counted(key: str) -> int:
        return int(last[key]) - (int(before[key]) if before else 0)

    bits = dict.fromkeys(bit for r in reports for bit in r["status"].split("|") if bit != "OK")
    return Health(
        step_median=1e-3 * float(last["step time p50 [ms]"]),
        step_p99=1e-3 * float(last["step time p99 [ms]"]),
        real_time_factor=float(last["real-time factor since start"]),
        steps=counted("steps"),
        late=counted("late steps"),
        overruns=counted("overruns"),
        limited_tets=int(worst("limited tets")),
        max_strain_ratio=worst("max strain/limit"),
        max_penetration=1e-3 * worst("penetration [mm]"),
        refused=int(last["refused commands"]),
        dropped=int(worst("dropped records")),
        troubled=sum(int(report["steps with status"]) for report in reports),
        status=", ".join(bits) or "OK",
    )


def _peak(reader: BagReader, triangles: Ints, start: int) -> Moment:
    """Cloud with the largest sum of contact forces from the first command on; the first if all are zero."""
    peak, largest = None, -1.0
    for logged, cloud in _of_type(reader, cdr.POINT_CLOUD):
        if logged < start:
            continue
        points = np.frombuffer(cloud.data, POINT_DTYPE)
        force = float(np.linalg.norm([points[name].sum(dtype=np.float64) for name in ("fx", "fy", "fz")]))
        if force > largest:
            peak, largest = (logged, points), force
    if peak is None:
        raise BagError(f"{reader.path}: no cloud of points was recorded after the first command")
    logged, points = peak
    return Moment(
        time=float(_seconds([logged], start)[0]),
        points=_columns(points, "x", "y", "z"),
        triangles=triangles,
        forces=_columns(points, "fx", "fy", "fz"),
        strain=points["strain"].astype(np.float64),
    )


def _columns(points: NDArray[np.void], *names: str) -> Floats:
    return np.stack([points[name].astype(np.float64) for name in names], axis=1)


def _seconds(times: Iterable[int], start: int) -> Floats:
    """Log times [ns] as seconds since `start`."""
    return np.array([(time - start) * 1e-9 for time in times])


def _first(reader: BagReader, kind: str) -> Any:
    return next(_of_type(reader, kind))[1]


def _of_type(reader: BagReader, kind: str, name: str = "") -> Iterator[tuple[int, Any]]:
    """Log times [ns] and messages on the first topic of a type whose name ends in `name`.

    What cannot be decoded is passed over. Raises BagError if nothing is left.
    """
    topics = [t.name for t in reader.topics if t.type == kind and t.name.endswith(name) and t.count]
    if not topics:
        raise BagError(f"{reader.path}: no {name or kind} was recorded")
    found, reason = False, "it is empty"
    for message in reader.messages([topics[0]], kind):
        try:
            decoded = cdr.deserialize(message.data, kind)
        except ValueError as error:
            reason = str(error)
            continue
        found = True
        yield message.log_time, decoded
    if not found:
        raise BagError(f"{reader.path}: topic {topics[0]}: nothing can be decoded: {reason}")

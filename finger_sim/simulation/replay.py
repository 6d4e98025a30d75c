"""A bag of commands through the simulator without a ROS graph: the same input makes the same bytes.

No wall clock enters the output. Time counts from the first good command: step k ends at (k + 1) dt and is
stamped with the bag's start plus that time, rounded to a nanosecond once, so stamps do not drift.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..bags import cdr
from ..bags.layout import node_strain, pack_points, wrench_frame_id
from ..bags.reader import BagReader, BagWriter, Message, PlanePoses, Qos, commands_of, plane_poses_of, require_absent
from ..scene import Pose, place

if TYPE_CHECKING:
    from ..bags.reader import Commands
    from ..scene import Scene
    from .result import StepResult
    from .simulator import Simulator

MESH_RATE = 60
"""Clouds of `mesh_points` a second of simulated time, at most one a step [Hz]."""

FINGER_FRAME = "finger"

Progress = Callable[[int, int], None]
"""Called with the steps done and all there are."""


@dataclass
class Summary:
    """What happened in a replay."""

    out: Path
    topic: str
    commands: int
    refused: int
    """Commands left out: refused as the node refuses them, or in another frame."""
    warning: str | None
    """What was wrong with the bag of commands, if it was cut off."""
    plane_topic: str | None = None
    """Where the plane's poses came from, if there were any."""
    plane_poses: int = 0
    plane_refused: int = 0
    """Poses of the plane left out: as commands are, or all, where the scene has no plane."""
    steps: int = 0
    duration: float = 0.0
    """Simulated time [s]."""
    wall: float = 0.0
    """Time that the steps alone took [s]."""
    step_median: float = 0.0
    """[s]"""
    step_p99: float = 0.0
    """[s]"""
    peak_force: float = 0.0
    """Largest contact force [N]."""
    peak_force_time: float = 0.0
    """When it was reached [s]."""
    limited_tets: int = 0
    """Most tetrahedra at a limit in one step."""
    max_strain_ratio: float = 0.0
    """Largest strain / limit."""
    max_penetration: float = 0.0
    """[m]"""
    status: dict[str, int] = field(default_factory=dict)
    """Steps in which each status bit was set; empty when all went well."""

    @property
    def real_time_factor(self) -> float:
        """Simulated time per time that the steps took."""
        return self.duration / self.wall if self.wall > 0.0 else math.inf


def run(
    scene: Scene,
    bag: str | Path,
    out: str | Path,
    topic: str | None = None,
    progress: Progress | None = None,
    *,
    simulator: Simulator | None = None,
    plane_topic: str | None = None,
    mode: Literal["free", "triggered"] = "free",
) -> Summary:
    """Simulates the commands of `bag` and writes what the node would publish to the new bag `out`.

    The newest command received up to the beginning of a step holds during it; the first one places the finger
    at rest. Poses of the plane in the bag move it likewise, from the newest before the first command on. The last
    step is the one that follows the last of all these. Both are
    copied as they were read, those that are refused too: replayed, `out` gives itself.
    A bag that the node recorded from its first command on gives the live wrench back but for where steps begin:
    what is live at a time is here within two steps of it. Of one that began later the history is not known.
    In mode triggered, as the node's, there is one step for each command, stamped with its receipt: what the node
    recorded in that mode from its first command on comes back bit by bit (but for when a moving plane's poses came).

    topic       : of the commands; see `bags.read_commands`
    progress    : called after every step
    simulator   : of this scene, instead of a new one
    plane_topic : of the plane's poses; see `bags.plane_poses_of`
    mode        : free or triggered
    Raises BagError for a bag that cannot be read or made, and what Simulator raises; what was simulated by
    then stays readable in `out`.
    """
    require_absent(out)
    reader = BagReader(bag)
    commands = commands_of(reader, topic)
    frame = commands.frame_id or "world"
    summary = Summary(Path(out), commands.topic, len(commands), commands.refused, commands.warning)
    poses = _poses(commands)
    plane = plane_poses_of(reader, commands, plane_topic)
    places: list[Pose] = []
    if plane is not None:
        if scene.plane is not None:
            places = _poses(plane)
        summary.plane_topic, summary.plane_poses = plane.topic, len(places)
        summary.plane_refused = plane.refused + len(plane) - len(places)
    if mode == "free":
        last = max(int(commands.receipt_ns[-1]), int(plane.receipt_ns[-1]) if plane is not None and places else 0)
        ends = [_nanoseconds(k + 1, scene.dt) for k in range(_steps(last, scene.dt))]
        begins = [0, *ends[:-1]]
        followed = [poses[i] for i in np.searchsorted(commands.receipt_ns, begins, side="right") - 1]
    else:
        ends = begins = commands.receipt_ns.tolist()
        followed = poses
    if simulator is None:
        from .simulator import Simulator

        simulator = Simulator(scene)
    with BagWriter(out) as recording:
        write = _Output(recording, commands.start, frame)
        copies = [_Copies(reader.messages([commands.topic]), recording, "command_pose")]
        if plane is not None:
            copies.append(_Copies(reader.messages([plane.topic]), recording, "plane_pose"))
        write.topology(simulator)
        simulator.reset(poses[0])
        before = placed = 0
        costs = np.empty(len(ends))
        bits: Counter[str] = Counter()
        for k, (begin, end, pose) in enumerate(zip(begins, ends, followed, strict=True)):
            due = placed
            while plane is not None and due < len(places) and plane.receipt_ns[due] <= begin:
                due += 1
            place_now, placed = places[due - 1] if due > placed else None, due
            clock = time.perf_counter()
            result = simulator.step(pose, place_now)
            costs[k] = time.perf_counter() - clock
            for copy in copies:
                copy.up_to(commands.start + end)
            write.step(result, end)
            if before * MESH_RATE // 1_000_000_000 < end * MESH_RATE // 1_000_000_000 or k == 0:
                write.points(simulator, result, end)
            _count(summary, bits, result, end)
            before = end
            if progress is not None:
                progress(k + 1, len(ends))
        for copy in copies:
            copy.up_to(None)
    summary.steps, summary.duration = len(ends), _nanoseconds(len(ends), scene.dt) * 1e-9
    summary.wall = float(costs.sum())
    summary.step_median, summary.step_p99 = (float(v) for v in np.percentile(costs, (50, 99)))
    summary.status = dict(bits)
    return summary


def _poses(recorded: Commands | PlanePoses) -> list[Pose]:
    return [
        Pose(position=(px, py, pz), orientation=(qx, qy, qz, qw))
        for (px, py, pz), (qx, qy, qz, qw) in zip(
            recorded.position.tolist(), recorded.orientation.tolist(), strict=True
        )
    ]


def _steps(last: int, dt: float) -> int:
    """Steps until the pose received at `last` [ns] has been simulated for one of them."""
    k = math.floor(last * 1e-9 / dt)
    while _nanoseconds(k, dt) < last:
        k += 1
    return k + 1


def _nanoseconds(k: int, dt: float) -> int:
    """k dt, rounded once [ns]."""
    return round(k * dt * 1e9)


def _count(summary: Summary, bits: Counter[str], result: StepResult, end: int) -> None:
    """Takes the result of a step into the summary."""
    force = float(np.linalg.norm(result.contact_wrench[:3]))
    if force > summary.peak_force:
        summary.peak_force, summary.peak_force_time = force, end * 1e-9
    summary.limited_tets = max(summary.limited_tets, int(result.limited_tets))
    summary.max_strain_ratio = max(summary.max_strain_ratio, float(result.max_strain_ratio))
    summary.max_penetration = max(summary.max_penetration, float(result.max_penetration))
    bits.update(bit.name or str(bit.value) for bit in result.status)


class _Copies:
    """Copies the poses of one topic to another of the recording in step with the simulation."""

    def __init__(self, messages: Iterator[Message], recording: BagWriter, topic: str) -> None:
        self.messages = messages
        self.recording = recording
        self.next = next(messages, None)
        self.topic = recording.add_topic(topic, cdr.POSE_STAMPED)

    def up_to(self, log_time: int | None) -> None:
        """Copies what was received until then [ns], or all that is left."""
        while self.next is not None and (log_time is None or self.next.log_time <= log_time):
            message = self.next
            number = message.sequence or None
            self.recording.write(self.topic, message.data, message.log_time, message.publish_time, sequence=number)
            self.next = next(self.messages, None)


class _Output:
    """Writes results as messages, stamped and logged at `start` plus the simulated time [ns]."""

    def __init__(self, recording: BagWriter, start: int, frame: str) -> None:
        self.recording, self.start, self.frame = recording, start, frame
        self.wrench_frame = wrench_frame_id("world_aligned", FINGER_FRAME, frame)
        recording.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        recording.add_topic("device_wrench", cdr.WRENCH_STAMPED)
        recording.add_topic("pose", cdr.POSE_STAMPED)
        recording.add_topic("mesh_points", cdr.POINT_CLOUD)
        recording.add_topic("mesh_topology", cdr.MESH, qos=Qos(depth=1, transient_local=True))

    def topology(self, simulator: Simulator) -> None:
        """The surface at rest: its triangles index the nodes of the mesh, as points of `mesh_points` do."""
        mesh = simulator.mesh
        self.recording.write("mesh_topology", cdr.mesh(mesh.points, mesh.surface), self.start)

    def step(self, result: StepResult, end: int) -> None:
        """Wrenches and pose of one step."""
        stamp, pose = self.start + end, result.pose
        for topic, wrench in (
            ("contact_wrench", result.contact_wrench),
            ("device_wrench", result.device_wrench),
        ):
            self.recording.write(topic, cdr.wrench_stamped(stamp, self.wrench_frame, wrench), stamp)
        data = cdr.pose_stamped(stamp, self.frame, pose.position, pose.orientation)
        self.recording.write("pose", data, stamp)

    def points(self, simulator: Simulator, result: StepResult, end: int) -> None:
        """The deformed nodes."""
        mesh = simulator.mesh
        strain = node_strain(simulator.strain_ratio, mesh.tets, len(mesh.points))
        rest = place(mesh.points, result.pose)
        points = pack_points(simulator.positions, rest, simulator.contact_forces, strain)
        stamp = self.start + end
        self.recording.write("mesh_points", cdr.point_cloud(stamp, self.frame, points), stamp)

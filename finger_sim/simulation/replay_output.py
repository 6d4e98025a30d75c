"""What a replay writes: the poses that it follows as they were read, and what the node would publish."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..arrays import Floats
from ..bags import cdr
from ..bags.excerpt import Excerpt
from ..bags.layout import node_strain, pack_points, wrench_frame_id
from ..bags.reader import BagWriter, Qos
from ..scene import place

if TYPE_CHECKING:
    from .result import StepResult
    from .simulator import Simulator

FINGER_FRAME = "finger"

MESH_RATE = 60
"""Clouds of `mesh_points` a second of simulated time, at most one a step [Hz]."""


class Copies:
    """Copies the poses of one topic to another of the recording in step with the simulation."""

    def __init__(self, poses: Excerpt, recording: BagWriter, topic: str) -> None:
        self._messages = poses.messages()
        self._recording = recording
        self._next = next(self._messages, None)
        self._topic = recording.add_topic(topic, cdr.POSE_STAMPED)

    def up_to(self, log_time: int | None) -> None:
        """Copies what was received until then [ns], or all that is left."""
        while self._next is not None and (log_time is None or self._next.log_time <= log_time):
            message = self._next
            number = message.sequence or None
            self._recording.write(self._topic, message.data, message.log_time, message.publish_time, sequence=number)
            self._next = next(self._messages, None)


class Output:
    """Writes results as messages, stamped and logged at `start` plus the simulated time [ns]."""

    def __init__(self, recording: BagWriter, start: int, frame: str) -> None:
        self._recording, self._start, self._frame = recording, start, frame
        self._wrench_frame = wrench_frame_id("world_aligned", FINGER_FRAME, frame)
        self._clouds = -1
        recording.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        recording.add_topic("device_wrench", cdr.WRENCH_STAMPED)
        recording.add_topic("pose", cdr.POSE_STAMPED)
        recording.add_topic("mesh_points", cdr.POINT_CLOUD)
        recording.add_topic("mesh_topology", cdr.MESH, qos=Qos(depth=1, transient_local=True))

    def topology(self, simulator: Simulator) -> None:
        """The surface at rest: its triangles index the nodes of the mesh, as points of `mesh_points` do."""
        mesh = simulator.mesh
        self._recording.write("mesh_topology", cdr.mesh(mesh.points, mesh.surface), self._start)

    def step(self, simulator: Simulator, result: StepResult, device_wrench: Floats, end: int) -> None:
        """What a step gave that ended at `end` [ns]: wrenches and pose, and the deformed nodes where they are due."""
        stamp, pose = self._start + end, result.pose
        for topic, wrench in (
            ("contact_wrench", result.contact_wrench),
            ("device_wrench", device_wrench),
        ):
            self._recording.write(topic, cdr.wrench_stamped(stamp, self._wrench_frame, wrench), stamp)
        data = cdr.pose_stamped(stamp, self._frame, pose.position, pose.orientation)
        self._recording.write("pose", data, stamp)
        if self._clouds < 0 or self._clouds < end * MESH_RATE // 1_000_000_000:
            self._points(simulator, result, stamp)
        self._clouds = end * MESH_RATE // 1_000_000_000

    def _points(self, simulator: Simulator, result: StepResult, stamp: int) -> None:
        """The deformed nodes."""
        mesh = simulator.mesh
        strain = node_strain(simulator.strain_ratio, mesh.tets, len(mesh.points))
        rest = place(mesh.points, result.pose)
        points = pack_points(simulator.positions, rest, simulator.contact_forces, strain)
        self._recording.write("mesh_points", cdr.point_cloud(stamp, self._frame, points), stamp)

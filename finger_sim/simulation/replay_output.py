"""What a replay writes: what it follows as it was read, and what the node would publish."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..arrays import Floats
from ..bags import cdr
from ..bags.changes import EVENTS_QOS, RESET_QOS, Change
from ..bags.excerpt import Excerpt
from ..bags.frames import MOVING, MOVING_QOS, STANDING, STANDING_QOS, Frames
from ..bags.layout import express_wrench, node_strain, pack_points, wrench_frame_id
from ..bags.reader import BagWriter, Qos
from ..scene import place

if TYPE_CHECKING:
    from .result import StepResult
    from .simulator import Simulator

MESH_RATE = 60
"""Clouds of `mesh_points` a second of simulated time, at most one a step [Hz]."""
FRAME_RATE = 100
"""Messages on /tf a second of simulated time, at most one a step [Hz]."""


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


class Changes:
    """Makes the live changes of a recording in step with the simulation, and copies them.

    clutched : whether the clutch is open now
    """

    def __init__(self, changes: Sequence[Change], recording: BagWriter, clutched: bool) -> None:
        self.clutched = clutched
        self._waiting = deque(changes)
        self._recording = recording
        for change in changes:
            qos = EVENTS_QOS if change.clutch is None and not change.reset else RESET_QOS
            recording.add_topic(change.message.topic, change.message.type, qos=qos)

    def up_to(self, log_time: int, simulator: Simulator) -> dict[str, Any]:
        """Makes those that hold from then on [ns] or were to hold before; gives the node's parameters among them."""
        options: dict[str, Any] = {}
        while self._waiting and self._waiting[0].time <= log_time:
            change = self._waiting.popleft()
            if change.scene:
                simulator.apply(change.scene)
            if change.reset:
                simulator.reset()
            options.update(change.options)
            if change.clutch is not None:
                self.clutched = change.clutch
            message = change.message
            number = message.sequence or None
            self._recording.write(message.topic, message.data, change.time, message.publish_time, sequence=number)
        return options


class Output:
    """Writes results as messages, stamped and logged at `start` plus the simulated time [ns].

    options : the node's parameters that name frames
    """

    def __init__(self, recording: BagWriter, start: int, options: Mapping[str, Any]) -> None:
        frame, finger, self._axes = (options[name] for name in ("world_frame", "finger_frame", "wrench_frame"))
        self._recording, self._start, self._frame = recording, start, frame
        self._contact_frame = wrench_frame_id(self._axes, finger, frame)
        self._device_frame = wrench_frame_id("world_aligned", finger, frame)
        self._frames = Frames(frame, finger)
        self._clouds = self._transforms = -1
        recording.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        recording.add_topic("device_wrench", cdr.WRENCH_STAMPED)
        recording.add_topic("pose", cdr.POSE_STAMPED)
        recording.add_topic("mesh_points", cdr.POINT_CLOUD)
        recording.add_topic("mesh_topology", cdr.MESH, qos=Qos(depth=1, transient_local=True))
        recording.add_topic(MOVING, cdr.TF_MESSAGE, qos=MOVING_QOS)
        recording.add_topic(STANDING, cdr.TF_MESSAGE, qos=STANDING_QOS)

    def begin(self, simulator: Simulator) -> None:
        """The surface at rest: its triangles index the nodes of the mesh, as points of `mesh_points` do; the plane."""
        mesh = simulator.mesh
        self._recording.write("mesh_topology", cdr.mesh(mesh.points, mesh.surface), self._start)
        standing = self._frames.standing(self._start, simulator.plane_pose)
        if standing is not None:
            self._recording.write(STANDING, standing, self._start)

    def step(self, simulator: Simulator, result: StepResult, device_wrench: Floats, end: int) -> None:
        """What a step gave that ended at `end` [ns]: wrenches and pose, and the deformed nodes where they are due."""
        stamp, pose = self._start + end, result.pose
        contact = express_wrench(result.contact_wrench, pose, self._axes)
        for topic, frame, wrench in (
            ("contact_wrench", self._contact_frame, contact),
            ("device_wrench", self._device_frame, device_wrench),
        ):
            self._recording.write(topic, cdr.wrench_stamped(stamp, frame, wrench), stamp)
        data = cdr.pose_stamped(stamp, self._frame, pose.position, pose.orientation)
        self._recording.write("pose", data, stamp)
        if self._clouds < 0 or self._clouds < end * MESH_RATE // 1_000_000_000:
            self._points(simulator, result, stamp)
        self._clouds = end * MESH_RATE // 1_000_000_000
        if self._transforms < 0 or self._transforms < end * FRAME_RATE // 1_000_000_000:
            self._recording.write(MOVING, self._frames.moving(stamp, pose, simulator.plane_pose), stamp)
        self._transforms = end * FRAME_RATE // 1_000_000_000

    def _points(self, simulator: Simulator, result: StepResult, stamp: int) -> None:
        """The deformed nodes."""
        mesh = simulator.mesh
        strain = node_strain(simulator.strain_ratio, mesh.tets, len(mesh.points))
        rest = place(mesh.points, result.pose)
        points = pack_points(simulator.positions, rest, simulator.contact_forces, strain)
        self._recording.write("mesh_points", cdr.point_cloud(stamp, self._frame, points), stamp)

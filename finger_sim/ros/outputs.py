"""Everything the node sends: topics, their quality of service, and what one step puts on them.

Each message is serialised once; the same bytes are published and recorded.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker

from ..bags import cdr
from ..bags.changes import EVENTS, EVENTS_QOS
from ..bags.frames import MOVING, MOVING_QOS, STANDING, STANDING_QOS, Frames
from ..bags.layout import node_strain, pack_points, wrench_frame_id
from ..bags.reader import Qos
from ..bags.template import Template, doubles
from ..scene import Pose, place
from ..scene.mesh import TetMesh
from . import messages, transforms
from .device import Device
from .device_out import DeviceOut
from .options import NodeOptions
from .recorder import RecordedTopic, Recorder
from .snapshot import Shown

_TYPES: dict[str, tuple[Any, Qos]] = {
    "mesh_topology": (Mesh, Qos(depth=1, transient_local=True)),
    "contact_wrench": (WrenchStamped, Qos()),
    "device_wrench": (WrenchStamped, Qos()),
    "pose": (PoseStamped, Qos()),
    "mesh_points": (PointCloud2, Qos(depth=5)),
    "device_wrench_throttle": (WrenchStamped, Qos(depth=5)),
    "mesh_marker": (Marker, Qos(depth=1)),
    "/diagnostics": (DiagnosticArray, Qos()),
}
"""Topic, type and offered quality of service."""
REPEATS = ("mesh_marker", "device_wrench_throttle")
"""Topics that hold nothing that others do not; they are not recorded. The others are, in their order."""

STEPPED = ("device_wrench", "contact_wrench", "pose")
"""Topics with a message for each step, in their order."""
_RECORDED = (
    RecordedTopic(STANDING, cdr.TF_MESSAGE, STANDING_QOS),
    RecordedTopic(MOVING, cdr.TF_MESSAGE, MOVING_QOS),
    RecordedTopic(EVENTS, cdr.PARAMETER_EVENT, EVENTS_QOS),
)
"""What a recording holds that no publisher of this class sends: frames, which need no tf2 there, and live changes."""


def ros_qos(qos: Qos) -> QoSProfile:
    """The profile of rclpy."""
    return QoSProfile(
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
    )


class Outputs:
    """The publishers of the node and the recording, if there is one.

    options  : the node's options as they are now, never changed but replaced; a step works on what it read at once
    recorder : gets every message that is sent, but for those to `device`; None while nothing is recorded
    device   : publishers of what a device is sent beside device_wrench
    mesh_messages : point clouds made so far
    """

    def __init__(self, node: Any, options: NodeOptions, device: Device | None = None) -> None:
        self.options = options
        self.recorder: Recorder | None = None
        self.topology = b""
        self.mesh_messages = 0
        self._publishers = {
            name: node.create_publisher(kind, name, ros_qos(qos)) for name, (kind, qos) in _TYPES.items()
        }
        self._names = {name: publisher.topic_name for name, publisher in self._publishers.items()}
        self._wrench = messages.wrench_template(
            wrench_frame_id(options.wrench_frame, options.finger_frame, options.world_frame)
        )
        aligned = f"{options.finger_frame}_world_aligned"
        self._device, self._throttled = messages.wrench_template(aligned), messages.wrench_template(aligned)
        given = device.command_input if device is not None else None
        frames = {"world": aligned, "device": aligned, "handle": ""}
        if given is not None and given.frame:
            frames |= {"device": given.frame, "handle": given.child_frame}
        self.device = DeviceOut(node, device, frames, ros_qos(Qos()))
        self._pose = messages.pose_template(options.world_frame)
        self._frames = Frames(options.world_frame, options.finger_frame)
        self._broadcast = transforms.Broadcast(node, options) if transforms.available() else None

    def prepare(self, mesh: TetMesh) -> None:
        """Makes room for the messages of a mesh and sends its topology."""
        self._mesh = mesh
        self._cloud = messages.cloud_template(self.options.world_frame, len(mesh.points))
        self._corners = mesh.surface.ravel()
        self._marker = messages.marker_template(self.options.world_frame, len(self._corners))
        self._areas = np.maximum(messages.node_areas(mesh.points, mesh.surface), 1e-12)
        for topic in self.recorded_topics():
            cdr.definition(topic.type)
        self.topology = cdr.mesh(mesh.points, mesh.surface)
        self.send("mesh_topology", self.topology)

    def recorded_topics(self) -> list[RecordedTopic]:
        """Topics of a recording under their resolved names, the topology first."""
        sent = [
            RecordedTopic(self._names[name], ros_type(kind), qos)
            for name, (kind, qos) in _TYPES.items()
            if name not in REPEATS
        ]
        return [*sent, *_RECORDED]

    def stepped(self) -> list[tuple[Any, Template]]:
        """Publisher and message of all that each step sends."""
        sent = (self._device, self._wrench, self._pose)
        return [(self._publishers[name], template) for name, template in zip(STEPPED, sent, strict=True)]

    @property
    def topics(self) -> set[str]:
        """Names of all that is sent on."""
        return {*self._names.values(), *(str(publisher.topic_name) for publisher, _ in self.device.sent)}

    @property
    def stepped_topics(self) -> list[str]:
        """Their names."""
        return [self._names[name] for name in STEPPED]

    def start_recording(
        self, recorder: Recorder, plane: Pose | None, stamp: int, standing: Iterable[tuple[str, bytes]] = ()
    ) -> None:
        """Records from now on, beginning with what late listeners get too: the topology, and where the plane is.

        Nothing of a step that has begun before is in it: it would come before the topology.
        plane : see Simulator.plane_pose
        stamp : the present time [ns]
        standing : topics and messages of what else holds now
        """
        frames = Frames(self.options.world_frame, self.options.finger_frame)
        recorder.put(self._names["mesh_topology"], self.topology, recorder.began)
        for topic, data in standing:
            recorder.put(topic, data, recorder.began)
        still = frames.standing(stamp, plane)
        if still is not None:
            recorder.put(STANDING, still, time.monotonic_ns())
        self._frames = frames
        self.recorder = recorder

    def record(self, topic: str, data: bytes) -> None:
        """Records one message of CDR bytes that is not published, if there is a recording."""
        if self.recorder is not None:
            self.recorder.put(topic, data, time.monotonic_ns())

    def send(self, topic: str, data: bytes, at: int | None = None) -> None:
        """Publishes and records one message of CDR bytes; `at`: steady time that it is of [ns], the present if None."""
        self._publishers[topic].publish(data)
        recorder, at = self.recorder, time.monotonic_ns() if at is None else at
        if recorder is not None and topic not in REPEATS and at >= recorder.began:
            recorder.put(self._names[topic], data, at)

    @property
    def recording(self) -> bool:
        """Whether messages are recorded."""
        return self.recorder is not None and self.recorder.active

    @property
    def broadcasts(self) -> bool:
        """Whether frames are broadcast."""
        return self._broadcast is not None

    def heard(self, topic: str) -> bool:
        """Whether anybody subscribes to a topic."""
        return bool(self._publishers[topic].get_subscription_count() > 0)

    def mesh(self, shown: Shown) -> None:
        """Sends the deformed mesh."""
        strain = node_strain(shown.strain, self._mesh.tets, len(self._mesh.points))
        points = pack_points(shown.positions, place(self._mesh.points, shown.pose), shown.forces, strain)
        self.send("mesh_points", self._cloud.fill(shown.stamp, points.tobytes()), shown.at)
        self.mesh_messages += 1

    def throttled(self, shown: Shown) -> None:
        """Sends again what a device was sent with that step: whoever takes this does not hold up the loop."""
        self.send("device_wrench_throttle", self._throttled.fill(shown.stamp, doubles(shown.device)))

    def marker(self, shown: Shown) -> None:
        """Sends the surface, coloured."""
        if self.options.marker_color == "strain":
            values = node_strain(shown.strain, self._mesh.tets, len(self._mesh.points))
        else:
            values = np.linalg.norm(shown.forces, axis=1) / self._areas / self.options.marker_pressure
        colors = messages.ramp_colors(values)[self._corners]
        self.send(
            "mesh_marker", self._marker.fill(shown.stamp, doubles(shown.positions[self._corners]), colors.tobytes())
        )

    def frames(self, shown: Shown) -> None:
        """Records where finger and plane are, and broadcasts it."""
        if self.recording:
            self.record(MOVING, self._frames.moving(shown.stamp, shown.pose, shown.plane))
        if self._broadcast is not None:
            self._broadcast.send(shown.pose, shown.plane, shown.stamp)


def ros_type(kind: Any) -> str:
    """Name of a message class, such as geometry_msgs/msg/PoseStamped."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"

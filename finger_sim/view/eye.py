"""What of a node's messages becomes a picture: the newest of each topic, taken when a page wants one."""

from __future__ import annotations

import math

from ..bags.poses import check_pose, read_pose
from ..errors import FingerSimError
from ..scene import Plane, Pose
from .forces import split
from .link import Link
from .picture import Ground, Painter, plane_frame
from .protocol import Picture, Topology
from .raw import CloudReader, read_wrench
from .samples import Samples
from .values import Values

REPLACED = 60
"""Clouds of another mesh after which a node has not just been replaced: some that are on their way."""


class Eye:
    """Looks at one node through a Link, from its beginning to its end.

    samples : forces of the pictures so far
    """

    def __init__(self, topology: Topology, values: Values) -> None:
        self.samples = Samples()
        self._painter, self._reader = Painter(topology.rest), CloudReader()
        self._world = str(values.plain("world_frame") or "world")
        self._ground, self._moved = Ground(), False
        self._command: tuple[float, ...] | None = None
        self._device: tuple[float, ...] | None = None
        self._plane_moves = True
        self._strange = 0
        self._virtual = False
        self.take(values, moved=True)

    @property
    def world_frame(self) -> str:
        """In which commands are."""
        return self._world

    def take(self, values: Values, moved: bool) -> None:
        """Takes what pictures need of the parameters; moved: the plane is where they say now."""
        self._virtual = values.plain("coupling.type") == "virtual"
        if "plane.friction" not in values:
            self._ground = Ground()
            return
        self._moved = self._moved and not moved
        plane = Plane(tuple(values.plain("plane.point")), tuple(values.plain("plane.normal")))
        frame = self._ground.plane if self._moved else plane_frame(plane)
        self._ground = Ground(frame, float(values.plain("plane.friction")), float(values.plain("solver.tolerance")))

    def look_for(self, link: Link) -> None:
        """Nothing is taken from topics on which nobody sends."""
        self._plane_moves = link.senders("plane_pose") > 0
        link.look_for_others()

    def commanded(self, pose: Pose) -> None:
        """A page sent the finger there."""
        self._command = (*pose.position, *pose.orientation)

    def look(self, link: Link) -> Picture | None:
        """The picture of a cloud that has come since the last call. Raises FingerSimError for what is none."""
        clouds = link.taken("mesh_points")
        if not clouds:
            return None
        cloud = self._reader.read(clouds[-1])
        if len(cloud.points) != len(self._painter):
            self._strange += 1
            if self._strange > REPLACED:
                raise FingerSimError(
                    f"mesh_points has {len(cloud.points)} nodes, mesh_topology {len(self._painter)}: "
                    f"there may be two nodes {link.target}"
                )
            return None  # of a node that has just been replaced
        self._strange = 0
        if self._plane_moves:
            for data in link.taken("plane_pose"):
                self._move_plane(_pose(data, self._world))
        for data in link.taken("command_pose"):
            pose = _pose(data, self._world)
            if pose is not None:
                self.commanded(pose)
        for data in link.taken("device_wrench_throttle"):
            self._device = read_wrench(data)[1]
        picture = self._painter.paint(cloud, 1e-9 * cloud.stamp, self._ground)
        picture.command, picture.device, picture.virtual = self._command, self._device, self._virtual
        self._sample(picture)
        return picture

    def _move_plane(self, pose: Pose | None) -> None:
        """It is where plane_pose says until a parameter says otherwise."""
        ground = self._ground
        if pose is not None and ground.plane is not None:
            self._ground, self._moved = Ground(pose, ground.friction, ground.tolerance), True

    def _sample(self, picture: Picture) -> None:
        """The forces of a picture, for the plot. Where a clock was set back, it begins anew."""
        if picture.time < self.samples.last - 1.0:
            self.samples.clear()
        if picture.wrench is not None and picture.time > self.samples.last:
            normal, tangential = split(picture.wrench[:3], self._ground.normal)
            device = math.nan if self._device is None else math.hypot(*self._device[:3])
            self.samples.add(picture.time, normal, tangential, device, picture.depth)


def _pose(data: bytes, world: str) -> Pose | None:
    """The pose in a message that the node takes, too."""
    try:
        pose = check_pose(read_pose(data), world)
    except ValueError:
        return None
    return pose if isinstance(pose, Pose) else None

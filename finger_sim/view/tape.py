"""A bag read once from its beginning to its end: small things kept in memory, clouds laid on disk."""

from __future__ import annotations

import tempfile
from bisect import bisect_right
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bags import cdr
from ..bags.frames import MOVING, PLANE, STANDING
from ..bags.layout import FLOAT, POINT_NAMES, node_of_status
from ..bags.poses import read_pose
from ..bags.reader import BagReader, Message
from ..errors import BagError, FingerSimError
from ..scene import Pose
from .protocol import Topology
from .raw import CloudReader, read_wrench
from .samples import PERIOD
from .shape import topology_of
from .words import Report

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_THIN = round(1e9 * PERIOD)

Meter = Callable[[float, float], None]
"""Called with the seconds read and all there are."""


class Series:
    """Values at rising times."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[Any] = []

    def add(self, time: float, value: Any) -> None:
        """Takes the next."""
        self.times.append(time)
        self.values.append(value)

    def at(self, time: float) -> Any:
        """The newest by a time [s]; None where there is none."""
        k = bisect_right(self.times, time) - 1
        return self.values[k] if k >= 0 else None

    def __bool__(self) -> bool:
        return bool(self.times)


class Tape:
    """What a bag of one node holds. Times count from its first message [s].

    mesh        : at rest
    cloud_times : of all clouds; `points` (k, n, 10) are their points
    contact     : contact_wrench as frame_id and numbers, and so is device; one in each PERIOD
    commands    : (7,) position and x y z w, one in each PERIOD
    reports     : of /diagnostics
    planes      : where /tf says that the plane is
    notes       : what of it cannot be read, and why
    """

    def __init__(self, path: str | Path, progress: Meter) -> None:
        """Reads it. Raises BagError where there is nothing to show."""
        self.reader = BagReader(path)
        self.duration = max(self.reader.duration, 1e-3)
        self.notes = [self.reader.warning] if self.reader.warning else []
        self.start = self.reader.start_time or 0
        self.cloud_times: list[float] = []
        self.contact, self.device, self.commands = Series(), Series(), Series()
        self.planes = Series()
        self._reports: dict[str, Series] = {}
        self._spool = tempfile.TemporaryFile()  # noqa: SIM115
        self._clouds = CloudReader()
        self._due = dict.fromkeys(("contact_wrench", "device_wrench", "command_pose"), 0)
        self._choose_topics()
        found: list[Topology] = []
        for message in self.reader.messages(self._topics):
            progress(1e-9 * (message.log_time - self.start), self.duration)
            self._take(message, found)
        self._spool.flush()
        self.reports = self._own_reports()
        if not found or not self.cloud_times:
            lacks = "clouds of the mesh (mesh_points)" if found else "mesh (mesh_topology)"
            make = f"finger_sim run SCENE --bag {path}"
            raise BagError(f"{path}: holds no {lacks}; what holds commands only is to be simulated first: {make}")
        self.mesh = found[0]
        shape = (len(self.cloud_times), len(self.mesh.rest), len(POINT_NAMES))
        self.points: NDArray[np.float32] = np.memmap(self._spool, FLOAT, "r", shape=shape)

    def _choose_topics(self) -> None:
        """The topics of one node: the one whose clouds come first."""
        kinds = {cdr.POINT_CLOUD: "mesh_points", cdr.MESH: "mesh_topology"}
        clouds = [t.name for t in self.reader.topics if t.type == cdr.POINT_CLOUD and t.name.endswith("mesh_points")]
        self._prefix = clouds[0].removesuffix("mesh_points") if clouds else "/"
        named = {
            name: self._prefix + name for name in (*kinds.values(), "contact_wrench", "device_wrench", "command_pose")
        }
        self._named = {full: name for name, full in named.items()}
        self._topics = [*named.values(), "/diagnostics", MOVING, STANDING]

    def _take(self, message: Message, found: list[Topology]) -> None:
        """Takes one message; one that is of no use is passed over, and the first told."""
        time = 1e-9 * (message.log_time - self.start)
        try:
            name = self._named.get(message.topic, message.topic)
            if name == "mesh_points":
                cloud = self._clouds.read(message.data)
                if found and len(cloud.points) == len(found[0].rest):
                    self._spool.write(np.ascontiguousarray(cloud.points).tobytes())
                    self.cloud_times.append(time)
            elif name in self._due and not self._is_due(name, message.log_time):
                pass
            elif name == "contact_wrench":
                self.contact.add(time, read_wrench(message.data))
            elif name == "device_wrench":
                self.device.add(time, read_wrench(message.data))
            elif name == "command_pose":
                self.commands.add(time, read_pose(message.data).values)
            elif name == "mesh_topology" and not found:
                found.append(topology_of(cdr.deserialize(message.data, cdr.MESH)))
            elif name == "/diagnostics" and message.type == DIAGNOSTICS:
                for status in cdr.deserialize(message.data, DIAGNOSTICS).status:
                    node = node_of_status(status.name)
                    if node is not None:
                        values = {item.key: item.value for item in status.values}
                        report = Report(values, status.message, int(status.level))
                        self._reports.setdefault(node, Series()).add(time, report)
            elif name in (MOVING, STANDING):
                self._take_frames(message, time)
        except (ValueError, FingerSimError) as error:
            if not any(text.startswith(message.topic) for text in self.notes):
                self.notes.append(f"{message.topic}: {error}")

    def _own_reports(self) -> Series:
        """Reports of the node whose clouds these are; its name alone tells it where only one reports."""
        if len(self._reports) == 1:
            return next(iter(self._reports.values()))
        own = [series for node, series in self._reports.items() if node.rpartition("/")[0] + "/" == self._prefix]
        return own[0] if own else Series()

    def _take_frames(self, message: Message, time: float) -> None:
        for transform in cdr.deserialize(message.data, cdr.TF_MESSAGE).transforms:
            if transform.child_frame_id == PLANE:
                p, q = transform.transform.translation, transform.transform.rotation
                self.planes.add(time, Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))

    def _is_due(self, what: str, log_time: int) -> bool:
        """One message in each PERIOD is enough of what comes a thousand times a second."""
        if log_time < self._due[what]:
            return False
        self._due[what] = log_time + _THIN
        return True

"""A node as what pages show: its pictures, its parameters, how it is, and what it is told to do."""

from __future__ import annotations

import asyncio
import gc
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..bags.poses import check_pose, read_pose
from ..errors import FingerSimError
from ..scene import Plane, Pose
from .costs import LevelCosts
from .files import RECORDINGS, Recordings
from .forces import split
from .guard import Guard
from .hub import Hub
from .link import Heard, Link
from .orders import Order, OrderError
from .picture import Ground, Painter, plane_frame
from .poses import Poses
from .protocol import Picture, Topology
from .raw import CloudReader, read_wrench
from .samples import Samples
from .session import Session
from .shape import with_scene
from .values import Values
from .words import FED_SLOWLY, Report, status_of

LOOK_PERIOD = 0.25
"""Time between two looks at whether the node is there [s]."""
QUIET = 3.5
"""Time without a report, which a node sends each second, after which it has gone [s]."""


class LiveSource:
    """Shows the node of a session.

    watch : whether pages only look
    """

    kind = "node"

    def __init__(self, session: Session, guard: Guard, recordings: Recordings, watch: bool = False) -> None:
        self.drive = not watch
        self.samples = Samples()
        self._session, self._guard, self._recordings = session, guard, recordings
        self._phase, self._message = "starting", "the node is starting"
        self._report, self._before, self._heard = Report(), Report(), 0.0
        self._values = Values({})
        self._costs = LevelCosts()
        self._painter: Painter | None = None
        self._ground, self._moved = Ground(), False
        self._reader = CloudReader()
        self._command: tuple[float, ...] | None = None
        self._device: tuple[float, ...] | None = None
        self._plane_moves = self._others_command = True
        self._virtual = False
        self._world = "world"
        self._lock = asyncio.Lock()
        self._link: Link | None = None
        self._hub: Hub | None = None
        self._busy: set[asyncio.Task[None]] = set()
        self._poses = Poses(self._send)

    async def run(self, hub: Hub) -> None:
        """Until it is cancelled."""
        self._hub = hub
        session = self._session
        session.start()
        self._link = Link(session.name, session.domain, Heard(self._on_report, self._on_topology, self._on_values))
        try:
            while True:
                await asyncio.sleep(LOOK_PERIOD)
                await self._look_after(hub)
        finally:
            self._link.close()
            session.close()

    def hello(self) -> Mapping[str, Any]:
        """See Source."""
        scene = self._session.scene or _stem(self._values.plain("scene"))
        return {"title": f"{scene or self._session.name}", "scenes": list(self._session.scenes), "scene": scene}

    def parameters(self) -> list[dict[str, Any]]:
        """See Source."""
        items = self._values.items()
        return items if self.drive else [item | {"live": False} for item in items]

    def status(self) -> Mapping[str, Any]:
        """See Source."""
        runs = self._phase == "running"
        report, before = (self._report, self._before) if runs else (Report(), Report())
        levels = self._costs.texts() if runs else None
        told = status_of(report, before)
        if self._hub is not None and self._hub.holder is not None:
            told["words"] = [word for word in told["words"] if not word["text"].startswith(FED_SLOWLY)]
        return told | {"level_errors": levels, "phase": self._phase, "message": self._message}

    def position(self) -> None:
        """See Source."""

    def listen(self, on: bool) -> None:
        """See Source."""
        if self._link is not None:
            self._link.listen(on)

    def look(self) -> Picture | None:
        """See Source."""
        link, painter = self._link, self._painter
        if link is None or painter is None:
            return None
        try:
            return self._look(link, painter)
        except FingerSimError as error:
            self._message = str(error)
            return None

    def pose(self, position: list[float], orientation: list[float]) -> None:
        """See Source."""
        self._poses.submit([*position, *orientation])

    async def do(self, order: Order, hub: Hub) -> Mapping[str, Any] | None:
        """See Source."""
        if order.type == "yaml":
            name = _stem(self._values.plain("scene")) or "scene"
            return {"text": await asyncio.to_thread(self._values.scene_yaml), "name": f"{name}.yaml"}
        if order.type not in ("set", "reset", "record", "scene"):
            raise OrderError(f"{order.type}: there is no recording to play")
        if not self.drive:
            raise OrderError(f"{order.type}: this page only shows the node")
        if order.type == "scene":
            await self._change_scene(str(order.said["name"]), hub)
            return None
        link = self._running()
        if order.type == "set":
            name = str(order.said["name"])
            await link.set(name, self._values.ros_value(name, order.said["value"]))
        elif order.type == "reset":
            hub.notice("info", await link.reset())
        else:
            await self._record(link, bool(order.said["on"]), hub)
        return None

    def _running(self) -> Link:
        if self._link is None or self._phase != "running":
            raise FingerSimError(f"not ready: {self._message}")
        return self._link

    async def _record(self, link: Link, on: bool, hub: Hub) -> None:
        answer = await link.record(on)
        hub.notice("info", answer)
        if not on:
            folder = Path(answer.rpartition(": ")[0])
            offered = await asyncio.to_thread(self._recordings.add, folder)
            if offered is not None:
                name, size = offered
                url = f"{RECORDINGS}{name}{self._guard.query}"
                hub.tell("recorded", {"name": name, "url": url, "bytes": size})

    async def _change_scene(self, name: str, hub: Hub) -> None:
        async with self._lock:
            self._session.choose(name)
            self._forget(f"starting the node with {name}")
            hub.tell("status", self.status())
            await asyncio.to_thread(self._session.end)
            self._session.start()
            self._forget(f"starting the node with {name}")

    def _forget(self, message: str) -> None:
        """A new node is to come."""
        self._phase, self._message = "starting", message
        self._report = self._before = Report()
        self._painter, self._heard = None, 0.0

    async def _look_after(self, hub: Hub) -> None:
        """Notices that the node has ended, or is not heard; starts our own again if it had been ready."""
        if self._lock.locked():
            return
        if self._link is not None:  # nothing is looked for where nobody sends
            self._plane_moves = self._link.senders("plane_pose") > 0
            self._others_command = self._link.senders("command_pose") > 1
        ended = self._session.ended
        if ended is not None:
            was_ready = self._report.runs
            if self._phase != "gone":
                hub.notice("error", ended)
            self._phase, self._message = "gone", ended
            if was_ready:
                self._session.start()
                self._forget(f"{ended}; it is started again")
        elif self._heard and time.monotonic() > self._heard + QUIET:
            self._phase, self._message = "gone", f"{self._session.name} is not heard any more"
        elif not self._heard and self._session.scene == "":
            domain = self._link.domain if self._link else ""
            self._phase = "gone"
            self._message = f"no node {self._session.name} is heard in ROS_DOMAIN_ID {domain}"

    def _on_report(self, report: Report) -> None:
        if self._lock.locked():
            return
        self._heard = time.monotonic()
        self._before, self._report = self._report if self._report.runs else report, report
        if report.runs and self._painter is not None:
            self._phase, self._message = "running", report.message
            self._costs.see(report)
        else:
            self._phase, self._message = "starting", report.message

    def _on_topology(self, message: Any) -> None:
        rest = np.array([(v.x, v.y, v.z) for v in message.vertices])
        triangles = np.array([t.vertex_indices for t in message.triangles], np.int32).reshape(-1, 3)
        if len(rest) and not self._lock.locked():
            self._later(self._begin(Topology(rest, triangles)))

    def _on_values(self, changed: Mapping[str, Any]) -> None:
        shown = self._values.take(changed)
        if shown and self._hub is not None:
            self._hub.tell("values", {"values": shown})
            if {"plane.point", "plane.normal"} & shown.keys():
                self._moved = False
            self._settle()
            self._later(self._look_up_costs())

    def _later(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._busy.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._busy.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None and self._hub is not None:
            self._hub.notice("error", f"{type(error).__name__}: {error}")

    async def _begin(self, topology: Topology) -> None:
        """A node has begun: what it is made of is asked for, and told to all."""
        link, hub = self._link, self._hub
        assert link is not None
        assert hub is not None
        try:
            self._values = Values(await link.parameters())
        except FingerSimError as error:
            hub.notice("warn", f"its parameters are not known: {error}")
        self._costs = LevelCosts()
        try:
            scene = self._values.scene()
            topology = await asyncio.to_thread(with_scene, topology, scene)
        except FingerSimError:
            pass  # its mesh is not on this machine: what was heard is shown
        self._painter, self._reader = Painter(topology.rest), CloudReader()
        self._command, self._device, self._moved = None, None, False
        self.samples.clear()
        self._world = str(self._values.plain("world_frame") or "world")
        link.use_frame(self._world)
        self._settle()
        hub.begin(topology)
        # What lives until the end is not looked through again and again: that takes 20 ms.
        gc.collect()
        gc.freeze()
        await self._look_up_costs()

    async def _look_up_costs(self) -> None:
        self._costs.use(self._values.plain("solver.level"))
        try:
            scene = self._values.scene()
            await asyncio.to_thread(lambda: self._costs.measured_errors(scene, scene.load_mesh()))
        except FingerSimError:
            pass  # nothing is known of a scene that is not here

    def _settle(self) -> None:
        """Takes what pictures need of the parameters."""
        values = self._values
        if "plane.friction" not in values:
            self._ground = Ground()
            return
        plane = Plane(tuple(values.plain("plane.point")), tuple(values.plain("plane.normal")))
        frame = self._ground.plane if self._moved else plane_frame(plane)
        self._virtual = values.plain("coupling.type") == "virtual"
        self._ground = Ground(frame, float(values.plain("plane.friction")), float(values.plain("solver.tolerance")))

    def _look(self, link: Link, painter: Painter) -> Picture | None:
        clouds = link.taken("mesh_points")
        if not clouds:
            return None
        cloud = self._reader.read(clouds[-1])
        if len(cloud.points) != len(painter):
            return None  # of a node that has just been replaced
        if self._plane_moves:
            for data in link.taken("plane_pose"):
                self._move_plane(check_pose(read_pose(data), self._world))
        if self._others_command:
            for data in link.taken("command_pose"):
                pose = check_pose(read_pose(data), self._world)
                if isinstance(pose, Pose):
                    self._command = (*pose.position, *pose.orientation)
        for data in link.taken("device_wrench"):
            self._device = read_wrench(data)[1]
        picture = painter.paint(cloud, 1e-9 * cloud.stamp, self._ground)
        picture.command, picture.device = self._command, self._device
        self._sample(picture)
        picture.status = int(self._report.status)
        picture.virtual = self._virtual
        return picture

    def _move_plane(self, pose: Pose | str) -> None:
        """It is where plane_pose says until a parameter says otherwise."""
        ground = self._ground
        if isinstance(pose, Pose) and ground.plane is not None:
            self._ground, self._moved = Ground(pose, ground.friction, ground.tolerance), True

    def _sample(self, picture: Picture) -> None:
        """The forces of a picture, for the plot."""
        if picture.wrench is not None and picture.time > self.samples.last:
            normal, tangential = split(picture.wrench[:3], self._ground.normal)
            device = 0.0 if self._device is None else math.hypot(*self._device[:3])
            self.samples.add(picture.time, normal, tangential, device, picture.depth)

    def _send(self, pose: Pose) -> None:
        if self._link is not None and self._phase == "running":
            self._link.send(list(pose.position), list(pose.orientation))
            self._command = (*pose.position, *pose.orientation)


def _stem(scene: Any) -> str:
    """Name of a scene from its file."""
    return Path(scene).stem if isinstance(scene, str) and scene else ""

"""A node as what pages show: its pictures, its parameters, how it is, and what it is told to do."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import FingerSimError
from ..scene import Pose
from .costs import LevelCosts
from .eye import Eye
from .files import RECORDINGS, Recordings
from .guard import Guard
from .hub import Hub, Past
from .link import Heard, Link
from .orders import Order, OrderError
from .poses import Poses
from .protocol import Picture, Topology
from .samples import Samples
from .session import Session
from .shape import topology_of, with_scene
from .values import Values
from .words import Report, status_of

LOOK_PERIOD = 0.25
"""Time between two looks at whether the node is there [s]."""
_RECORDED = re.compile(r"(.*): \d+ messages, \d+ dropped")
"""What the node answers when a recording has ended: its folder, and what is in it."""
FINISHING = 10.0
"""How long the recording of a node that has ended is waited for [s]."""
QUIET = 3.5
"""Time without a report, which a node sends each second, after which it has gone [s]."""


class LiveSource:
    """Shows the node of a session.

    watch : whether pages only look
    """

    kind = "node"

    def __init__(self, session: Session, guard: Guard, recordings: Recordings, watch: bool = False) -> None:
        self.drive = not watch
        self._session, self._guard, self._recordings = session, guard, recordings
        self._recorded: list[dict[str, Any]] = []
        self._phase, self._message = "starting", "the node is starting"
        self._report, self._before, self._heard = Report(), Report(), 0.0
        self._values = Values({})
        self._costs = LevelCosts()
        self._eye: Eye | None = None
        self._nothing = Samples()
        self._listens = False
        self._refused = ""
        self._lock = asyncio.Lock()
        self._link: Link | None = None
        self._hub: Hub | None = None
        self._busy: set[asyncio.Task[None]] = set()
        self._poses = Poses(self._send)

    async def run(self, hub: Hub) -> None:
        """Until it is cancelled."""
        self._hub = hub
        session = self._session
        try:
            session.start()
            heard = Heard(self._on_report, self._on_topology, self._on_values)
            self._link = Link(session.name, session.domain, heard)
            self._link.listen(self._listens)
            while True:
                await asyncio.sleep(LOOK_PERIOD)
                await self._look_after(hub)
        finally:
            if self._link is not None:
                self._link.close()
            session.close()

    @property
    def samples(self) -> Past:
        """See Source."""
        return self._nothing if self._eye is None else self._eye.samples

    def hello(self) -> Mapping[str, Any]:
        """See Source."""
        scene = self._session.scene or _stem(self._values.plain("scene"))
        scenes = list(self._session.scenes)
        return {
            "title": f"{scene or self._session.name}", "scenes": scenes, "scene": scene, "recorded": self._recorded,
        }  # fmt: skip

    def parameters(self) -> list[dict[str, Any]]:
        """See Source."""
        items = self._values.items()
        return items if self.drive else [item | {"live": False} for item in items]

    def status(self) -> Mapping[str, Any]:
        """See Source."""
        runs = self._phase == "running"
        report, before = (self._report, self._before) if runs else (Report(), Report())
        levels = self._costs.texts() if runs else None
        told = {"level_errors": levels, "phase": self._phase, "message": self._message}
        return status_of(report, before) | told

    def position(self) -> None:
        """See Source."""

    def listen(self, on: bool) -> None:
        """See Source."""
        self._listens = on
        if self._link is not None:
            self._link.listen(on)

    def look(self) -> Picture | None:
        """See Source."""
        if self._link is None or self._eye is None:
            return None
        try:
            picture = self._eye.look(self._link)
        except FingerSimError as error:
            if str(error) != self._refused and self._hub is not None:
                self._hub.notice("error", str(error))
            self._refused = str(error)
            return None
        if picture is not None:
            picture.status = int(self._report.status)
        return picture

    def pose(self, numbers: Sequence[float]) -> None:
        """See Source."""
        self._poses.submit(numbers)

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
        found = None if on else _RECORDED.match(answer)
        if found:
            await self._offer(found[1], hub)

    async def _offer(self, folder: str, hub: Hub) -> None:
        """A recording that has ended can be fetched, where it is on this machine."""
        offered = await asyncio.to_thread(self._recordings.add, Path(folder))
        if offered is not None:
            name, size = offered
            self._recorded.append({"name": name, "url": f"{RECORDINGS}{name}{self._guard.query}", "bytes": size})
            hub.tell("recorded", self._recorded[-1])

    async def _offer_once_whole(self, folder: str, hub: Hub) -> None:
        """The same of a node that has ended: the process that writes its recording finishes it after that."""
        end = time.monotonic() + FINISHING
        while not (Path(folder) / "metadata.yaml").exists() and time.monotonic() < end:
            await asyncio.sleep(LOOK_PERIOD)
        await self._offer(folder, hub)

    async def _change_scene(self, name: str, hub: Hub) -> None:
        async with self._lock:
            self._session.choose(name)
            link = self._link if self._phase == "running" else None
            self._forget(f"starting the node with {name}")
            hub.tell("status", self.status())
            if link is not None:
                with contextlib.suppress(FingerSimError):  # nothing is being recorded
                    await self._record(link, False, hub)
            await asyncio.to_thread(self._session.end)
            self._session.start()
            self._forget(f"starting the node with {name}")

    def _forget(self, message: str) -> None:
        """A new node is to come."""
        self._phase, self._message = "starting", message
        self._report = self._before = Report()
        self._eye, self._heard = None, 0.0

    async def _look_after(self, hub: Hub) -> None:
        """Notices that the node has ended, or is not heard; starts our own again if it had been ready."""
        if self._lock.locked():
            return
        if self._link is not None and self._eye is not None:
            self._eye.look_for(self._link)
        ended = self._session.ended
        if ended is not None:
            was_ready = self._report.runs
            if self._phase != "gone":
                hub.notice("error", ended)
                recording = self._report.values.get("recording", "off")
                if recording != "off":
                    self._later(self._offer_once_whole(recording, hub))
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
        if report.runs and self._eye is not None:
            self._phase, self._message = "running", report.message
            self._costs.see(report)
        else:
            self._phase = "starting"
            self._message = "its mesh is waited for" if report.runs else report.message

    def _on_topology(self, message: Any) -> None:
        if not self._lock.locked():
            with contextlib.suppress(ValueError):  # another node's, or none
                self._later(self._begin(topology_of(message)))

    def _on_values(self, changed: Mapping[str, Any]) -> None:
        shown = self._values.take(changed)
        if shown and self._hub is not None:
            self._hub.tell("values", {"values": shown})
            if self._eye is not None:
                self._eye.take(self._values, moved=bool({"plane.point", "plane.normal"} & shown.keys()))
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
        with contextlib.suppress(FingerSimError):  # its mesh is not on this machine: what was heard is shown
            topology = await asyncio.to_thread(with_scene, topology, self._values.scene())
        self._eye = Eye(topology, self._values)
        link.use_frame(self._eye.world_frame)
        hub.begin(topology)
        # What lives until the end is not looked through again and again: that takes 20 ms.
        gc.collect()
        gc.freeze()
        await self._look_up_costs()

    async def _look_up_costs(self) -> None:
        self._costs.use(self._values.plain("solver.level"))
        with contextlib.suppress(FingerSimError):  # nothing is known of a scene that is not here
            scene = self._values.scene()
            await asyncio.to_thread(lambda: self._costs.measured_errors(scene, scene.load_mesh()))

    def _send(self, pose: Pose) -> None:
        if self._link is not None and self._eye is not None and self._phase == "running":
            self._link.send(pose)
            self._eye.commanded(pose)


def _stem(scene: Any) -> str:
    """Name of a scene from its file."""
    return Path(scene).stem if isinstance(scene, str) and scene else ""

"""A recording as what pages show: played, paused, at any speed, from any moment. It needs no ROS."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import FingerSimError
from .hub import Hub, Past
from .orders import Order, OrderError
from .protocol import Picture
from .recording import Recording
from .values import Values, of_scene
from .words import Report, status_of


class Playback:
    """Plays a recording; all pages see the same moment of it."""

    kind = "bag"
    drive = False

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._playing, self._speed = True, 1.0
        self._time, self._since = 0.0, time.monotonic()
        self._shown = -1
        self._seen = False
        self._changes = 0
        self._values = self._values_at(0.0)
        self._hub: Hub | None = None

    @property
    def samples(self) -> Past:
        """See Source."""
        return self._recording

    async def run(self, hub: Hub) -> None:
        """See Source."""
        self._hub = hub
        self._go_to(0.0)
        hub.begin(self._recording.topology)
        for note in self._recording.notes:
            hub.notice("warn", note)
        await asyncio.Event().wait()

    def hello(self) -> Mapping[str, Any]:
        """See Source."""
        recording = self._recording
        bag = {"name": recording.name, "duration": recording.duration}
        return {"title": recording.name, "scenes": [], "scene": "", "bag": bag}

    def parameters(self) -> list[dict[str, Any]]:
        """See Source."""
        return self._values.items()

    def status(self) -> Mapping[str, Any]:
        """See Source."""
        now = self._now()
        reports = self._recording.tape.reports
        report: Report = reports.at(now) or Report()
        before: Report = reports.at(now - 1.0) or report
        off = {"on": False, "name": None, "messages": None, "dropped": None}
        warning = "; ".join(self._recording.notes)
        return status_of(report, before) | {
            "recording": off, "level_errors": None, "phase": "running", "message": warning,
        }  # fmt: skip

    def position(self) -> Mapping[str, Any]:
        """See Source."""
        return {"time": self._now(), "playing": self._playing, "speed": self._speed}

    def listen(self, on: bool) -> None:
        """See Source. While nobody looks, it waits."""
        self._go_to(self._now())
        self._seen = on

    def look(self) -> Picture | None:
        """See Source."""
        recording, now = self._recording, self._now()
        if self._playing and now >= recording.duration:
            self._playing = False
            self._go_to(recording.duration)
        self._tell_changes(now)
        k = recording.cloud_at(now)
        if k == self._shown:
            return None
        picture = recording.picture(k, k == self._shown + 1)
        self._shown = k
        tape, scene = recording.tape, recording.scene_at(now)
        picture.command = tape.commands.at(now)
        device = tape.device.at(now)
        picture.device = None if device is None else device[1]
        report: Report | None = tape.reports.at(now)
        picture.status = 0 if report is None else int(report.status)
        picture.virtual = scene is not None and scene.coupling.type == "virtual"
        return picture

    def pose(self, numbers: Sequence[float]) -> None:
        """Raises OrderError."""
        raise OrderError("pose: a recording cannot be held")

    async def do(self, order: Order, hub: Hub) -> Mapping[str, Any] | None:
        """See Source."""
        if order.type == "seek":
            self._go_to(min(float(order.said["time"]), self._recording.duration))
            self._shown = -1
            hub.samples_anew()
        elif order.type == "play":
            self._go_to(self._now())
            self._speed = float(order.said.get("speed", self._speed))
            self._playing = bool(order.said["on"])
            if self._playing and self._time >= self._recording.duration:
                self._go_to(0.0)
                self._shown = -1
                hub.samples_anew()
        elif order.type == "yaml":
            return {"text": self._values.scene_yaml(), "name": f"{self._recording.name}.yaml"}
        else:
            raise OrderError(f"{order.type}: this is a recording")
        hub.tell("position", self.position())
        return None

    def _now(self) -> float:
        """The moment that is shown [s]."""
        if not (self._playing and self._seen):
            return self._time
        passed = self._speed * (time.monotonic() - self._since)
        return min(self._time + passed, self._recording.duration)

    def _go_to(self, moment: float) -> None:
        self._time, self._since = moment, time.monotonic()

    def _tell_changes(self, now: float) -> None:
        """Tells pages of what was changed live, or is no longer after a jump back."""
        changes = self._recording.changed_by(now)
        if changes != self._changes:
            self._changes = changes
            self._values = self._values_at(now)
            if self._hub is not None:
                self._hub.tell("values", {"values": {item["name"]: item["value"] for item in self._values.items()}})

    def _values_at(self, now: float) -> Values:
        scene = self._recording.scene_at(now)
        options = dict(self._recording.options)
        for made in self._recording.changes.values[: self._recording.changed_by(now)]:
            options |= {name: value for name, value in made.items() if "." not in name}
        try:
            return Values({}) if scene is None else of_scene(scene, options.items())
        except FingerSimError:
            return Values({})

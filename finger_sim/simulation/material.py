"""What of a bag a replay simulates: poses, changes, gaps, and how many steps they take."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..bags import cdr
from ..bags.changes import Change, accepted, before_their_steps, changed, changes_in
from ..bags.excerpt import Tally, commands_in, plane_poses_in
from ..bags.gaps import Gap, gaps_in, require_allowed, told
from ..bags.origin import Origin, read_origin, recorded_scene
from ..bags.reader import BagReader
from ..errors import BagError
from .schedule import nanoseconds, steps_to
from .selection import DEFAULTS, RENDERING, Mode, Selection, options_of, unusable

if TYPE_CHECKING:
    from ..scene import Scene


class Material:
    """A bag to be simulated, read once from end to end: a mistake shows before kernels compile.

    scene   : what is simulated; None: what the bag was made with, as it was when the first command came, with the
              node's parameters and all that was changed live. With a scene given, of these only resets and the clutch
              are taken
    options : the node's parameters by name, plain values, at the first step; where a scene is given, DEFAULTS
    changes : what is changed from then on, in order
    clutched : whether the clutch of a device is open at the first step

    Raises BagError for a bag that cannot be read, for a selection of what is not in it, and where the scene or the mesh
    that it was made with cannot be had.
    """

    def __init__(self, scene: Scene | None, bag: str | Path, selection: Selection | None = None) -> None:
        self.selection = selection or Selection()
        self.reader = BagReader(bag)
        self.as_recorded = scene is None
        self.warnings: list[str] = []
        """What is to be known before anything is simulated: long gaps, and what cannot be read."""
        self.origin = self._origin()
        """What the bag was made with; None where it does not say."""
        self.scene = recorded_scene(self.reader, self.origin) if scene is None else scene
        said = self.origin.options if self.origin is not None and self.as_recorded else {}
        self.options = options_of(said, self.selection.mode, self.reader.path)
        by_node = self.as_recorded and self.origin is not None and self.origin.made_by == "node"
        frame = said.get("world_frame") if by_node and self.selection.topic is None else None
        self.commands, self.tally = commands_in(self.reader, self.selection.topic, frame)
        self.options["world_frame"] = self.commands.frame_id or DEFAULTS["world_frame"]
        changes = self._recorded_changes()
        self.plane = plane_poses_in(self.reader, self.commands, self.selection.plane_topic)
        self.plane_tally = self._plane_tally()
        self._zero = self.tally.first
        begin, end = self._window()
        if begin is not None or end is not None:
            self.commands = self.commands.cut(begin, end)
            self.tally = self.commands.tally()
            self.plane = self.plane and self.plane.cut(begin, end)
            self.plane_tally = self._plane_tally()
        self.start = self.tally.first
        """Log time from which simulated time counts [ns]."""
        self._take(changes)
        self.gaps = self._judged_gaps()
        """Long times without a message, in order."""
        self.steps = self._count()
        """Steps to be made, those too that are passed over in gaps."""
        if self._last() + nanoseconds(1, self.scene.dt) >= cdr.STAMPS_END:
            where = f"{self.reader.path}: topic {self.commands.topic}"
            allowed = "allowed: below 2^31 s, as messages are stamped; --duration can end before it"
            raise BagError(f"{where}: got a log time of {self._last() * 1e-9:.9g} s, {allowed}")

    def _origin(self) -> Origin | None:
        """What the bag says of its making. Raises BagError where that is needed, and cannot be read."""
        try:
            return read_origin(self.reader)
        except BagError as error:
            if self.as_recorded:
                raise
            self.warnings.append(f"{error}; the scene that is given is simulated")
            return None

    def _recorded_changes(self) -> list[Change]:
        """Changes and resets of the recording; those that tell nothing are left out with a warning."""
        if self.origin is None:
            return []
        changes, left_out = changes_in(self.reader)
        if self.as_recorded:
            for change in changes:
                if reason := unusable(change.options):
                    left_out.append(f"{change.place}: {reason}")
            changes, refused = accepted(self.scene, (each for each in changes if not unusable(each.options)))
            left_out += refused
        if left_out:
            count = f"{len(left_out)} recorded changes are" if len(left_out) > 1 else "a recorded change is"
            self.warnings.append(f"{self.reader.path}: {count} left out; {left_out[0]}")
        if self.mode == "triggered":
            changes = before_their_steps(self.reader, self.commands.poses(), changes)
        return changes

    def _take(self, changes: list[Change]) -> None:
        """What was changed by the first step is in scene and options then; what comes later is to be changed."""
        before = [change for change in changes if change.time <= self.start]
        later = [change for change in changes if change.time > self.start]
        self._before = before
        self.clutched = next((each.clutch for each in reversed(before) if each.clutch is not None), False)
        if self.as_recorded:
            self.scene = changed(self.scene, before)
            for change in before:
                self.options.update((name, value) for name, value in change.options.items() if name in RENDERING)
            self.changes = later
        else:
            self.changes = [change for change in later if change.reset or change.clutch is not None]
        self.left_out = len(later) - len(self.changes)
        """Live changes that are not followed, as a scene was given."""

    def _received(self) -> Iterator[tuple[int, str, int]]:
        """All that may change a step: log time [ns], topic and number of the message."""
        plane = self.plane if self.scene.plane is not None else None
        streams: list[Iterable[tuple[int, str, int]]] = [poses.times() for poses in (self.commands, plane) if poses]
        streams.append((change.time, change.message.topic, change.number) for change in self.changes)
        last = self._last()
        return (each for each in heapq.merge(*streams, key=lambda item: item[0]) if self.start <= each[0] <= last)

    def _judged_gaps(self) -> list[Gap]:
        """Long times without a message. Raises BagError for one that is too long to be simulated unasked."""
        gaps = list(gaps_in(self._received()))
        if self.mode == "free" and not self.selection.allow_gaps:
            require_allowed(self.reader.path, gaps, (self._zero, self.start))
        if gaps:
            rest = "; a finger at rest is not stepped in between" if self.mode == "free" else ""
            self.warnings.append(f"{self.reader.path}: {told(gaps)}{rest}")
        return gaps

    @property
    def mode(self) -> Mode:
        """When steps are made; see `Selection.mode`."""
        mode: Mode = self.options["mode"]
        return mode

    def _count(self) -> int:
        """Steps to be made. Raises BagError where the mode asks for recorded ones, and there are none."""
        match self.mode:
            case "free":
                return steps_to(self._last() - self.start, self.scene.dt)
            case "triggered":
                return self.tally.good
        origin = self.origin
        by_node = origin is not None and (origin.made_by == "node" or origin.options.get("mode") == "recorded")
        count = sum(1 for _ in self._recorded_steps()) if by_node else 0
        if count == 0:
            needed = f"a bag that the node itself recorded, with the topic {self._steps_topic}"
            raise BagError(f"{self.reader.path}: mode: got recorded, which needs {needed}; allowed: free, triggered")
        return count

    @property
    def _steps_topic(self) -> str:
        return f"{self.commands.topic.rpartition('/')[0]}/contact_wrench"

    def _recorded_steps(self) -> Iterator[int]:
        """When the node began its steps, from the first that followed a command on [ns since the start]."""
        last = self.commands.end if self.commands.end is not None else math.inf
        for message in self.reader.messages([self._steps_topic], cdr.WRENCH_STAMPED):
            if self.start <= message.log_time <= last:
                yield message.log_time - self.start

    def _plane_tally(self) -> Tally:
        """What there is of the plane's poses."""
        return Tally(0, 0, 0, 0) if self.plane is None else self.plane.tally()

    def _last(self) -> int:
        """Log time of the last pose that a step follows [ns]."""
        moves = self.mode == "free" and self.scene.plane is not None and self.plane_tally.good
        return max(self.tally.last, self.plane_tally.last) if moves else self.tally.last

    def _window(self) -> tuple[int | None, int | None]:
        """Log times [ns] of its beginning and end, None for those of the bag. Raises BagError if it is not in it."""
        start, duration, first, last = self.selection.start, self.selection.duration, self.tally.first, self._last()
        begin = first + round(start * 1e9) if math.isfinite(start) else -1
        if not first <= begin <= last:
            allowed = f"allowed: 0 to {(last - first) * 1e-9:.9g} s, where its commands end"
            raise BagError(f"{self.reader.path}: start: got {start:.9g} s, {allowed}")
        if duration is None:
            return begin if start else None, None
        end = begin + round(duration * 1e9) if math.isfinite(duration) else -1
        if not begin < end <= last:
            allowed = f"allowed: more than 0, up to {(last - begin) * 1e-9:.9g} s, where its commands end"
            raise BagError(f"{self.reader.path}: duration: got {duration:.9g} s from {start:.9g} s on, {allowed}")
        return begin if start else None, end

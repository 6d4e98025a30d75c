"""A bag of commands through the simulator without a ROS graph: the same input makes the same bytes.

No wall clock enters the output. Time counts from the first good command, or from the start of the window that was
asked for: step k ends at (k + 1) dt and is stamped with the log time of that beginning plus this time, rounded to a
nanosecond once, so stamps do not drift. Messages are read, and steps made, one at a time: memory does not grow with
the length of the bag, but for the index of its chunks.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

from ..bags import cdr
from ..bags.changes import Change, after, before_their_steps, changed, changes_in
from ..bags.excerpt import Newest, Received, Tally, commands_in, plane_poses_in
from ..bags.interrupts import deferred
from ..bags.layout import WRENCH_FRAMES
from ..bags.origin import Origin, differences, origin_of, read_origin, recorded_scene
from ..bags.reader import LONGEST_SPAN_SECONDS, BagReader, BagWriter, require_absent
from ..errors import BagError, FingerSimError
from .costs import Costs
from .replay_output import Changes, Copies, Output
from .summary import Summary

if TYPE_CHECKING:
    from ..scene import Scene
    from .simulator import Simulator

StepsDone = Callable[[int, int], None]
"""Called with the steps done and all there are."""


Mode = Literal["free", "triggered"]
MODES: tuple[Mode, ...] = get_args(Mode)


@dataclass(frozen=True)
class Selection:
    """What of a bag is simulated, and how.

    The window of `start` and `duration` counts as a bag of its own that holds what was received in it, ends included.
    Its first command is the newest one received by its beginning, as if it came right then: it places the finger at
    rest. The newest pose of the plane by then holds likewise.
    """

    topic: str | None = None
    """Of the commands; see `bags.reader.read_commands`."""
    plane_topic: str | None = None
    """Of the plane's poses; see `bags.reader.plane_poses_of`."""
    mode: Mode | None = None
    """As the node's: steps on a clock, or one step for each command, stamped with its receipt; None: as the bag was
    made where its own scene is simulated, else free."""
    start: float = 0.0
    """Beginning of the window, since the first good command [s]."""
    duration: float | None = None
    """Length of the window [s]; None: to the end of the bag."""


DEFAULTS: Mapping[str, Any] = {
    "mode": "free",
    "world_frame": "world",
    "finger_frame": "finger",
    "wrench_frame": "world_aligned",
}
"""The node's parameters that a run follows too, and says that it did; values where no recording gives others."""


class Replay:
    """A bag to be simulated, read once from end to end: a mistake shows before kernels compile.

    scene   : what is simulated; None: what the bag was made with, as it was when the first command came, with the
              node's parameters and all that was changed live. With a scene given, only resets are taken of these
    options : the node's parameters by name, plain values, at the first step; where a scene is given, DEFAULTS
    changes : what is changed from then on, in order; see `live_changes`

    Raises BagError for a bag that cannot be read, for a selection of what is not in it, and where the scene or the mesh
    that it was made with cannot be had.
    """

    def __init__(self, scene: Scene | None, bag: str | Path, selection: Selection | None = None) -> None:
        self.selection = selection or Selection()
        self.reader = BagReader(bag)
        self.as_recorded = scene is None
        self.origin = read_origin(self.reader)
        """What the bag was made with; None where it does not say."""
        self.scene = recorded_scene(self.reader, self.origin) if scene is None else scene
        self.options = self._options()
        self.commands, self.tally = commands_in(self.reader, self.selection.topic)
        self.options["world_frame"] = self.commands.frame_id or DEFAULTS["world_frame"]
        changes = changes_in(self.reader) if self.origin is not None else []
        if not self._free:
            changes = before_their_steps(self.reader, self.commands.poses(), changes)
        self.plane = plane_poses_in(self.reader, self.commands, self.selection.plane_topic)
        self.plane_tally = self._plane_tally()
        begin, end = self._window()
        if begin is not None or end is not None:
            self.commands = self.commands.cut(begin, end)
            self.tally = self.commands.tally()
            self.plane = self.plane and self.plane.cut(begin, end)
            self.plane_tally = self._plane_tally()
        self.start = self.tally.first
        """Log time from which simulated time counts [ns]."""
        self._take(changes)
        self.steps = _steps(self._last() - self.start, self.scene.dt) if self._free else self.tally.good
        """Steps to be made."""
        if self._last() + _nanoseconds(1, self.scene.dt) >= cdr.STAMPS_END:
            where = f"{self.reader.path}: topic {self.commands.topic}"
            allowed = "allowed: below 2^31 s, as messages are stamped"
            raise BagError(f"{where}: got a log time of {self._last() * 1e-9:.9g} s, {allowed}")
        self.remains: str | None = None
        """What is left of a run that did not come to its end."""

    def _options(self) -> dict[str, Any]:
        """The node's parameters at the bag's beginning. Raises BagError for one that no node has."""
        options = {**DEFAULTS, **(self.origin.options if self.origin is not None and self.as_recorded else {})}
        for name, known in (("mode", MODES), ("wrench_frame", WRENCH_FRAMES)):
            if options[name] not in known:
                got = f"{name}: got {options[name]!r}, allowed: {', '.join(known)}"
                raise BagError(f"{self.reader.path}: what it says of its making: options: {got}")
        return options if self.selection.mode is None else {**options, "mode": self.selection.mode}

    @property
    def live_changes(self) -> list[tuple[float, Mapping[str, Any], Mapping[str, Any]]]:
        """Time since the first command [s], changes of the scene and changes of the node's parameters, in order."""
        return [(1e-9 * (change.time - self.start), change.scene, change.options) for change in self.changes]

    def _take(self, changes: list[Change]) -> None:
        """What was changed by the first step is in scene and options then; what comes later is to be changed.

        Raises BagError for what the scene refuses.
        """
        before = [change for change in changes if change.time <= self.start]
        later = [change for change in changes if change.time > self.start]
        self._before = before
        if self.as_recorded:
            self.scene = changed(self.reader, self.scene, before)
            changed(self.reader, self.scene, later)
            for change in before:
                self.options.update(change.options)
            self.changes = later
        else:
            self.changes = [change for change in later if change.reset]
        self.left_out = len(later) - len(self.changes)
        """Live changes that are not followed, as a scene was given."""

    def run(self, out: str | Path, progress: StepsDone | None = None, *, simulator: Simulator | None = None) -> Summary:
        """Simulates, and writes what the node would publish to the new bag `out`; see `run` of this module."""
        require_absent(out)
        if simulator is None:
            from .simulator import Simulator

            simulator = Simulator(self.scene)
        taken = {name: self.options[name] for name in DEFAULTS}
        origin = origin_of("run", self.scene, simulator.mesh, taken)
        summary = self._summary(out, origin)
        with deferred() as interrupt:
            recording = BagWriter(out, origin=origin.words())
            try:
                self._simulate(simulator, recording, summary, progress, interrupt)
                recording.close()
            except BaseException as error:
                self.remains = self._leave(recording, summary, error)
                raise
        return summary

    def _simulate(
        self,
        simulator: Simulator,
        recording: BagWriter,
        summary: Summary,
        progress: StepsDone | None,
        interrupt: Callable[[], None],
    ) -> None:
        """Makes all steps, and records them beside the poses that they follow."""
        output = Output(recording, self.start, self.options)
        copies = [Copies(self.commands, recording, "command_pose")]
        if self.plane is not None:
            copies.append(Copies(self.plane, recording, "plane_pose"))
        changes = Changes(self.changes, recording)
        plane = Newest(self.plane.poses() if self.plane is not None and self.scene.plane is not None else iter(()))
        before = plane.received_by(self.start)
        held = next(self.commands.poses()).pose
        simulator.reset(held, before and before.pose)
        output.begin(simulator)
        costs = Costs()
        for moment in self._moments():
            changes.up_to(self.start + moment.begin, simulator)
            place = plane.received_by(self.start + moment.begin)
            held = moment.command.pose if moment.command is not None else held
            clock = time.perf_counter()
            result = simulator.step(held, place and place.pose)
            costs.add(time.perf_counter() - clock)
            for copy in copies:
                copy.up_to(self.start + moment.end)
            output.step(simulator, result, moment.end)
            summary.count(result, moment.end)
            if progress is not None:
                progress(summary.steps, self.steps)
            interrupt()
        for copy in copies:
            copy.up_to(None)
        summary.duration, summary.wall = _nanoseconds(summary.steps, self.scene.dt) * 1e-9, costs.total
        summary.step_median, summary.step_p99 = costs.percentile(50.0), costs.percentile(99.0)

    @property
    def _free(self) -> bool:
        return bool(self.options["mode"] == "free")

    def _moments(self) -> Iterator[_Moment]:
        """When steps begin and end, with the command that came for each."""
        if not self._free:
            for command in self.commands.poses():
                at = command.log_time - self.start
                yield _Moment(at, at, command)
            return
        newest = Newest(self.commands.poses())
        begin = 0
        for k in range(self.steps):
            end = _nanoseconds(k + 1, self.scene.dt)
            yield _Moment(begin, end, newest.received_by(self.start + begin))
            begin = end

    def _plane_tally(self) -> Tally:
        """What there is of the plane's poses. Raises BagError when one is too far away from the commands."""
        if self.plane is None:
            return Tally(0, 0, 0, 0)
        tally = self.plane.tally()
        farthest = max(abs(time - self.tally.first) for time in (tally.first, tally.last)) * 1e-9 if tally.good else 0.0
        if farthest > LONGEST_SPAN_SECONDS:
            far = f"{farthest:.3g} s away from the first command, allowed: {LONGEST_SPAN_SECONDS:g} s"
            raise BagError(f"{self.reader.path}: topic {self.plane.topic}: a log time is {far}")
        return tally

    def _last(self) -> int:
        """Log time of the last pose that a step follows [ns]."""
        moves = self._free and self.scene.plane is not None and self.plane_tally.good
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

    def _summary(self, out: str | Path, origin: Origin) -> Summary:
        """What is known before the first step."""
        tally, plane = self.tally, self.plane_tally
        summary = Summary(Path(out), self.commands.topic, tally.good, tally.refused, self.reader.warning)
        if self.plane is not None:
            summary.plane_topic = self.plane.topic
            summary.plane_poses = plane.good if self.scene.plane is not None else 0
            summary.plane_refused = plane.refused + plane.good - summary.plane_poses
        summary.resets = sum(change.reset for change in self.changes)
        summary.live_changes, summary.left_out = len(self.changes) - summary.resets, self.left_out
        summary.as_recorded = self.as_recorded
        if self.origin is not None:
            summary.differences = list(differences(origin, after(self.origin, self._before)))
        return summary

    def _leave(self, recording: BagWriter, summary: Summary, error: BaseException) -> str:
        """Finishes the bag of a run that ends here, or removes it if nothing was simulated; what is left, in words."""
        if summary.steps:
            with contextlib.suppress(BagError):
                recording.cut(f"{_cause(error)} after {summary.steps} of {self.steps} steps")
                left = recording.counts["/pose"]  # a full disk takes some back
                return f"{summary.out}: cut after {left} of {self.steps} steps, readable up to there"
        recording.discard()
        return f"{summary.out}: removed, as nothing in it could be used"


def run(
    scene: Scene | None,
    bag: str | Path,
    out: str | Path,
    selection: Selection | None = None,
    progress: StepsDone | None = None,
    *,
    simulator: Simulator | None = None,
) -> Summary:
    """Simulates the commands of `bag` and writes what the node would publish to the new bag `out`.

    The newest command received up to the beginning of a step holds during it; the first one places the finger
    at rest. Poses of the plane in the bag move it likewise: it rests at the newest before the first command. The last
    step is the one that follows the last of all these. Both are copied as they were read, those that are refused
    too, and so are live changes that are followed: replayed, `out` gives itself.
    A bag that the node recorded from its first command on gives the live wrench back but for where steps begin:
    what is live at a time is here within two steps of it. Of one that began later the history is not known.
    In mode triggered, as the node's, there is one step for each command, stamped with its receipt: what the node
    recorded in that mode from its first command on comes back bit by bit (but for when a moving plane's poses came).

    scene     : None: what the bag was made with, the node's parameters and all that was changed live; see Replay.
                Resets are made in any case, each before the first step that begins after it
    selection : what of the bag is simulated, and in which mode; all, if left out
    progress   : called after every step
    simulator : of the scene that is simulated, instead of a new one
    Raises BagError for a bag that cannot be read or made and for a selection that is not in it, and what Simulator
    raises. SIGINT and SIGTERM take effect between two steps. Whatever ends it before its end leaves a finished bag
    of the steps made by then, with the reason in its metadata; where there are none, no bag.
    """
    require_absent(out)
    return Replay(scene, bag, selection).run(out, progress, simulator=simulator)


class _Moment(NamedTuple):
    """A step: when it begins and ends [ns], and the command that came for it, if one did."""

    begin: int
    end: int
    command: Received | None


def _steps(last: int, dt: float) -> int:
    """Steps until the pose received at `last` [ns] has been simulated for one of them."""
    k = math.floor(last * 1e-9 / dt)
    while _nanoseconds(k, dt) < last:
        k += 1
    return k + 1


def _nanoseconds(k: int, dt: float) -> int:
    """k dt, rounded once [ns]."""
    return round(k * dt * 1e9)


def _cause(error: BaseException) -> str:
    """Why a run ended, in few words."""
    if isinstance(error, KeyboardInterrupt | SystemExit):
        return "interrupted"
    return str(error) if isinstance(error, FingerSimError) else f"{type(error).__name__}: {error}"

"""A bag of commands through the simulator without a ROS graph: the same input makes the same bytes.

No wall clock enters the output. Time counts from the first good command, or from the start of the window that was
asked for: step k ends at (k + 1) dt and is stamped with the log time of that beginning plus this time, rounded to a
nanosecond once, so stamps do not drift. Messages are read, and steps made, one at a time: memory does not grow with
the length of the bag, but for the index of its chunks. In a gap longer than `bags.gaps.GAP_TOLD`, a finger that has
come to rest is not stepped, and nothing is written, until the last step before the message that ends it.
"""

from __future__ import annotations

import contextlib
import heapq
import math
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..bags import cdr
from ..bags.changes import Change, accepted, after, before_their_steps, changed, changes_in
from ..bags.excerpt import Arrivals, Received, Tally, commands_in, plane_poses_in
from ..bags.gaps import Gap, gaps_in, require_allowed, told
from ..bags.interrupts import deferred
from ..bags.origin import Origin, differences, origin_of, read_origin, recorded_scene
from ..bags.reader import BagReader, BagWriter, require_absent
from ..errors import BagError, FingerSimError
from ..haptics.rendering import Rendering
from .costs import Costs
from .replay_output import Changes, Copies, Output
from .schedule import Moment, at_times, nanoseconds, of_commands, on_a_clock, steps_to
from .selection import DEFAULTS, RENDERING, Mode, options_of, unusable
from .selection import Selection as Selection
from .summary import Summary

if TYPE_CHECKING:
    from ..scene import Scene
    from .simulator import Simulator

StepsDone = Callable[[int, int], None]
"""Called with the steps done and all there are."""


class Replay:
    """A bag to be simulated, read once from end to end: a mistake shows before kernels compile.

    scene   : what is simulated; None: what the bag was made with, as it was when the first command came, with the
              node's parameters and all that was changed live. With a scene given, only resets are taken of these
    options : the node's parameters by name, plain values, at the first step; where a scene is given, DEFAULTS
    changes : what is changed from then on, in order

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
        self.remains: str | None = None
        """What is left of a run that did not come to its end."""

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
        if self.as_recorded:
            self.scene = changed(self.scene, before)
            for change in before:
                self.options.update((name, value) for name, value in change.options.items() if name in RENDERING)
            self.changes = later
        else:
            self.changes = [change for change in later if change.reset]
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
            require_allowed(self.reader.path, gaps, self._zero, self.start)
        if gaps:
            rest = "; a finger at rest is not stepped in between" if self.mode == "free" else ""
            self.warnings.append(f"{self.reader.path}: {told(gaps)}{rest}")
        return gaps

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
        plane = Arrivals(self.plane.poses() if self.plane is not None and self.scene.plane is not None else iter(()))
        costs, rendering = Costs(), Rendering(*(self.options[name] for name in RENDERING))
        newest: Received | None = None
        asleep = False
        zero = self.start

        def unchanged() -> float:
            return rendering.unchanged(newest.log_time) if asleep and newest is not None else 0.0

        for moment in self._moments(unchanged):
            for name, value in changes.up_to(self.start + moment.begin, simulator).items():
                if name in RENDERING:
                    setattr(rendering, RENDERING[name], value)
            places, commands = plane.up_to(self.start + moment.begin), moment.commands
            if newest is None:
                commands = commands[-1:]
                zero = commands[0].log_time
                simulator.reset(commands[0].pose, places[-1].pose if places else None)
                summary.set_down_by, places = simulator.set_down_by, []
                output.begin(simulator)
            clock = time.perf_counter()
            answers = commands[-1].pose if self.mode == "triggered" else None
            if answers is None:
                for command in commands:
                    simulator.hear(command.pose, 1e-9 * (command.log_time - zero))
            now = 1e-9 * (self.start + moment.begin - zero) if answers is None else None
            result = simulator.step(answers, places[-1].pose if places else None, now=now)
            if answers is not None and newest is not None:
                rendering.watch(1e-9 * (commands[-1].log_time - newest.log_time))
            newest = commands[-1] if commands else newest
            assert newest is not None
            rendering.watch(1e-9 * (self.start + moment.begin - newest.log_time))
            device = rendering.render(result.device_wrench, simulator.scene.coupling, self.scene.dt)
            costs.add(time.perf_counter() - clock)
            for copy in copies:
                copy.up_to(self.start + moment.end)
            output.step(simulator, result, device, moment.end)
            asleep = bool(self.gaps) and result.asleep
            summary.count(result, moment.end)
            summary.passed_over = nanoseconds(moment.number - summary.steps, self.scene.dt) * 1e-9
            if progress is not None:
                progress(moment.number, self.steps)
            interrupt()
        for copy in copies:
            copy.up_to(None)
        summary.duration, summary.wall = nanoseconds(summary.steps, self.scene.dt) * 1e-9, costs.total
        summary.step_median, summary.step_p99 = costs.percentile(50.0), costs.percentile(99.0)

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

    def _moments(self, unchanged: Callable[[], float]) -> Iterator[Moment]:
        """When steps begin and end, with the commands that came for each; `unchanged`: see `on_a_clock`."""
        if self.mode == "triggered":
            return of_commands(self.commands, self.start)
        if self.mode == "recorded":
            return at_times(self.commands, self.start, self._recorded_steps())
        return on_a_clock(self.commands, self.start, self.steps, self.scene.dt, iter(self.gaps), unchanged)

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

    def _summary(self, out: str | Path, origin: Origin) -> Summary:
        """What is known before the first step."""
        tally, plane = self.tally, self.plane_tally
        summary = Summary(Path(out), self.commands.topic, tally.good, tally.refused, self.reader.warning)
        summary.refusal, summary.warnings = tally.refusal, list(self.warnings)
        if self.plane is not None:
            summary.plane_topic = self.plane.topic
            summary.plane_poses = plane.good if self.scene.plane is not None else 0
            summary.plane_refused = plane.refused + plane.good - summary.plane_poses
            summary.plane_refusal = plane.refusal
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


def _cause(error: BaseException) -> str:
    """Why a run ended, in few words."""
    if isinstance(error, KeyboardInterrupt | SystemExit):
        return "interrupted"
    return str(error) if isinstance(error, FingerSimError) else f"{type(error).__name__}: {error}"

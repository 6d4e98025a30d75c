"""A bag of commands through the simulator without a ROS graph: the same input makes the same bytes.

No wall clock enters the output. Time counts from the first good command, or from the start of the window that was
asked for: step k ends at (k + 1) dt and is stamped with the log time of that beginning plus this time, rounded to a
nanosecond once, so stamps do not drift. Messages are read, and steps made, one at a time: memory does not grow with
the length of the bag, but for the index of its chunks. In a gap longer than `bags.gaps.GAP_TOLD`, a finger that has
come to rest is not stepped, and nothing is written, until the last step before the message that ends it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..bags.changes import after
from ..bags.excerpt import Arrivals, Received
from ..bags.interrupts import deferred
from ..bags.origin import Origin, differences, origin_of
from ..bags.reader import BagWriter, require_absent
from ..errors import BagError, FingerSimError
from ..haptics.rendering import Rendering
from .costs import Costs
from .material import Material
from .replay_output import Changes, Copies, Output
from .schedule import Moment, at_times, nanoseconds, of_commands, on_a_clock
from .selection import DEFAULTS, RENDERING
from .selection import Selection as Selection
from .summary import Summary

if TYPE_CHECKING:
    from ..scene import Scene
    from .simulator import Simulator

StepsDone = Callable[[int, int], None]
"""Called with the steps done and all there are."""


class Replay(Material):
    """A bag to be simulated, read once from end to end; see Material, whose errors it raises."""

    remains: str | None = None
    """What is left of a run that did not come to its end."""

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
        changes = Changes(self.changes, recording, self.clutched)
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
            rendering.clutched = changes.clutched
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

    def _moments(self, unchanged: Callable[[], float]) -> Iterator[Moment]:
        """When steps begin and end, with the commands that came for each; `unchanged`: see `on_a_clock`."""
        if self.mode == "triggered":
            return of_commands(self.commands, self.start)
        if self.mode == "recorded":
            return at_times(self.commands, self.start, self._recorded_steps())
        return on_a_clock(self.commands, self.start, self.steps, self.scene.dt, iter(self.gaps), unchanged)

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
        clutched = sum(change.clutch is not None for change in self.changes)
        summary.live_changes, summary.left_out = len(self.changes) - summary.resets - clutched, self.left_out
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

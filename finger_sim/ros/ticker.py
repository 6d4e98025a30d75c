"""The loop's thread: compiled code makes the steps (tick.py), and this does what it needs Python for."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from ..arrays import Ints
from ..bags.recording import Recording, no_recording
from ..errors import FingerSimError
from ..haptics.budget import Purse, build_purse
from ..haptics.path import numbers, pose_of
from ..haptics.phase import no_phase
from ..physics.compile import compiling
from ..physics.records import changed, direct, held
from ..scene import Pose
from ..simulation.simulator import Compiled
from . import tick
from .accounts import nothing_counted
from .endpoints import Endpoints
from .inbox import Command, Inbox
from .loop import IDLE_PERIOD, Loop, StepCounts, Triggers
from .messages import time_of
from .outputs import Outputs
from .pose_bytes import frame_bytes
from .rcl import meaning
from .snapshot import Shown, Snapshot
from .stepper import Stepper
from .tick import Heard, Live, Sent, deadlines
from .wire import UNFIT

_PATIENCE = 0.5
"""How long the loop may take to hand over what is shown [s]; after that it is asked anew."""

_LAST_WORDS = 0.2
"""How long the last messages to a device may take to arrive [s]."""


class Ticker(Loop):
    """Makes steps every `period` [s], or one for each command.

    reported : what diagnostics tell of, for one thread
    resting  : whether it makes no steps, and the device gets no force
    resumed  : steady time at which it last made steps again [s]

    take     : commands that came by a steady time [ns], or till now; poses of the plane go to the Stepper
    triggers : commands that wait for their steps; None: steps have deadlines
    clock    : of the node

    Where rcl does not fit, and under simulated time, messages go through rclpy, by hand: see tick.py.
    """

    def __init__(
        self,
        period: float,
        prepare: Callable[[], object],
        parts: tuple[Stepper, Outputs, Inbox],
        take: Callable[[int | None], list[Command]],
        triggers: Triggers[Command] | None,
        clock: Any,
        log: Any,
    ) -> None:
        super().__init__(prepare)
        self._stepper, self._outputs, self._inbox = parts
        self._take_commands, self._triggers = take, triggers
        self._clock, self._log = clock, log
        self._grid, self._phase = deadlines(period), no_phase(period)
        self._loaded = self.resting = False
        self.resumed = 0.0
        self._wake = self._ask
        self._endpoints = Endpoints([*self._outputs.stepped(), *self._outputs.device.sent], self._inbox.subscriptions)
        self._said = ""
        self._held: Any = None
        self._no_purse, self._no_recording = build_purse(), no_recording()
        self._shifted: Pose | None = None

    def compile(self, compiled: Compiled) -> None:
        """Compiles what will step, for the types of a Simulator to be, where it is not there yet."""
        self._make(compiled)
        self._bind(compiled, self._parts(compiled, None, None))

    def load(self, tell: Callable[[str], None]) -> None:
        """Compiles or loads what steps, once there is a Simulator."""
        with compiling(tell, tick.KERNELS):
            self._arranged: tuple[Any, ...] = ()
            self._arrange()
        self._inbox.also = self._heard.commands
        self._loaded = True

    def release(self) -> None:
        """Takes force from the device, and lets publishers and subscriptions go; once the thread has ended."""
        if self._held is not None and self._ready:
            with contextlib.suppress(FingerSimError):
                self._silence(self._held, time_of(self._clock))
                self._send_to_device()
                self._endpoints.delivered(_LAST_WORDS)  # what is lost after its publisher has gone is not sent again
        self._endpoints.release()

    def shown(self, whole: bool) -> Shown | None:
        """The body after its last step, whole or not, for one thread; None before that, or of a loop that stands."""
        if not self.ready or self.resting or not self._shown.take(_PATIENCE):
            return None
        return self._shown.shown(self._stepper.sim, whole)

    def rest(self) -> None:
        """Makes no steps from now on; before the start, or by `call`."""
        self.resting = True

    def go_on(self) -> None:
        """Makes steps again; likewise."""
        self.resting = False

    def _ask(self) -> None:
        self._grid.asked[0] = 1
        if self._triggers is not None:
            self._inbox.wake()

    @property
    def progress(self) -> StepCounts:
        """Steps made and missed until now."""
        if not self._loaded:
            return self._progress
        grid = self._grid
        steps, late, overruns = (int(count[0]) for count in (grid.steps, grid.late, grid.overruns))
        dropped = self._triggers.dropped if self._triggers is not None else 0
        begin, last = (1e-9 * int(when[0]) for when in (grid.origin, grid.last))
        return StepCounts(steps, late, overruns + dropped, begin, max(begin, last))

    def _turn(self, origin: float) -> None:
        rested = self.resting
        if rested:
            self._rest()
        self._set_out(rested)
        asked = {
            tick.ASKED: self._listen,
            tick.TO_AWAIT: self._await,
            tick.TO_TAKE: self._take,
            tick.TO_LOOK: self._look,
            tick.UNHEARD: self._unheard,
            tick.TO_PLACE: self._place,
            tick.TO_MEND: self._mend,
            tick.TO_FIT: self._fit,
            tick.TO_SEND: self._send,
            tick.TO_TELL: self._tell,
        }
        while not self._stop.is_set():
            asked[self._run_compiled()]()

    def _run_compiled(self) -> int:
        """Steps until Python is needed; why."""
        return self._function(*self._arguments)

    def _listen(self) -> None:
        """Somebody wants a turn between two steps."""
        self._grid.asked[0] = 0
        self._answer()
        if self.resting:
            self._rest()
        self._arrange()

    def _rest(self) -> None:
        """Until steps are wanted again, or the end. Commands that come meanwhile are passed over."""
        begun = time.monotonic_ns()
        self._stepper.rendering.silence()
        self._silence(self._held, time_of(self._clock))
        self._send_to_device()
        while self.resting and not self._stop.is_set():
            time.sleep(IDLE_PERIOD)
            self._take_commands(None)
            self._answer()
        now = time.monotonic_ns()
        self._grid.origin[0] += now - begun
        self._grid.last[0] = now
        self.resumed = 1e-9 * now

    def _await(self) -> None:
        """The next command has its step; without one, the device is let go of in time."""
        triggers = self._triggers
        assert triggers is not None
        triggers.extend(self._take_commands(None))
        self._shift()
        command = triggers.pop()
        if command is not None:
            before = int(self._heard.received[0])
            if before != 0 and 1e-9 * (command.received_ns - before) > self._stepper.rendering.timeout:
                self._stepper.rendering.silence()
            self._follow(command)
            self._answer_to(self._held, time.monotonic_ns(), command.stamp or time_of(self._clock))
        elif not self._inbox.wait(IDLE_PERIOD):
            if self._let_go(self._held, time.monotonic_ns(), time_of(self._clock)) and self._live.by_hand[0] != 0:
                self._send_to_device()
            self._tell()

    def _take(self) -> None:
        """What came by the beginning of the step, through rclpy."""
        for command in self._take_commands(int(self._grid.begun[0])):
            self._follow(command)
        self._shift()
        self._sent.stamp[0] = time_of(self._clock)

    def _fit(self) -> None:
        """Where a free body is, and the wrench about there."""
        self._sent.contact[:] = self._stepper.sim.locate()

    def _send(self) -> None:
        """What the step brought, through rclpy."""
        self._send_to_device()
        for which in (tick.CONTACT, tick.POSE):
            self._endpoints.send(which)

    def _send_to_device(self) -> None:
        """What was filled in for it, through rclpy."""
        self._endpoints.send(tick.DEVICE)
        for k in np.flatnonzero(self._outputs.device.record.due).tolist():
            self._endpoints.send(tick.POSE + 1 + k)

    def _make(self, compiled: Compiled) -> None:
        """The parts of what compiled code works on that are its own."""
        options = self._outputs.options
        state = getattr(compiled.state, "record", compiled.state)
        self._shown, self.reported = Snapshot(state), Snapshot(state)
        self._heard = Heard(
            newest=np.zeros(7), received=_one(), stamp=_one(), transport=np.zeros(1), before=np.zeros(7), fresh=_one(),
            zero=_one(), commands=_one(), looked=np.full(len(self._inbox.subscriptions), time.monotonic_ns()),
            frame=frame_bytes(options.world_frame), at=np.zeros(7), which=_one(), when=_one(), failure=_one(),
        )  # fmt: skip
        axes = {"world_aligned": tick.WORLD_ALIGNED, "finger": tick.FINGER, "world": tick.WORLD}[options.wrench_frame]
        self._sent = Sent(
            np.zeros(6), np.zeros(6), np.array([axes]), np.zeros(2), np.zeros(6, np.int64), _one(), _one()
        )  # fmt: skip
        self._by_hand, answers = _one(), np.array([self._triggers is not None], np.int64)
        self._flow, self._counted = (_one(), _one(), _one(), _one(), self._by_hand, answers), nothing_counted()

    def _set_out(self, rested: bool = False) -> None:
        """What came before the first step, if the loop has not rested, and when that is."""
        with self._inbox.early:
            newest = self._stepper.newest
        if newest is not None and self._triggers is None and not rested:
            self._follow(newest)
        self._shift()
        self._stepper.follow(self._newest)
        self._grid.origin[0] = self._grid.last[0] = time.monotonic_ns()

    def _newest(self) -> Command | None:
        """The command that is followed."""
        heard = self._heard
        if heard.received[0] == 0:
            return None
        return Command(pose_of(heard.newest), int(heard.received[0]), float(heard.transport[0]), int(heard.stamp[0]))

    def _arrange(self) -> None:
        """What compiled code works on, as it is now."""
        stepper, outputs = self._stepper, self._outputs
        stepper.allow(outputs.options)
        why = "use_sim_time is set" if self._clock.ros_time_is_active else self._endpoints.lack
        if why != self._said:
            self._log.info(f"messages go through rclpy, which is slower: {why}" if why else "messages go through rcl")
        self._said, self._by_hand[0] = why, why != ""
        recorder, compiled = outputs.recorder, stepper.sim.compiled
        recording = recorder.loop if recorder is not None else None
        purse = stepper.budget.purse if stepper.budget is not None else None
        if self._arranged and all(a is b for a, b in zip(self._arranged, (recording, compiled, purse), strict=True)):
            return
        if recorder is not None:
            topics = [recorder.number(name) for name in (*outputs.stepped_topics, *self._inbox.topics)]
            self._sent.topics[: len(topics)] = topics
        self._bind(compiled, self._parts(compiled, recording, purse))
        self._arranged = (recording, compiled, purse)

    def _parts(self, compiled: Compiled, recording: Recording | None, purse: Purse | None) -> Live:
        incoming, outgoing, stepper = self._endpoints.incoming, self._endpoints.outgoing, self._stepper
        return Live(
            *self._flow, incoming.clock, self._grid, self._phase, self._heard, self._sent, compiled.body,
            stepper.sender.record, purse or self._no_purse, incoming, outgoing, self._inbox.device.record,
            self._outputs.device.record, recording or self._no_recording, self._counted, self.step_time, self.lateness,
            stepper.delay, stepper.transport, self._shown.record, self.reported.record,
        )  # fmt: skip

    def _bind(self, compiled: Compiled, live: Live) -> None:
        before, self._live = self._held, live
        self._held = held(live) if before is None else changed(before, live)
        self._arguments = (compiled.address, compiled.model, compiled.state, self._held)
        if before is None:
            self._function: Callable[..., int] = direct(tick.run, types.int64, *self._arguments[1:])
            self._hear = direct(tick.hear, self._held, types.int64, types.int64, types.float64)
            self._answer_to = direct(tick.answer, self._held, types.int64, types.int64)
            self._let_go = direct(tick.let_go, self._held, types.int64, types.int64)
            self._silence = direct(tick.silence, self._held, types.int64)

    def _look(self) -> None:
        """A message that is not the usual one."""
        which, received = int(self._heard.which[0]), int(self._heard.when[0])
        if not self._inbox.explain(which):
            made = which == tick.COMMAND and self._inbox.device.active
            self._judge(which, self._inbox.device.command if made else self._endpoints.taken(which).data, received)

    def _judge(self, which: int, data: bytes, received: int) -> None:
        if which == tick.COMMAND:
            command = self._inbox.judge(data, received)
            if command is not None:
                self._follow(command)
        else:
            plane = self._inbox.judge_plane(data, received)
            if plane is not None:
                self._stepper.plane = plane
                self._shift()

    def _follow(self, command: Command) -> None:
        self._heard.at[:] = numbers(command.pose)
        self._hear(self._held, command.received_ns, command.stamp, command.transport)

    def _shift(self) -> None:
        """The plane goes where it is wanted, if that is new."""
        plane = self._stepper.plane
        if plane is not None and plane is not self._shifted:
            table = self._live.body.table
            table.target[:], table.given[0] = numbers(plane), 1.0
        self._shifted = plane

    def _unheard(self) -> None:
        """A message that could not be taken, or the first one, which shows that rcl is not what it is taken for."""
        which, failure = int(self._heard.which[0]), int(self._heard.failure[0])
        if failure != -UNFIT:
            raise FingerSimError(f"what comes in cannot be taken: {meaning(failure)}")
        received = time.monotonic_ns()
        data = self._inbox.arrived(which, self._endpoints.taken(which).data, received)
        if data is not None:
            self._judge(which, data, received)
        self._arrange()

    def _place(self) -> None:
        """The first command places the finger, and the plane where it is wanted."""
        heard, table = self._heard, self._live.body.table
        heard.zero[0] = heard.received[0]
        heard.before[:] = heard.at[:] = heard.newest
        self._stepper.place(pose_of(heard.newest), pose_of(table.target) if table.given[0] != 0.0 else None)
        self._hear(self._held, int(heard.received[0]), int(heard.stamp[0]), float(heard.transport[0]))

    def _mend(self) -> None:
        self._live.begin[0] = self._stepper.sim.mend(int(self._live.why[0]))

    def _tell(self) -> None:
        told, self._live.told[0] = int(self._live.told[0]), 0
        self._stepper.tell(told & (tick.BECAME_STALE | tick.BACK))
        if told & tick.UNSENT:
            raise FingerSimError(f"a message cannot be sent: {meaning(int(self._sent.failure[0]))}")
        if told & tick.RUNG:
            self._stepper.take_rung()
            self._arrange()


def _one() -> Ints:
    return np.zeros(1, np.int64)

"""The loop of mode free: compiled where it can be (tick.py), and what it needs Python for."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import types

from ..arrays import Ints
from ..bags.recording import Recording, no_recording
from ..errors import FingerSimError
from ..haptics.budget import Purse, build_purse
from ..haptics.path import numbers, pose_of
from ..physics.compile import compiling
from ..physics.records import direct, held
from ..scene import Pose
from ..simulation.simulator import Compiled
from . import tick
from .accounts import Window, nothing_counted
from .endpoints import Endpoints
from .inbox import Command, Inbox
from .loop import RateLoop, StepCounts
from .outputs import Outputs
from .pose_bytes import frame_bytes
from .rcl import UnfitError, meaning
from .stepper import Observed, Stepper
from .tick import Heard, Live, Sent, deadlines
from .wire import UNFIT


class Ticker(RateLoop):
    """A RateLoop whose steps compiled code makes by itself, without the interpreter, for as long as nothing is rare.

    tick  : a step in Python, for where that is not possible: without rcl's own functions, under simulated time, of a
            body without a bone
    clock : of the node
    """

    def __init__(
        self,
        period: float,
        prepare: Callable[[], object],
        tick: Callable[[], None],
        parts: tuple[Stepper, Outputs, Inbox],
        clock: Any,
        log: Any,
    ) -> None:
        super().__init__(period, prepare, tick)
        self._stepper, self._outputs, self._inbox = parts
        self._clock, self._log = clock, log
        self._grid = deadlines(period)
        self._compiled = False
        self._wake = self._ask
        self._endpoints = Endpoints(self._outputs.stepped(), self._inbox.subscriptions)

    def compile(self, compiled: Compiled) -> None:
        """Compiles what will step, for the types of a Simulator to be, where it is not there yet."""
        if not self._lack():
            self._make()
            self._bind(compiled, self._parts(compiled, None, None))

    def load(self, tell: Callable[[str], None]) -> None:
        """Compiles or loads what steps, once there is a Simulator; or says why Python makes them."""
        why = self._lack()
        if why:
            self._log.info(f"steps are made in Python, which is slower: {why}")
        else:
            with compiling(tell, tick.KERNELS):
                self._begin()

    def release(self) -> None:
        """Lets publishers and subscriptions go, once the thread has ended."""
        self._endpoints.release()

    def _ask(self) -> None:
        self._grid.asked[0] = 1

    @property
    def progress(self) -> StepCounts:
        """Steps made and missed until now."""
        if not self._compiled:
            return self._progress
        grid = self._grid
        steps, late, overruns = (int(count[0]) for count in (grid.steps, grid.late, grid.overruns))
        begin, last = (1e-9 * int(when[0]) for when in (grid.origin, grid.last))
        return StepCounts(steps, late, overruns, begin, max(begin, last))

    def _turn(self, origin: float) -> None:
        if not self._compiled:
            super()._turn(origin)
            return
        self._set_out()
        asked = {
            tick.ASKED: self._listen,
            tick.TO_LOOK: self._look,
            tick.UNHEARD: self._unheard,
            tick.TO_PLACE: self._place,
            tick.TO_MEND: self._mend,
            tick.TO_TELL: self._tell,
        }
        try:
            while not self._stop.is_set():
                asked[self._run_compiled()]()
        except UnfitError as error:
            self._log.warning(f"steps are made in Python from now on, which is slower: {error}")
            self._hand_back()
            super()._turn(time.monotonic())

    def _listen(self) -> None:
        """Somebody wants a turn between two steps."""
        self._grid.asked[0] = 0
        self._answer()
        self._arrange()

    def _lack(self) -> str:
        """Why compiled code cannot make the steps; empty: it can."""
        if numba.config.DISABLE_JIT:
            return "nothing is compiled (NUMBA_DISABLE_JIT)"
        if self._clock.ros_time_is_active:
            return "use_sim_time is set"
        if self._stepper.scene.driven is None:
            return "the body has no bone"
        return self._endpoints.lack

    def _begin(self) -> None:
        """The loop is compiled code's."""
        self._make()
        self._arranged: tuple[Any, ...] = ()
        self._arrange()
        self._inbox.also = self._heard.commands
        self._compiled = True

    def _make(self) -> None:
        """The parts of what compiled code works on that are its own."""
        options = self._outputs.options
        self._heard = Heard(
            newest=np.zeros(7), received=_one(), stamp=_one(), transport=np.zeros(1), before=np.zeros(7), fresh=_one(),
            zero=_one(), commands=_one(), looked=np.full(2, time.monotonic_ns()),
            frame=frame_bytes(options.world_frame), at=np.zeros(7), which=_one(), when=_one(), failure=_one(),
        )  # fmt: skip
        axes = {"world_aligned": tick.WORLD_ALIGNED, "finger": tick.FINGER, "world": tick.WORLD}[options.wrench_frame]
        self._sent = Sent(np.zeros(6), np.zeros(6), np.array([axes]), np.zeros(5, np.int64), _one(), _one())
        self._flow, self._counted = (_one(), _one(), _one(), _one()), nothing_counted()

    def _set_out(self) -> None:
        """What came before the first step, and when that is."""
        with self._inbox.early:
            newest, plane = self._stepper.newest, self._stepper.plane
        if newest is not None:
            self._follow(newest)
        if plane is not None:
            self._shift(plane)
        self._stepper.observe(Observed(self._newest, self._moment, lambda: Window.of(self._counted)))
        self._grid.origin[0] = self._grid.last[0] = time.monotonic_ns()

    def _newest(self) -> Command | None:
        """The command that is followed."""
        heard = self._heard
        if heard.received[0] == 0:
            return None
        return Command(pose_of(heard.newest), int(heard.received[0]), float(heard.transport[0]), int(heard.stamp[0]))

    def _moment(self) -> tuple[int, int] | None:
        """Stamp of the last step, and the steady time at which it began [ns]."""
        return (int(self._sent.stamp[0]), int(self._grid.begun[0])) if self._grid.steps[0] else None

    def _arrange(self) -> None:
        """What compiled code works on, as it is now."""
        stepper, outputs = self._stepper, self._outputs
        stepper.allow(outputs.options)
        recorder, compiled = outputs.recorder, stepper.sim.compiled
        recording = recorder.loop if recorder is not None else None
        purse = stepper.budget.purse if stepper.budget is not None else None
        if self._arranged and all(a is b for a, b in zip(self._arranged, (recording, compiled, purse), strict=True)):
            return
        if recorder is not None:
            self._sent.topics[:] = [recorder.number(name) for name in (*outputs.stepped_topics, *self._inbox.topics)]
        self._bind(compiled, self._parts(compiled, recording, purse))
        self._arranged = (recording, compiled, purse)

    def _parts(self, compiled: Compiled, recording: Recording | None, purse: Purse | None) -> Live:
        incoming, outgoing, stepper = self._endpoints.incoming, self._endpoints.outgoing, self._stepper
        assert incoming is not None
        assert outgoing is not None
        return Live(
            *self._flow, incoming.clock, self._grid, self._heard, self._sent, compiled.body, stepper.sender.record,
            purse or build_purse(), incoming, outgoing, recording or no_recording(), self._counted, self.step_time,
            self.lateness, stepper.delay, stepper.transport,
        )  # fmt: skip

    def _bind(self, compiled: Compiled, live: Live) -> None:
        self._live, self._held = live, held(live)
        self._arguments = (compiled.address, compiled.model, compiled.state, self._held)
        self._function = direct(tick.run, types.int64, *self._arguments[1:])
        self._hear = direct(tick.hear, self._held, types.int64, types.int64, types.float64)

    def _look(self) -> None:
        """A message that is not the usual one."""
        which, received = int(self._heard.which[0]), int(self._heard.when[0])
        self._judge(which, self._endpoints.taken(which).data, received)

    def _judge(self, which: int, data: bytes, received: int) -> None:
        if which == tick.COMMAND:
            command = self._inbox.judge(data, received)
            if command is not None:
                self._follow(command)
        else:
            plane = self._inbox.judge_plane(data)
            if plane is not None:
                self._stepper.plane = plane
                self._shift(plane)

    def _follow(self, command: Command) -> None:
        self._heard.at[:] = numbers(command.pose)
        self._hear(self._held, command.received_ns, command.stamp, command.transport)

    def _shift(self, plane: Pose) -> None:
        table = self._live.body.table
        table.target[:], table.given[0] = numbers(plane), 1.0

    def _unheard(self) -> None:
        """A message that could not be taken, or the first one, which shows that rcl is not what it is taken for."""
        which, failure = int(self._heard.which[0]), int(self._heard.failure[0])
        if failure != -UNFIT:
            raise FingerSimError(f"what comes in cannot be taken: {meaning(failure)}")
        data, received = self._endpoints.taken(which).data, time.monotonic_ns()
        if self._outputs.recorder is not None:
            self._outputs.recorder.put(self._inbox.topics[which], data, received)
        self._judge(which, data, received)
        raise UnfitError(self._endpoints.lack)

    def _hand_back(self) -> None:
        """The loop is Python's from now on."""
        newest, self._progress = self._newest(), self.progress
        self._compiled = False
        self._stepper.observe(None)
        if newest is not None:
            self._stepper.newest = newest

    def _place(self) -> None:
        """The first command places the finger, and the plane where it is wanted."""
        heard, table = self._heard, self._live.body.table
        plane = pose_of(table.target) if table.given[0] != 0.0 else None
        heard.zero[0] = heard.received[0]
        heard.before[:] = heard.newest
        pose = pose_of(heard.newest)
        self._stepper.place(pose, plane)
        self._stepper.sim.hear(pose, 0.0)

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

    def _run_compiled(self) -> int:
        why: int = self._function(*self._arguments)
        return why


def _one() -> Ints:
    return np.zeros(1, np.int64)

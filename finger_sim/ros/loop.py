"""The thread of the simulation, and a loop that calls one function at a fixed rate, on absolute deadlines.

RateLoop: deadlines lie at origin + k · period on the steady clock. A step that is not done at the next deadline is
late; the step after it begins at once. Deadlines missed by more than a period are skipped and counted as
overruns: steps are never bunched up, and time lost is never hidden.

`python -m finger_sim.ros.loop PERIOD SECONDS PRIORITY` runs a loop that does nothing, and prints its StepCounts as
JSON: what this machine allows. It needs no ROS.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import os
import pwd
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from ..plain import printing
from .accounts import Recent

IDLE_PERIOD = 0.01
"""How often a triggered loop looks at the time while nothing triggers it [s]."""
_PR_SET_TIMERSLACK = 29  # of prctl(2)
_RECEIVERS = ("dds.udp", "dds.shm", "dds.ev")  # names of Fast DDS's threads that receive, and that acknowledge
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # of mlockall(2)


class StepCounts(NamedTuple):
    """How far a loop has come."""

    steps: int
    late: int
    """Steps not done at the next deadline."""
    overruns: int
    """Deadlines skipped, or triggers dropped: steps that were never made."""
    begin: float
    """Steady time at which the loop was ready [s]."""
    last: float
    """Steady time at which the last step was done [s]."""

    @property
    def late_fraction(self) -> float:
        """Late steps, of the steps made; 0 when there were none."""
        return self.late / self.steps if self.steps else 0.0

    def since(self, before: StepCounts) -> dict[str, float]:
        """Steps, late and skipped ones since then, and the rate at which they were made [Hz]."""
        steps, seconds = self.steps - before.steps, self.last - (before.last or self.begin)
        return {
            "rate": round(steps / seconds, 1) if seconds > 0.0 else 0.0,
            "steps": steps,
            "late": self.late - before.late,
            "skipped": self.overruns - before.overruns,
        }

    def real_time_factor(self, period: float) -> float:
        """Simulated time / wall time at `period` [s] a step, from the first to the last; 0 before the second."""
        return (self.steps - 1) * period / (self.last - self.begin) if self.steps > 1 else 0.0


class Loop:
    """A thread that makes steps, once `prepare` has returned there.

    `error` holds the exception that ended the thread, if one did. Whatever else must happen between two steps
    comes in through `call`.

    step_time : times that steps took [s]
    lateness  : times from when steps should have begun until they did [s]
    """

    def __init__(self, prepare: Callable[[], object]) -> None:
        self.error: Exception | None = None
        self.step_time = Recent.none()
        self.lateness = Recent.none()
        self._prepare = prepare
        self._wake: Callable[[], None] = lambda: None
        self._calls: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._stop = threading.Event()
        self._progress = StepCounts(0, 0, 0, 0.0, 0.0)
        self._ready = False
        self._thread = threading.Thread(target=self._run, name="loop", daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def ready(self) -> bool:
        """Whether steps can be made."""
        return self._ready

    @property
    def progress(self) -> StepCounts:
        """Steps made and missed until now."""
        return self._progress

    def stop(self, timeout: float) -> bool:
        """Asks the thread to end after its present step; False if it has not after `timeout` [s]."""
        self._stop.set()
        self._wake()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def call(self, function: Callable[[], Any]) -> Future[Any]:
        """Has the thread call `function` between two steps; the future gives its result or exception."""
        future: Future[Any] = Future()
        self._calls.append((function, future))
        self._wake()
        return future

    def _run(self) -> None:
        try:
            _sleep_exactly()
            self._prepare()
            if not self._stop.is_set():
                now = time.monotonic()
                self._progress = StepCounts(0, 0, 0, now, now)
                self._ready = True
                self._turn(now)
        except Exception as error:
            self.error = error

    def _turn(self, origin: float) -> None:
        """Makes steps until it is to stop; `origin` is the steady time at the beginning [s]."""
        raise NotImplementedError

    def _answer(self) -> None:
        """Makes the calls that wait."""
        while self._calls:
            function, future = self._calls.popleft()
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(function())
                except Exception as error:
                    future.set_exception(error)


class RateLoop(Loop):
    """Calls `tick` every `period` [s]."""

    def __init__(self, period: float, prepare: Callable[[], object], tick: Callable[[], None]) -> None:
        super().__init__(prepare)
        self.period = period
        self._tick = tick

    def _turn(self, origin: float) -> None:
        period, k = self.period, 0
        steps, late, overruns, begun, _ = self._progress
        while not self._stop.is_set():
            deadline = origin + k * period
            ahead = deadline - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            begin = time.monotonic()
            self._answer()
            self._tick()
            end = time.monotonic()
            steps += 1
            passed = math.floor((end - origin) / period)
            late += passed > k
            following = max(k + 1, passed)
            overruns += following - (k + 1)
            k = following
            self.step_time.add(end - begin)
            self.lateness.add(begin - deadline)
            self._progress = StepCounts(steps, late, overruns, begun, end)


T = TypeVar("T")


class Triggers(Generic[T]):
    """What waits for its step, in its order; of more than `capacity` the oldest are dropped, and counted."""

    def __init__(self, capacity: int) -> None:
        self.dropped = 0
        self._waiting: deque[T] = deque()
        self._capacity = capacity

    def extend(self, come: Iterable[T]) -> None:
        """What has come."""
        self._waiting.extend(come)
        while len(self._waiting) > self._capacity:
            self._waiting.popleft()
            self.dropped += 1

    def pop(self) -> T | None:
        """The next one."""
        return self._waiting.popleft() if self._waiting else None


def prefer_this_thread(priority: int) -> str | None:
    """The calling thread runs before all without a priority of SCHED_FIFO; 0: as any other thread.

    Where that is not permitted, what to tell a user; the thread is then as any other.
    """
    if priority == 0:
        return None
    try:
        # What this thread starts has no such priority.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:
        return (
            f"real-time priority {priority} is not permitted here: the loop runs as any other thread; to permit it, "
            f"put the line '{_user()} - rtprio {priority}' into /etc/security/limits.d/finger_sim.conf and log in anew"
        )
    return None


def prefer_receivers(priority: int) -> None:
    """Fast DDS's threads of this process that receive get this priority of SCHED_FIFO; 0: as they are.

    A command waits for them: beside other busy threads a loop that is never late steps with old ones.
    """
    if priority == 0:
        return
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended, or that is not permitted
            if (thread / "comm").read_text().startswith(_RECEIVERS):
                os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))


def keep_in_memory() -> str | None:
    """What this process has and will have of memory stays in RAM: no step waits for a page that was put aside.

    Where that is not permitted, what to tell a user; nothing has changed then.
    """
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0:
        return None
    why = os.strerror(ctypes.get_errno())
    return (
        f"memory cannot be locked here ({why}): it stays as it is; to permit it, put the line "
        f"'{_user()} - memlock unlimited' into /etc/security/limits.d/finger_sim.conf and log in anew"
    )


def _user() -> str:
    """Whose threads these are: the name, or the number where there is no name."""
    with contextlib.suppress(KeyError):
        return pwd.getpwuid(os.geteuid()).pw_name
    return str(os.geteuid())


def bare(period: float, seconds: float, priority: int = 0) -> StepCounts:
    """How far a loop that does nothing comes in `seconds` at `period` [s]; `priority`: of SCHED_FIFO, 0 for none."""
    loop = RateLoop(period, lambda: prefer_this_thread(priority), lambda: None)
    loop.start()
    time.sleep(seconds)
    loop.stop(timeout=1.0)
    if loop.error is not None:
        raise loop.error
    return loop.progress


def _sleep_exactly() -> None:
    """This thread's sleeps end when they should: by default Linux lets them last 50 µs longer, to wake up less."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1))  # [ns]


if __name__ == "__main__":
    period, seconds, priority = sys.argv[1:]
    counts = bare(float(period), float(seconds), int(priority))
    sys.exit(printing("finger_sim.ros.loop", lambda: print(json.dumps(counts._asdict()))))

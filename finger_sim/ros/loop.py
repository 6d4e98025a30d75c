"""The clock of the simulation: a thread that calls one function at a fixed rate, on absolute deadlines.

Deadlines lie at origin + k · period on the steady clock. A step that is not done at the next deadline is
late; the step after it begins at once. Deadlines missed by more than a period are skipped and counted as
overruns: steps are never bunched up, and time lost is never hidden.

`python -m finger_sim.ros.loop PERIOD SECONDS PRIORITY` runs a loop that does nothing, and prints its Progress as
JSON: what this machine allows. It needs no ROS.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats

RING = 4096
"""Steps whose times are kept for percentiles."""
_PR_SET_TIMERSLACK = 29  # of prctl(2)


class Ring:
    """The last RING numbers, for percentiles; written by one thread, read by any."""

    def __init__(self) -> None:
        self._values: Floats = np.zeros(RING)
        self._count = 0

    def add(self, value: float) -> None:
        self._values[self._count % RING] = value
        self._count += 1

    def percentiles(self, *wanted: float) -> tuple[float, ...]:
        """The wanted percentiles [0, 100] of what is kept; zeros when nothing is."""
        kept = self._values[: min(self._count, RING)]
        return tuple(float(p) for p in np.percentile(kept, wanted)) if len(kept) else (0.0,) * len(wanted)


class Progress(NamedTuple):
    """How far a loop has come."""

    steps: int
    late: int
    """Steps not done at the next deadline."""
    overruns: int
    """Deadlines skipped: steps that were never made."""
    begin: float
    """Steady time of the first deadline [s]."""
    last: float
    """Steady time at which the last step was done [s]."""

    @property
    def late_fraction(self) -> float:
        """Late steps, of the steps made; 0 when there were none."""
        return self.late / self.steps if self.steps else 0.0

    def real_time_factor(self, period: float) -> float:
        """Simulated time / wall time at `period` [s] a step, from the first to the last; 0 before the second."""
        return (self.steps - 1) * period / (self.last - self.begin) if self.steps > 1 else 0.0


class RateLoop:
    """Calls `tick` every `period` [s] in a thread of its own, once `prepare` has returned there.

    `error` holds the exception that ended the thread, if one did. Whatever else must happen between two ticks
    comes in through `call`.
    """

    def __init__(self, period: float, prepare: Callable[[], None], tick: Callable[[], None]) -> None:
        self.period = period
        self.error: Exception | None = None
        self.step_time = Ring()
        self.lateness = Ring()
        self._prepare, self._tick = prepare, tick
        self._calls: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._stop = threading.Event()
        self._progress = Progress(0, 0, 0, 0.0, 0.0)
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
        """Whether ticks have begun."""
        return self._ready

    @property
    def progress(self) -> Progress:
        """Steps made and missed until now."""
        return self._progress

    def stop(self, timeout: float) -> bool:
        """Asks the thread to end after its present step; False if it has not after `timeout` [s]."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def call(self, function: Callable[[], Any]) -> Future[Any]:
        """Has the thread call `function` between two ticks; the future gives its result or exception."""
        future: Future[Any] = Future()
        self._calls.append((function, future))
        return future

    def _run(self) -> None:
        try:
            _sleep_exactly()
            self._prepare()
            if not self._stop.is_set():
                self._turn()
        except Exception as error:
            self.error = error

    def _turn(self) -> None:
        period = self.period
        origin = time.monotonic()
        k = steps = late = overruns = 0
        self._progress = Progress(0, 0, 0, origin, origin)
        self._ready = True
        while not self._stop.is_set():
            deadline = origin + k * period
            ahead = deadline - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            begin = time.monotonic()
            while self._calls:
                self._answer(*self._calls.popleft())
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
            self._progress = Progress(steps, late, overruns, origin, end)

    @staticmethod
    def _answer(function: Callable[[], Any], future: Future[Any]) -> None:
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(function())
            except Exception as error:
                future.set_exception(error)


def prefer_this_thread(priority: int) -> None:
    """The calling thread runs before all without a priority of SCHED_FIFO. Raises OSError where not permitted."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def bare(period: float, seconds: float, priority: int = 0) -> Progress:
    """How far a loop that does nothing comes in `seconds` at `period` [s]; `priority`: of SCHED_FIFO, 0 for none."""
    loop = RateLoop(period, lambda: prefer_this_thread(priority) if priority else None, lambda: None)
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
    print(json.dumps(bare(float(period), float(seconds), int(priority))._asdict()))

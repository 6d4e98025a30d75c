"""The loop's thread: deadlines kept, skipped and counted on a clock of the test's own; triggers in their order."""

from __future__ import annotations

import ctypes
import getpass
import os
import threading
from types import SimpleNamespace

import pytest

from finger_sim.ros import loop as module
from finger_sim.ros.loop import (
    Loop,
    RateLoop,
    StepCounts,
    Triggers,
    keep_in_memory,
    prefer_receivers,
    prefer_this_thread,
)

PR_SET_NAME = 15  # of prctl(2)


class Clock:
    """Time that passes only where it is slept or spent."""

    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


def begun(costs: list[float], monkeypatch: pytest.MonkeyPatch) -> tuple[list[float], StepCounts]:
    """When steps that take `costs` [periods of 1/8 s] began, and how they were counted."""
    clock = Clock()
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock.monotonic, sleep=clock.sleep))
    begins: list[float] = []

    def tick() -> None:
        begins.append((clock.now - 100.0) / 0.125)
        clock.now += 0.125 * costs[len(begins) - 1]
        if len(begins) == len(costs):
            loop._stop.set()

    loop = RateLoop(0.125, lambda: None, tick)
    loop.start()
    loop._thread.join(60.0)
    assert loop.error is None
    return begins, loop.progress


def test_steps_begin_at_their_deadlines(monkeypatch):
    """On the grid of the first, however long each takes below a period."""
    begins, progress = begun([0.5, 0.125, 0.75, 0.0], monkeypatch)
    assert begins == [0.0, 1.0, 2.0, 3.0]
    assert (progress.steps, progress.late, progress.overruns) == (4, 0, 0)


def test_a_late_step_is_counted_and_the_next_follows_at_once(monkeypatch):
    """Then the grid holds again: nothing drifts."""
    begins, progress = begun([1.25, 0.125, 0.125], monkeypatch)
    assert begins == [0.0, 1.25, 2.0]
    assert (progress.steps, progress.late, progress.overruns) == (3, 1, 0)


def test_missed_deadlines_are_skipped_and_never_bunched_up(monkeypatch):
    """A step of five and a half periods: the deadlines 1 to 4 are given up, the one of 5 is made at once."""
    begins, progress = begun([5.5, 0.125, 0.125, 0.125], monkeypatch)
    assert begins == [0.0, 5.5, 6.0, 7.0]
    assert (progress.steps, progress.late, progress.overruns) == (4, 1, 4)


def test_what_triggers_steps_keeps_its_order_and_of_too_many_the_oldest_are_dropped():
    """The newest always has its step; what is dropped is counted."""
    triggers = Triggers[int](10)
    assert triggers.pop() is None
    triggers.extend([0, 1])
    triggers.extend([2])
    assert [triggers.pop() for _ in range(4)] == [0, 1, 2, None]
    assert triggers.dropped == 0
    triggers.extend(range(25))
    assert [triggers.pop() for _ in range(10)] == list(range(15, 25))
    assert (triggers.dropped, triggers.pop()) == (15, None)


class Once(Loop):
    """Makes the calls that wait until it is to stop."""

    def _turn(self, origin: float) -> None:
        while not self._stop.is_set():
            self._answer()


def test_calls_are_made_by_the_thread_and_their_exceptions_go_to_who_asked():
    """The loop goes on."""
    loop = Once(lambda: None)
    loop.start()
    assert loop.call(threading.get_ident).result(60.0) == loop._thread.ident
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 / 0).result(60.0)
    assert loop.stop(60.0)
    assert loop.error is None


def test_an_error_in_a_step_ends_the_loop_and_is_kept():
    """For whoever looks at it."""
    left = iter([1, 1])
    loop = RateLoop(0.001, lambda: None, lambda: next(left))
    loop.start()
    loop._thread.join(60.0)
    assert isinstance(loop.error, StopIteration)
    assert loop.progress.steps == 2


class Libc:
    """Stands in for the C library; `code` is what mlockall gives."""

    def __init__(self, code: int) -> None:
        self.code, self.flags = code, -1

    def mlockall(self, flags: int) -> int:
        self.flags = flags
        return self.code


def test_memory_that_cannot_be_locked_is_told_with_what_permits_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of now and of later; the line for the system's limits names the user."""
    libc = Libc(0)
    monkeypatch.setattr(module.ctypes, "CDLL", lambda *_, **__: libc)
    assert keep_in_memory() is None
    assert libc.flags == 3
    libc.code = -1
    monkeypatch.setattr(module.ctypes, "get_errno", lambda: 12)
    refused = keep_in_memory()
    assert refused is not None
    assert "Cannot allocate memory" in refused
    assert f"'{getpass.getuser()} - memlock unlimited'" in refused


def test_a_priority_that_is_not_permitted_is_told_with_what_permits_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line for the system's limits names the user; none is asked for with 0, and children inherit none."""
    asked: list[tuple[int, int]] = []

    def schedule(_: int, policy: int, parameters: os.sched_param) -> None:
        asked.append((policy, parameters.sched_priority))
        if parameters.sched_priority > 7:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    assert prefer_this_thread(0) is None
    assert asked == []
    assert prefer_this_thread(7) is None
    assert asked == [(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 7)]
    refused = prefer_this_thread(20)
    assert refused is not None
    assert f"'{getpass.getuser()} - rtprio 20'" in refused


def test_threads_that_receive_are_preferred_and_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the names that Fast DDS gives them; what is not permitted, and 0, change nothing."""
    asked: list[tuple[int, int, int]] = []

    def schedule(thread: int, policy: int, parameters: os.sched_param) -> None:
        asked.append((thread, policy, parameters.sched_priority))
        if parameters.sched_priority > 7:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    ready, done, ids = threading.Barrier(4), threading.Event(), {}

    def wait(name: str) -> None:
        ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode())
        ids[name] = threading.get_native_id()
        ready.wait()
        done.wait()

    threads = [threading.Thread(target=wait, args=(name,)) for name in ("dds.udp.7411", "dds.asyn.0.0", "other")]
    for thread in threads:
        thread.start()
    ready.wait()
    try:
        prefer_receivers(0)
        assert asked == []
        prefer_receivers(7)
        assert (ids["dds.udp.7411"], os.SCHED_FIFO, 7) in asked  # beside such of other tests' nodes
        assert not {ids["dds.asyn.0.0"], ids["other"]} & {thread for thread, _, _ in asked}
        prefer_receivers(8)
    finally:
        done.set()
        for thread in threads:
            thread.join()

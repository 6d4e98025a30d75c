"""The loop's thread: deadlines kept, skipped and counted on a clock of the test's own; one step for each trigger."""

from __future__ import annotations

import getpass
import os
import threading
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from finger_sim.ros import loop as module
from finger_sim.ros.loop import RateLoop, StepCounts, TriggeredLoop, prefer_this_thread


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


class Item(NamedTuple):
    number: int
    received: float = 0.0


class Source:
    """What a TriggeredLoop takes from."""

    def __init__(self) -> None:
        self.woken = threading.Semaphore(0)
        self.coming: list[list[Item]] = []

    def take(self) -> list[Item]:
        return self.coming.pop(0) if self.coming else []

    def send(self, *items: Item) -> None:
        self.coming.append(list(items))
        self.woken.release()

    def loop(self, tick: Any, idle: Any = lambda: None, capacity: int = 10) -> TriggeredLoop[Item]:
        return TriggeredLoop(
            lambda: None,
            tick,
            idle,
            take=self.take,
            wait=lambda seconds: self.woken.acquire(timeout=seconds),
            wake=self.woken.release,
            capacity=capacity,
        )


def test_each_trigger_makes_one_step_in_its_order():
    """None without; what came together too."""
    source, made, done = Source(), [], threading.Event()

    def tick(item: Item) -> None:
        made.append(item.number)
        if item.number == 4:
            done.set()

    loop = source.loop(tick)
    loop.start()
    source.send(Item(0))
    source.send(Item(1), Item(2), Item(3))
    source.send(Item(4))
    assert done.wait(60.0)
    assert loop.stop(60.0)
    assert made == [0, 1, 2, 3, 4]
    assert (loop.progress.steps, loop.progress.overruns) == (5, 0)


def test_of_too_many_triggers_the_oldest_are_dropped_and_counted():
    """The newest is always followed."""
    source, made, done = Source(), [], threading.Event()

    def tick(item: Item) -> None:
        made.append(item.number)
        if item.number == 24:
            done.set()

    loop = source.loop(tick, capacity=10)
    source.send(*(Item(k) for k in range(25)))
    loop.start()
    assert done.wait(60.0)
    assert loop.stop(60.0)
    assert made == list(range(15, 25))
    assert loop.progress.overruns == 15


def test_between_triggers_calls_are_made_and_the_time_is_looked_at():
    """A call need not wait for a trigger; its exception goes to who asked."""
    source, idle = Source(), threading.Event()
    loop = source.loop(lambda _: None, idle.set)
    loop.start()
    assert loop.call(lambda: 42).result(60.0) == 42
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 / 0).result(60.0)
    assert idle.wait(60.0)
    assert loop.stop(60.0)
    assert loop.error is None
    assert loop.progress.steps == 0


def test_an_error_in_a_step_ends_the_loop_and_is_kept():
    """For whoever looks at it."""
    source = Source()
    loop = source.loop(lambda item: 1 / (item.number - 1))
    loop.start()
    source.send(Item(0), Item(1), Item(2))
    loop._thread.join(60.0)
    assert isinstance(loop.error, ZeroDivisionError)
    assert loop.progress.steps == 1


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

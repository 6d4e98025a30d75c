"""The measurements of `finger_sim bench`: step times, stages, steadiness, allocations, start."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np

from ...arrays import Floats
from ...physics.ready import advance
from ...scene import place
from .scenes import PHASES, BenchError, Ours, Record, Runner

Meter = Callable[[float, float], None]
Name = TypeVar("Name")

WARM_UP = 2.0
"""Longest time that a contender runs before it is measured [s]: its whole motion, or as far as it comes."""
LONG_STEP = 5e-3
"""Steps longer than this are not disturbed by showing progress after them [s]."""
_START = """
import sys
from finger_sim import Scene, Simulator
Simulator(Scene.load(sys.argv[1]))
print("ready", flush=True)
"""


def interleaved(runners: Mapping[Name, Runner], repeats: int, meter: Meter) -> dict[Name, Record]:
    """Each runner's whole motion, `repeats` times, one runner after the other, from another one on each time.

    Before it is measured, each runs once for at most WARM_UP.
    """
    names = list(runners)
    records = {name: Record.empty(repeats, len(runners[name].given)) for name in names}
    total = float((repeats + 1) * len(names))
    done = 0
    with _no_garbage():
        for repeat in range(-1, repeats):
            for turn in range(len(names)):
                name = names[(turn + max(repeat, 0)) % len(names)]
                _run(runners[name], records[name], repeat, partial(_part_of, meter, done, total))
                done += 1
    return records


def _part_of(meter: Meter, done: int, total: float, share: float) -> None:
    meter(done + share, total)


def once(runner: Runner, meter: Meter) -> Record:
    """One run, measured without a warm-up: for answers."""
    record = Record.empty(1, len(runner.given))
    _run(runner, record, 0, lambda share: meter(share, 1.0))
    return record


def _run(runner: Runner, record: Record, repeat: int, show: Callable[[float], None]) -> None:
    """The motion once; into row `repeat` of the times, or a warm-up when it is negative."""
    step, given, begun = runner.begin(), runner.given, time.perf_counter()
    show(0.0)
    for k, command in enumerate(given):
        start = time.perf_counter()
        came = step(command)
        spent = time.perf_counter() - start
        if repeat >= 0:
            record.seconds[repeat, k] = spent
        elif start - begun > WARM_UP:
            return
        runner.observe(k, came, record)
        if spent > LONG_STEP:
            show(k / len(given))


@contextmanager
def _no_garbage() -> Iterator[None]:
    """What lives now is not searched for garbage in a `with` block: collections are as short as in a small program."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def stages(runner: Ours, meter: Meter) -> dict[str, dict[str, float]]:
    """Mean time of each stage a step [s], by phase, in a run of a `timed` simulator after one to warm up."""
    record, motion, out = Record.empty(1, len(runner.given)), runner.motion, {}
    _run(runner, record, -1, lambda share: meter(0.5 * share, 1.0))
    step, before = runner.begin(), dict.fromkeys(runner.simulator.stage_seconds, 0.0)
    for k, pose in enumerate(runner.given):
        step(pose)
        meter(0.5 + 0.5 * k / len(runner.given), 1.0)
        if k + 1 == len(runner.given) or motion.phase[k + 1] != motion.phase[k]:
            after, steps = runner.simulator.stage_seconds, int((motion.phase == motion.phase[k]).sum())
            out[PHASES[motion.phase[k]]] = {name: (after[name] - before[name]) / steps for name in after}
            before = after
    return out


def _work(rounds: int) -> float:
    x = 0.5
    for _ in range(rounds):
        x = 3.7 * x * (1.0 - x)
    return x


def steadiness(runner: Ours, repeats: int, meter: Meter) -> tuple[Floats, Floats]:
    """Times of steps that press and slide, and of a fixed piece of work run after each of them, (repeats * steps,) [s].

    The work is one chain of multiplications, as long as the median of these steps before.
    """
    work: Any = numba.njit(_work)
    touching = runner.motion.phase > PHASES.index("air")
    rounds, aim = 1000, Record.empty(1, len(runner.given))
    _run(runner, aim, 0, lambda share: None)
    work(rounds)
    for _ in range(5):
        rounds = max(1, round(rounds * float(np.median(aim.seconds[0, touching])) / _median_time(work, rounds)))
    ours, reference = np.empty((2, repeats, len(runner.given)))
    with _no_garbage():
        for repeat in range(repeats):
            step = runner.begin()
            meter(repeat, repeats)
            for k, pose in enumerate(runner.given):
                start = time.perf_counter()
                step(pose)
                middle = time.perf_counter()
                work(rounds)
                ours[repeat, k], reference[repeat, k] = middle - start, time.perf_counter() - middle
    return ours[:, touching].ravel(), reference[:, touching].ravel()


def _median_time(work: Any, rounds: int) -> float:
    times = []
    for _ in range(9):
        start = time.perf_counter()
        work(rounds)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def _nothing(model: Any, state: Any, targets: Floats, h: float) -> None:
    pass


def allocations(runner: Ours) -> float | None:
    """What compiled code allocates in a step of the motion after its first ten, beyond taking its arguments.

    None where nothing is compiled.
    """
    if numba.config.DISABLE_JIT:
        return None
    from numba.core.runtime import _nrt_python, rtsys

    simulator, h = runner.simulator, runner.simulator.scene.dt
    rest = simulator.mesh.points[simulator.scene.driven_nodes(simulator.mesh)]
    targets = [place(rest, pose) for pose in runner.given]
    ready, empty = simulator._ready, numba.njit(_nothing)

    def counted(call: Callable[[Floats], None]) -> int:
        runner.begin()
        for target in targets[:10]:
            call(target)
        before = rtsys.get_allocation_stats().alloc
        for target in targets[10:]:
            call(target)
        return int(rtsys.get_allocation_stats().alloc - before)

    _nrt_python.memsys_enable_stats()
    try:
        steps = counted(lambda target: advance(ready, target, h))
        calls = counted(lambda target: empty(ready.model, ready.state, target, h))
    finally:
        _nrt_python.memsys_disable_stats()
    return (steps - calls) / len(targets[10:])


def starts(scene: str, again: int, meter: Meter) -> tuple[float, list[float]]:
    """Seconds from the start of a process to a ready Simulator: with nothing compiled yet, then `again` times more."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        source = str(Path(__file__).parents[3])
        environment["XDG_CACHE_HOME"] = cache
        environment["PYTHONPATH"] = os.pathsep.join([source, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        times = []
        for k in range(again + 1):
            meter(k, again + 1)
            times.append(_start(scene, environment))
    return times[0], times[1:]


def _start(scene: str, environment: dict[str, str]) -> float:
    begun = time.perf_counter()
    command = [sys.executable, "-c", _START, scene]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", errors="replace"
    ) as child:
        assert child.stdout is not None
        ready = child.stdout.readline()
        spent = time.perf_counter() - begun
        _, said = child.communicate()
    if not ready or child.returncode:
        raise BenchError(f"a process that only builds a Simulator failed: {said.strip().splitlines()[-1:]}")
    return spent

"""The ladder of accuracy: error and time of each rung; and the node's loop under a CPU hog, without and with a budget.

The loop is the node's own, at 1 kHz through `press_slide`, pinned to one processor that so many busy processes share.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections import Counter

import numpy as np

from finger_sim import Pose, Scene, Simulator
from finger_sim.haptics.budget import Budget, ladder
from finger_sim.plain import printing
from finger_sim.ros.loop import RateLoop
from finger_sim.studies.shared import poses
from finger_sim.studies.tradeoff.rungs import costs

AWAKE = {"solver.sleep": False}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["finger_haptic", "finger"], help="the first is run under load")
    parser.add_argument("--hogs", type=int, default=2, help="busy processes on the loop's processor")
    parser.add_argument("--budget-ms", type=float, default=0.3)
    parser.add_argument("--seconds", type=float, default=7.0)
    args = parser.parse_args()
    scenes = {name: Scene.load(name).with_values(AWAKE) for name in args.scenes}
    cpu = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cpu})
    for name, scene in scenes.items():
        rungs(name, scene, poses(scene, "press_slide"))
    scene = scenes[args.scenes[0]]
    commands = poses(scene, "press_slide")
    print(f"\n{args.seconds:g} s at {1 / scene.dt:g} Hz, {args.hogs} busy processes on the same processor")
    print(f"{'budget':>10} {'late steps':>11} {'skipped':>8} {'step p50 ms':>12} {'p99 ms':>8}   steps on each rung")
    for hogs in (0, args.hogs):
        for milliseconds in (None, args.budget_ms, None, args.budget_ms):
            under_load(scene, commands, hogs, milliseconds, args.seconds)


def rungs(name: str, scene: Scene, commands: list[Pose]) -> None:
    """Error of contact force against a converged run, and median time of a step with a contact."""
    print(f"{name}\n{'rung':>10} {'error rms':>10} {'max':>8} {'median ms':>10}   of the peak force")
    for rung, cost in zip(ladder(scene.solver), costs(scene, commands), strict=True):
        simulator = Simulator(scene)
        simulator.solve_with(rung.solver)
        print(f"{rung.name:>10} {cost.rms:>10.2%} {cost.most:>8.2%} {1e3 * median(simulator, commands):>10.3f}")


def median(simulator: Simulator, commands: list[Pose]) -> float:
    """Of the times of steps with a contact [s]."""
    simulator.reset(commands[0])
    seconds = []
    for pose in commands:
        start = time.perf_counter()
        if simulator.step(pose).contacts:
            seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


def under_load(scene: Scene, commands: list[Pose], hogs: int, milliseconds: float | None, duration: float) -> None:
    """The loop beside busy processes: late and skipped steps, step times, and how long it stood on each rung."""
    simulator = Simulator(scene)
    simulator.reset(commands[0])
    steps = ladder(scene.solver)
    budget = Budget(np.inf if milliseconds is None else 1e-3 * milliseconds, len(steps))
    stood: Counter[int] = Counter()
    count = 0

    def tick() -> None:
        nonlocal count
        start = time.perf_counter()
        simulator.step(commands[count % len(commands)])
        count += 1
        stood[budget.rung] += 1
        if budget.spent(time.perf_counter() - start):
            simulator.solve_with(steps[budget.rung].solver)

    busy = [multiprocessing.Process(target=spin, daemon=True) for _ in range(hogs)]
    for process in busy:
        process.start()
    loop = RateLoop(scene.dt, lambda: None, tick)
    loop.start()
    time.sleep(duration)
    loop.stop(timeout=5.0)
    for process in busy:
        process.kill()
    progress = loop.progress
    median, p99 = loop.step_time.percentiles(50, 99)
    text = ", ".join(f"{steps[rung].name} {count}" for rung, count in sorted(stood.items()))
    print(
        f"{'none' if milliseconds is None else f'{milliseconds:g} ms':>10} {progress.late_fraction:>11.1%} "
        f"{progress.overruns:>8} {1e3 * median:>12.3f} {1e3 * p99:>8.2f}   {text}; {hogs} hogs",
        flush=True,
    )


def spin() -> None:
    while True:
        pass


if __name__ == "__main__":
    sys.exit(printing("budget", main))

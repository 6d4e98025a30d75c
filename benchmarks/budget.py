"""The ladder of accuracy: error and time of each rung; and the node's loop under a CPU hog, without and with a budget.

The loop is the node's own, at 1 kHz through `press_slide`, pinned to one processor that so many busy processes share.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections import Counter

import numpy as np

from finger_sim import Pose, Scene, Simulator
from finger_sim.haptics.budget import LADDER, Budget, on_rung
from finger_sim.ros.loop import RateLoop
from finger_sim.studies.strokes import poses

AWAKE = {"solver.sleep": False}
CONVERGED = {"solver.tolerance": 1e-9, "solver.max_iterations": 500}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--hogs", type=int, default=2, help="busy processes on the loop's processor")
    parser.add_argument("--budget-ms", type=float, default=0.3)
    parser.add_argument("--seconds", type=float, default=7.0)
    args = parser.parse_args()
    scene = Scene.load(args.scene).with_values(AWAKE)
    commands = poses(scene, "press_slide")
    cpu = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cpu})
    ladder(scene, commands)
    print(f"\n{args.seconds:g} s at {1 / scene.dt:g} Hz, {args.hogs} busy processes on the same processor")
    print(f"{'budget':>10} {'late steps':>11} {'skipped':>8} {'step p50 ms':>12} {'p99 ms':>8}   steps on each rung")
    for hogs in (0, args.hogs):
        for milliseconds in (None, args.budget_ms, None, args.budget_ms):
            under_load(scene, commands, hogs, milliseconds, args.seconds)


def ladder(scene: Scene, commands: list[Pose]) -> None:
    """Error of contact force against a converged run, and median step time with 40 tetrahedra at a limit or more."""
    exact, _ = run(Simulator(scene.with_values(CONVERGED)), commands)
    peak = np.linalg.norm(exact, axis=1).max()
    print(f"{'rung':>10} {'error rms':>10} {'max':>8} {'median ms':>10}   of the peak, {peak:.2f} N")
    for number, rung in enumerate(LADDER):
        simulator = Simulator(scene)
        simulator.solve_with(on_rung(scene.solver, number))
        force, seconds = run(simulator, commands)
        error = np.linalg.norm(force - exact, axis=1) / peak
        print(f"{rung.name:>10} {np.sqrt((error**2).mean()):>10.2%} {error.max():>8.2%} {1e3 * seconds:>10.3f}")


def run(simulator: Simulator, commands: list[Pose]) -> tuple[np.ndarray, float]:
    """Contact force of every step (k, 3) [N]; median time of steps with 40 tetrahedra at a limit or more [s]."""
    simulator.reset(commands[0])
    force, seconds = [], []
    for pose in commands:
        start = time.perf_counter()
        out = simulator.step(pose)
        if out.limited_tets >= 40:
            seconds.append(time.perf_counter() - start)
        force.append(out.contact_wrench[:3])
    return np.array(force), float(np.median(seconds))


def under_load(scene: Scene, commands: list[Pose], hogs: int, milliseconds: float | None, duration: float) -> None:
    """The loop beside busy processes: late and skipped steps, step times, and how long it stood on each rung."""
    simulator = Simulator(scene)
    simulator.reset(commands[0])
    budget = Budget(np.inf if milliseconds is None else 1e-3 * milliseconds)
    rungs: Counter[int] = Counter()
    count = 0

    def tick() -> None:
        nonlocal count
        start = time.perf_counter()
        simulator.step(commands[count % len(commands)])
        count += 1
        rungs[budget.rung] += 1
        if budget.spent(time.perf_counter() - start):
            simulator.solve_with(on_rung(scene.solver, budget.rung))

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
    text = ", ".join(f"{LADDER[rung].name} {steps}" for rung, steps in sorted(rungs.items()))
    print(
        f"{'none' if milliseconds is None else f'{milliseconds:g} ms':>10} {progress.late_fraction:>11.1%} "
        f"{progress.overruns:>8} {1e3 * median:>12.3f} {1e3 * p99:>8.2f}   {text}; {hogs} hogs",
        flush=True,
    )


def spin() -> None:
    while True:
        pass


if __name__ == "__main__":
    main()

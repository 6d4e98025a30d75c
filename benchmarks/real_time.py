"""The demo in turn with a bare loop of the same rate: real-time factors, and how many steps of each were late."""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from finger_sim import Scene
from finger_sim.plain import printing
from finger_sim.ros.demo import PRIORITY, RATE, SCENE, Outcome, bare_loop, run_demo

SECONDS = 7.0
"""Of the bare loop: about as long as the commands of the demo."""
COLUMNS = ("factor", "bare", "late %", "bare %", "above %", "step ms", "p99 ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default=SCENE)
    parser.add_argument("--rate", type=float, default=RATE, help="[Hz]")
    parser.add_argument("--substeps", type=int, help="of a step; 10 at 1000 Hz: steps of 0.1 ms (default: the scene's)")
    parser.add_argument("--priority", type=int, default=PRIORITY, help="of the loops; 0: as any other thread")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--guide", action="store_true", help="instead: what each measure of the guide brings, in turn")
    parser.add_argument("--busy", type=int, default=0, help="processes that do nothing but take time, meanwhile")
    args = parser.parse_args()
    with busy(args.busy):
        if args.guide:
            guide(args.scene, args.rate, args.pairs)
        else:
            pairs(args)


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes run meanwhile."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def guide(scene: str, rate: float, rounds: int) -> None:
    """Late steps of the demo with one measure after the other, in turn."""
    last = str(max(os.sched_getaffinity(0)))
    measures: dict[str, tuple[int, dict[str, object]]] = {
        "no priority": (0, {}),
        "priority": (PRIORITY, {}),
        "a processor": (PRIORITY, {"cpu_affinity": last}),
        "memory": (PRIORITY, {"cpu_affinity": last, "lock_memory": True}),
    }
    late: dict[str, list[float]] = {name: [] for name in measures}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            for name, (priority, options) in measures.items():
                out = Path(folder) / f"{name} {number}"
                outcome = run_demo(scene, out=out, rate=rate, priority=priority, options=options)
                late[name].append(100 * outcome.late)
                print(f"{name:>12} {late[name][-1]:6.2f} % late", *outcome.failures, sep="   ", flush=True)
    print()
    for name, found in late.items():
        print(f"{name:>12} {np.median(found):6.2f} % late, {min(found):.2f} to {max(found):.2f}")


def pairs(args: argparse.Namespace) -> None:
    """The demo and a bare loop in turn."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene.load(args.scene)
        if args.substeps:
            scene = scene.with_values({"substeps": args.substeps})
        file = Path(folder) / f"{Path(args.scene).stem}.yaml"
        file.write_text(yaml.safe_dump(scene.to_dict()))
        for pair in range(args.pairs):
            outcome = run_demo(str(file), out=Path(folder) / f"demo_{pair}", rate=args.rate, priority=args.priority)
            rows.append(row(outcome))
            if pair == 0:
                print(
                    f"{args.scene} at {args.rate:g} Hz, {scene.substeps} substeps, priority {outcome.priority}\n"
                    + " ".join(f"{name:>8}" for name in COLUMNS)
                )
            print(line(rows[-1]), *outcome.failures, *outcome.losses, sep="   ", flush=True)
    print(f"{line(np.median(rows, axis=0))}   median")


def row(outcome: Outcome) -> tuple[float, ...]:
    """COLUMNS of a demo that has just ended, and of a bare loop of now."""
    floor = bare_loop(outcome.dt, SECONDS, outcome.priority)
    late, least = 100 * outcome.late, 100 * floor.late_fraction
    health = outcome.health
    return (
        outcome.real_time_factor, floor.real_time_factor(outcome.dt), late, least, late - least,
        1e3 * health.step_median, 1e3 * health.step_p99,
    )  # fmt: skip


def line(values: tuple[float, ...] | np.ndarray) -> str:
    """One line of the table."""
    digits = (4, 4, 2, 2, 2, 3, 3)
    return " ".join(f"{value:>8.{n}f}" for value, n in zip(values, digits, strict=True))


if __name__ == "__main__":
    sys.exit(printing("real_time", main))

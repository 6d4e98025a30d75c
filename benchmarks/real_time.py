"""The demo's real-time factor, in turn with a bare loop of the same rate that does a constant piece of work."""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numba
import numpy as np

from finger_sim.ros.loop import RateLoop

SECONDS = 7.0


@numba.njit(nogil=True)
def work(numbers: np.ndarray, times: int) -> float:
    """Sums the numbers over and over, without the GIL."""
    total = 0.0
    for _ in range(times):
        for i in range(numbers.shape[0]):
            total += 1.0000001 * numbers[i]
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=500.0, help="[Hz]")
    parser.add_argument("--work", type=float, default=1.2, help="of the bare loop's step [ms]")
    parser.add_argument("--pairs", type=int, default=5)
    args = parser.parse_args()
    numbers = np.random.default_rng(0).random(20_000)
    work(numbers, 1)
    begin = time.perf_counter()
    work(numbers, 100)
    times = max(1, round(args.work * 1e-3 / ((time.perf_counter() - begin) / 100)))
    results = []
    print(f"{'demo':>8} {'bare loop':>10}   real-time factor at {args.rate:g} Hz")
    for _ in range(args.pairs):
        results.append((demo(args.rate), bare(1.0 / args.rate, numbers, times)))
        print(f"{results[-1][0]:>8.4f} {results[-1][1]:>10.4f}", flush=True)
    ours, floor = (statistics.median(column) for column in zip(*results, strict=True))
    print(f"{ours:>8.4f} {floor:>10.4f}   median")


def demo(rate: float) -> float:
    """Real-time factor that `finger_sim demo` prints."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "finger_sim",
            "demo",
            "--rate",
            f"{rate:g}",
            "--out",
            str(Path(folder) / "demo"),
        ]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = re.search(r"real-time factor\s+([\d.]+)", printed)
    if found is None:
        raise SystemExit(f"the demo printed no real-time factor: {printed}")
    return float(found[1])


def bare(period: float, numbers: np.ndarray, times: int) -> float:
    """Real-time factor of a loop with nothing but constant work in it."""
    loop = RateLoop(period, lambda: None, lambda: work(numbers, times))
    loop.start()
    time.sleep(SECONDS)
    progress = loop.progress
    loop.stop(1.0)
    return progress.steps * period / (progress.last - progress.begin)


if __name__ == "__main__":
    main()

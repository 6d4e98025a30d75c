"""What stress that relaxes costs: step time with two terms, in ratio to that without, run in turn in one process.

In free air, pressed 2 mm, and slid. Terms with a share of 1e-6 leave the motion as it is, so that both do the same work
but for the terms; those of real shares soften the flesh, and other tetrahedra reach their limits.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import numpy as np

from finger_sim import Scene
from finger_sim.console import gauge
from finger_sim.physics.work import WORK
from finger_sim.plain import printing
from finger_sim.studies.bench import passes
from finger_sim.studies.bench.scenes import PHASES, Ours, press_and_slide, touch_height
from finger_sim.studies.shared import pinned

AWAKE = {"solver.sleep": False, "solver.settle": False}
NONE = "no term"


def terms(*shares: float) -> list[dict[str, float]]:
    """A term for each share, 4 ms, 70 ms and 1.4 s in turn."""
    return [{"time": time, "share": share} for time, share in zip((0.004, 0.07, 1.4), shares, strict=False)]


VARIANTS: dict[str, dict[str, Any]] = {
    NONE: {"material.relaxation": []},
    "two terms, 1e-6 each": {"material.relaxation": terms(1e-6, 1e-6)},
    "three terms, 1e-6 each": {"material.relaxation": terms(1e-6, 1e-6, 1e-6)},
    "two terms, 0.3 and 0.2": {"material.relaxation": terms(0.3, 0.2)},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--cpu", type=int, default=None, help="processor to run on (default: the last allowed one)")
    args = parser.parse_args()
    whole = Scene.load(args.scene).with_values(AWAKE)
    motion = press_and_slide(touch_height(whole), whole.dt)
    runners = {name: Ours(whole.with_values(values), motion) for name, values in VARIANTS.items()}
    with pinned(args.cpu), gauge("relaxation") as meter:
        records = passes.interleaved(runners, args.repeats, meter)
    print(f"{args.scene}: median step [µs], and of that without terms; {args.repeats} repetitions in turn")
    print(f"{'':>24}" + "".join(f"{phase:>17}" for phase in PHASES) + f"{WORK[0]:>15}{WORK[2]:>17}")
    before = None
    for name, record in records.items():
        times = np.array([np.median(record.seconds[:, motion.phase == k]) for k in range(len(PHASES))])
        before = times if before is None else before
        shown = "".join(f"{1e6 * t:>9.1f} ({r:.3f})" for t, r in zip(times, times / before, strict=True))
        work = runners[name].simulator.work
        print(f"{name:>24}{shown}{work[WORK[0]]:>15}{work[WORK[2]]:>17}")


if __name__ == "__main__":
    sys.exit(printing("relaxation", main))

"""Steps of presses from free air at several speeds, and of a slide after each: how long, and what they factor.

`python benchmarks/first_touch.py [SCENE …]`; without scenes: finger_haptic and finger_coupled.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Iterator

import numpy as np

from finger_sim import Pose, Scene, Simulator

FLAT = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
HEIGHT, DEEP = 0.0105, 0.006  # where the finger frame begins, above all contact, and where it goes [m]
SPEEDS = (0.003, 0.03, 0.1, 0.3)  # of the press [m/s]
SLIDE, SLIDE_SPEED = 0.2, 0.1  # time [s] and speed [m/s] of the slide


def poses(dt: float, speed: float) -> Iterator[Pose]:
    """Down to DEEP, then along the plane."""
    for k in range(int((HEIGHT - DEEP) / speed / dt)):
        yield Pose((0.0, 0.0, HEIGHT - speed * dt * k), FLAT)
    for k in range(int(SLIDE / dt)):
        yield Pose((SLIDE_SPEED * dt * k, 0.0, DEEP), FLAT)


def main() -> None:
    """A line for each scene and speed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=["finger_haptic", "finger_coupled"])
    parser.add_argument("--repeats", type=int, default=3, help="runs, of which each step's median is taken (3)")
    arguments = parser.parse_args()
    print("scene, speed [m/s]: median, p99, longest step [µs]; factorisations a step, most, steps with two or more")
    gc.disable()
    for name in arguments.scenes:
        sim = Simulator(Scene.load(name))
        for speed in SPEEDS:
            path = list(poses(sim.scene.dt, speed))
            times = np.empty((arguments.repeats, len(path)))
            factored = np.empty(len(path), int)
            for run in times:
                sim.reset(path[0])
                for k, pose in enumerate(path):
                    before, began = sim.work["factorisations"], time.perf_counter()
                    sim.step(pose)
                    run[k] = time.perf_counter() - began
                    factored[k] = sim.work["factorisations"] - before
            p50, p99, most = np.percentile(np.median(times, axis=0) * 1e6, (50, 99, 100))
            print(
                f"{name}, {speed:g}: {p50:.0f}, {p99:.0f}, {most:.0f}; "
                f"{factored.mean():.2f}, {factored.max()}, {(factored > 1).sum()} of {len(path)}",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""Error of the contact wrench against a converged run of the same scene and bag, by solver tolerance."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from finger_sim import Pose, Scene, Simulator
from finger_sim.plain import printing
from finger_sim.studies.shared import poses

CONVERGED = {"solver.tolerance": 1e-6, "solver.max_iterations": 5_000}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger")
    parser.add_argument("--bag", default="press_slide")
    args = parser.parse_args()
    scene = Scene.load(args.scene).with_values({"solver.sleep": False})
    commands = poses(scene, args.bag)
    exact, _, _ = forces(scene.with_values(CONVERGED), commands)
    peak = np.linalg.norm(exact, axis=1).max()
    print(f"{args.scene}, {args.bag}: errors of the contact force relative to the peak, {peak:.2f} N")
    print(f"{'tolerance':>10} {'rms':>8} {'max':>8} {'median ms':>10} {'sweeps':>7}")
    for tolerance in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4):
        force, seconds, sweeps = forces(scene.with_values({"solver.tolerance": tolerance}), commands)
        error = np.linalg.norm(force - exact, axis=1) / peak
        rms, worst = np.sqrt((error**2).mean()), error.max()
        print(f"{tolerance:>10g} {rms:>8.2%} {worst:>8.2%} {seconds * 1e3:>10.3f} {sweeps:>7.0f}")


def forces(scene: Scene, commands: list[Pose]) -> tuple[np.ndarray, float, float]:
    """Contact force of every step (k, 3) [N], median step time [s], median sweeps of steps that had any."""
    simulator = Simulator(scene)
    simulator.reset(commands[0])
    force, seconds, sweeps = [], [], []
    for pose in commands:
        start = time.perf_counter()
        out = simulator.step(pose)
        seconds.append(time.perf_counter() - start)
        force.append(out.contact_wrench[:3])
        sweeps.append(out.iterations)
    loaded = [s for s in sweeps if s] or [0]
    return np.array(force), float(np.median(seconds)), float(np.median(loaded))


if __name__ == "__main__":
    sys.exit(printing("accuracy", main))

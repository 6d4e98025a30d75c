"""Step time of a scene through a bag of commands, by how many tetrahedra are at a limit."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from finger_sim import Scene, Simulator, Status
from finger_sim.plain import printing
from finger_sim.studies.shared import poses

BANDS = [(0, 0), (1, 39), (40, 99), (100, 199), (200, 10**9)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger")
    parser.add_argument("--bag", default="press_slide")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--dt", type=float, help="time step [s], default: the scene's")
    args = parser.parse_args()
    scene = Scene.load(args.scene).with_values({"solver.sleep": False})
    if args.dt:
        scene = scene.with_values({"dt": args.dt})
    commands = poses(scene, args.bag)
    simulator = Simulator(scene)
    rows = []
    for _ in range(args.repeats):
        simulator.reset(commands[0])
        for pose in commands:
            start = time.perf_counter()
            out = simulator.step(pose)
            rows.append(
                (
                    time.perf_counter() - start,
                    out.limited_tets,
                    out.limit_rows,
                    out.iterations,
                    out.max_strain_ratio,
                    bool(out.status & Status.ITERATION_LIMIT),
                )
            )
    seconds, tets, limit_rows, sweeps, ratio, capped = np.array(rows, float).T
    print(
        f"{args.scene}, {args.bag}, dt {scene.dt * 1e3:g} ms, {len(simulator.mesh.tets)} tets, "
        f"{args.repeats} repeats, {len(rows)} steps"
    )
    print(
        f"{'tets at a limit':>16} {'steps':>7} {'median ms':>10} {'p99 ms':>8} {'rows':>6} {'sweeps':>7} "
        f"{'strain/limit':>13} {'capped':>7}"
    )
    for low, high in [*BANDS, (40, 10**9), (0, 10**9)]:
        band = (tets >= low) & (tets <= high)
        if band.any():
            name = f"{low}" if low == high else f"{low} or more" if high == 10**9 else f"{low} to {high}"
            print(
                f"{name:>16} {band.sum():>7} {np.median(seconds[band]) * 1e3:>10.3f} "
                f"{np.percentile(seconds[band], 99) * 1e3:>8.3f} {np.median(limit_rows[band]):>6.0f} "
                f"{np.median(sweeps[band]):>7.0f} {ratio[band].max():>13.2f} {capped[band].sum():>7.0f}"
            )


if __name__ == "__main__":
    sys.exit(printing("step_time", main))

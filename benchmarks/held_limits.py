"""How well limits hold where they can be met: the paper's 4 % beams under gravity, `newton` with the `tensor` limit."""

from __future__ import annotations

import argparse

import numpy as np

from finger_sim import Scene, Simulator

SWING, REST = 1.5, 12.0  # simulated time of each run [s]
LAST = 0.3  # of the run to rest that is looked at [s]
REST_DAMPING = 5.0  # mass-proportional damping that brings a beam to rest [1/s]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["beam_isotropic_newton", "beam_anisotropic_newton"])
    args = parser.parse_args()
    print(f"{'':>24}{'swing: strain/limit':>26}{'at rest: strain/limit':>24}{'force jitter':>14}{'iterations':>12}")
    print(f"{'':>24}{'median':>13}{'max':>13}{'':>24}{'max, of weight':>14}{'mean':>12}")
    for name in args.scenes:
        scene = Scene.load(name)
        swing, _, _ = follow(scene, SWING)
        rest, jitter, iterations = follow(scene.with_values({"material.damping.mass": REST_DAMPING}), REST)
        last = round(LAST / scene.dt)
        print(
            f"{name:>24}{np.median(swing[swing > 0.5]):>13.4f}{swing.max():>13.3f}{rest[-last:].max():>24.4f}"
            f"{jitter[-last:].max():>14.1e}{iterations[-last:].mean():>12.1f}"
        )


def follow(scene: Scene, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strain/limit, change of the force at the held end from step to step over the weight, and iterations, by step.

    That force is what gravity and the momentum of the free nodes say: weight + d(Σ m v)/dt, vertically.
    """
    simulator = Simulator(scene)
    mass = simulator.node_mass.copy()
    mass[scene.driven_nodes(simulator.mesh)] = 0.0
    weight = 9.81 * mass.sum()
    ratio, force, iterations = [], [], []
    momentum = 0.0
    for _ in range(round(duration / scene.dt)):
        out = simulator.step()
        before, momentum = momentum, float(mass @ simulator.velocities[:, 2])
        ratio.append(out.max_strain_ratio)
        force.append(weight + (momentum - before) / scene.dt)
        iterations.append(out.iterations)
    return np.array(ratio), np.abs(np.diff(force)) / weight, np.array(iterations, float)


if __name__ == "__main__":
    main()

"""How well limits hold where they can be met, `newton` with the `tensor` limit.

The paper's 4 % beams under gravity, and `finger_coupled`, pressed down in 0.2 s, slid 5 mm in 0.25 s, and held.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from finger_sim import Pose, Scene, Simulator
from finger_sim.plain import printing

SWING, REST = 1.5, 12.0  # simulated time of each run [s]
LAST = 0.3  # of the run to rest that is looked at [s]
REST_DAMPING = 5.0  # mass-proportional damping that brings a beam to rest [1/s]
TOUCH = 0.0075  # height of the commanded bone at which the pad touches the plane [m]
HELD = 0.7  # how long the press is held; its last LAST is looked at [s]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["beam_isotropic_newton", "beam_anisotropic_newton"])
    parser.add_argument("--depths", type=float, nargs="+", default=[0.0048, 0.0055, 0.0062], help="of the command [m]")
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
    print(
        f"\n{'finger_coupled':>24}{'in motion: strain/limit':>26}{'at rest: strain/limit':>24}{'force jitter, N':>16}"
    )
    for depth in args.depths:
        moving, resting, force = press(Scene.load("finger_coupled").with_values({"solver.sleep": False}), depth)
        jitter = np.abs(np.diff(force, axis=0)).max()
        print(f"{np.linalg.norm(force[-1]):>21.2f} N{moving.max():>26.4f}{resting.max():>24.4f}{jitter:>16.1e}")


def press(scene: Scene, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strain/limit in motion and at rest, and the force on the device at rest [N], by step."""
    simulator = Simulator(scene)
    stops = [(0.0, 0.02), (0.0, TOUCH + 0.0005), (0.0, TOUCH - depth), (0.005, TOUCH - depth)]
    path = [
        np.linspace(here, there, round(seconds / scene.dt) + 1)[1:]
        for here, there, seconds in zip(stops, stops[1:], (0.1, 0.2, 0.25), strict=False)
    ]
    flat = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
    moving = [simulator.step(Pose((x, 0.0, z), flat)) for x, z in np.concatenate(path)]
    held = [simulator.step() for _ in range(round(HELD / scene.dt))][-round(LAST / scene.dt) :]
    return (
        np.array([out.max_strain_ratio for out in moving]),
        np.array([out.max_strain_ratio for out in held]),
        np.array([out.device_wrench[:3] for out in held]),
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
    sys.exit(printing("held_limits", main))

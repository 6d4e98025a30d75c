"""Force against depth of a flat press at rest, for the scene's pulp modulus and others; and a picture of it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from finger_sim import Pose, Scene, Simulator
from finger_sim.physics.rotations import matrix
from finger_sim.plain import printing

DEPTHS = np.arange(0.25, 2.51, 0.25) * 1e-3
SPEED = 0.02
SETTLE = 0.1
MODULI = (1.0e4, 1.4e4, 2.5e4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger")
    parser.add_argument("--out", type=Path, default=Path("config/pictures/finger_press.png"))
    args = parser.parse_args()
    scene = Scene.load(args.scene)
    curves = {young: press(scene.with_values({"material.young": young})) for young in MODULI}
    free = {"limits.stretch": [None] * 3, "limits.compress": [None] * 3}
    without = press(scene.with_values(free))
    print(f"{'depth mm':>9}" + "".join(f"{f'{young / 1e3:g} kPa':>9}" for young in MODULI) + f"{'no limits':>11}   [N]")
    for k, depth in enumerate(DEPTHS):
        print(
            f"{depth * 1e3:>9.2f}" + "".join(f"{curve[k]:>9.3f}" for curve in curves.values()) + f"{without[k]:>11.3f}"
        )
    force = curves[scene.material.young]
    slope = np.gradient(force, DEPTHS)
    at = np.interp([0.2, 1.5, 5.0], force, slope)
    print(f"tangent stiffness at 0.2, 1.5, 5 N: {at[0]:.0f}, {at[1]:.0f}, {at[2]:.0f} N/m")
    print(f"1 N at {np.interp(1.0, force, DEPTHS) * 1e3:.2f} mm")
    draw(curves, without, scene, args.out)
    print(args.out)


def press(scene: Scene) -> np.ndarray:
    """Normal force [N] at rest at each of DEPTHS, pressed one after the other."""
    simulator = Simulator(scene)
    orientation = scene.initial_pose.orientation
    touch = -float((simulator.mesh.points @ matrix(orientation).T)[:, 2].min())
    height = touch + 2e-4
    simulator.reset(Pose((0.0, 0.0, height), orientation))
    forces = []
    for depth in DEPTHS:
        while height > touch - depth:
            height = max(height - SPEED * scene.dt, touch - depth)
            simulator.step(Pose((0.0, 0.0, height), orientation))
        settled = [simulator.step().contact_wrench[2] for _ in range(round(SETTLE / scene.dt))]
        forces.append(np.mean(settled[len(settled) // 2 :]))
    return np.array(forces)


def draw(curves: dict[float, np.ndarray], without: np.ndarray, scene: Scene, out: Path) -> None:
    """The curves as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    for young, force in curves.items():
        chosen = young == scene.material.young
        axes.plot(
            DEPTHS * 1e3,
            force,
            marker="o",
            ms=4,
            lw=2.2 if chosen else 1.0,
            color="C0" if chosen else "0.55",
            ls="-" if chosen else (0, (4, 2)) if young < scene.material.young else (0, (1, 1)),
            label=f"E = {young / 1e3:g} kPa" + (" (the scene's)" if chosen else ""),
        )
    axes.plot(DEPTHS * 1e3, without, "-", color="C1", lw=1.2, label="the scene's, without limits")
    axes.axhline(1.0, color="0.8", lw=0.8, zorder=0)
    axes.axvspan(1.5, 2.0, color="0.94", zorder=0)
    axes.set(xlabel="depth of a flat press [mm]", ylabel="normal force at rest [N]", xlim=(0, 2.5), ylim=(0, 10))
    axes.text(1.52, 9.5, "1.5 to 2 mm", fontsize=8, color="0.4", va="top")
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=150)


if __name__ == "__main__":
    sys.exit(printing("press_curve", main))

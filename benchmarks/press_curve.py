"""Force against depth of a flat press at rest: the scene's, without limits, and what it converges to; and a picture.

Stiffness of a human fingertip is linear in force, k = b + m F (Pawluk & Howe 1999): the fit says how nearly this is.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from finger_sim import Scene
from finger_sim.plain import printing
from finger_sim.scene.calibration import modulus
from finger_sim.studies.at_rest import DEPTHS, ORIENTATIONS, Press, at_rest
from finger_sim.studies.fingertip.laws import FORCES, stiffness_line, tangent
from finger_sim.studies.mesh_error import CONVERGED, YOUNG

STEP, DEEPEST = 5e-5, 2.6e-3  # [m]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--out", type=Path, default=Path("config/pictures/finger_press.png"))
    args = parser.parse_args()
    scene = Scene.load(args.scene)
    depth = np.arange(1, round(DEEPEST / STEP) + 1) * STEP
    force, without = (press(each, depth) for each in (scene, scene.with_values({"limits": None})))
    meant = converged(scene)
    print(f"{'depth mm':>9}{'force N':>10}{'no limits':>11}{'converged':>11}")
    for at in np.arange(0.25e-3, DEEPEST, 0.25e-3):
        told = [float(np.interp(at, depth, curve)) for curve in (force, without)]
        known = [value for place, value in zip(DEPTHS["flat"], meant, strict=True) if abs(place - at) < 1e-9]
        print(f"{1e3 * at:>9.2f}{told[0]:>10.3f}{told[1]:>11.3f}" + "".join(f"{value:>11.3f}" for value in known))
    print(f"{stiffness_line(depth, force)} over {FORCES[0]:g} to {FORCES[1]:g} N")
    print(f"1 N at {1e3 * np.interp(1.0, force, depth):.2f} mm")
    draw(depth, force, without, meant, args.out)
    print(args.out)


def press(scene: Scene, depth: np.ndarray) -> np.ndarray:
    """Normal force at rest [N] at each depth, pressed one after the other."""
    finger = Press(at_rest(scene), ORIENTATIONS["flat"])
    return np.array([finger.to(float(at)) for at in depth])


def converged(scene: Scene) -> list[float]:
    """What the finger that is meant gives with the scene's tissue at DEPTHS [N]."""
    answers = CONVERGED[True, 0.45]
    softer = scene.material.young / modulus(scene.mesh.file) / YOUNG
    return [softer * answers[f"flat {1e3 * at:g} mm [N]"].value for at in DEPTHS["flat"]]


def draw(depth: np.ndarray, force: np.ndarray, without: np.ndarray, meant: list[float], out: Path) -> None:
    """The curves, and stiffness against force, as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    law = stiffness_line(depth, force)
    assert law is not None
    b, m, R2 = law
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.4), layout="constrained")
    left.plot(1e3 * depth, force, color="C0", lw=2.0, label="the scene's finger")
    left.plot(1e3 * depth, without, color="C1", lw=1.2, label="without limits")
    left.plot(1e3 * np.array(DEPTHS["flat"]), meant, "k+", ms=8, label="converged")
    left.set(xlabel="depth of a flat press [mm]", ylabel="normal force at rest [N]", xlim=(0, 2.5), ylim=(0, 8))
    left.legend(frameon=False, fontsize=8, loc="upper left")
    F, k = tangent(depth, force)
    right.plot(F, 1e-3 * k, ".", color="C0", ms=4, label="the scene's finger")
    line = np.array(FORCES)
    right.plot(
        line, 1e-3 * (b + m * line), color="0.4", lw=1.0, label=f"k = {1e-3 * b:.2f} + {1e-3 * m:.2f} F, R² {R2:.3f}"
    )
    right.set(xlabel="normal force F [N]", ylabel="stiffness k [N/mm]", xlim=(0, 5.5))
    right.set_ylim(0, 1.3e-3 * (b + m * FORCES[1]))
    right.legend(frameon=False, fontsize=8, loc="upper left")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=150)


if __name__ == "__main__":
    sys.exit(printing("press_curve", main))

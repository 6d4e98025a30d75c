"""Each mesh's answers at rest beside those of the finger that is meant: forces, tangential stiffness, contact area."""

from __future__ import annotations

import argparse
import sys

from finger_sim.plain import printing
from finger_sim.studies.mesh_error import CONVERGED, errors, finger_on, measured

MESHES = ("finger", "finger_500", "finger_2000", "finger_4000", "finger_distal")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", default=MESHES, help="names of shipped meshes, or files")
    parser.add_argument("--poisson", type=float, default=0.45)
    parser.add_argument("--no-limits", action="store_true", help="leave strain free")
    parser.add_argument("--same-modulus", action="store_true", help="one Young's modulus for all meshes")
    args = parser.parse_args()
    truth = CONVERGED.get((not args.no_limits, args.poisson), {})
    found, wrong = {}, {}
    for mesh in args.meshes:
        scene = finger_on(mesh, args.poisson, limits=not args.no_limits, calibrated=not args.same_modulus)
        found[mesh] = measured(scene)
        wrong[mesh] = errors(found[mesh], scene)
        print(f"{mesh}: E = {scene.material.young:.6g} Pa", flush=True)
    print(f"\n| answer | converged | {' | '.join(found)} |\n|{'---|' * (2 + len(found))}")
    for name in next(iter(found.values())):
        meant = truth.get(name)
        cells = [f"{meant.value:.4g} ± {100 * meant.error:.1f} %" if meant else ""]
        for mesh, values in found.items():
            error = f" ({100 * wrong[mesh][name]:+.1f} %)" if name in wrong[mesh] else ""
            cells.append(f"{values[name]:.4g}{error}")
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    sys.exit(printing("mesh_error", main))

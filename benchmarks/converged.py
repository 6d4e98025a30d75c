"""What the answers of the finger that is meant converge to: meshes that are finest where each press touches.

Each press has meshes of its own, twice as fine each time. `studies.mesh_error.CONVERGED` has what the finest gives, and
by how much the next coarser differs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from finger_sim.plain import printing
from finger_sim.scene.finger_mesh import Finest, finger
from finger_sim.studies.at_rest import answers
from finger_sim.studies.mesh_error import finger_on

FINEST = {
    "flat": Finest(x=1.0, half_x=9.0, below=-4.0, half_z=7.0, growth=0.3),
    "side": Finest(x=-1.0, half_x=10.0, below=4.0, half_z=9.0, growth=0.3),
    "tip": Finest(x=10.0, half_x=3.0, below=0.5, half_z=5.0, growth=0.3),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presses", nargs="*", default=list(FINEST), help="flat, side, tip (default: all)")
    parser.add_argument("--sizes", type=int, nargs="+", default=[2000, 4000, 8000], help="tetrahedra")
    parser.add_argument("--poisson", type=float, default=0.45)
    parser.add_argument("--no-limits", action="store_true", help="leave strain free; of the flat press")
    args = parser.parse_args()
    presses = ["flat"] if args.no_limits else args.presses
    print(f"| answer | {' | '.join(map(str, args.sizes))} | last change |\n|{'---|' * (2 + len(args.sizes))}")
    with tempfile.TemporaryDirectory() as folder:
        for press in presses:
            found = []
            for size in args.sizes:
                file = Path(folder) / f"{press}_{size}.vtu"
                finger(size, finest=FINEST[press]).save(file)
                scene = finger_on(str(file), args.poisson, limits=not args.no_limits, calibrated=False)
                found.append(answers(scene, (press,)).values())
            for name in found[0]:
                values = [each[name] for each in found]
                change = f"{100.0 * (values[-2] / values[-1] - 1.0):+.1f} %" if len(values) > 1 else ""
                print(f"| {name} | {' | '.join(f'{value:.4g}' for value in values)} | {change} |", flush=True)


if __name__ == "__main__":
    sys.exit(printing("converged", main))

"""The node's time from the start of its process to its first step: first time ever, then with kernels cached."""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile

from node_process import running_node

from finger_sim.plain import printing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger")
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        fresh = {"NUMBA_CACHE_DIR": cache}
        print(f"first time ever: {ready(args.scene, fresh):.1f} s", flush=True)
        after = [ready(args.scene, fresh) for _ in range(args.repeats)]
    print(f"after: median {statistics.median(after):.2f} s, worst {max(after):.2f} s of {args.repeats}")


def ready(scene: str, changes: dict[str, str]) -> float:
    """Seconds to ready."""
    with running_node({"scene": scene}, changes) as (_, seconds):
        return seconds


if __name__ == "__main__":
    sys.exit(printing("startup", main))

"""The node's resident memory and CPU while a bag presses it over and over, recording on."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from node_process import cpu_seconds, environment, running_node

from finger_sim.plain import printing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger")
    parser.add_argument("--bag", default="press_slide")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=500.0, help="[Hz]")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        parameters = {"scene": args.scene, "dt": f"{1.0 / args.rate:.6f}", "record": f"{folder}/bag"}
        with running_node(parameters) as (node, _):
            threading.Thread(target=node.stderr.read, daemon=True).start()
            measure(node, args)


def measure(node: subprocess.Popen[str], args: argparse.Namespace) -> None:
    """Print a line for every stroke: minutes, resident memory, CPU since the line before."""
    begin = time.monotonic()
    sizes = []
    print(f"{'min':>6} {'RSS MB':>8} {'CPU cores':>10}")
    while time.monotonic() - begin < args.minutes * 60.0:
        clock, cpu = time.monotonic(), cpu_seconds(node.pid)
        play = [sys.executable, "-m", "finger_sim", "play", args.bag]
        subprocess.run(play, env=environment(), check=True, capture_output=True)
        sizes.append(resident(node.pid))
        cores = (cpu_seconds(node.pid) - cpu) / (time.monotonic() - clock)
        print(f"{(time.monotonic() - begin) / 60.0:>6.2f} {sizes[-1] / 1e6:>8.1f} {cores:>10.2f}", flush=True)
    print(f"first {sizes[0] / 1e6:.1f} MB, last {sizes[-1] / 1e6:.1f} MB, most {max(sizes) / 1e6:.1f} MB")


def resident(pid: int) -> int:
    """Resident memory [byte]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    sys.exit(printing("node_memory", main))

"""From SIGINT or SIGTERM to the end of the node's process: at 1 kHz with a recording, and while kernels compile."""

from __future__ import annotations

import argparse
import signal
import statistics
import sys
import tempfile
import time
from pathlib import Path

from node_process import running_node

from finger_sim.bags.reader import BagReader
from finger_sim.plain import printing

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--repeats", type=int, default=5, help="of each signal")
    args = parser.parse_args()
    taken: dict[str, list[float]] = {"recording": [], "compiling": []}
    for _ in range(args.repeats):
        for number in SIGNALS:
            with tempfile.TemporaryDirectory() as folder:
                bag = Path(folder) / "bag"
                parameters = {"scene": args.scene, "record": str(bag)}
                taken["recording"].append(ending(parameters, {}, "ready after", number))
                warning = BagReader(bag).warning
                if warning is not None:
                    raise SystemExit(f"the bag was not closed: {warning}")
            with tempfile.TemporaryDirectory() as folder:
                cache = {"NUMBA_CACHE_DIR": folder}
                taken["compiling"].append(ending({"scene": args.scene}, cache, "compiling kernels", number))
    print(f"{'while':>10} {'median s':>9} {'most s':>7}   of {args.repeats} SIGINT and {args.repeats} SIGTERM")
    for what, seconds in taken.items():
        print(f"{what:>10} {statistics.median(seconds):>9.2f} {max(seconds):>7.2f}   all with code 0")


def ending(parameters: dict[str, str], changes: dict[str, str], said: str, number: signal.Signals) -> float:
    """Seconds from the signal, sent a second after the node said so, to the end of its process."""
    with running_node(parameters, changes, said) as (node, _):
        time.sleep(1.0)
        begin = time.monotonic()
        node.send_signal(number)
        code = node.wait(timeout=30)
        took = time.monotonic() - begin
    if code != 0:
        raise SystemExit(f"{number.name}: the node ended with code {code}")
    return took


if __name__ == "__main__":
    sys.exit(printing("exit_time", main))

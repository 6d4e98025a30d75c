"""What the page of `finger_sim view` costs: its server's share of a core, and the node's late steps beside it.

By default the share at 30 and 60 frames a second with one client that draws each frame at once: first in free air, then
while it holds the finger, presses it on the plane and slides it, and sends 60 poses a second, as a screen does. The
node is the default one, in a process of its own.

With --late: slices with and without a page in turn, within one run of the node, whose own counts are compared. Commands
come as for benchmarks/recording.py, a thousand a second, the strokes of a bag forth and back.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator

import numpy as np
from node_process import cpu_seconds, environment, running_node
from recording import RATE, Bench
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from finger_sim.bags.reader import read_commands
from finger_sim.plain import printing
from finger_sim.scene.resources import find_bag

SETTLE = 3.0
"""Of a page that has just been opened [s]."""
ALLOWED = {30.0: 5.0, 60.0: 8.0}
"""Share of a core [%] that is wanted at most, by frames a second."""
SCREEN = 60.0
"""Poses a second of a page that holds the finger."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement (default: %(default)g)")
    parser.add_argument("--late", action="store_true", help="instead: late steps of the node with and without a page")
    parser.add_argument("--priority", type=int, default=20, help="of the node's loop; 0: as any other thread")
    parser.add_argument("--slice", type=float, default=10.0, help="length of a slice [s]")
    parser.add_argument("--pairs", type=int, default=8, help="of slices without and with a page")
    parser.add_argument("--bag", default="press_slide", help="of commands, with --late")
    args = parser.parse_args()
    os.environ.update(environment())
    with tempfile.TemporaryDirectory() as folder:
        parameters = {
            "scene": args.scene, "dt": f"{1.0 / RATE:.6f}", "record_directory": folder,
            "realtime_priority": str(args.priority),
        }  # fmt: skip
        with running_node(parameters) as (process, _):
            assert process.stderr is not None
            threading.Thread(target=process.stderr.read, daemon=True).start()
            if args.late:
                late(process.pid, args)
            else:
                share(args)


def share(args: argparse.Namespace) -> None:
    """The server's share of a core."""
    with page_server() as (pid, port):
        for drag, (hz, allowed) in itertools.product((False, True), ALLOWED.items()):
            with Client(port, hz, drag) as client:
                time.sleep(SETTLE)
                cpu, frames, sent, begin = cpu_seconds(pid), client.frames, client.bytes, time.monotonic()
                time.sleep(args.seconds)
                passed = time.monotonic() - begin
                spent = 100.0 * (cpu_seconds(pid) - cpu) / passed
                print(
                    f"{hz:g} Hz, {'dragged' if drag else 'in free air'}: {spent:.1f} % of a core "
                    f"(wanted: at most {allowed:g}), "
                    f"{(client.frames - frames) / passed:.1f} frames and {(client.bytes - sent) / passed / 1e3:.0f} kB "
                    f"a second, a frame arrives {1e3 * client.age:.1f} ms after its step (median)",
                    flush=True,
                )
        time.sleep(SETTLE)
        cpu, begin = cpu_seconds(pid), time.monotonic()
        time.sleep(args.seconds)
        print(f"no page open: {100.0 * (cpu_seconds(pid) - cpu) / (time.monotonic() - begin):.1f} % of a core")


def late(node: int, args: argparse.Namespace) -> None:
    """The node's late steps in slices with and without a page; the server runs in both, nobody looks in the latter."""
    found: dict[bool, list[float]] = {False: [], True: []}
    steps: dict[bool, list[float]] = {False: [], True: []}
    with page_server() as (_, port), Bench(node, read_commands(find_bag(args.bag)), True) as bench:
        for k in range(2 * args.pairs):
            on = k % 2 == 1
            with Client(port, 30.0) if on else contextlib.nullcontext():
                slice_ = bench.slice(args.slice, False)
            found[on].append(slice_.late)
            steps[on].append(slice_.p99)
            print(
                f"{'with' if on else 'without':>8} a page: {slice_.late:.3f} % late, p99 {slice_.p99:.3f} ms",
                flush=True,
            )
    change = np.array(found[True]) - np.array(found[False])
    spread = np.std(change, ddof=1) / math.sqrt(len(change)) if len(change) > 1 else math.nan
    print(
        f"late steps: {np.median(found[False]):.3f} % without, {np.median(found[True]):.3f} % with a page (medians); "
        f"{np.median(change):+.3f} from a slice to the next (median), {change.mean():+.3f} ± {spread:.3f} (mean); "
        f"p99 of a step {np.median(steps[False]):.3f} and {np.median(steps[True]):.3f} ms"
    )


@contextlib.contextmanager
def page_server() -> Iterator[tuple[int, int]]:
    """`finger_sim view --join` in the node's domain: process id and port."""
    command = [sys.executable, "-m", "finger_sim", "view", "--join", "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    try:
        url = process.stdout.readline().strip()
        if not url:
            raise SystemExit("the page is not served")
        yield process.pid, int(url.rpartition(":")[2].strip("/"))
    finally:
        process.terminate()
        process.wait(30)


class Client:
    """A page without a browser, in a process of its own only in that it does little."""

    def __init__(self, port: int, hz: float, drag: bool = False) -> None:
        self.frames = self.bytes = 0
        self._ages: list[float] = []
        self._drag = drag
        self._stop = threading.Event()
        self._stack = contextlib.ExitStack()
        self._socket = self._stack.enter_context(connect(f"ws://127.0.0.1:{port}/ws", compression=None, max_size=None))
        self._say("frames", hz=hz)
        self._drawn = 0
        self._threads = [threading.Thread(target=self._draw)]
        if drag:
            self._say("take")
            self._threads.append(threading.Thread(target=self._move))

    def __enter__(self) -> Client:
        for thread in self._threads:
            thread.start()
        end = time.monotonic() + 60.0
        while not self.frames:
            if time.monotonic() > end:
                raise SystemExit("no frame came within 60 s")
            time.sleep(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._stack.close()
        for thread in self._threads:
            thread.join()

    @property
    def age(self) -> float:
        """Time from a step to the arrival of its frame, median [s]."""
        return float(np.median(self._ages))

    def _say(self, kind: str, **said: object) -> None:
        self._socket.send(json.dumps({"type": kind} | said))

    def _draw(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            while not self._stop.is_set():
                data = self._socket.recv()
                if isinstance(data, bytes) and data[0] == 2:
                    _, _, seq, _, stamp = struct.unpack_from("<4Id", data)
                    self.frames, self.bytes = self.frames + 1, self.bytes + len(data)
                    self._ages.append(time.time() - stamp)
                    self._drawn = seq
                    if not self._drag:
                        self._socket.send(struct.pack("<2I", 1, seq))

    def _move(self) -> None:
        """Down onto the plane by 2 mm and up again, and to and fro along it; says what was drawn by then, too."""
        begin = time.monotonic()
        half = math.sqrt(0.5)
        with contextlib.suppress(ConnectionClosed):
            while not self._stop.wait(1.0 / SCREEN):
                t = time.monotonic() - begin
                place = (2e-3 * math.sin(t), 0.0, 0.0075 - 0.002 * (1.0 - math.cos(2.0 * t)) / 2.0)
                self._socket.send(struct.pack("<2I7d", 2, self._drawn, *place, half, 0.0, 0.0, half))


if __name__ == "__main__":
    sys.exit(printing("view", main))

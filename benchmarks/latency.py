"""Round trips over ROS topics: a command sent, the first contact_wrench computed from it received.

One driver process sends PoseStamped at fixed rates to the node, in mode free and in mode triggered, and to a bare echo
node, in turn in one run: the echo is what messages alone take. Each is started anew in each round; nothing else of
this benchmark runs beside it. In mode free a command that a newer one overtook before the next step has no wrench
of its own: it is counted as overtaken. Lost is what the node never received. With --load the node sends its mesh at
60 Hz to a viewer in another process and records everything.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from node_process import DOMAIN, cpu_seconds, environment, running_node, started
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

from finger_sim import Scene
from finger_sim.plain import printing
from finger_sim.ros.loop import prefer_receivers, prefer_this_thread
from finger_sim.studies.bench.scenes import FLAT, touch_height

DEPTH, STROKE = 1e-3, 2e-3
"""Of the press, and of the slide to either side [m]."""
MARK = 1e-10
"""Command number k is so many times k off to the side [m]: by that the pose says which command a step followed."""
LEAD = 2.0
"""Time at the beginning of each series that is not counted, and that the last answers are waited for [s]."""
OWN = 0.1e-3
"""Time that the node may take beside half a period and what messages take, as asked of its median [s]."""
STAMP = struct.Struct("<iI")
POSE = struct.Struct("<7d")


class Series(NamedTuple):
    """What one series of commands gave."""

    trips: np.ndarray
    """Round trips [s]."""
    overtaken: int
    lost: int
    cores: float
    """Processor time of the node a second."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 500.0, 1000.0], help="of commands [Hz]")
    parser.add_argument("--subjects", nargs="+", default=["echo-events", "free", "triggered"],
                        help="echo-events (the floor), echo-single, echo-multi, free, triggered")  # fmt: skip
    parser.add_argument("--reliability", choices=("reliable", "best_effort"), default="reliable")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each series")
    parser.add_argument(
        "--priority", type=int, default=0, help="of the driver under SCHED_FIFO; 0: as any other thread"
    )
    parser.add_argument("--load", action="store_true", help="mesh at 60 Hz to a viewer, and recording")
    parser.add_argument("--parameter", action="append", default=[], metavar="NAME:=VALUE", help="of the node")
    parser.add_argument("--view", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.view:
        view()
        return
    scene = Scene.load(args.scene)
    gc.disable()
    results: dict[tuple[str, float], list[Series]] = {}
    for k in range(args.rounds):
        for subject in args.subjects:
            with serving(subject, args) as process, Driver(scene, subject, args) as driver:
                for rate in args.rates:
                    results.setdefault((subject, rate), []).append(driver.series(rate, args.seconds, process.pid))
            print(f"\rround {k + 1} of {args.rounds}: {subject:<12}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(f"{args.scene}, {args.reliability}, {'mesh, viewer, recording' if args.load else 'wrench and pose only'}; ")
    print(f"median of {args.rounds} rounds of {args.seconds:g} s; round trip [ms]")
    print(f"{'':>12} {'Hz':>5} {'median':>8} {'p99':>8} {'p99.9':>8} {'overtaken':>10} {'lost':>5} {'cores':>6}")
    for (subject, rate), series in results.items():
        p = percentiles(series)
        sent = len(series) * rate * args.seconds
        overtaken = 100 * sum(s.overtaken for s in series) / sent
        cores = np.median([s.cores for s in series])
        print(f"{subject:>12} {rate:>5g} {p[0]:>8.3f} {p[1]:>8.3f} {p[2]:>8.3f} {overtaken:>8.1f} % "
              f"{sum(s.lost for s in series):>5} {cores:>6.2f}")  # fmt: skip
    for rate in args.rates:
        if rate * scene.dt >= 1.0 and {("free", rate), ("echo-events", rate)} <= set(results):  # slower ones are led
            compare(rate, percentiles(results["free", rate]), percentiles(results["echo-events", rate]), scene.dt)


def percentiles(series: list[Series]) -> np.ndarray:
    """Median, p99 and p99.9 [ms], each the median over rounds."""
    return 1e3 * np.median([np.percentile(s.trips, (50, 99, 99.9)) for s in series], axis=0)


def compare(rate: float, node: np.ndarray, floor: np.ndarray, dt: float) -> None:
    """The node beside what is asked of it."""
    allowed = (floor[0] + 1e3 * (0.5 * dt + OWN), floor[1] + 1e3 * dt)
    for name, is_, may in zip(("median", "p99"), node, allowed, strict=False):
        print(f"{rate:g} Hz, free: {name} {is_:.3f} of {may:.3f} ms allowed: {'met' if is_ <= may else 'missed'}")


@contextlib.contextmanager
def serving(subject: str, args: argparse.Namespace) -> Iterator[subprocess.Popen[str]]:
    """The process of a subject, ready."""
    kind, _, executor = subject.partition("-")
    if kind == "echo":
        echo = Path(__file__).with_name("echo_node.py")
        with started([str(echo), executor, args.reliability]) as (process, _):
            yield process
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        parameters = {
            "scene": args.scene,
            "mode": subject,
            "qos_overrides./command_pose.subscription.reliability": args.reliability,
            **dict(item.split(":=") for item in args.parameter),
            **({"record": f"{folder}/bag"} if args.load else {}),
        }
        process, _ = stack.enter_context(running_node(parameters))
        if args.load:
            viewer = subprocess.Popen([sys.executable, __file__, "--view"], env=environment())
            stack.callback(viewer.wait)
            stack.callback(viewer.send_signal, signal.SIGKILL)
        yield process


def view() -> None:
    """Receives mesh_points until it is ended."""
    rclpy.init(domain_id=int(DOMAIN))
    node = rclpy.create_node("viewer")
    node.create_subscription(PointCloud2, "mesh_points", lambda cloud: None, 5)
    rclpy.spin(node)


class Driver:
    """Sends commands and notes what comes back."""

    def __init__(self, scene: Scene, subject: str, args: argparse.Namespace) -> None:
        self.height = touch_height(scene) if scene.driven else 0.0
        self.free = subject == "free"
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=int(DOMAIN))
        self.node = rclpy.create_node("driver", context=self.context, enable_rosout=False)
        if refused := prefer_this_thread(args.priority):
            raise SystemExit(refused)
        prefer_receivers(args.priority)
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy[args.reliability.upper()])
        self.publisher = self.node.create_publisher(PoseStamped, "command_pose", qos)
        self.node.create_subscription(WrenchStamped, "contact_wrench", self._wrench, 100, raw=True)
        if self.free:
            self.node.create_subscription(PoseStamped, "pose", self._pose, 100, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._report, 10)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)
        message = PoseStamped()
        message.header.frame_id = "world"
        self.template = bytearray(serialize_message(message))
        self.received: int | None = None
        self.reports = 0
        self.number = 0
        self._begin(0, 0)

    def __enter__(self) -> Driver:
        end = time.monotonic() + 20.0
        while not (self.publisher.get_subscription_count() and self.node.count_publishers("contact_wrench")):
            if time.monotonic() > end:
                raise SystemExit("nobody listens to command_pose")
            self._spin(0.02)
        self._spin(LEAD)
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def series(self, rate: float, seconds: float, pid: int) -> Series:
        """Commands at `rate` [Hz] for so long, after some that are not counted."""
        ahead, count = round(rate * LEAD), round(rate * seconds)
        before = self._received()
        self._begin(ahead, count)
        busy, clock = cpu_seconds(pid), time.monotonic()
        self._send(rate, ahead + count)
        cores = (cpu_seconds(pid) - busy) / (time.monotonic() - clock)
        self._spin(LEAD)
        after = self._received()
        trips = self.answered - self.sent
        answered = np.isfinite(trips)
        missing = int(np.count_nonzero(~answered))
        lost = missing if before is None or after is None else ahead + count - (after - before)
        return Series(trips[answered], missing - lost, lost, cores)

    def _begin(self, ahead: int, count: int) -> None:
        self.first = self.number + ahead
        self.sent = np.full(count, np.nan)
        self.answered = np.full(count, np.nan)
        self.wrenches: dict[bytes, float] = {}

    def _send(self, rate: float, count: int) -> None:
        origin = time.monotonic()
        for k in range(count):
            due = origin + k / rate
            self._spin_until(due)
            self._command(time.monotonic() - origin)

    def _command(self, age: float) -> None:
        number = self.number
        self.number += 1
        STAMP.pack_into(self.template, 4, number, 1)
        slide = STROKE * np.sin(2.0 * np.pi * age)
        POSE.pack_into(self.template, len(self.template) - POSE.size,
                       slide, number * MARK, self.height - DEPTH, *FLAT)  # fmt: skip
        data = bytes(self.template)
        if 0 <= number - self.first < len(self.sent):
            self.sent[number - self.first] = time.perf_counter()
        self.publisher.publish(data)

    def _wrench(self, data: bytes) -> None:
        now = time.perf_counter()
        if self.free:
            self.wrenches[data[4:12]] = now
        else:
            self._answer(STAMP.unpack_from(data, 4)[0], now)

    def _pose(self, data: bytes) -> None:
        came = self.wrenches.pop(data[4:12], None)
        if came is not None:
            self._answer(round(POSE.unpack_from(data, len(data) - POSE.size)[1] / MARK), came)

    def _answer(self, number: int, came: float) -> None:
        k = number - self.first
        if 0 <= k < len(self.answered) and np.isnan(self.answered[k]):
            self.answered[k] = came

    def _report(self, message: Any) -> None:
        values = {item.key: item.value for item in message.status[0].values}
        self.received = int(values["received commands"])
        self.reports += 1

    def _received(self) -> int | None:
        """Commands that the node has received; None of the echo, which does not say."""
        if not self.node.count_publishers("/diagnostics"):
            return None
        reports = self.reports
        while self.reports < reports + 1:
            self._spin(0.05)
        return self.received

    def _spin(self, seconds: float) -> None:
        self._spin_until(time.monotonic() + seconds)

    def _spin_until(self, end: float) -> None:
        while (ahead := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=ahead)


if __name__ == "__main__":
    sys.exit(printing("latency", main))

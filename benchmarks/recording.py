"""What recording costs the node's loop: slices with and without it in turn, within one run of the node.

With --everything, what all that is not a step costs: in slices with a recording there are a viewer of the mesh, one of
the marker, and a storm of parameters, set and asked for, too; in those without there is nothing of it.

A thread here sends commands at the loop's rate, the strokes of a bag forth and back; one viewer has subscribed to
mesh_points. The figures are the node's own, of its diagnostics; the first second of a slice does not count.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from node_process import DOMAIN, bag_process, cpu_seconds, environment, running_node

from finger_sim.bags.reader import BagReader, Commands, read_commands
from finger_sim.plain import printing
from finger_sim.scene.resources import find_bag

RATE = 1000.0
"""[Hz]"""
STORM = 20.0
"""Parameters that are set, and questions for three, in a second."""
COLUMNS = ("recording", "late %", "step ms", "p99 ms", "node CPU", "writer CPU", "messages", "dropped")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--bag", default="press_slide")
    parser.add_argument("--priority", type=int, default=20, help="of the node's loop; 0: as any other thread")
    parser.add_argument("--slice", type=float, default=10.0, help="length of a slice [s]")
    parser.add_argument("--pairs", type=int, default=8, help="of slices without and with a recording")
    parser.add_argument("--long", type=float, help="instead: one recording of so many seconds between two slices")
    parser.add_argument("--everything", action="store_true", help="viewers and parameters in the slices with, too")
    parser.add_argument("--folder", type=Path, help="where the bags are made for a while (default: a temporary one)")
    args = parser.parse_args()
    os.environ.update(environment())
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        parameters = {
            "scene": args.scene, "dt": f"{1.0 / RATE:.6f}", "record_directory": folder,
            "realtime_priority": str(args.priority),
        }  # fmt: skip
        with running_node(parameters) as (process, _):
            assert process.stderr is not None
            threading.Thread(target=process.stderr.read, daemon=True).start()
            with Bench(process.pid, read_commands(find_bag(args.bag)), args.everything) as bench:
                if args.long is None:
                    lengths = [(args.slice, on) for _ in range(args.pairs) for on in (False, True)]
                else:
                    lengths = [(args.slice, False), (args.long, True), (args.slice, False)]
                print(" ".join(f"{name:>10}" for name in COLUMNS))
                slices = []
                for seconds, on in lengths:
                    slices.append(bench.slice(seconds, on))
                    print(slices[-1].line(), flush=True)
        report(slices)


@dataclass
class Slice:
    """What was seen in one; `bag`: of its recording."""

    late: float
    """Late steps [%]."""
    median: float
    """Step time [ms]."""
    p99: float
    """Of the last 4096 steps [ms]."""
    node: float
    """Processor time of the node per time."""
    writer: float
    bag: Path | None = None
    messages: int = 0
    dropped: int = 0

    def line(self) -> str:
        """One line of the table."""
        numbers = (self.late, self.median, self.p99, self.node, self.writer)
        return " ".join(
            [f"{'on' if self.bag else 'off':>10}", *(f"{number:>10.3f}" for number in numbers)]
            + [f"{count:>10}" for count in (self.messages, self.dropped)]
        )


class Bench:
    """A commander and a viewer of the node with process id `node`."""

    def __init__(self, node: int, commands: Commands, everything: bool) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
        from rcl_interfaces.srv import GetParameters, SetParameters
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import PointCloud2
        from std_srvs.srv import SetBool
        from visualization_msgs.msg import Marker

        self.pids = (node, bag_process(node))
        self.reports: list[dict[str, str]] = []
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=int(DOMAIN))
        self.node = rclpy.create_node("bench", context=self.context, enable_rosout=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, 10)
        self.viewers = [(PointCloud2, "mesh_points"), *([(Marker, "mesh_marker")] if everything else [])]
        self.views = []
        self.everything = everything
        if not everything:
            self._view()
        self.set = self.node.create_client(SetParameters, "/finger/set_parameters")
        self.get = self.node.create_client(GetParameters, "/finger/get_parameters")
        self.sets = (
            SetParameters.Request(
                parameters=[
                    Parameter(
                        name="plane.friction",
                        value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.5 + 0.001 * k),
                    )
                ]
            )
            for k in itertools.cycle(range(100))
        )
        self.gets = GetParameters.Request(names=["plane.friction", "dt", "solver.tolerance"])
        self.storm = self.node.create_timer(1.0 / STORM, self._storm)
        self.storm.cancel()
        self.record = self.node.create_client(SetBool, "/finger/record")
        self.request = SetBool.Request
        self.publisher = self.node.create_publisher(PoseStamped, "command_pose", 10)
        self.poses = forth_and_back(commands)
        self.motion = itertools.cycle(self.poses)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self._command, args=(commands.frame_id,))

    def __enter__(self) -> Bench:
        self.thread.start()
        self._spin(lambda: self.record.service_is_ready() and len(self.reports) >= 3)
        return self

    def __exit__(self, *_: object) -> None:
        import rclpy

        self.stop.set()
        self.thread.join()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def slice(self, seconds: float, on: bool) -> Slice:
        """So long with or without a recording."""
        if on:
            self._ask(True)
            if self.everything:
                self._view()
                self.storm.reset()
        self.motion = itertools.cycle(self.poses)  # each slice sees the same of it
        first = len(self.reports)
        end = time.monotonic() + seconds
        self._spin(lambda: len(self.reports) >= first + 2)  # of the first second; from there on
        cpu, clock = [cpu_seconds(pid) for pid in self.pids], time.monotonic()
        self._spin(lambda: time.monotonic() >= end and len(self.reports) >= first + 3)
        spent = [
            (cpu_seconds(pid) - before) / (time.monotonic() - clock) for pid, before in zip(self.pids, cpu, strict=True)
        ]
        before, after = self.reports[first + 1], self.reports[-1]
        steps, late = (int(after[key]) - int(before[key]) for key in ("steps", "late steps"))
        found = Slice(
            100.0 * late / steps, float(after["step time p50 [ms]"]), float(after["step time p99 [ms]"]), *spent
        )
        if on and self.everything:
            self.storm.cancel()
            while self.views:
                self.node.destroy_subscription(self.views.pop())
        if on:
            path, counts = self._ask(False).rsplit(": ", 1)
            found.bag = Path(path)
            found.messages, found.dropped = (int(word.split()[0]) for word in counts.split(", "))
        return found

    def _view(self) -> None:
        self.views = [self.node.create_subscription(*what, lambda _: None, 5, raw=True) for what in self.viewers]

    def _storm(self) -> None:
        self.set.call_async(next(self.sets))
        self.get.call_async(self.gets)

    def _ask(self, on: bool) -> str:
        """What ~/record answers."""
        future = self.record.call_async(self.request(data=on))
        self._spin(future.done)
        if not future.result().success:
            raise SystemExit(future.result().message)
        return future.result().message

    def _spin(self, done) -> None:
        while not done():
            self.executor.spin_once(timeout_sec=0.1)

    def _on_report(self, message) -> None:
        self.reports.append({item.key: item.value for item in message.status[0].values})

    def _command(self, frame_id: str) -> None:
        from finger_sim.bags.template import doubles
        from finger_sim.ros.loop import RateLoop
        from finger_sim.ros.messages import pose_template

        template = pose_template(frame_id)
        send = lambda: self.publisher.publish(template.fill(time.time_ns(), doubles(next(self.motion))))  # noqa: E731
        loop = RateLoop(1.0 / RATE, lambda: None, send)
        loop.start()
        self.stop.wait()
        loop.stop(timeout=1.0)


def forth_and_back(commands: Commands) -> np.ndarray:
    """(n, 7) position and quaternion at RATE; the last is beside the first."""
    poses = np.hstack([commands.position, commands.orientation])
    times = np.arange(0.0, commands.duration, 1.0 / RATE)
    even = np.stack([np.interp(times, commands.receipt, column) for column in poses.T], axis=1)
    return np.vstack([even, even[::-1]])


def report(slices: list[Slice]) -> None:
    """Medians with and without and of the differences between neighbours, and what the bags hold."""
    off, on = ([s for s in slices if bool(s.bag) is which] for which in (False, True))
    print()
    for name in ("late", "median", "p99", "node", "writer"):
        without, with_ = (np.array([getattr(s, name) for s in some]) for some in (off, on))
        change = np.median(with_ - without[: len(with_)])
        unit = {"late": "% late steps", "median": "ms a step, p50", "p99": "ms a step, p99"}.get(name, f"cores, {name}")
        print(f"{unit:>20}: {np.median(without):.3f} without, {np.median(with_):.3f} with a recording; ", end="")
        print(f"{change:+.3f} from a slice to the next")
    lost = counted = 0
    for s in on:
        reader = BagReader(s.bag)
        if reader.warning:
            raise SystemExit(f"a broken bag: {reader.warning}")
        lost += sum(topic.lost for topic in reader.topics)
        counted += reader.message_count
    print(f"{sum(s.messages for s in on)} messages recorded, {sum(s.dropped for s in on)} dropped; ", end="")
    print(f"read back: {counted}, {lost} missing between them")


if __name__ == "__main__":
    sys.exit(printing("recording", main))

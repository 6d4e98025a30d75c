"""A hand of several fingers, a node each, that press and slide at once: processor time, late and skipped steps."""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from node_process import cpu_seconds, environment, started

from finger_sim.bags.reader import read_commands
from finger_sim.plain import printing
from finger_sim.scene.resources import find_bag

NAMES = ("thumb", "index", "middle", "ring", "little")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=5, choices=range(1, len(NAMES) + 1))
    parser.add_argument("--rates", type=float, nargs="+", default=[50.0, 100.0, 200.0], metavar="HZ")
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--seconds", type=float, default=14.0, help="of commands at each rate; a stroke takes seven")
    parser.add_argument("--priority", type=int, default=0, help="of the loops, under SCHED_FIFO")
    args = parser.parse_args()
    os.environ.update(environment())
    print(f"{args.fingers} × {args.scene}, {len(os.sched_getaffinity(0))} processors")
    print("rate [Hz]   processors, all   largest of one   late steps: median, most   skipped   real-time factor, least")
    for rate in args.rates:
        counts = hand(args, rate)
        used, late = [c["used"] for c in counts], [100.0 * c["late"] / max(c["steps"], 1.0) for c in counts]
        print(
            f"{rate:9g}   {sum(used):15.2f}   {max(used):14.2f}   {np.median(late):14.2f} %, {max(late):5.2f} %"
            f"   {sum(c['skipped'] for c in counts):7.0f}   {min(c['factor'] for c in counts):23.3f}"
        )


def hand(args: argparse.Namespace, rate: float) -> list[dict[str, float]]:
    """What each finger used and missed."""
    names = NAMES[: args.fingers]
    with contextlib.ExitStack() as keep:
        nodes = [keep.enter_context(finger(args, name, rate)) for name in names]
        listener = keep.enter_context(Listener(names))
        listener.drive(min(2.0, args.seconds))  # the first touch compiles nothing, but fills caches
        before, used = listener.report(), [cpu_seconds(pid) for pid in nodes]
        begin = time.monotonic()
        listener.drive(args.seconds)
        wall = time.monotonic() - begin
        after, now = listener.report(), [cpu_seconds(pid) for pid in nodes]
    return [
        {
            "used": (last - first) / wall,
            "factor": float(after[name]["real-time factor"]),
            **{
                key: float(after[name][said]) - float(before[name][said])
                for key, said in (("steps", "steps"), ("late", "late steps"), ("skipped", "overruns"))
            },
        }
        for name, first, last in zip(names, used, now, strict=True)
    ]


@contextlib.contextmanager
def finger(args: argparse.Namespace, name: str, rate: float) -> Iterator[int]:
    """One node, once it is ready: its process."""
    settings = {
        "scene": args.scene, "dt": f"{1.0 / rate:.9f}", "finger_frame": name, "realtime_priority": str(args.priority)
    }  # fmt: skip
    words = [word for key, value in settings.items() for word in ("-p", f"{key}:={value}")]
    with started(["-m", "finger_sim.ros.node", "--ros-args", "-r", f"__ns:=/{name}", *words]) as (process, _):
        yield process.pid


class Listener:
    """Drives all fingers along the shipped stroke, and hears what they say of themselves."""

    def __init__(self, names: tuple[str, ...]) -> None:
        rclpy.init()
        self._names, self._said = names, dict[str, dict[str, str]]()
        self._node = rclpy.create_node("hand")
        self._publishers = [self._node.create_publisher(PoseStamped, f"/{name}/command_pose", 10) for name in names]
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 100)
        commands = read_commands(find_bag("press_slide"))
        self._times, self._positions, self._turns = commands.receipt, commands.position, commands.orientation

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        rclpy.shutdown()

    def drive(self, seconds: float, rate: float = 100.0) -> None:
        """Commands to all, `rate` times a second."""
        begin = time.monotonic()
        length = self._times[-1] - self._times[0]
        while (now := time.monotonic() - begin) < seconds:
            k = min(int(np.searchsorted(self._times, self._times[0] + now % length)), len(self._times) - 1)
            message = PoseStamped()
            message.header.frame_id = "world"
            p, q = message.pose.position, message.pose.orientation
            p.x, p.y, p.z = map(float, self._positions[k])
            q.x, q.y, q.z, q.w = map(float, self._turns[k])
            for publisher in self._publishers:
                publisher.publish(message)
            rclpy.spin_once(self._node, timeout_sec=1.0 / rate)

    def report(self) -> dict[str, dict[str, str]]:
        """The next report of each."""
        self._said.clear()
        while len(self._said) < len(self._names):
            rclpy.spin_once(self._node, timeout_sec=0.1)
        return dict(self._said)

    def _hear(self, message: Any) -> None:
        for status in message.status:
            self._said[status.name.partition("/")[0]] = {item.key: item.value for item in status.values}


if __name__ == "__main__":
    raise SystemExit(printing("hand", main))

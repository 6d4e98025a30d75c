"""A client in lock-step with the node on simulated time: it owns /clock, and each command has its answer.

    finger_sim node --ros-args -p use_sim_time:=true -p mode:=triggered     # in one terminal
    python examples/sim_time.py                                             # in another one

Time stands while nobody moves it, so a slow client gives the same forces as a fast one, to the last bit.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

STEP = 1_000_000
"""The node's dt [ns]."""
FLAT = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""Pad down."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--timeout", type=float, default=120.0, help="to wait for the node and each answer [s]")
    args = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node("lock_step")
    clock = node.create_publisher(Clock, "/clock", 10)
    commands = node.create_publisher(PoseStamped, "command_pose", 10)
    answers: dict[int, WrenchStamped] = {}

    def hear(message: WrenchStamped) -> None:
        stamp = message.header.stamp
        answers[stamp.sec * 1_000_000_000 + stamp.nanosec] = message

    node.create_subscription(WrenchStamped, "device_wrench", hear, 10)
    try:
        wait(node, lambda: commands.get_subscription_count() * node.count_publishers("device_wrench") > 0, args.timeout)
        for k in range(1, args.steps + 1):
            now = k * STEP
            clock.publish(Clock(clock=stamped(now).header.stamp))
            command = stamped(now)
            command.pose.position.z = 0.0075 - 5e-6 * k
            command.pose.orientation.x, _, _, command.pose.orientation.w = FLAT
            commands.publish(command)
            wait(node, partial(answers.__contains__, now), args.timeout)
        force = answers[args.steps * STEP].wrench.force
        print(f"after {1e-9 * args.steps * STEP:.3f} s of simulated time: {force.z:.3f} N")
    except TimeoutError as error:
        print(f"sim_time: {error}", file=sys.stderr)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def stamped(now: int) -> PoseStamped:
    """A pose of that time [ns] in the world."""
    message = PoseStamped()
    message.header.frame_id = "world"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 1_000_000_000)
    return message


def wait(node: Node, condition: Callable[[], bool], seconds: float) -> None:
    """Serves the node until the condition holds. Raises TimeoutError."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"the node has not answered within {seconds:g} s")
        rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == "__main__":
    raise SystemExit(main())

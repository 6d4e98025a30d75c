"""A bare rclpy node: each PoseStamped on command_pose at once gives a WrenchStamped of its stamp on contact_wrench.

Bytes in, bytes out, nothing made into messages: the least that any node between these topics could take.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from finger_sim.plain import printing

EXECUTORS = {"events": EventsExecutor, "single": SingleThreadedExecutor, "multi": MultiThreadedExecutor}
STAMP = slice(4, 12)
"""Of a message that begins with a header, in its CDR bytes."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("executor", choices=EXECUTORS)
    parser.add_argument("reliability", choices=("reliable", "best_effort"))
    given = parser.parse_args(remove_ros_args(sys.argv)[1:])
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("echo")
    answer = WrenchStamped()
    answer.header.frame_id = "finger_world_aligned"
    data = bytearray(serialize_message(answer))
    publisher = node.create_publisher(WrenchStamped, "contact_wrench", 10)

    def echo(command: bytes) -> None:
        data[STAMP] = command[STAMP]
        publisher.publish(bytes(data))

    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy[given.reliability.upper()])
    node.create_subscription(PoseStamped, "command_pose", echo, qos, raw=True)
    executor = EXECUTORS[given.executor]()
    executor.add_node(node)
    print("ready after", file=sys.stderr, flush=True)
    while not stop.is_set():
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(printing("echo_node", main))

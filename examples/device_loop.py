"""A haptic loop around the node: sends where the device is as command_pose, and renders device_wrench on it.

Put your driver where DEVICE stands. What is here moves a mass by a hand that presses the table and lets go, over and
over; start `finger_sim node --ros-args -p scene:=finger_coupled` beside it. Ends with Ctrl-C, no force on the device.
"""

import argparse
import math
import signal
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Vector3, WrenchStamped
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from finger_sim.plain import printing

RATE, SILENCE = 1000.0, 0.05
"""Poses a second [Hz]; a force older than this is no longer rendered [s]."""


class Device:  # DEVICE: your driver instead
    """A mass of 0.2 kg, damped with 0.8 N s/m, that a hand leads up and down by a spring of 200 N/m."""

    height, speed = 0.02, 0.0

    def pose(self) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
        """Position [m] and orientation x y z w of the finger frame in the node's world: the pad over the table."""
        return (0.0, 0.0, self.height), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))

    def render(self, force: Vector3) -> None:
        """Holds the force [N, world axes] until the next one."""
        hand = 0.006 + 0.014 * math.cos(math.pi * time.monotonic())
        pull = 200.0 * (hand - self.height) - (4.0 + 0.8) * self.speed
        self.speed += (force.z + pull) / 0.2 / RATE
        self.height += self.speed / RATE


def main() -> None:
    usage = "%(prog)s [-h] [--ros-args -r device_wrench:=… -r command_pose:=…]"
    argparse.ArgumentParser(usage=usage, description=__doc__).parse_args(remove_ros_args(sys.argv)[1:])
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, executor, device = rclpy.create_node("device"), EventsExecutor(), Device()
    executor.add_node(node)
    force, came, largest, count, due = Vector3(), -math.inf, 0.0, 0, time.monotonic()

    def on_wrench(message: WrenchStamped) -> None:
        nonlocal force, came, largest, count
        force, came, count = message.wrench.force, time.monotonic(), count + 1
        largest = max(largest, math.hypot(force.x, force.y, force.z))

    node.create_subscription(WrenchStamped, "device_wrench", on_wrench, qos_profile_sensor_data)
    publisher = node.create_publisher(PoseStamped, "command_pose", qos_profile_sensor_data)
    message = PoseStamped()
    message.header.frame_id = "world"
    try:
        while not stop.is_set():
            p, q = message.pose.position, message.pose.orientation
            (p.x, p.y, p.z), (q.x, q.y, q.z, q.w) = device.pose()
            message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
            due = max(due + 1.0 / RATE, time.monotonic() - 0.01)
            while (wait := due - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=wait)
            device.render(force if time.monotonic() - came < SILENCE else Vector3())
    finally:
        device.render(Vector3())
        print(f"{count} wrenches came, the largest force was {largest:.2f} N", flush=True)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(printing("device_loop", main))

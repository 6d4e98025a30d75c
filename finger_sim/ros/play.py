"""A bag's commands onto a topic in real time, as whoever recorded them sent them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from ..bags.reader import Commands
from ..bags.template import doubles
from ..errors import FingerSimError
from .messages import pose_template
from .process import logged

SUBSCRIBER_TIMEOUT = 10.0
"""How long a subscriber is waited for [s]."""
POLL_PERIOD = 0.02
"""Time between two looks for a subscriber [s]."""
LOOK_AHEAD = 1e-3
"""Progress is told only when the next command is at least this far away [s]."""

Meter = Callable[[float, float], None]
"""Called with the seconds played and all there are."""


@dataclass(frozen=True)
class Played:
    """What was sent, and how late after its time each command left."""

    topic: str
    sent: int
    duration: float
    """From the first to the last command [s]."""
    late_median: float
    """[s]"""
    late_p99: float
    """[s]"""
    late_max: float
    """[s]"""


@contextmanager
def ros_node(name: str, domain: int | None = None) -> Iterator[Any]:
    """A node in a context of its own, in `domain` or the environment's; signals are left to Python."""
    context = rclpy.Context()
    rclpy.init(args=logged([]), context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        quiet = {"enable_rosout": False, "use_global_arguments": False, "start_parameter_services": False}
        node = rclpy.create_node(name, context=context, **quiet)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


def play(
    node: Any,
    commands: Commands,
    *,
    topic: str = "command_pose",
    frame_id: str | None = None,
    speed: float = 1.0,
    duration: float | None = None,
    timeout: float = SUBSCRIBER_TIMEOUT,
    progress: Meter | None = None,
) -> Played:
    """Sends `commands` from `node`, each at its time of receipt since the first, header stamp = now.

    Gaps stay gaps, and commands received at one time are sent one right after the other. Waits until
    somebody subscribes to the topic, and at the end until reliable subscribers have it all.

    frame_id : instead of the recorded one
    speed    : > 1 is faster than recorded
    duration : of the recording, from its first command on; longer ones are cut there [s]
    timeout  : how long a subscriber is waited for [s]
    Raises FingerSimError when nobody subscribes.
    """
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
    publisher = node.create_publisher(PoseStamped, topic, qos)
    try:
        _await_subscriber(node, publisher, timeout)
        due = commands.receipt if duration is None else commands.receipt[commands.receipt <= duration]
        poses = np.hstack([commands.position, commands.orientation])
        template = pose_template(commands.frame_id if frame_id is None else frame_id)
        late = np.empty(len(due))
        origin = time.monotonic()
        for k, deadline in enumerate((origin + due / speed).tolist()):
            ahead = deadline - time.monotonic()
            if progress is not None and ahead > LOOK_AHEAD:
                progress(float(due[k]), float(due[-1]))
                ahead = deadline - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            publisher.publish(template.fill(time.time_ns(), doubles(poses[k])))
            late[k] = time.monotonic() - deadline
        publisher.wait_for_all_acked(Duration(seconds=1.0))
        median, p99 = (float(value) for value in np.percentile(late, (50, 99)))
        return Played(str(publisher.topic_name), len(due), float(due[-1]), median, p99, float(late.max()))
    finally:
        node.destroy_publisher(publisher)


def _await_subscriber(node: Any, publisher: Any, timeout: float) -> None:
    end = time.monotonic() + timeout
    while publisher.get_subscription_count() == 0:
        if time.monotonic() > end:
            domain = node.context.get_domain_id()
            raise FingerSimError(
                f"nobody subscribed to {publisher.topic_name} (ROS_DOMAIN_ID {domain}) within {timeout:g} s; "
                f"start `finger_sim node` first, or name the topic with --to"
            )
        time.sleep(POLL_PERIOD)

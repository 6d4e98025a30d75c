"""What nodes log, for recordings: /rosout, taken now and then by whoever serves ROS, never by the loop.

No executor waits for it: a node that logs much would wake it for each line, and take the interpreter from a step.
"""

from __future__ import annotations

import time
from typing import Any

from rcl_interfaces.msg import Log

from ..bags.reader import Qos
from .outputs import Outputs, ros_qos, ros_type
from .rclpy_private import take
from .recorder import RecordedTopic

TOPIC = "/rosout"
QOS = Qos(depth=1000, transient_local=True)
"""As every node offers it."""


class Rosout:
    """The subscription to /rosout.

    entity : what no executor is to wait for
    """

    def __init__(self, node: Any, outputs: Outputs) -> None:
        self._outputs = outputs
        self.entity = node.create_subscription(Log, TOPIC, lambda _: None, ros_qos(QOS), raw=True)
        self._looked = time.monotonic_ns()

    def recorded_topics(self) -> list[RecordedTopic]:
        """The topic of a recording."""
        return [RecordedTopic(TOPIC, ros_type(Log), QOS)]

    def record(self) -> None:
        """Puts what came since the last call, and since the recording began, into it; without one all is left to lie.

        The wall clock tells when a message came: one that jumps puts it at the last look at the earliest.
        """
        recorder = self._outputs.recorder
        if recorder is None or not recorder.active:
            return
        while (taken := take(self.entity)) is not None:
            data, received, _ = taken
            now = time.monotonic_ns()
            came = now - min(max(time.time_ns() - received, 0), now - self._looked)
            if came >= recorder.began:
                recorder.put(TOPIC, data, came)
        self._looked = time.monotonic_ns()

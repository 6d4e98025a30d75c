"""What comes in on command_pose and plane_pose, taken by the loop itself when it is about to step.

No executor waits for these topics: woken for each command, only to note it for a later step, it would take the
interpreter from the present one. Until the loop is ready whoever serves ROS looks now and then, so that nothing is
refused without a word while kernels are compiled.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions

from ..bags.poses import check_pose, read_pose
from ..bags.reader import Qos
from ..scene import Pose
from .accounts import MOST_TRANSPORT
from .outputs import Outputs, ros_qos
from .rclpy_private import Waiter, take
from .recorder import RecordedTopic
from .transforms import Lookup

COMMAND_QOS = {"free": Qos(depth=1000, reliable=False), "triggered": Qos(depth=1000)}
"""Of command_pose, by mode; the parameters qos_overrides./command_pose.subscription.… change it.

free: best effort hears reliable and best-effort senders alike, and a command that came late is of no use. The newest is
followed whatever the depth; a recording holds those too that came while the node was busy.
triggered: each command is to be answered, so none may be lost.
"""
PLANE_QOS = Qos(depth=10, reliable=False)


class Command(NamedTuple):
    """A command that passed the check."""

    pose: Pose
    received_ns: int
    """Steady time of receipt [ns]."""
    transport: float = 0.0
    """Time from its stamp to its receipt by the node's clock [s]; 0 where the stamp cannot be of the same clock."""
    stamp: int = 0
    """Of its header [ns]; 0: none."""

    @property
    def received(self) -> float:
        """Steady time of receipt [s]."""
        return 1e-9 * self.received_ns


class Inbox:
    """The subscriptions of the loop.

    wait     : for a command, or for `wake`; see `Waiter`
    received : commands that came here, good or not
    also     : (1,) those that compiled code took beside them
    early    : held by who takes what comes before the loop is ready, until it is where the loop finds it
    refused  : commands and plane poses of no use
    reason   : why the last of them was refused

    frames : transforms poses of other frames; None: they are refused
    What is transformed is recorded as it is followed, in the world frame: a replay needs no transforms.
    """

    def __init__(self, node: Any, outputs: Outputs, has_plane: Callable[[], bool], frames: Lookup | None) -> None:
        self.received = self.refused = 0
        self.also = np.zeros(1, np.int64)
        self.early = threading.Lock()
        self.reason = ""
        self._outputs, self._has_plane, self._frames = outputs, has_plane, frames
        self._clock, self._log = node.get_clock(), node.get_logger()
        self._said: set[str] = set()
        self._lock = threading.Lock()
        overriding = QoSOverridingOptions((QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY))
        self._commands = _Subscription(node, "command_pose", COMMAND_QOS[outputs.options.mode], overriding)
        self._plane = _Subscription(node, "plane_pose", PLANE_QOS)
        waiter = Waiter(node, self._commands.entity)
        self.wait, self.wake = waiter.wait, waiter.wake

    @property
    def subscriptions(self) -> tuple[Any, ...]:
        """What no executor is to wait for."""
        return (self._commands.entity, self._plane.entity)

    @property
    def topics(self) -> tuple[str, str]:
        """Their names: commands, poses of the plane."""
        return (self._commands.name, self._plane.name)

    def recorded_topics(self) -> list[RecordedTopic]:
        """Topics that are recorded as they come."""
        kind = "geometry_msgs/msg/PoseStamped"
        return [
            RecordedTopic(self._commands.name, kind, COMMAND_QOS[self._outputs.options.mode]),
            RecordedTopic(self._plane.name, kind, PLANE_QOS),
        ]

    def counts(self) -> tuple[int, int, str]:
        """`received`, `refused` and `reason` of one moment."""
        with self._lock:
            return self.received + int(self.also[0]), self.refused, self.reason

    def commands(self, now: int | None = None) -> list[Command]:
        """The good ones that came since the last look, in their order; others are counted, the first is logged.

        now: steady time of this look [ns], by which all that is taken came, and after which all else comes.
        """
        with self._lock:
            taken = self._take(self._commands, now)
            if not taken:
                return []
            self.received += len(taken)
            commands = [self._command(data, received) for data, received in taken]
            return [command for command in commands if command is not None]

    def judge(self, data: bytes, received: int) -> Command | None:
        """The command in a message that was taken and counted elsewhere; None where it is of no use. It is recorded."""
        with self._lock:
            return self._command(self._kept(self._commands, data, received), received)

    def judge_plane(self, data: bytes, received: int) -> Pose | None:
        """The same of a pose of the plane."""
        with self._lock:
            accepted = self._accepted(self._kept(self._plane, data, received), "plane_pose")
            return None if accepted is None else accepted[0]

    def _command(self, data: bytes, received: int) -> Command | None:
        accepted = self._accepted(data, "command")
        if accepted is None:
            return None
        pose, stamp = accepted
        transport = 1e-9 * (self._clock.now().nanoseconds - stamp - (time.monotonic_ns() - received))
        return Command(pose, received, transport if 0.0 <= transport <= MOST_TRANSPORT else 0.0, stamp)

    def plane(self, now: int | None = None) -> Pose | None:
        """The newest good pose of the plane that came since the last look; `now` as for commands."""
        with self._lock:
            good = [self._accepted(data, "plane_pose") for data, _ in self._take(self._plane, now)]
            return next((accepted[0] for accepted in reversed(good) if accepted is not None), None)

    def _take(self, subscription: _Subscription, now: int | None) -> list[tuple[bytes, int]]:
        """What came on it, recorded if there is a recording."""
        return [(self._kept(subscription, data, received), received) for data, received in subscription.take(now)]

    def _kept(self, subscription: _Subscription, data: bytes, received: int) -> bytes:
        """A message as it is followed, in the world frame if it can be; recorded if there is a recording."""
        if self._frames is not None:
            data = self._frames.in_world(data)
        recorder = self._outputs.recorder
        if recorder is not None:
            recorder.put(subscription.name, data, received)
        return data

    def _accepted(self, data: bytes, what: str) -> tuple[Pose, int] | None:
        """Pose and stamp [ns] of a message; None where it is of no use: that is counted, and the first is logged."""
        try:
            message = read_pose(data)
            pose = check_pose(message, self._outputs.options.world_frame)
            if isinstance(pose, str) and self._frames is not None:
                pose = self._frames.why(message) or pose
            if what == "plane_pose" and not self._has_plane():
                pose = "the scene has no plane to move"
            if not isinstance(pose, str):
                return pose, message.stamp
        except ValueError as error:
            pose = str(error)
        if what not in self._said:
            self._said.add(what)
            self._log.warning(f"{what} refused: {pose}; refusals are counted in /diagnostics")
        self.refused += 1
        self.reason = f"{what}: {pose}"
        return None


class _Subscription:
    """One to PoseStamped whose messages lie until they are taken, at most as many as its depth.

    name : of the topic, resolved
    """

    def __init__(self, node: Any, topic: str, qos: Qos, overriding: Any = None) -> None:
        self.entity = node.create_subscription(
            PoseStamped, topic, lambda _: None, ros_qos(qos), raw=True, qos_overriding_options=overriding
        )
        self.name = str(self.entity.topic_name)
        self._looked = time.monotonic_ns()

    def take(self, now: int | None = None) -> list[tuple[bytes, int]]:
        """What came since the last call: CDR bytes, and the steady time of receipt [ns].

        The middleware tells the time of receipt by the wall clock. Whatever that does, and however long it takes to
        look at two clocks, a message came after the last look at all that there was, not before the message before it,
        and by the present look: so a replay knows what each step had heard, and in which order.
        """
        out: list[tuple[bytes, int]] = []
        received = self._looked + 1
        while (taken := take(self.entity)) is not None:
            present = time.monotonic_ns()
            received = max(present - max(time.time_ns() - taken[1], 0), received)
            out.append((taken[0], received if now is None else min(received, now)))
        self._looked = time.monotonic_ns() if now is None else now
        return out

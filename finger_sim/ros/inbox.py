"""What comes in on command_pose, or from a device, and on plane_pose, taken by the loop when it is about to step.

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

from ..bags import cdr
from ..bags.poses import check_pose, read_pose
from ..bags.reader import Qos
from ..errors import SceneError
from ..scene import Pose
from .accounts import MOST_TRANSPORT
from .device import COMMANDS
from .device_bytes import CLUTCH, PASSED_OVER, POSITION
from .device_in import DeviceIn
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
    """The subscriptions of the loop: commands, poses of the plane, and what else a device sends.

    device   : makes commands of what its driver sends
    wait     : for a command, or for `wake`; see `Waiter`
    received : commands that came here, good or not
    also     : (1,) those that compiled code took beside them
    early    : held by who takes what comes before the loop is ready, until it is where the loop finds it
    refused  : commands and plane poses of no use
    reason   : why the last of them was refused

    frames : transforms poses of other frames; None: they are refused
    What is transformed is recorded as it is followed, in the world frame: a replay needs no transforms.
    """

    def __init__(
        self, node: Any, outputs: Outputs, has_plane: Callable[[], bool], device: DeviceIn, frames: Lookup | None
    ) -> None:
        self.device = device
        self.received = self.refused = 0
        self.also = np.zeros(1, np.int64)
        self.early = threading.Lock()
        self.reason = ""
        self._outputs, self._has_plane, self._frames = outputs, has_plane, frames
        self._clock, self._log = node.get_clock(), node.get_logger()
        self._said: set[str] = set()
        self._lock = threading.Lock()
        overriding = QoSOverridingOptions((QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY))
        qos, poses = COMMAND_QOS[outputs.options.mode], device.sources[0]
        self._commands = _Subscription(node, poses.topic, poses.kind, qos, overriding)
        self._plane = _Subscription(node, "plane_pose", PoseStamped, PLANE_QOS)
        self._beside = [_Subscription(node, each.topic, each.kind, qos) for each in device.sources[1:]]
        self._recorded = {self._plane: self._plane.name}
        self._recorded[self._commands] = node.resolve_topic_name(COMMANDS) if device.active else self._commands.name
        self._clutch = device.recorded_topics(node)
        own = outputs.topics
        for source, heard in zip(device.sources, (self._commands, *self._beside), strict=True):
            if heard.name in own:
                raise SceneError(source.key, source.topic, "a topic on which the node itself does not send")
        waiter = Waiter(node, self._commands.entity)
        self.wait, self.wake = waiter.wait, waiter.wake

    @property
    def subscriptions(self) -> tuple[Any, ...]:
        """What no executor is to wait for."""
        return tuple(each.entity for each in (self._commands, self._plane, *self._beside))

    @property
    def topics(self) -> list[str]:
        """Names under which they are recorded: commands, poses of the plane, the clutch if there is one."""
        return [self._recorded[self._commands], self._recorded[self._plane], *(topic.name for topic in self._clutch)]

    def recorded_topics(self) -> list[RecordedTopic]:
        """Topics that are recorded: as they come, or as they are made of what a device sends."""
        qualities = (COMMAND_QOS[self._outputs.options.mode], PLANE_QOS)
        poses = [RecordedTopic(name, cdr.POSE_STAMPED, qos) for name, qos in zip(self.topics, qualities, strict=False)]
        return poses + self._clutch

    def standing(self) -> list[tuple[str, bytes]]:
        """What a recording begins with: whether the clutch is open."""
        return [(topic.name, self.device.button) for topic in self._clutch]

    def counts(self) -> tuple[int, int, str]:
        """`received`, `refused` and `reason` of one moment."""
        with self._lock:
            return self.received + int(self.also[0]), self.refused, self.reason

    def commands(self, now: int | None = None) -> list[Command]:
        """The good ones that came since the last look, in their order; others are counted, the first is logged.

        now: steady time of this look [ns], by which all that is taken came, and after which all else comes.
        """
        with self._lock:
            for which, beside in enumerate(self._beside, start=2):
                for data, received in beside.take(now):
                    self._arrived(which, data, received)
            taken = self._take(0, self._commands, now)
            if not taken:
                return []
            commands = [self._command(data, received) for data, received in taken]
            return [command for command in commands if command is not None]

    def arrived(self, which: int, data: bytes, received: int) -> bytes | None:
        """A message that was taken elsewhere, but not looked at, as a PoseStamped; None where there is no pose."""
        with self._lock:
            return self._arrived(which, data, received)

    def explain(self, which: int) -> bool:
        """Whether compiled code could not use a message of a device, which then is counted."""
        with self._lock:
            why, self.device.record.why[0] = int(self.device.record.why[0]), 0
            if why != 0:
                self._refuse("command", self.device.words(self._what(which), why))
            return why != 0

    def judge(self, data: bytes, received: int) -> Command | None:
        """The command in a message that was taken and counted elsewhere; None where it is of no use. It is recorded."""
        with self._lock:
            return self._command(self._kept(0, data, received), received)

    def judge_plane(self, data: bytes, received: int) -> Pose | None:
        """The same of a pose of the plane."""
        with self._lock:
            accepted = self._accepted(self._kept(1, data, received), "plane_pose")
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
            good = [self._accepted(data, "plane_pose") for data, _ in self._take(1, self._plane, now)]
            return next((accepted[0] for accepted in reversed(good) if accepted is not None), None)

    def _take(self, which: int, subscription: _Subscription, now: int | None) -> list[tuple[bytes, int]]:
        """The poses that came on it, as they are followed, recorded if there is a recording."""
        arrived = [(self._arrived(which, data, received), received) for data, received in subscription.take(now)]
        return [(self._kept(which, data, received), received) for data, received in arrived if data is not None]

    def _kept(self, which: int, data: bytes, received: int) -> bytes:
        """A pose as it is followed, in the world frame if it can be; recorded if there is a recording."""
        if self._frames is not None:
            data = self._frames.in_world(data)
        self._record(which, data, received)
        return data

    def _record(self, which: int, data: bytes, received: int) -> None:
        recorder = self._outputs.recorder
        if recorder is not None:
            recorder.put(self.topics[which], data, received)

    def _what(self, which: int) -> int:
        """What comes in a subscription of the device."""
        return POSITION if which == 0 else int(self.device.record.roles[which - 2])

    def _arrived(self, which: int, data: bytes, received: int) -> bytes | None:
        """A pose as PoseStamped; None where there is none: a mistake is counted. A clutch is recorded."""
        if which < 2 and not (which == 0 and self.device.active):
            self.received += which == 0
            return data
        what, timeout = self._what(which), self._outputs.options.command_timeout
        told = self.device.take_in(what, data, received, timeout)
        if told == PASSED_OVER:
            return None
        if which == 0:
            self.received += 1
        if told < 0:
            self._refuse("command", self.device.words(what, told))
            return None
        if told != 0 and what == CLUTCH:
            self._record(2, self.device.button, received)
        return self.device.command if told != 0 and what == POSITION else None

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
        self._refuse(what, pose)
        return None

    def _refuse(self, what: str, why: str) -> None:
        """Counts it; the first of a kind is logged."""
        if what not in self._said:
            self._said.add(what)
            self._log.warning(f"{what} refused: {why}; refusals are counted in /diagnostics")
        self.refused += 1
        self.reason = f"{what}: {why}"


class _Subscription:
    """One whose messages lie until they are taken, at most as many as its depth.

    name : of the topic, resolved
    """

    def __init__(self, node: Any, topic: str, kind: Any, qos: Qos, overriding: Any = None) -> None:
        self.entity = node.create_subscription(
            kind, topic, lambda _: None, ros_qos(qos), raw=True, qos_overriding_options=overriding
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

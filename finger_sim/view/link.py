"""A ROS node of this process's own that looks at one finger node: what it says, its services, its parameters.

Messages that come a thousand times a second wake nobody: they lie in their subscriptions until a picture is made. An
executor in a thread of its own serves the rest, which comes once a second.
"""

from __future__ import annotations

import asyncio
import os
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_srvs.srv import SetBool, Trigger

from ..bags.layout import status_name
from ..errors import FingerSimError
from ..ros.messages import pose_template
from ..ros.process import TRANSPORTS, logged
from ..ros.rclpy_private import failures, take_all
from ..scene import Pose
from .values import Described
from .words import Report

ANSWER_TIMEOUT = 5.0
"""How long a service may take [s]: closing a recording takes longest."""
SPIN_PERIOD = 0.5
"""Time within which its thread notices that it is to end [s]."""
_NUMBERS = struct.Struct("<7d")


class Heard(NamedTuple):
    """Who is told what the node says; all are called in the loop of asyncio."""

    report: Callable[[Report], object]
    topology: Callable[[Any], object]
    """A shape_msgs/Mesh: a node has begun."""
    values: Callable[[Mapping[str, Any]], object]
    """Parameters that have changed, as ROS has them."""


class Link:
    """Looks at the node of that full name, in `domain` or the environment's."""

    def __init__(self, name: str, domain: int | None, heard: Heard) -> None:
        """Raises FingerSimError where ROS does not let this process in."""
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", TRANSPORTS)
        self.target, self._heard = name, heard
        self._status = status_name(name)
        self._loop = asyncio.get_running_loop()
        self._context = rclpy.Context()
        quiet = {"domain_id": domain, "signal_handler_options": SignalHandlerOptions.NO}
        refusals: tuple[type[Exception], ...] = (RuntimeError, *failures())
        try:
            rclpy.init(args=logged([]), context=self._context, **quiet)
        except refusals as error:
            text = " ".join(str(error).split())
            raise FingerSimError(f"ROS_DOMAIN_ID {os.environ.get('ROS_DOMAIN_ID', '')}: ROS refuses: {text}") from None
        self.domain = int(self._context.get_domain_id())
        namespace = name.rpartition("/")[0] or "/"
        self._node = _Quiet(f"finger_sim_view_{os.getpid()}", namespace, self._context)
        self._clients: dict[str, Any] = {}
        self._subscriptions: dict[str, Any] = {}
        self._listens = False
        self._publisher = self._node.create_publisher(PoseStamped, "command_pose", 10)
        self._template = pose_template("world")
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        lasting = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, newest)
        self._node.create_subscription(Mesh, "mesh_topology", self._on_topology, lasting, raw=True)
        self._node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, 1000)
        self._hear("plane_pose", PoseStamped, True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leaves ROS."""
        self._stop.set()
        self._thread.join(2.0)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def listen(self, on: bool) -> None:
        """Begins or ends to hear what is sent only where somebody hears it."""
        self._listens = on
        self._hear("mesh_points", PointCloud2, on)
        self._hear("device_wrench_throttle", WrenchStamped, on)
        self.look_for_others()

    def look_for_others(self) -> None:
        """Hears commands where others send some, too: each of its own would come back to it."""
        self._hear("command_pose", PoseStamped, self._listens and self.senders("command_pose") > 1)

    def taken(self, topic: str) -> list[bytes]:
        """The messages that lie in the subscription of a topic, oldest first."""
        subscription = self._subscriptions.get(topic)
        return [] if subscription is None else take_all(subscription)

    def use_frame(self, world: str) -> None:
        """Poses are sent in this frame."""
        self._template = pose_template(world)

    def send(self, pose: Pose) -> None:
        """Sends a command."""
        self._publisher.publish(self._template.fill(time.time_ns(), _NUMBERS.pack(*pose.position, *pose.orientation)))

    def senders(self, topic: str) -> int:
        """How many send on a topic; of command_pose this is one."""
        return int(self._node.count_publishers(topic))

    async def parameters(self) -> dict[str, Described]:
        """All parameters of the node. Raises FingerSimError when it does not answer."""
        listed = await self._call(ListParameters, "list_parameters", ListParameters.Request())
        names = list(listed.result.names)
        values = await self._call(GetParameters, "get_parameters", GetParameters.Request(names=names))
        told = await self._call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names))
        out = {}
        for name, value, each in zip(names, values.values, told.descriptors, strict=False):
            spans = [*each.floating_point_range, *each.integer_range]
            span = (float(spans[0].from_value), float(spans[0].to_value)) if spans else ()
            out[name] = Described(parameter_value_to_python(value), each.description, not each.read_only, *span)
        return out

    async def set(self, name: str, value: Any) -> None:
        """Sets a parameter. Raises FingerSimError with the node's reason when it does not take the value."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        result = (await self._call(SetParameters, "set_parameters", request)).results[0]
        if not result.successful:
            raise FingerSimError(result.reason)

    async def reset(self) -> str:
        """Back to rest; what the node answers. Raises FingerSimError."""
        return _granted(await self._call(Trigger, "reset", Trigger.Request()))

    async def record(self, on: bool) -> str:
        """Begins or ends a recording; what the node answers. Raises FingerSimError."""
        return _granted(await self._call(SetBool, "record", SetBool.Request(data=on), timeout=30.0))

    async def _call(self, kind: Any, name: str, request: Any, timeout: float = ANSWER_TIMEOUT) -> Any:
        """The answer of a service of the node."""
        service = f"{self.target}/{name}"
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, service)
        client, end = self._clients[name], time.monotonic() + timeout
        while not client.service_is_ready():
            if time.monotonic() > end:
                raise FingerSimError(f"{self.target} does not offer {service}")
            await asyncio.sleep(0.05)
        answer: asyncio.Future[Any] = self._loop.create_future()
        asked = client.call_async(request)
        asked.add_done_callback(lambda done: self._loop.call_soon_threadsafe(_settle, answer, done))
        try:
            return await asyncio.wait_for(answer, timeout)
        except TimeoutError:
            client.remove_pending_request(asked)
            raise FingerSimError(f"{service} did not answer within {timeout:g} s") from None

    def _hear(self, topic: str, kind: Any, on: bool) -> None:
        """Begins or ends to hear a topic, whose newest message lies there until it is taken."""
        if on and topic not in self._subscriptions:
            quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            # An executor that waits for events of a subscription wakes for each of its messages, too.
            silent = SubscriptionEventCallbacks(use_default_callbacks=False)
            subscription = self._node.create_subscription(
                kind, topic, lambda _: None, quality, raw=True, event_callbacks=silent
            )
            self._node.taken.add(subscription)
            self._subscriptions[topic] = subscription
        elif not on and topic in self._subscriptions:
            subscription = self._subscriptions.pop(topic)
            self._node.taken.discard(subscription)
            self._node.destroy_subscription(subscription)

    def _spin(self) -> None:
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        while not self._stop.is_set() and self._context.ok():
            try:
                executor.spin_once(timeout_sec=SPIN_PERIOD)
            except Exception as error:  # what rclpy cannot take ends nothing
                self._node.get_logger().error(f"a message cannot be taken: {error}", throttle_duration_sec=10.0)
        executor.shutdown(timeout_sec=0.0)

    def _on_report(self, array: Any) -> None:
        for status in array.status:
            if status.name == self._status:
                values = {item.key: item.value for item in status.values}
                self._tell(self._heard.report, Report(values, status.message, status.level[0]))

    def _on_topology(self, data: bytes) -> None:
        self._tell(self._heard.topology, deserialize_message(data, Mesh))

    def _on_event(self, event: Any) -> None:
        if event.node == self.target:
            changed = [*event.new_parameters, *event.changed_parameters]
            self._tell(self._heard.values, {each.name: parameter_value_to_python(each.value) for each in changed})

    def _tell(self, who: Callable[[Any], object], what: Any) -> None:
        if not self._stop.is_set():
            self._loop.call_soon_threadsafe(who, what)


class _Quiet(Node):  # type: ignore[misc]
    """A node without parameters and log messages of its own.

    taken : subscriptions whose messages are taken, for which no executor waits
    """

    def __init__(self, name: str, namespace: str, context: Any) -> None:
        self.taken: set[Any] = set()
        super().__init__(
            name, namespace=namespace, context=context, enable_rosout=False, use_global_arguments=False,
            start_parameter_services=False,
        )  # fmt: skip

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Those that an executor serves."""
        for subscription in super().subscriptions:
            if subscription not in self.taken:
                yield subscription


def _settle(answer: asyncio.Future[Any], done: Any) -> None:
    if not answer.done():
        error = done.exception()
        if error is not None:
            answer.set_exception(FingerSimError(" ".join(str(error).split())))
        else:
            answer.set_result(done.result())


def _granted(response: Any) -> str:
    if not response.success:
        raise FingerSimError(response.message)
    return str(response.message)

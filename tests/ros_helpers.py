"""The node in a process of its own, and a client to talk to it over ROS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install 'finger_sim[ros]'")

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from domains import DOMAINS
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

REPOSITORY = Path(__file__).resolve().parent.parent
TIMEOUT = 200.0
"""Longest wait for any condition [s], the first compilation of the kernels among them."""

BLOCK = """
mesh: {beam: {size: [0.02, 0.01, 0.01], cells: [2, 1, 1]}}
driven: {box: [[-1, -1, 0.0099], [1, 1, 1]]}
material: {young: 5.0e4, poisson: 0.4}
limits: {projection: hyperbolic, stretch: [1.05, 1.25, null], compress: [0.95, 0.75, 0.98]}
plane: {point: [0, 0, 0], friction: 0.5}
initial_pose: {position: [0, 0, 0.01]}
dt: 0.005
"""
"""A block of 10 tetrahedra whose top is driven; at position z its bottom is z above the plane."""
BLOCK_DT = 0.005
"""Its step [s]."""


def environment(domain: int) -> dict[str, str]:
    """Of a process that shares its ROS domain with nobody else and checks what is put into messages."""
    paths = [str(REPOSITORY), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"ROS_DOMAIN_ID": str(domain), "PYTHONPATH": os.pathsep.join(filter(None, paths))}


class NodeProcess:
    """The node, started with ROS arguments; `program` replaces `-m finger_sim.ros.node`.

    In `domain`, or one of its own; `changes` are made to its environment.
    """

    def __init__(
        self,
        log: Path,
        *arguments: str,
        program: Sequence[str] = ("-m", "finger_sim.ros.node"),
        domain: int | None = None,
        changes: Mapping[str, str] | None = None,
    ) -> None:
        self.domain = next(DOMAINS) if domain is None else domain
        self.log = log
        # Several nodes of tests share few processors: none may take them from the test that listens to it.
        ros_arguments = ("--ros-args", "-p", "realtime_priority:=0", *arguments) if arguments else ()
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, *program, *ros_arguments],
                env=environment(self.domain) | dict(changes or {}),
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    @property
    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def wait_for(self, text: str) -> None:
        """Until the node's log holds `text`."""
        end = time.monotonic() + TIMEOUT
        while text not in self.output:
            assert self.process.poll() is None, f"the node ended:\n{self.output}"
            assert time.monotonic() < end, f"no {text!r} in the log:\n{self.output}"
            time.sleep(0.02)

    def end(self, number: int = signal.SIGINT) -> int:
        """Sends a signal and gives the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.code()

    def code(self) -> int:
        """The exit code, once the process has ended; where it hangs if it does not."""
        try:
            return self.process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)
            self.process.wait(TIMEOUT)
            pytest.fail(f"the process did not end:\n{self.output}")

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(TIMEOUT)


class Client:
    """A node of the test's own in the domain of a NodeProcess."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("client", context=self.context, enable_rosout=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._subscriptions: list[Any] = []
        self.reports: list[Any] = self.collect(DiagnosticArray, "/diagnostics")
        self._subscriptions.clear()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def until(
        self, condition: Callable[[], Any], repeat: Callable[[], None] | None = None, period: float = 0.02
    ) -> Any:
        """Spins until the condition is true and gives its value; `repeat` is called every `period` [s] meanwhile."""
        end, due = time.monotonic() + TIMEOUT, 0.0
        while not (value := condition()):
            assert time.monotonic() < end, "the condition did not come true"
            if repeat is not None and time.monotonic() >= due:
                due = time.monotonic() + period
                repeat()
            self.executor.spin_once(timeout_sec=min(0.01, 0.5 * period))
        return value

    def collect(self, kind: Any, topic: str, qos: Any = 100) -> list[Any]:
        """A list to which each message of a topic is appended."""
        got: list[Any] = []
        self._subscriptions.append(self.node.create_subscription(kind, topic, got.append, qos))
        return got

    def forget(self) -> None:
        """Ends all that `collect` began since this client was made: a thousand messages a second for nobody."""
        while self._subscriptions:
            self.node.destroy_subscription(self._subscriptions.pop())

    def next(self, messages: list[Any], repeat: Callable[[], None] | None = None) -> Any:
        """The first message that comes from now on."""
        count = len(messages)
        self.until(lambda: len(messages) > count, repeat)
        return messages[count]

    def publish(self, message: Any, topic: str = "command_pose") -> None:
        """Sends a message once the node listens.

        A best-effort message is lost where the node has not yet found this sender: repeat what must arrive.
        """
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(message), topic, 100)
            self.until(lambda: self._publishers[topic].get_subscription_count() > 0)
        self._publishers[topic].publish(message)

    def command(self, z: float, x: float = 0.0) -> None:
        """Commands the position (x, 0, z) [m], level."""
        self.publish(command(z, x))

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """The answer of a service."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
            self.until(self._clients[service].service_is_ready)
        future = self._clients[service].call_async(request)
        self.until(future.done)
        return future.result()

    def set(self, name: str, value: Any) -> SetParametersResult:
        """What the node answers to a new value of a parameter."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, "/finger/set_parameters", request).results[0]

    def get(self, name: str, node: str = "/finger") -> Any:
        """The value of a parameter of a node."""
        answer = self.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name]))
        return rclpy.parameter.parameter_value_to_python(answer.values[0])

    def describe(self, name: str) -> ParameterDescriptor:
        """The descriptor of a parameter of the node."""
        request = DescribeParameters.Request(names=[name])
        return self.call(DescribeParameters, "/finger/describe_parameters", request).descriptors[0]

    def parameter_names(self) -> list[str]:
        """All parameters of the node."""
        return list(self.call(ListParameters, "/finger/list_parameters", ListParameters.Request()).result.names)

    def report(self, repeat: Callable[[], None] | None = None) -> tuple[Any, dict[str, str]]:
        """The next whole second's diagnostics: the status and its values by key."""
        self.next(self.reports, repeat)
        status = self.next(self.reports, repeat).status[0]
        return status, {item.key: item.value for item in status.values}


def forces(bag: Path) -> tuple[Any, Any]:
    """Receipt times (n,) [s] and contact forces (n, 3) [N] of a bag, read with the mcap library."""
    with next(bag.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        rows = [
            (1e-9 * message.log_time, ros.wrench.force.x, ros.wrench.force.y, ros.wrench.force.z)
            for _, _, message, ros in reader.iter_decoded_messages(topics=["/contact_wrench"])
        ]
    table = np.array(rows)
    return table[:, 0], table[:, 1:]


def kept_pace(bag: Path) -> bool:
    """Whether the loop skipped hardly a step: a busy machine's loop does, and is then behind its commands."""
    times, _ = forces(bag)
    return len(times) > 0.97 * (times[-1] - times[0]) / BLOCK_DT


def beyond_replay(bag: Path, again: Path) -> tuple[Any, Any, Any]:
    """Live forces of the block while its replay lasts: times (n,), forces (n, 3), and how far each is from the replay.

    (n,) [N]: 0 within the range of what the replay gives within two steps.
    """
    (time_live, live), (time_again, replayed) = forces(bag), forces(again)
    inside = (time_live > time_again[0] + 0.01) & (time_live < time_again[-1] - 0.01)
    time_live, live = time_live[inside], live[inside]
    first = np.searchsorted(time_again, time_live - 0.01) - 1
    last = np.searchsorted(time_again, time_live + 0.01) + 1
    windows = [replayed[i:j] for i, j in zip(first, last, strict=True)]
    beyond = [np.maximum(w.min(axis=0) - f, f - w.max(axis=0)).clip(0.0) for w, f in zip(windows, live, strict=True)]
    return time_live, live, np.linalg.norm(beyond, axis=1)


def bag_process(parent: int) -> int:
    """The process that writes bags for `parent`: the youngest, as one that was ended may still be finishing its bag."""
    found = {
        int(status[19]): int(process.name)
        for process in Path("/proc").glob("[0-9]*")
        if (status := _read(process / "stat").rpartition(b")")[2].split())
        and int(status[1]) == parent
        and b"finger_sim.bags" in _read(process / "cmdline")
    }
    return found[max(found)]


def _read(path: Path) -> bytes:
    """Content of a file; nothing where it has gone."""
    try:
        return path.read_bytes()
    except OSError:
        return b""


def command(z: float, x: float = 0.0) -> PoseStamped:
    """A command to (x, 0, z) [m], level, in the frame world."""
    message = PoseStamped()
    message.header.frame_id = "world"
    message.pose.position.x, message.pose.position.z = float(x), float(z)
    message.pose.orientation.w = 1.0
    return message


def write_block(folder: Path) -> Path:
    """The scene BLOCK as a file."""
    path = folder / "block.yaml"
    path.write_text(BLOCK)
    return path

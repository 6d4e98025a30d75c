"""finger_node in a process and a ROS domain of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping

DOMAIN = "87"


def environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment, on this machine's ROS traffic only."""
    return {**os.environ, "ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **(changes or {})}


@contextlib.contextmanager
def running_node(
    parameters: Mapping[str, str], changes: Mapping[str, str] | None = None
) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """The node, once it has said that it is ready, and the seconds that took from the start of its process."""
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "finger_sim.ros.node", "--ros-args", *arguments]
    begin = time.perf_counter()
    node = subprocess.Popen(command, env=environment(changes), stderr=subprocess.PIPE, text=True)
    try:
        assert node.stderr is not None
        for line in node.stderr:
            if "ready after" in line:
                break
        else:
            raise SystemExit(f"the node ended with code {node.wait()} before it was ready")
        yield node, time.perf_counter() - begin
    finally:
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=10)

"""finger_node, or another program, in a process and a ROS domain of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence

DOMAIN = os.environ.get("ROS_DOMAIN_ID") or str(1 + os.getpid() % 100)
"""The one that is set, or this process's own."""


def environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment, on this machine's ROS traffic only."""
    return {**os.environ, "ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **(changes or {})}


@contextlib.contextmanager
def running_node(
    parameters: Mapping[str, str], changes: Mapping[str, str] | None = None
) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """The node, once it has said that it is ready, and the seconds that took from the start of its process."""
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    with started(["-m", "finger_sim.ros.node", "--ros-args", *arguments], changes) as found:
        yield found


@contextlib.contextmanager
def started(
    program: Sequence[str], changes: Mapping[str, str] | None = None
) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """A Python program, once it has said on stderr that it is ready, and the seconds that took; ended by SIGINT."""
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, *program], env=environment(changes), stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if "ready after" in line:
                break
        else:
            raise SystemExit(f"the process ended with code {process.wait()} before it was ready")
        yield process, time.perf_counter() - begin
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=10)

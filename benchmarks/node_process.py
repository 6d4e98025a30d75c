"""finger_node, or another program, in a process and a ROS domain of its own, and what it costs."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

DOMAIN = os.environ.get("ROS_DOMAIN_ID") or str(1 + os.getpid() % 100)
"""The one that is set, or this process's own."""
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")  # traffic of this machine only, if nothing is set


def environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment in that domain."""
    return {**os.environ, "ROS_DOMAIN_ID": DOMAIN, **(changes or {})}


@contextlib.contextmanager
def running_node(
    parameters: Mapping[str, str], changes: Mapping[str, str] | None = None, said: str = "ready after"
) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """The node, once it has said so on stderr, and the seconds that took from the start of its process."""
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    with started(["-m", "finger_sim.ros.node", "--ros-args", *arguments], changes, said) as found:
        yield found


@contextlib.contextmanager
def started(
    program: Sequence[str], changes: Mapping[str, str] | None = None, said: str = "ready after"
) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """A Python program, once it has said so on stderr, and the seconds that took; ended by SIGINT."""
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, *program], env=environment(changes), stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if said in line:
                break
        else:
            raise SystemExit(f"the process ended with code {process.wait()} before {said!r}")
        yield process, time.perf_counter() - begin
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=10)


def cpu_seconds(pid: int) -> float:
    """User and system time of a process [s]."""
    words = _stat(pid)
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def bag_process(parent: int) -> int:
    """The process that writes the bags of a node."""
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if (
                int(_stat(process.name)[1]) == parent
                and b"finger_sim.bags.process" in (process / "cmdline").read_bytes()
            ):
                return int(process.name)
    raise SystemExit("the node has no process that writes bags")


def _stat(pid: int | str) -> list[str]:
    """The words of /proc/PID/stat after the name, which may hold anything."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()

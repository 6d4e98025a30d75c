"""This process, as the node speaks of it and sets it up."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

TRANSPORTS = "UDPv4"
"""Of Fast DDS, where the environment names none: through shared memory a publisher, and a step with it, waits for a
listening process that was paused. A round trip takes 0.2 to 0.3 ms longer over UDP (docs/speed.md). Under
ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST rmw takes shared memory all the same."""

SWITCH_INTERVAL = 5e-5
"""How long another thread of this process may keep the interpreter when a step is due [s]."""


def set_up() -> None:
    """Makes this process one in which a loop keeps its time."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", TRANSPORTS)


def logged(arguments: Sequence[str] | None) -> list[str]:
    """Arguments for rclpy.init; None: this process's own.

    Where ROS could not write its log files, which would end the process, it is told to write none; stderr says so.
    """
    given = list(sys.argv if arguments is None else arguments)
    home = Path(os.environ.get("ROS_HOME") or Path(os.environ.get("HOME", "/")) / ".ros")
    folder = Path(os.environ.get("ROS_LOG_DIR") or home / "log").expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        print(f"warning: ROS writes no log file: {folder}: {error.strerror}; see ROS_LOG_DIR", file=sys.stderr)
        return [*given, "--ros-args", "--disable-external-lib-logs"]
    return given


def process_age() -> float:
    """Time since this process was started, its imports included [s]."""
    ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


def flush() -> None:
    """Hands what was printed to the system."""
    sys.stdout.flush()
    sys.stderr.flush()

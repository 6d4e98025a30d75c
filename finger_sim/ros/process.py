"""This process, as the node speaks of it."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path


def process_age() -> float:
    """Time since this process was started, its imports included [s]."""
    ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


def flush() -> None:
    """Hands what was printed to the system."""
    sys.stdout.flush()
    sys.stderr.flush()

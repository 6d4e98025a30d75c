"""ROS domains of the tests' own: no two tests that run at the same time share one."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from zlib import crc32

_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_first = crc32(os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid())).encode())

DOMAINS: Iterator[int] = itertools.cycle([17 * (_first + i) % 101 + 1 for i in range(_worker, 101, _workers)])
"""Whoever takes the next has it for itself: 1 to 101 in an order of this run, shared out between its processes."""

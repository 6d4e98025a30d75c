"""ROS domains of the tests' own: no two tests that run at the same time share one, be they of another run."""

from __future__ import annotations

import itertools
import os
import socket
from collections import deque
from collections.abc import Iterator
from zlib import crc32

from finger_sim.ros.child import claim_domain

_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_first = crc32(os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid())).encode())
_HELD = 12
"""So many of those taken last are kept from others: a file of tests uses no more at once."""


def _domains() -> Iterator[int]:
    """1 to 101 in an order of this run, shared out between its processes, without those that somebody else has."""
    held: deque[socket.socket] = deque()
    failed = 0
    for i in itertools.count(_worker, _workers):
        domain = 17 * (_first + i) % 101 + 1
        claim = claim_domain(domain)
        if claim is None:
            failed += 1
            if failed > 101 and held:
                held.popleft().close()
            continue
        failed = 0
        held.append(claim)
        if len(held) > _HELD:
            held.popleft().close()
        yield domain


DOMAINS: Iterator[int] = _domains()
"""Whoever takes the next has it for itself."""

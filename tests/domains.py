"""ROS domains of the tests' own: no two tests that run at the same time share one, be they of another run."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import IO
from zlib import crc32

_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_first = crc32(os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid())).encode())
_HELD = 12
"""So many of those taken last are kept from others: a file of tests uses no more at once."""


def _domains() -> Iterator[int]:
    """1 to 101 in an order of this run, shared out between its processes, without those that another run has."""
    folder = Path(tempfile.gettempdir()) / f"finger_sim_domains_{os.getuid()}"
    folder.mkdir(exist_ok=True)
    held: deque[IO[bytes]] = deque()
    failed = 0
    for i in itertools.count(_worker, _workers):
        domain = 17 * (_first + i) % 101 + 1
        file = (folder / str(domain)).open("wb")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            failed += 1
            if failed > 101 and held:
                held.popleft().close()
            continue
        failed = 0
        held.append(file)
        if len(held) > _HELD:
            held.popleft().close()
        yield domain


DOMAINS: Iterator[int] = _domains()
"""Whoever takes the next has it for itself."""

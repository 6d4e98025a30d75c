"""The page beside the demo: a process of its own that only looks, so that the demo's own threads keep their time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..console import say
from ..ros.child import end_node

END_TIMEOUT = 5.0
"""How long it may take to end [s]."""


@contextmanager
def page_beside(domain: int, log: Path) -> Iterator[None]:
    """A page that shows the node in a ROS domain, for the time of a `with` block; what it says goes to the file `log`.

    Where it cannot be shown, that is said, and nothing else changes.
    """
    command = [sys.executable, "-m", "finger_sim", "view", "--join", "--watch", "--port", "0"]
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=output,
            start_new_session=True,
        )
    assert process.stdout is not None
    try:
        url = process.stdout.readline().decode(errors="replace").strip()
        say(f"the page: {url}" if url else f"finger_sim: warning: there is no page; see {log}")
        yield
    finally:
        end_node(process, END_TIMEOUT)
        process.stdout.close()

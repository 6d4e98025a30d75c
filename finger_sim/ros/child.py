"""The node as a child process in a ROS domain that it shares with nobody else."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import FingerSimError

END_TIMEOUT = 15.0
"""Longest time that the node may take to close its bag and end [s]."""
_WITH_ITS_PARENT = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGINT)
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
"""
"""Starts Python with the arguments after the first; it gets SIGINT when the process with that id ends, however it ends:
a node that nobody knows of would make steps for ever. (1 is PR_SET_PDEATHSIG of prctl(2).)"""


def start_node(parameters: Mapping[str, Any], domain: int, log: Path) -> subprocess.Popen[bytes]:
    """Starts the node with these parameters; what it says goes to the file `log`.

    It ends with the thread that calls this.
    """
    assigned = [f"{name}:={json.dumps(value)}" for name, value in parameters.items()]
    arguments = [text for assignment in assigned for text in ("-p", assignment)]
    node = ["-m", "finger_sim.ros.node", "--ros-args", *arguments]
    command = [sys.executable, "-c", _WITH_ITS_PARENT, str(os.getpid()), *node]
    with log.open("wb") as output:
        return subprocess.Popen(
            command,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def end_node(process: subprocess.Popen[bytes], patience: float = END_TIMEOUT) -> None:
    """Ends the node as Ctrl-C does, after `patience` [s] by force; nothing happens where it has ended."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def node_process(parameters: Mapping[str, Any], domain: int, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The node for the time of a `with` block; see `start_node` and `end_node`."""
    process = start_node(parameters, domain, log)
    try:
        yield process
    finally:
        end_node(process)


def free_domain() -> int:
    """A ROS domain, 1 to 101, in which no process of this machine takes part. Raises FingerSimError.

    Until this process ends no other call takes it, here or in another process.
    """
    first = os.getpid() % 101
    for domain in ((first + i) % 101 + 1 for i in range(101)):
        claim = claim_domain(domain)
        if claim is None:
            continue
        listening = _bound(domain, _FIRST)
        if listening is not None:
            listening.close()
            _claims.append(claim)
            return domain
        claim.close()
    raise FingerSimError("all ROS domains of this machine are in use")


def claim_domain(domain: int) -> socket.socket | None:
    """Keeps a domain from all others who claim it, until what is returned is closed; None: somebody has it."""
    return _bound(domain, _CLAIM)


_FIRST, _CLAIM = 10, 9
"""Ports of a domain: the one where its first participant listens, and one of 2 to 9, of which DDS makes no use."""
_claims: list[socket.socket] = []
"""Held until the process ends."""


def _bound(domain: int, port: int) -> socket.socket | None:
    """A socket at a port of a domain (RTPS 2.3, 9.6.1.1), which others cannot use then; None: it is in use."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind(("", 7400 + 250 * domain + port))
    except OSError:
        made.close()
        return None
    return made


def last_line(log: Path) -> str:
    """The last thing that the node said."""
    return last_of(log.read_text(errors="replace"))


def last_of(text: str) -> str:
    """Its last line that is not empty."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"

"""This end of the pipe to a process that writes bags (`finger_sim.bag_process`)."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import Any

from ..bag_process import HEAD
from ..errors import BagError

COMMAND = (sys.executable, "-m", "finger_sim.bag_process")
PIPE = 1 << 20
"""Size to ask for [byte]; where the system refuses, it keeps its own."""
PORTION = 1 << 18
"""Most that is handed over at once [byte]: whoever does it must not be kept from its own work."""
END_TIMEOUT = 0.2
"""How long the end of an idle process is waited for [s]."""


class BagPipe:
    """A process that writes bags, and what waits for it; used by one thread at a time, which it never blocks.

    Raises BagError when the process cannot be started.
    """

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        try:
            # In a process group of its own it does not get the Ctrl-C that is meant for this process.
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, process_group=0
            )
        except OSError as error:
            raise BagError(f"the process that writes bags cannot be started: {error}") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._frames, self._answers = self._process.stdin, self._process.stdout
        self._waiting, self._heard = bytearray(), bytearray()
        for pipe in (self._frames, self._answers):
            os.set_blocking(pipe.fileno(), False)
        with contextlib.suppress(OSError):
            fcntl.fcntl(self._frames, fcntl.F_SETPIPE_SZ, PIPE)

    @property
    def usable(self) -> bool:
        """Whether the process runs and has not been let go."""
        return not self._frames.closed and self._process.poll() is None

    def add(self, number: int, data: bytes, sequence: int = 0, log_time: int = 0) -> None:
        """Has a frame wait for the next exchange."""
        self._waiting += HEAD.pack(len(data), number, sequence, log_time)
        self._waiting += data

    def exchange(self) -> list[dict[str, Any]]:
        """Hands over a portion of what waits, if the pipe takes it; gives the answers that have come.

        Raises BrokenPipeError when the process is gone, once its last answer has been given.
        """
        heard = None
        with contextlib.suppress(BlockingIOError):
            heard = os.read(self._answers.fileno(), 1 << 16)
            self._heard += heard
        *lines, self._heard = self._heard.split(b"\n")
        answers = [json.loads(line) for line in lines]
        if heard == b"":
            raise BrokenPipeError
        if self._waiting:
            try:
                with memoryview(self._waiting) as all, all[:PORTION] as portion:
                    taken = os.write(self._frames.fileno(), portion)
                del self._waiting[:taken]
            except BlockingIOError:
                pass
            except BrokenPipeError:
                if not answers:
                    raise
        return answers

    def wait(self, timeout: float) -> None:
        """Until there is something to exchange, or `timeout` [s] is over."""
        ready = select.poll()
        ready.register(self._answers, select.POLLIN)
        if self._waiting:
            ready.register(self._frames, select.POLLOUT)
        ready.poll(1e3 * max(timeout, 0.0))

    def ending(self) -> str:
        """How the process ended, as far as the system has said."""
        code = self._process.poll()
        if code is None:
            return ""
        return f" by {signal.Signals(-code).name}" if code < 0 else f" with code {code}"

    def let_go(self) -> None:
        """Leaves the process to itself: it finishes its bag with what it was given, and ends."""
        self._frames.close()
        self._answers.close()

    def end(self) -> None:
        """Lets go and waits for the end a little: for a process that has no bag."""
        self.let_go()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_TIMEOUT)


class Standby:
    """Keeps a process that writes bags ready, so that a recording can begin at once; for any thread."""

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self._command = command
        self._lock = threading.Lock()
        self._pipe: BagPipe | None = None

    def pipe(self) -> BagPipe:
        """The process, a new one where the last is of no use any more. Raises BagError."""
        with self._lock:
            if self._pipe is None or not self._pipe.usable:
                self._pipe = BagPipe(self._command)
            return self._pipe

    def prepare(self) -> None:
        """Starts the process if that is needed and possible."""
        with contextlib.suppress(BagError):
            self.pipe()

    def end(self) -> None:
        """Ends it."""
        with self._lock:
            if self._pipe is not None:
                self._pipe.end()

"""This end of a process that writes bags (`finger_sim.bags.process`)."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import IO, Any

from ..bags.process import Ending, Order
from ..bags.ring import Memory, make_file
from ..errors import BagError

COMMAND = (sys.executable, "-m", "finger_sim.bags.process")
END_TIMEOUT = 0.2
"""How long the end of an idle process is waited for [s]."""


class BagPipe:
    """A process that writes bags; used by one thread at a time, but for `memory`.

    memory : for the messages of the bag that is open

    Raises BagError when the process cannot be started.
    """

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        try:
            file = make_file()
            try:
                self.memory = Memory(file)
                # In a process group of its own it does not get the Ctrl-C that is meant for this process.
                self._process = subprocess.Popen(
                    [*command, str(file)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    pass_fds=[file],
                    process_group=0,
                    bufsize=0,
                )
            finally:
                os.close(file)
        except OSError as error:
            raise BagError(f"the process that writes bags cannot be started: {error}") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._orders, self._answers = self._process.stdin, self._process.stdout
        self._heard = b""
        os.set_blocking(self._orders.fileno(), False)

    @property
    def usable(self) -> bool:
        """Whether the process runs and has not been let go."""
        return not self._orders.closed and self._process.poll() is None

    def order(self, order: Order | Ending, timeout: float) -> None:
        """Has it begin a bag, or finish it. No answer will come where it does not listen for so long [s]."""
        rest = json.dumps(order).encode() + b"\n"
        with contextlib.suppress(BrokenPipeError):  # the answers will say so
            while rest and _ready(self._orders, select.POLLOUT, timeout):
                rest = rest[os.write(self._orders.fileno(), rest) :]

    def answers(self, timeout: float = 0.0) -> list[dict[str, Any]]:
        """The answers that have come, or the first that comes within `timeout` [s].

        Raises BrokenPipeError when the process is gone and its last answer has been given.
        """
        if not _ready(self._answers, select.POLLIN, timeout):
            return []
        heard = os.read(self._answers.fileno(), 1 << 16)
        if not heard:
            raise BrokenPipeError
        *lines, self._heard = (self._heard + heard).split(b"\n")
        return [json.loads(line) for line in lines]

    def ending(self) -> str:
        """How the process ended, as far as the system has said."""
        code = self._process.poll()
        if code is None:
            return ""
        return f" by {signal.Signals(-code).name}" if code < 0 else f" with code {code}"

    def let_go(self) -> None:
        """Leaves the process to itself: it finishes its bag with what it was given, and ends."""
        self._orders.close()
        self._answers.close()

    def end(self) -> None:
        """Lets go and waits for the end a little: for a process that has no bag."""
        self.let_go()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_TIMEOUT)


def _ready(file: IO[bytes], event: int, timeout: float) -> bool:
    """Waits for an event of poll(2)."""
    poll = select.poll()
    poll.register(file, event)
    return bool(poll.poll(1e3 * timeout))


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

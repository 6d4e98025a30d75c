"""SIGINT and SIGTERM wait while a bag is written: half a message would spoil all that is in the bag."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def deferred() -> Iterator[Callable[[], None]]:
    """For the time of a `with` block SIGINT and SIGTERM take effect only where the block calls what it is given.

    There, or at the end of the block, the handler from before is called, which usually raises KeyboardInterrupt.
    Where a signal had no handler, SystemExit is raised with the exit code that a shell would show for it. Signals
    that are ignored stay so. Outside of the main thread, which alone may change handlers, nothing changes.
    """
    before: dict[int, Any] = {}
    arrived: list[int] = []

    def deliver() -> None:
        while arrived:
            number = arrived.pop(0)
            handler = before[number]
            if not callable(handler):
                raise SystemExit(128 + number)
            handler(number, None)

    if threading.current_thread() is threading.main_thread():
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        before = {number: handler for number, handler in handlers.items() if handler not in (None, signal.SIG_IGN)}
    for number in before:
        signal.signal(number, lambda number, _: arrived.append(number))
    try:
        yield deliver
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        deliver()

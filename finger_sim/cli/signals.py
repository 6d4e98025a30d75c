"""What SIGINT and SIGTERM do while a verb runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .common import TERMINATED


class Terminated(SystemExit):
    """SIGTERM came; the exit code is TERMINATED."""

    def __init__(self) -> None:
        super().__init__(TERMINATED)


@contextmanager
def unwinding() -> Iterator[None]:
    """For the time of a `with` block SIGINT raises KeyboardInterrupt, and SIGTERM raises Terminated.

    So whatever the verb began is finished or removed on the way out. The first of these signals is the only one that
    counts: a second one would tear what the first one has finished. A signal that the process was told to ignore
    stays ignored. Outside of the main thread, which alone may change handlers, nothing changes.
    """
    numbers = (signal.SIGINT, signal.SIGTERM)
    before: dict[int, Any] = {}
    counts = True

    def handle(number: int, _: object) -> None:
        nonlocal counts
        if counts:
            counts = False
            raise KeyboardInterrupt if number == signal.SIGINT else Terminated

    if threading.current_thread() is threading.main_thread():
        handlers = {number: signal.getsignal(number) for number in numbers}
        before = {number: handler for number, handler in handlers.items() if handler not in (None, signal.SIG_IGN)}
    for number in before:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

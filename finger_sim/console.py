"""What people see while they wait, and tables: progress on stderr, results on stdout."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

LINE_PERIOD = 2.0
"""Time between two lines about the same work where there is no terminal [s]."""
BAR_PERIOD = 0.2
"""Time between two redraws of a bar [s]."""
PLAIN_WIDTH = 200
"""Characters in a line where there is no terminal: paths stay in one piece."""


def console(stream: IO[str] | None = None) -> Console:
    """A console on stdout, or on `stream`."""
    stream = stream or sys.stdout
    width = None if stream.isatty() else PLAIN_WIDTH
    return Console(file=stream, width=width, highlight=False, markup=False)


def say(text: str) -> None:
    """One line on stderr."""
    console(sys.stderr).print(text, soft_wrap=True)


def table(*columns: str) -> Table:
    """An empty table; without columns it has no head, and gets them from its rows."""
    out = Table(show_header=bool(columns), box=None, pad_edge=False)
    for column in columns:
        out.add_column(column, overflow="fold")
    return out


class Gauge:
    """How far one piece of work is; call it with what is done and all there is."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._due = time.monotonic() + LINE_PERIOD
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
            self._bar = Progress(
                *columns, TimeElapsedColumn(), console=console(sys.stderr), auto_refresh=False, transient=True
            )
            self._task = self._bar.add_task(text, total=None)
            self._bar.start()
            self._due = 0.0

    def __call__(self, done: float, total: float) -> None:
        now = time.monotonic()
        if now < self._due:
            return
        if self._bar is None:
            self._due = now + LINE_PERIOD
            say(f"{self._text}: {100.0 * done / max(total, 1e-300):.0f} %")
        else:
            self._due = now + BAR_PERIOD
            self._bar.update(self._task, completed=done, total=total, refresh=True)

    def close(self) -> None:
        """Takes the bar away."""
        if self._bar is not None:
            self._bar.stop()


@contextmanager
def gauge(text: str) -> Iterator[Gauge]:
    """A Gauge for the time of a `with` block, announced by a line."""
    say(text)
    meter = Gauge(text)
    try:
        yield meter
    finally:
        meter.close()

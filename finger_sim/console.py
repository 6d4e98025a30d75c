"""What people see: progress on stderr while they wait, results on stdout; commands that only make files."""

from __future__ import annotations

import argparse
import io
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from .errors import FingerSimError
from .plain import in_words, printing

LINE_PERIOD = 2.0
"""Time between two lines about the same work where there is no terminal [s]."""
BAR_PERIOD = 0.2
"""Time between two redraws of a bar [s]."""
INDENT = "  "
"""Before what belongs to the line above."""
PLAIN_WIDTH = 200
"""Characters in a line where there is no terminal: paths stay in one piece."""


def console(stream: IO[str] | None = None) -> Console:
    """A console on stdout, or on `stream`; on nothing where there is none."""
    stream = stream or sys.stdout or io.StringIO()
    width = None if stream.isatty() else PLAIN_WIDTH
    return Console(file=stream, width=width, highlight=False, markup=False)


def say(text: str) -> None:
    """One line on stderr."""
    console(sys.stderr).print(text, soft_wrap=True)


def show(*parts: str | Table) -> None:
    """Texts and tables on stdout, one below the other. Long lines are left to the terminal to wrap."""
    out = console()
    for part in parts:
        out.print(part, soft_wrap=isinstance(part, str), crop=False)


class FittedTable(Table):
    """A table whose columns are never narrower than their longest word; where they do not fit side by side, a list."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if not console.encoding.startswith("utf"):
            self._put_in_words(console.encoding)
        cells = [[str(cell) for cell in (column.header, *column.cells)] for column in self.columns]
        least = [max(cell_len(word) for cell in column for word in cell.split() or [""]) for column in cells]
        wanted = [max(cell_len(line) for cell in column for line in cell.split("\n")) for column in cells]
        gaps = max(len(cells) - 1, 0) * (self.padding[1] + self.padding[3])
        room = options.max_width - gaps
        if sum(least) > room and console.is_terminal:
            yield from _listed(cells, options.max_width)
            return
        room = max(room, sum(least))
        for column, width in zip(self.columns, _widths(least, wanted, room), strict=True):
            column.width = width
        yield from super().__rich_console__(console, options.update(max_width=room + gaps))

    def _put_in_words(self, encoding: str) -> None:
        """Cells as an encoding can have them, so that columns are as wide as what is printed."""
        rows = list(zip(*(column.cells for column in self.columns), strict=True))
        self.columns = [column.copy() for column in self.columns]
        for column in self.columns:
            column.header = in_words(str(column.header), encoding)
        self.rows = []
        for row in rows:
            self.add_row(*(in_words(str(cell), encoding) for cell in row))


def _widths(least: list[int], wanted: list[int], room: int) -> list[int]:
    """Widths of columns, at least `least`, at most `wanted`; what is scarce goes to the narrowest first."""
    widths = list(least)
    spare = room - sum(widths)
    open_ones = sorted((i for i in range(len(widths))), key=lambda i: wanted[i] - least[i])
    for k, i in enumerate(open_ones):
        more = min(wanted[i] - least[i], spare // (len(open_ones) - k))
        widths[i] += more
        spare -= more
    return widths


def _listed(cells: list[list[str]], width: int) -> Iterator[Text]:
    """Rows of a table one below the other: the first cell, and below it the others, each after its column's name."""
    names, *rows = zip(*cells, strict=True)
    for first, *others in rows:
        if first:
            yield from _lines(first, width, "")
        for name, cell in zip(names[1:], others, strict=True):
            if cell:
                yield from _lines(f"{name}: {cell}" if name else cell, width, INDENT)


def _lines(text: str, width: int, indent: str) -> Iterator[Text]:
    """A text in lines of whole words; a word that is longer than a line is left in one piece."""
    wrapped = textwrap.wrap(
        text, width, initial_indent=indent, subsequent_indent=2 * indent, break_long_words=False, break_on_hyphens=False
    )
    for line in wrapped or [""]:
        yield Text(line, no_wrap=True, overflow="ignore")


def table(*columns: str) -> Table:
    """An empty table; without columns it has no head, and gets them from its rows."""
    out = FittedTable(show_header=bool(columns), box=None, pad_edge=False)
    for column in columns:
        out.add_column(column, overflow="fold")
    return out


class Gauge:
    """How far one piece of work is; call it with what is done and all there is."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._due = time.monotonic() + LINE_PERIOD
        self._said = ""
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            columns = (BarColumn(), TextColumn("{task.percentage:3.0f} %"))
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
            line = f"{self._text}: {100.0 * done / max(total, 1e-300):.0f} %"
            if line != self._said:
                say(line)
            self._said = line
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


def make_files(
    module: str, what: str, place: str, make: Callable[[Path], Iterable[Path]], arguments: Sequence[str] | None
) -> int:
    """The command `python -m MODULE PLACE`: makes files there and prints their paths. Exit code 1 where it cannot.

    what, place : said of the command and of its argument by --help
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=what)
    parser.add_argument("place", type=Path, help=place)

    def made() -> int:
        try:
            for path in make(parser.parse_args(arguments).place):
                print(path)
        except (FingerSimError, OSError) as error:
            print(error, file=sys.stderr)
            return 1
        return 0

    return printing(parser.prog, made)

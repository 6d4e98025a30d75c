"""Poses in columns of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from ...arrays import Floats
from ...errors import BagError
from .cells import Row, number, same
from .formats import TIME_UNITS
from .layout import Layout
from .recorded import DEFAULTS, ORIENTATION, POSITION, Reading, Recorded

LONGEST_SPAN = 1e6
"""Longest time from the first row to another that is believed [s]: more comes of another unit."""
PAUSE = 0.5
"""Time between repeats that are played one after another [s]."""


def read_columns(source: Path, layout: Layout, reading: Reading) -> Recorded:
    """The numbers in the columns of the rows that were asked for."""
    names = list(layout.names)
    for name in [*reading.where, *([reading.concatenate] if reading.concatenate else [])]:
        if name not in names:
            raise BagError(f"{source}: no column {name!r}; found {', '.join(names) or 'none with a name'}")
    where = {names.index(name): text for name, text in reading.where.items()}
    width = len(names) or (len(layout.rows[0].cells) if layout.rows else 0)
    numbers: dict[str, list[float]] = {name: [] for name in layout.used if name != "t"}
    course = _Timeline(source, layout, names.index(reading.concatenate) if reading.concatenate else None)
    for row in layout.rows:
        if len(row.cells) != width:
            raise BagError(f"{source}:{row.line}: got {len(row.cells)} cells, allowed: {width}, one a column")
        if all(same(row.cells[i], text) for i, text in where.items()):
            for name, values in numbers.items():
                values.append(number(source, row, layout.used[name], name))
            course.add(row)
    if not course.times:
        wanted = " with " + ", ".join(f"{name}={text}" for name, text in reading.where.items()) if where else ""
        raise BagError(f"{source}: has no rows{wanted}")
    count = len(course.times)
    return Recorded(
        format=layout.format,
        time=course.times,
        position=_arranged(numbers, POSITION, count),
        orientation=_arranged(numbers, ORIENTATION, count) if numbers.keys() & set(ORIENTATION) else None,
        places=course.places,
        missing=tuple(name for name in DEFAULTS if name not in numbers),
        scale=layout.scale,
        repeats=course.repeats,
        notes=layout.notes,
    )


class _Timeline:
    """Times [ns] of rows since the first one, exact to the last digit; repeats are put one after another.

    repeat : index of the column that numbers them; None where time must not start anew
    """

    def __init__(self, source: Path, layout: Layout, repeat: int | None) -> None:
        self.times: list[int] = []
        self.places: list[str] = []
        self.repeats = 1
        self._source, self._layout, self._repeat = source, layout, repeat
        self._column, self._unit = layout.used["t"], layout.unit
        self._shift, self._before, self._previous = 0, 0, Row(0, [])

    def add(self, row: Row) -> None:
        """One more row. Raises BagError for a time that falls, or is too far from the first."""
        cell, unit = row.cells[self._column], self._unit
        number(self._source, row, self._column, "t", unit)
        t = round(Decimal(cell) * TIME_UNITS[unit])
        here = f"{self._source}:{row.line}: column t: got {cell}"
        if not self.times:
            self._shift = -t
        elif self._repeat is not None and row.cells[self._repeat] != self._previous.cells[self._repeat]:
            self._shift, self.repeats = self.times[-1] + round(PAUSE * 1e9) - t, self.repeats + 1
        elif t < self._before:
            advice = _repeat_advice(self._layout.names, self._previous.cells, row.cells)
            older = f"{unit} after {self._previous.cells[self._column]} {unit}"
            raise BagError(f"{here} {older}, allowed: times that never fall{advice}")
        if t + self._shift > LONGEST_SPAN * 1e9:
            after = f"{(t + self._shift) * 1e-9:.3g} s after the first where t is in {unit}"
            limit = f"allowed: {LONGEST_SPAN:g} s"
            raise BagError(f"{here}, {after}, {limit}; another unit? --time-unit {', '.join(TIME_UNITS)}")
        self.times.append(t + self._shift)
        self.places.append(f"{self._source}:{row.line}")
        self._before, self._previous = t, row


def _arranged(numbers: Mapping[str, list[float]], names: Iterable[str], count: int) -> Floats:
    """Columns (count, len(names)); those that are not there hold their defaults."""
    return np.array([numbers.get(name, [DEFAULTS[name]] * count) for name in names], dtype=np.float64).T


def _repeat_advice(header: Sequence[str], before: Sequence[str], after: Sequence[str]) -> str:
    """Names the column that numbers repeats, if one changes where t starts anew."""
    for name, old, new in zip(header, before, after, strict=False):
        if old != new and name in ("rep", "repeat", "trial", "run", "demo", "id"):
            one, all_of = f"--where {name}={old}", f"--concatenate {name}"
            return f"; {name} goes from {old} to {new} here: take one with {one}, or all with {all_of}"
    return ""

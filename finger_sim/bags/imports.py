"""Recordings that never saw ROS: a CSV of poses becomes a bag."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import numpy as np

from ..errors import BagError, SceneError
from ..scene import Pose, checked_pose
from .reader import LONGEST_SPAN_SECONDS, START, absolute, write_commands

COLUMNS = {"t": "s", "x": "m", "y": "m", "z": "m", "qx": "1", "qy": "1", "qz": "1", "qw": "1"}
"""Columns of a CSV of poses and their units."""
DEFAULTS = {"x": 0.0, "y": 0.0, "z": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
"""What stands for a column that is not there: the identity pose."""
PAUSE = 0.5
"""Time between repeats that are played one after another [s]."""


@dataclass(frozen=True)
class ImportSummary:
    """What came out of a CSV: counts of what is unusual in it, all of which was kept as recorded."""

    path: Path
    topic: str
    poses: int
    duration: float
    """[s]"""
    rate: float
    """Commands a second, from the median interval [Hz]; 0 for a single pose."""
    repeats: int
    """Parts played one after another."""
    repeated_stamps: int
    gaps: int
    """Intervals longer than three times the median one."""
    longest_gap: float
    """Longest interval [s]."""
    sign_flips: int
    """Steps from a quaternion to about its negative."""
    defaulted: tuple[str, ...]
    """Pose columns that the file does not have."""


def import_csv(
    source: str | Path,
    out: str | Path,
    *,
    topic: str = "command_pose",
    frame_id: str = "world",
    constants: Mapping[str, float] | None = None,
    offset: Mapping[str, float] | None = None,
    where: Mapping[str, str] | None = None,
    concatenate: str | None = None,
) -> ImportSummary:
    """Makes a bag of poses in a CSV file and says what was in it.

    The file has one line of column names, of which t x y z qx qy qz qw count (SI units, quaternions xyzw);
    cells are separated by comma, semicolon, tab or blanks; lines that begin with # are skipped. Missing pose
    columns are 0, qw is 1. The bag begins at START; intervals of t are kept.

    constants   : column -> value for every row, present in the file or not
    offset      : column -> value added to every row, after `constants`
    where       : column -> text: only rows with that cell are read
    concatenate : column that numbers repeats in which t starts anew: they are played one after another, PAUSE
                  between them
    Raises BagError with file, line, column and value of what cannot be used.
    """
    source = Path(source)
    for option, values in (("constants", constants), ("offset", offset)):
        _check_options(option, values or {})
    table = _read_table(source, where or {}, concatenate)
    columns = dict(table.columns)
    defaulted = tuple(name for name in DEFAULTS if name not in columns and name not in (constants or {}))
    n = len(table.lines)
    for name, default in DEFAULTS.items():
        value = (constants or {}).get(name)
        if value is not None or name not in columns:
            columns[name] = [default if value is None else value] * n
        columns[name] = [v + (offset or {}).get(name, 0.0) for v in columns[name]]
    position = np.array([columns[name] for name in ("x", "y", "z")]).T
    orientation = np.array([columns[name] for name in ("qx", "qy", "qz", "qw")]).T
    for line, (x, y, z), (qx, qy, qz, qw) in zip(table.lines, position.tolist(), orientation.tolist(), strict=True):
        try:
            checked_pose(Pose((x, y, z), (qx, qy, qz, qw)))
        except SceneError as error:
            raise BagError(f"{source}:{line}: {error}") from None
    times = [START + round(t * 1e9) for t in table.time]
    path = write_commands(Path(out), times, position, orientation, topic=topic, frame_id=frame_id)
    steps = np.array([(b - a) * 1e-9 for a, b in pairwise(times)])
    moved = steps[steps > 0.0]
    usual = float(np.median(moved)) if len(moved) else 0.0
    return ImportSummary(
        path=path,
        topic=absolute(topic),
        poses=n,
        duration=(times[-1] - times[0]) * 1e-9,
        rate=1.0 / usual if usual else 0.0,
        repeats=table.repeats,
        repeated_stamps=int((steps == 0).sum()),
        gaps=int((steps > 3.0 * usual).sum()) if usual else 0,
        longest_gap=float(steps.max(initial=0.0)),
        sign_flips=int((np.einsum("ij,ij->i", orientation[1:], orientation[:-1]) < 0.0).sum()),
        defaulted=defaulted,
    )


@dataclass(frozen=True)
class _Table:
    """The rows of a CSV that were asked for."""

    lines: list[int]
    time: list[float]
    """Since the first row, repeats put one after another [s]."""
    columns: dict[str, list[float]]
    repeats: int


def _check_options(option: str, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        if name not in DEFAULTS:
            raise BagError(f"{option}: got column {name!r}, allowed: {', '.join(DEFAULTS)}")
        if not math.isfinite(value):
            raise BagError(f"{option}: {name}: got {value!r}, allowed: a finite number")


def _read_table(source: Path, where: Mapping[str, str], concatenate: str | None) -> _Table:
    """Reads and checks the numbers of a CSV."""
    try:
        with source.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(_split_lines(stream))
    except OSError as error:
        raise BagError(f"{source}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise BagError(f"{source}: not a text file of columns: {error}") from None
    if not rows:
        raise BagError(f"{source}: is empty; the first line must name columns, such as {' '.join(COLUMNS)}")
    header_line, header = rows[0]
    _check_header(source, header_line, header, [*where, *([concatenate] if concatenate else [])])
    used = {name: header.index(name) for name in COLUMNS if name in header}
    table = _Table([], [], {name: [] for name in used if name != "t"}, 1)
    shift, previous, previous_cells, repeats = 0.0, None, header, 1
    for line, cells in rows[1:]:
        if len(cells) != len(header):
            raise BagError(f"{source}:{line}: got {len(cells)} cells, allowed: {len(header)}, one a column")
        if not all(_same(cells[header.index(name)], text) for name, text in where.items()):
            continue
        numbers = {name: _number(source, line, i, name, cells[i]) for name, i in used.items()}
        t = numbers.pop("t")
        if previous is None:
            shift = -t
        elif concatenate and (here := header.index(concatenate)) >= 0 and cells[here] != previous_cells[here]:
            shift, repeats = table.time[-1] + PAUSE - t, repeats + 1
        elif t < previous:
            advice = _repeat_advice(header, previous_cells, cells)
            found = f"{source}:{line}: column t: got {t:g} s after {previous:g} s"
            raise BagError(f"{found}, allowed: times that never fall{advice}")
        if t + shift > LONGEST_SPAN_SECONDS:
            raise BagError(f"{source}:{line}: column t: got {t:g}, {t + shift:g} s after the first; t is in seconds")
        previous, previous_cells = t, cells
        table.lines.append(line)
        table.time.append(t + shift)
        for name, value in numbers.items():
            table.columns[name].append(value)
    if not table.lines:
        asked = " with " + ", ".join(f"{name}={text}" for name, text in where.items()) if where else ""
        raise BagError(f"{source}: has no rows{asked}")
    return _Table(table.lines, table.time, table.columns, repeats)


def _split_lines(stream: TextIO) -> Iterator[tuple[int, list[str]]]:
    """Line number and stripped cells of every line that is neither blank nor a comment."""
    separator = None
    for line, text in enumerate(stream, start=1):
        text = text.strip()
        if not text or text.startswith("#"):
            continue
        if separator is None:
            separator = next((mark for mark in ",;\t" if mark in text), " ")
        if separator == " ":
            yield line, text.split()
        else:
            yield line, [cell.strip() for cell in next(csv.reader([text], delimiter=separator))]


def _check_header(source: Path, line: int, header: list[str], asked: list[str]) -> None:
    found = ", ".join(header)
    if len(set(header)) != len(header):
        raise BagError(f"{source}:{line}: got columns {found}, allowed: every name once")
    if "t" not in header:
        raise BagError(f"{source}:{line}: got columns {found}, allowed: t [s] and any of {', '.join(DEFAULTS)}")
    for name in asked:
        if name not in header:
            raise BagError(f"{source}:{line}: no column {name!r}; found {found}")


def _number(source: Path, line: int, index: int, name: str, cell: str) -> float:
    """The finite number in a cell."""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        where = f"{source}:{line}:{index + 1}: column {name}"
        raise BagError(f"{where}: got {cell!r}, allowed: a finite number [{COLUMNS[name]}]")
    return value


def _same(cell: str, text: str) -> bool:
    """Whether a cell is what was asked for, as text or as a number."""
    try:
        return cell == text or float(cell) == float(text)
    except ValueError:
        return False


def _repeat_advice(header: list[str], before: list[str], after: list[str]) -> str:
    """Names the column that numbers repeats, if one changes where t starts anew."""
    for name, old, new in zip(header, before, after, strict=True):
        if name not in COLUMNS and old != new and name in ("rep", "repeat", "trial", "run", "demo", "id"):
            one, all_of = f"--where {name}={old}", f"--concatenate {name}"
            return f"; {name} goes from {old} to {new} here: take one with {one}, or all with {all_of}"
    return ""

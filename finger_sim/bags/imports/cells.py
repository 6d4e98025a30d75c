"""Lines of text files, their cells, and the numbers in these."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ...errors import BagError
from .formats import FORMATS
from .recorded import ORIENTATION, POSITION

COLUMNS = {"t": "s", **dict.fromkeys(POSITION, "m"), **dict.fromkeys(ORIENTATION, "1")}
"""Columns that count, and their units."""


class Row(NamedTuple):
    """A line of cells."""

    line: int
    cells: list[str]


def expected() -> str:
    return "expected: " + "; ".join(FORMATS.values())


def split_file(source: Path) -> tuple[list[Row], list[Row]]:
    """The comments (without #) before the first row, and the rows: lines that are neither blank nor comments."""
    comments: list[tuple[int, str]] = []
    rows: list[Row] = []
    separator = ""
    try:
        with source.open(encoding="utf-8-sig", newline="") as stream:
            for line, text in enumerate(stream, start=1):
                text = text.strip()
                if text.startswith("#"):
                    if not rows:
                        comments.append((line, text.lstrip("# ")))
                elif text:
                    separator = separator or next((mark for mark in ",;\t" if mark in text), " ")
                    rows.append(Row(line, _cells(text, separator)))
    except OSError as error:
        raise BagError(f"{source}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise BagError(f"{source}: not a text file of columns: {error}; {expected()}") from None
    return [Row(line, _cells(text, separator or " ")) for line, text in comments], rows


def _cells(text: str, separator: str) -> list[str]:
    if separator == " ":
        return text.split()
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]


def number(source: Path, row: Row, index: int, name: str, unit: str | None = None) -> float:
    """The finite number in a cell."""
    cell = row.cells[index]
    value = as_number(cell)
    if not math.isfinite(value):
        unit = COLUMNS[name] if unit is None else unit
        allowed = "a finite number" + (f" [{unit}]" if unit else "")
        raise BagError(f"{source}:{row.line}:{index + 1}: column {name}: got {cell!r}, allowed: {allowed}")
    return value


def as_number(cell: str) -> float:
    """A number as text; nan for any other text."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def numeric(cells: Sequence[str]) -> bool:
    """Whether all cells are numbers, or say that there is none."""
    return all(cell.lower() == "nan" or not math.isnan(as_number(cell)) for cell in cells)


def same(cell: str, text: str) -> bool:
    """Whether a cell is what was asked for, as text or as a number."""
    return cell == text or as_number(cell) == as_number(text)

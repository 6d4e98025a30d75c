"""Which cells of a text file are what: from a header, from numbers of columns, or from how many stand in a line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from ...errors import BagError
from .cells import COLUMNS, Row, expected, numeric
from .formats import FORMATS, TIME_UNITS
from .recorded import DEFAULTS, ORIENTATION, POSITION, Reading

TUM = ("t", *POSITION, *ORIENTATION)
"""What the numbers of a line in a TUM file are."""
EUROC = ("t", *POSITION, "qw", "qx", "qy", "qz")
"""What the first numbers of a line in an EuRoC file are; there are more."""
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Units of length that a header may name [m]."""

_UNIT = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
"""A name with a unit in brackets of either kind."""
_UNITS = {
    "µs": "us", "sec": "s", "seconds": "s", "milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns",
    "meters": "m", "metres": "m", "centimeters": "cm", "centimetres": "cm", "millimeters": "mm", "millimetres": "mm",
}  # fmt: skip
"""Units in other words."""

_OF_ROS = ("", "pose.", "pose.pose.")
_NAMES = {
    "t": ("t", "time", "timestamp", "stamp", "%time"),
    **{
        axis: (
            *(
                form + axis
                for form in ("", "t", "t_", "p", "p_", "pos_", "position_", "p_rs_r_", "transform.translation.")
            ),
            *(f"{prefix}position.{axis}" for prefix in _OF_ROS),
        )
        for axis in POSITION
    },
    **{
        name: (
            *(form + name[1] for form in ("q", "q_", "quat_", "q_rs_", "orientation_")),
            *(f"{prefix}orientation.{name[1]}" for prefix in _OF_ROS),
            f"transform.rotation.{name[1]}",
        )
        for name in ORIENTATION
    },
}
"""Other names of our columns, in small letters: of TUM, EuRoC, `rostopic echo -p`, and usual ones."""


class Layout(NamedTuple):
    """Which cells of which rows are what."""

    format: str
    rows: Sequence[Row]
    used: Mapping[str, int]
    """Our column -> index of its cell."""
    names: Sequence[str]
    """Of all columns; empty where they have none."""
    unit: str
    """Of time: one of TIME_UNITS."""
    scale: float
    """What makes metres of the lengths."""
    notes: tuple[str, ...]


def find_layout(source: Path, comments: Sequence[Row], rows: Sequence[Row], reading: Reading) -> Layout:
    """Which cells are what, from the options, a header, or the count of numbers in a line."""
    if reading.columns and all(name.isdecimal() for name in reading.columns.values()):
        return _by_number(source, rows, reading)
    first = rows[0]
    if not numeric(first.cells):
        return _by_names(source, first, rows[1:], reading)
    unit = reading.time_unit
    if reading.format == "euroc" and len(first.cells) >= len(EUROC):
        return _unnamed("EuRoC/ASL", EUROC, rows, unit or "ns")
    named = next((row for row in reversed(comments) if _names_columns(row.cells, len(first.cells))), None)
    if named is not None:
        return _by_names(source, named, rows, reading)
    if reading.format in (None, "tum") and len(first.cells) == len(TUM):
        return _unnamed("TUM", TUM, rows, unit or "s")
    found = (
        f"{source}:{first.line}: got a row of {len(first.cells)} numbers ({', '.join(first.cells[:3])} …) and no names"
    )
    if reading.format is not None:
        raise BagError(f"{found}, allowed: {FORMATS[reading.format]}; or name columns by number: --columns t=1 x=2")
    raise BagError(f"{found}; name columns by number, such as --columns t=1 x=2; {expected()}")


def _unnamed(format: str, order: Sequence[str], rows: Sequence[Row], unit: str) -> Layout:
    """A format in which the place in a line says what a number is."""
    used = {name: i for i, name in enumerate(order)}
    note = f"columns in the order {' '.join(order)}, t in {unit}"
    return Layout(format, rows, used, (), unit, 1.0, (note,))


def _by_number(source: Path, rows: Sequence[Row], reading: Reading) -> Layout:
    """Columns by their numbers; rows before the first one with numbers there are a header."""
    used = {}
    for name, text in reading.columns.items():
        _check_ours(name)
        used[name] = int(text) - 1
    if "t" not in used or min(used.values()) < 0:
        given = " ".join(f"{name}={text}" for name, text in reading.columns.items())
        raise BagError(f"--columns: got {given}, allowed: t and any of {', '.join(DEFAULTS)}, numbers from 1 on")
    width = max(used.values()) + 1
    begin = next(
        (i for i, row in enumerate(rows) if len(row.cells) >= width and numeric([row.cells[j] for j in used.values()])),
        None,
    )
    if begin is None:
        raise BagError(f"{source}: no line with numbers in the columns {', '.join(reading.columns.values())}")
    skipped = (f"{begin} lines before the first numbers are left out",) if begin else ()
    names = rows[begin - 1].cells if begin and len(rows[begin - 1].cells) == len(rows[begin].cells) else ()
    unit = reading.time_unit or "s"
    return Layout("text, columns by number", rows[begin:], used, names, unit, 1.0, (*skipped, *said(reading, unit)))


def _by_names(source: Path, header: Row, rows: Sequence[Row], reading: Reading) -> Layout:
    """Columns by the names in a header, which may say units: `x [mm]`, `t [ns]`."""
    names, units = zip(*(_parted(cell) for cell in header.cells), strict=True)
    place = f"{source}:{header.line}"
    used = {ours: i for ours in COLUMNS if (i := _find(place, ours, names, header.cells, reading)) is not None}
    found = ", ".join(header.cells)
    if "t" not in used:
        advice = f"allowed: t [s] and any of {', '.join(DEFAULTS)}; say which is which with --columns t=NAME x=NAME"
        raise BagError(f"{place}: got columns {found}, {advice}; {expected()}")
    lower = [name.lower() for name in names]
    euroc = any(name.startswith("p_rs_r_") for name in lower)
    tum = lower == ["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
    of_ros = lower[used["t"]] == "%time"
    written = units[used["t"]] if units[used["t"]] in TIME_UNITS else None
    unit = reading.time_unit or written or ("ns" if euroc or of_ros else "s")
    notes = () if written else said(reading, unit)
    lengths = {units[used[axis]] for axis in POSITION if axis in used} & LENGTHS.keys()
    if len(lengths) > 1:
        raise BagError(f"{place}: got lengths in {', '.join(sorted(lengths))}, allowed: one unit")
    length = lengths.pop() if lengths else "m"
    others = ", ".join(f"{ours} = {names[i]}" for ours, i in used.items() if ours != names[i])
    notes += (f"columns {others}",) if others and not (tum or euroc) else ()
    notes += (f"the header has lengths in {length}",) if length != "m" else ()
    name = "EuRoC/ASL" if euroc else "TUM" if tum else "CSV of `rostopic echo -p`" if of_ros else "CSV"
    return Layout(name, rows, used, names, unit, LENGTHS[length], notes)


def said(reading: Reading, unit: str) -> tuple[str, ...]:
    return () if reading.time_unit else (f"t in {unit}",)


def _check_ours(name: str) -> None:
    if name not in COLUMNS:
        raise BagError(f"--columns: got column {name!r}, allowed: {', '.join(COLUMNS)}")


def _find(place: str, ours: str, names: Sequence[str], cells: list[str], reading: Reading) -> int | None:
    """Index of one of our columns, by what the user said, by our name, or by another usual name; or None."""
    for name in reading.columns:
        _check_ours(name)
    asked = reading.columns.get(ours)
    if asked is not None:
        if asked.isdecimal() and asked not in names and 0 < int(asked) <= len(names):
            return int(asked) - 1
        found = [i for i, name in enumerate(names) if asked in (name, cells[i])]
        if not found:
            raise BagError(f"{place}: no column {asked!r} for {ours}; found {', '.join(cells)}")
    else:
        found = [i for i, name in enumerate(names) if name == ours]
        found = found or [i for i, name in enumerate(names) if name.lower().removeprefix("field.") in _NAMES[ours]]
    if len(found) > 1:
        several = ", ".join(names[i] for i in found)
        unique = f"allowed: every name once; or choose by number: --columns {ours}={found[0] + 1}"
        raise BagError(f"{place}: got columns {', '.join(cells)}, of which {several} may be {ours}, {unique}")
    return found[0] if found else None


def _names_columns(cells: list[str], count: int) -> bool:
    """Whether a comment names `count` columns, time among them."""
    return len(cells) == count and any(_parted(cell)[0].lower() in _NAMES["t"] for cell in cells)


def _parted(cell: str) -> tuple[str, str]:
    """A column's name and its unit, which is empty where there is none: `x [mm]`, `time(ns)`."""
    match = _UNIT.fullmatch(cell)
    return (match[1], _UNITS.get(match[2].lower(), match[2])) if match else (cell, "")

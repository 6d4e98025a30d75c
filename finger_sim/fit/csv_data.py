"""Presses in CSV files: a header that names each column and its unit, a sample a line.

Lines `# direction: flat` before the header say how the finger was pressed; so do a column `direction`, or columns
qx qy qz qw. A column `press` tells several presses in one file apart.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..arrays import Floats
from ..physics.rotations import Quaternion, unit
from ..scene import Scene
from ..scene.mesh import TetMesh
from .press import FitError, Press, orientation_of, touch_height

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665}
AREA = {
    "m^2": 1.0,
    "cm^2": 1e-4,
    "mm^2": 1e-6,
    "m²": 1.0,
    "cm²": 1e-4,
    "mm²": 1e-6,
    "m2": 1.0,
    "cm2": 1e-4,
    "mm2": 1e-6,
}
QUANTITIES: dict[str, dict[str, float]] = {
    "time": TIME, "depth": LENGTH, "along": LENGTH, "across": LENGTH, "normal": FORCE, "tangential": FORCE,
    "tangential_x": FORCE, "tangential_y": FORCE, "area": AREA,
}  # fmt: skip
"""Columns of numbers and the units that each may have, in SI."""
ALIASES = {
    "t": "time", "force": "normal", "normal_force": "normal", "fn": "normal", "fz": "normal", "f": "normal",
    "tangential_force": "tangential", "ft": "tangential", "shear": "tangential", "fx": "tangential_x",
    "fy": "tangential_y", "x": "along", "y": "across", "contact_area": "area", "displacement": "depth",
    "indentation": "depth",
}  # fmt: skip
TURN = ("qx", "qy", "qz", "qw")
WORDS = ("direction", "press")
NEEDED = ("time", "depth", "normal")
_UNIT = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$")


def read_csv(path: Path, scene: Scene, mesh: TetMesh, direction: str | None = None) -> list[Press]:
    """The presses in a file; direction: of those that do not state theirs.

    Raises FitError with file, line, column and value of what cannot be used.
    """
    header, rows, said = _lines(path)
    columns = [_column(path, header[0], text) for text in header[1]]
    names = [name for name, _ in columns]
    for name in NEEDED:
        if name not in names:
            allowed = ", ".join(f"{name} [{'|'.join(QUANTITIES[name])}]" for name in NEEDED)
            raise FitError(f"{path}:{header[0]}: no column {name}; found {', '.join(names)}; needed: {allowed}")
    for name in names:
        if names.count(name) > 1:
            raise FitError(f"{path}:{header[0]}: column {name}: given twice")
    presses: dict[str, list[tuple[int, list[str]]]] = {}
    for line, cells in rows:
        if len(cells) != len(names):
            raise FitError(f"{path}:{line}: got {len(cells)} cells, allowed: {len(names)}, one a column")
        presses.setdefault(cells[names.index("press")] if "press" in names else "", []).append((line, cells))
    return [
        _press(path, label, lines, columns, said.get("direction", direction), scene, mesh)
        for label, lines in presses.items()
    ]


def _lines(path: Path) -> tuple[tuple[int, list[str]], list[tuple[int, list[str]]], dict[str, str]]:
    """The header and the rows, each with its line, and what comments of the form `# word: text` say."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        raise FitError(f"{path}: cannot be read: {why}") from None
    said: dict[str, str] = {}
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("#"):
            word, colon, rest = line.lstrip("# \t").partition(":")
            if colon and not rows:
                said[word.strip().lower()] = rest.strip()
        elif line.strip():
            mark = next((m for m in ",;\t" if m in line), ",")
            rows.append((number, [cell.strip() for cell in next(csv.reader([line], delimiter=mark))]))
    if len(rows) < 2:
        raise FitError(f"{path}: got {len(rows)} lines, allowed: a header with units and a line for each sample")
    return rows[0], rows[1:], said


def _column(path: Path, line: int, text: str) -> tuple[str, float]:
    """Name and factor to SI of a column; of words and quaternions 1."""
    match = _UNIT.match(text)
    name, unit_ = (match[1], match[2]) if match else (text, "")
    name = name.strip().lower().replace(" ", "_")
    if not match and "_" in name:  # depth_mm
        stem, _, end = text.strip().rpartition("_")
        if (ALIASES.get(stem.lower(), stem.lower()) in QUANTITIES) and _unit_of(
            ALIASES.get(stem.lower(), stem.lower()), end
        ):
            name, unit_ = stem.lower(), end
    name = ALIASES.get(name, name)
    if name in WORDS or name in TURN:
        return name, 1.0
    if name not in QUANTITIES:
        known = ", ".join((*QUANTITIES, *TURN, *WORDS))
        raise FitError(f"{path}:{line}: column {text!r} is not known; known: {known}")
    factor = _unit_of(name, unit_)
    if factor is None:
        got = f"got {unit_!r}" if unit_ else "it has no unit"
        raise FitError(f"{path}:{line}: column {name}: {got}, allowed: {name} [{'|'.join(QUANTITIES[name])}]")
    return name, factor


def _unit_of(name: str, text: str) -> float | None:
    return QUANTITIES[name].get(text)


def _press(
    path: Path, label: str, lines: Sequence[tuple[int, list[str]]], columns: Sequence[tuple[str, float]],
    direction: str | None, scene: Scene, mesh: TetMesh,
) -> Press:  # fmt: skip
    """One press of a file."""
    names, name = [each for each, _ in columns], path.stem + (f":{label}" if label else "")
    numbers: dict[str, Floats] = {}
    for index, (column, factor) in enumerate(columns):
        if column not in WORDS:
            numbers[column] = np.array([factor * _number(path, line, column, cells[index]) for line, cells in lines])
    stated = {cells[names.index("direction")] for _, cells in lines} if "direction" in names else set()
    if len(stated) > 1:
        raise FitError(f"{path}: column direction: got {', '.join(sorted(stated))} in one press, allowed: one")
    direction = next(iter(stated), direction)
    turn: Quaternion
    if numbers.keys() & set(TURN):
        missing = [q for q in TURN if q not in numbers]
        if missing:
            raise FitError(f"{path}: no column {missing[0]}; allowed: all of {', '.join(TURN)}, or none")
        found = [
            unit((float(a), float(b), float(c), float(d)))
            for a, b, c, d in zip(*(numbers[q] for q in TURN), strict=True)
        ]
        if None in found:
            raise FitError(f"{path}:{lines[found.index(None)][0]}: qx qy qz qw: no unit quaternion")
        orientation, direction = np.array(found), "pose"
        turn = found[0] or (0.0, 0.0, 0.0, 1.0)
    else:
        if direction is None:
            raise FitError(
                f"{path}: does not say how it was pressed; allowed: a line `# direction: flat|side|tip`, a column "
                f"direction, columns qx qy qz qw, or --direction"
            )
        turn = orientation_of(direction)
        orientation = np.tile(turn, (len(lines), 1))
    touch, nothing = touch_height(scene, mesh, turn), np.zeros(len(lines))
    along, across = numbers.get("along", nothing), numbers.get("across", nothing)
    tangential = numbers.get("tangential")
    if "tangential_x" in numbers or "tangential_y" in numbers:
        tangential = np.stack([numbers.get("tangential_x", nothing), numbers.get("tangential_y", nothing)], axis=1)
    position = np.stack([along, across, touch - numbers["depth"]], axis=1)
    return Press(
        name, direction, numbers["time"], position, orientation, touch, numbers["normal"], tangential,
        numbers.get("area"),
    )  # fmt: skip


def _number(path: Path, line: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FitError(f"{path}:{line}: column {column}: got {cell!r}, allowed: a finite number")
    return value

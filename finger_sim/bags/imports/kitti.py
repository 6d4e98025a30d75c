"""KITTI poses: 12 numbers a line, and times in a file of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import BagError
from .cells import Row, number, numeric, split_file
from .columns import read_columns
from .formats import FORMATS
from .layout import Layout, said
from .recorded import Reading, Recorded
from .turns import matrix_quaternions

KITTI = 12
"""Numbers in a line of a KITTI file: the upper three rows of a 4x4 matrix."""
NO_ROTATION = 1e-2
"""Largest entry of R Rᵀ − 1 that rounding leaves in a written matrix."""


def is_kitti(first: Row, reading: Reading) -> bool:
    by_count = reading.format is None and not reading.columns and numeric(first.cells)
    return reading.format == "kitti" or (by_count and len(first.cells) == KITTI)


def read_kitti(source: Path, rows: Sequence[Row], reading: Reading) -> Recorded:
    """Poses of rows r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z, and their times in a file of their own."""
    if reading.times is None:
        line = f"{source}:{rows[0].line}"
        raise BagError(f"{line}: KITTI poses carry no times: give them with --times FILE, one a line [s]")
    if reading.where or reading.concatenate or reading.columns:
        raise BagError(f"{source}: KITTI poses have no columns to choose by --columns, --where or --concatenate")
    for row in rows:
        if len(row.cells) != KITTI:
            raise BagError(f"{source}:{row.line}: got {len(row.cells)} cells, allowed: {FORMATS['kitti']}")
    names = [f"r{i}{j}" if j < 4 else "xyz"[i - 1] for i in (1, 2, 3) for j in (1, 2, 3, 4)]
    numbers = [[number(source, row, k, names[k], "") for k in range(KITTI)] for row in rows]
    matrices = np.array(numbers).reshape(-1, 3, 4)
    turns = matrices[:, :, :3]
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    off[np.linalg.det(turns) < 0.0] = math.inf
    if off.max() > NO_ROTATION:
        first = rows[int((off > NO_ROTATION).argmax())].line
        raise BagError(f"{source}:{first}: its first three columns are no rotation, allowed: {FORMATS['kitti']}")
    unit = reading.time_unit or "s"
    return Recorded(
        format=f"KITTI, times of {reading.times}",
        time=_read_times(reading.times, unit, len(rows), source),
        position=matrices[:, :, 3],
        orientation=matrix_quaternions(turns),
        places=[f"{source}:{row.line}" for row in rows],
        notes=said(reading, unit),
    )


def _read_times(source: Path, unit: str, count: int, poses: Path) -> list[int]:
    """One time a line, as many as there are poses."""
    _, rows = split_file(source)
    if len(rows) != count:
        raise BagError(f"{source}: got {len(rows)} times, allowed: {count}, one for each pose in {poses}")
    used = {"t": 0}
    layout = Layout("times", rows, used, (), unit, 1.0, ())
    return list(read_columns(source, layout, Reading()).time)

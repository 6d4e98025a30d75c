"""Poses in text files: CSV with a header, TUM, EuRoC/ASL and KITTI, told apart by what stands in them."""

from __future__ import annotations

from pathlib import Path

from ...errors import BagError
from .cells import expected, split_file
from .columns import read_columns
from .kitti import KITTI, is_kitti, read_kitti
from .layout import find_layout
from .recorded import Reading, Recorded


def read_text(source: Path, reading: Reading) -> Recorded:
    """The poses in a text file. Cells are separated by comma, semicolon, tab or blanks.

    Raises BagError with file, line, column and value of what cannot be used.
    """
    comments, rows = split_file(source)
    if not rows:
        raise BagError(f"{source}: is empty; {expected()}")
    if is_kitti(rows[0], reading):
        return read_kitti(source, rows, reading)
    if reading.times is not None:
        raise BagError(f"{source}:{rows[0].line}: --times is for KITTI poses, {KITTI} numbers a row, and nothing else")
    layout = find_layout(source, comments, rows, reading)
    return read_columns(source, layout, reading)

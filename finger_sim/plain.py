"""What files are written with: values as JSON has them, and files that are whole or not there."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Arrays and tuples as lists, no NumPy numbers, keys as text, what is not finite as null; all else as it is."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Where to write what `path` is to hold; it is put there when the `with` block ends well.

    Whatever ends the block otherwise, an interrupt too, leaves what was at `path` before, or nothing. The name given
    has the same ending. What is no file, such as /dev/stdout, is written to directly.
    Raises OSError when the file cannot be put in its place.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        yield Path(path)
        return
    part = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    try:
        yield part
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)

"""Where the node puts its bags."""

from __future__ import annotations

import os
import time
from pathlib import Path

from ..errors import SceneError


def bag_path(parameter: str, text: str) -> Path:
    """The path that a parameter gives. Raises SceneError naming it where that is none."""
    try:
        path = Path(text).expanduser().absolute()
        os.fsencode(path)
    except (RuntimeError, OSError, ValueError) as error:
        raise SceneError(parameter, text, f"a path ({error})") from None
    return path


def free_name(folder: Path) -> Path:
    """A path in `folder` that does not exist, named by the time."""
    stem = time.strftime("finger_%Y%m%d_%H%M%S")
    names = (folder / (stem + (f"_{i}" if i else "")) for i in range(10_000))
    return next(path for path in names if not os.path.lexists(path))

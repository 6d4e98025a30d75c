"""Rotations of plain numbers (rotations.py) for compiled code: the same functions, which kernels may call too."""

from __future__ import annotations

import math
from typing import Any

from numba.extending import overload

from .compile import FASTMATH, formula, stage
from .rotations import Quaternion, angle, matrix_entries, normalised, rotation_vector, slerp

__all__ = ["Quaternion", "angle", "matrix_entries", "normalised", "rotation_vector", "slerp"]

formula(matrix_entries)
for _function in (angle, normalised, rotation_vector, slerp):
    stage(_function)


@overload(math.hypot, jit_options={"error_model": "numpy", "fastmath": FASTMATH})  # type: ignore[untyped-decorator]
def _length(*parts: Any) -> Any:
    """Of more than two numbers, which Python's takes and numba's does not."""

    def length(*parts: Any) -> Any:
        total = 0.0
        for part in parts:
            total += part * part
        return math.sqrt(total)

    return length if len(parts) > 2 else None

"""A clock for compiled code: steady, in seconds; and what a step spends on each of its stages."""

from __future__ import annotations

from typing import Any

from numba.core import types

from ..arrays import Floats, Ints
from .compile import stage

STAGES = ("kinematics", "assembly", "rows", "factor", "solve", "output")
KINEMATICS, ASSEMBLY, ROWS, FACTOR, SOLVE, OUTPUT = range(6)

_MONOTONIC = 1  # CLOCK_MONOTONIC of clock_gettime(2)

_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))


@stage
def seconds(buffer: Ints) -> float:
    """Time on the steady clock [s]; buffer (2,) scratch. Compiled only."""
    _clock_gettime(_MONOTONIC, buffer.ctypes.data)
    now: float = buffer[0] + 1e-9 * buffer[1]
    return now


@stage
def lap(laps: Floats, buffer: Ints, done: int) -> None:
    """Add the time since the last lap to that of stage `done` [s]. laps (7,): the stages', and when the last ended.

    An empty `laps` measures nothing and costs nothing.
    """
    if laps.shape[0] > 0:
        now = seconds(buffer)
        laps[done] += now - laps[6]
        laps[6] = now

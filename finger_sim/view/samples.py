"""Forces over the last seconds, for the page's plot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .protocol import SAMPLE

PERIOD = 0.005
"""Time between two samples [s]."""
KEPT = 2000
"""Samples: ten seconds."""
_MEASURED = ("normal", "tangential", "device", "depth")


class Samples:
    """The newest samples, each numbered from 0 on."""

    def __init__(self) -> None:
        self._times = np.zeros(KEPT)
        self._rows = np.zeros(KEPT, SAMPLE)
        self._count = 0

    @property
    def last(self) -> float:
        """Time of the newest [s]; -inf: there is none."""
        return float(self._times[(self._count - 1) % KEPT]) if self._count else -np.inf

    def clear(self) -> None:
        """Forgets all."""
        self._count = 0

    def add(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Takes samples (n, 4) at rising times (n,) [s]: normal, tangential and device force [N], depth [m]."""
        times, values = times[-KEPT:], values[-KEPT:]
        places = (self._count + np.arange(len(times))) % KEPT
        self._times[places] = times
        for name, column, unit in zip(_MEASURED, values.T, (1.0, 1.0, 1.0, 1e3), strict=True):
            self._rows[name][places] = unit * column
        self._count += len(times)

    def since(self, seen: int, time: float) -> tuple[NDArray[np.void], int]:
        """Those after number `seen`, their times relative to `time` [s], and the number of the newest."""
        first = max(seen + 1, self._count - KEPT, 0)
        places = np.arange(first, self._count) % KEPT
        rows = self._rows[places]
        rows["time"] = np.minimum(self._times[places] - time, 0.0)
        return rows, self._count - 1

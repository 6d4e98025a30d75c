"""Forces over the last seconds, for the page's plot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .protocol import SAMPLE

PERIOD = 0.005
"""Time between two samples [s]."""
KEPT = 2000
"""Samples: ten seconds."""


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

    def add(self, time: float, values: tuple[float, float, float, float]) -> None:
        """Takes a sample later than the last [s]: normal, tangential and device force [N], depth [m]."""
        place = self._count % KEPT
        self._times[place] = time
        self._rows[place] = (0.0, *values[:3], 1e3 * values[3])
        self._count += 1

    def since(self, seen: int, time: float) -> tuple[NDArray[np.void], int]:
        """Those after number `seen`, their times relative to `time` [s], and the number of the newest."""
        first = max(seen + 1, self._count - KEPT, 0)
        places = np.arange(first, self._count) % KEPT
        rows = self._rows[places]
        rows["time"] = np.minimum(self._times[places] - time, 0.0)
        return rows, self._count - 1

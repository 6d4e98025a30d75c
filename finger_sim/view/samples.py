"""Forces over the last seconds, for the page's plot."""

from __future__ import annotations

import math
import struct
from collections import deque
from itertools import islice

KEPT = 2000
"""Samples that are sent to a page that comes new: of a recording those of ten seconds."""
PERIOD = 0.005
"""Time between two samples of a recording [s]."""
_SAMPLE = struct.Struct("<5f")


class Samples:
    """The newest samples, each numbered from 0 on."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, float, float, float, float]] = deque(maxlen=KEPT)
        self._count = 0

    @property
    def last(self) -> float:
        """Time of the newest [s]; -inf: there is none."""
        return self._rows[-1][0] if self._rows else -math.inf

    def clear(self) -> None:
        """Forgets all."""
        self._rows.clear()
        self._count = 0

    def add(self, time: float, normal: float, tangential: float, device: float, depth: float) -> None:
        """Takes a sample later than the last [s]: forces [N], depth [m]."""
        self._rows.append((time, normal, tangential, device, 1e3 * depth))
        self._count += 1

    def since(self, seen: int, time: float) -> tuple[bytes, int]:
        """Those after number `seen`, as messages hold them, relative to `time` [s]; and the number of the newest."""
        rows, skipped = self._rows, max(seen + 1 - self._count + len(self._rows), 0)
        # Of ten seconds few are new: they are at the end.
        new = islice(reversed(rows), len(rows) - skipped) if skipped else reversed(rows)
        packed = [_SAMPLE.pack(min(row[0] - time, 0.0), *row[1:]) for row in new]
        packed.reverse()
        return b"".join(packed), self._count - 1

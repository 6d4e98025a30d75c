"""Forces as the page plots them: along the plane's normal, along the plane, and to a device."""

from __future__ import annotations

import math
from collections.abc import Sequence


def split(force: Sequence[float], normal: Sequence[float]) -> tuple[float, float]:
    """Part of a force along a unit normal, positive away from the plane, and what is left, along the plane [N]."""
    (x, y, z), (a, b, c) = force, normal
    push = a * x + b * y + c * z
    return push, math.hypot(x - push * a, y - push * b, z - push * c)

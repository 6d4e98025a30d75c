"""Which tetrahedra lie side by side in lanes: neighbours, as what is near its limit, or turns, lies together.

A group of rows is of four tetrahedra, whether one of them needs it or all (tensor_rows.py). In the order of a mesh
generator a third of the lanes of the default finger had rows; of neighbours it is half.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Floats, Ints
from .lanes import LANES


def side_by_side(points: Floats, tets: Ints) -> Ints:
    """An order (T,) of tetrahedra (T, 4) in which each four, and each LANES, are neighbours.

    They are halved across the longest side of the box of their centres, again and again.
    """
    centres = points[tets].mean(axis=1)
    order, waiting = [], [np.arange(len(tets))]
    while waiting:
        some = waiting.pop()
        if len(some) <= LANES // 2:
            order.append(some)
            continue
        unit = LANES if len(some) > LANES else LANES // 2
        half = max(1, len(some) // (2 * unit)) * unit
        within = centres[some]
        some = some[np.argsort(within[:, np.ptp(within, axis=0).argmax()], kind="stable")]
        waiting += [some[half:], some[:half]]
    return np.concatenate(order)

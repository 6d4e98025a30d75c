"""Array types of this package."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Singles: TypeAlias = NDArray[np.float32]
Bytes: TypeAlias = NDArray[np.uint8]
Ints: TypeAlias = NDArray[np.signedinteger[Any]]


def read_only(array: Floats) -> Floats:
    """A view of an array that cannot be written to."""
    view = array.view()
    view.setflags(write=False)
    return view

"""`Ready`: a Model and a State as compiled code holds them, and what is done with the two (records.py)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types

from ..arrays import Floats
from .kinematics import kinematics
from .methods import NONE, TENSOR
from .model import Model, State
from .records import Pointed
from .step import step
from .strain_limits import find_bounded, strain_ratio
from .tensor_limit import all_strains

KERNELS = (step, all_strains)
"""What `advance` and `measure_strains` call."""


class Ready(NamedTuple):
    """The two, for the functions below; and what these need to know of them themselves."""

    model: Any
    state: Any
    arrays: State
    projection: int
    run: Callable[[Any, Any, Floats, float], None]  # step.step; compiled, without the search for a fitting version


def ready(model: Model, state: State) -> Ready:
    """Both as addresses. A changed Model (with_live_values) needs a new one; arrays are shared, not copied."""
    if numba.config.DISABLE_JIT:
        return Ready(model, state, state, model.projection, step)
    pointed, body = Pointed(model), Pointed(state)
    run = step.compile((pointed.kind, body.kind, types.float64[:, ::1], types.float64))  # type: ignore[attr-defined]
    return Ready(pointed, body, state, model.projection, run)


def advance(both: Ready, targets: Floats, h: float) -> None:
    """See step.step. targets: C-contiguous."""
    both.run(both.model, both.state, targets, h)


def refresh(both: Ready) -> None:
    """Everything that follows from the state's positions, after they were set anew."""
    state = both.arrays
    state.quaternion[:, :3] = 0.0
    state.quaternion[:, 3] = 1.0
    state.tensor.bound[:] = np.inf
    state.tensor.near[:] = 0.0
    state.tensor.frames[:, 3:] = np.eye(3).reshape(9, 1)
    kinematics(both.model, both.state)
    if both.projection != NONE:
        find_bounded(both.model, both.state)
    if both.projection not in (NONE, TENSOR):
        strain_ratio(both.model, both.state)


def measure_strains(both: Ready) -> None:
    """strain/limit of every tetrahedron into state.strain_ratio."""
    all_strains(both.model, both.state)

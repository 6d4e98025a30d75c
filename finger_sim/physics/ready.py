"""`Ready`: a Model and a State as compiled code holds them, so that a call passes two pointers.

Handing the hundred arrays of the two records over takes longer than some stages of a step: it is done once. In kernels
`model` and `state` have the fields of the records; a field that is an array is best fetched once, before a loop.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core import types
from numba.experimental import structref

from ..arrays import Floats
from .compile import kernel
from .kinematics import kinematics
from .model import Model, State
from .step import step
from .strain_limits import NONE, TENSOR, strain_ratio
from .tensor_limit import all_strains, find_near


@structref.register
class _ModelType(types.StructRef):  # type: ignore[misc, name-defined]
    """numba's type of a Model behind a pointer."""


@structref.register
class _StateType(types.StructRef):  # type: ignore[misc, name-defined]
    """numba's type of a State behind a pointer."""


class _ModelReference(structref.StructRefProxy):  # type: ignore[misc]
    """A Model behind a pointer."""


class _StateReference(structref.StructRefProxy):  # type: ignore[misc]
    """A State behind a pointer."""


for _proxy, _type, _record in ((_ModelReference, _ModelType, Model), (_StateReference, _StateType, State)):
    structref.define_boxing(_type, _proxy)
    structref.define_constructor(_proxy, _type, list(_record._fields))
    structref.define_attributes(_type)


class Ready(NamedTuple):
    """The two, for the functions below; and what these need to know of them themselves."""

    model: Any
    state: Any
    arrays: State
    projection: int


@kernel
def _model_reference(model: Model) -> Any:
    return _ModelReference(*model)


@kernel
def _state_reference(state: State) -> Any:
    return _StateReference(*state)


def ready(model: Model, state: State) -> Ready:
    """Both behind pointers. A changed Model (with_live_values) needs a new one; arrays are shared, not copied."""
    if numba.config.DISABLE_JIT:
        return Ready(model, state, state, model.projection)
    return Ready(_model_reference(model), _state_reference(state), state, model.projection)


def advance(both: Ready, targets: Floats, h: float) -> None:
    """See step.step."""
    step(both.model, both.state, targets, h)


def refresh(both: Ready) -> None:
    """Everything that follows from the state's positions, after they were set anew."""
    state = both.arrays
    state.quaternion[:, :3] = 0.0
    state.quaternion[:, 3] = 1.0
    state.bound[:] = np.inf
    kinematics(both.model, both.state)
    if both.projection == TENSOR:
        find_near(both.model, both.state)
    elif both.projection != NONE:
        strain_ratio(both.model, both.state)


def measure_strains(both: Ready) -> None:
    """strain/limit of every tetrahedron into state.strain_ratio."""
    all_strains(both.model, both.state)

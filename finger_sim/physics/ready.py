"""`Ready`: a Model and a State as compiled code holds them, so that a call passes two pointers.

Handing the hundred arrays of the two records over takes longer than some stages of a step: it is done once. In kernels
`model` and `state` have the fields of the records; a record within a record is a pointer of its own. A field that is an
array is best fetched once, before a loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core import types
from numba.experimental import structref

from ..arrays import Floats
from .compile import kernel
from .kinematics import kinematics
from .methods import NONE, TENSOR
from .model import Model, Newton, Patches, Pgs, Principal, State, Tensor, Yielding
from .step import step
from .strain_limits import find_bounded, strain_ratio
from .tensor_limit import all_strains


def _pointers_to(record: Any) -> Callable[[Any], Any]:
    """What puts a record of that class behind a pointer that compiled code can follow."""
    name = f"_{record.__name__}Pointer"
    kind = structref.register(type(f"{name}Type", (types.StructRef,), {"__module__": __name__}))  # type: ignore[attr-defined]
    proxy = type(name, (structref.StructRefProxy,), {"__module__": __name__})
    globals().update({kind.__name__: kind, name: proxy})  # kernels in the cache look types up by name
    structref.define_boxing(kind, proxy)
    structref.define_constructor(proxy, kind, list(record._fields))
    structref.define_attributes(kind)

    @kernel
    def pointer(fields: Any) -> Any:
        return proxy(*fields)

    return pointer


_POINTERS = {
    record: _pointers_to(record) for record in (Model, State, Patches, Newton, Pgs, Yielding, Principal, Tensor)
}
KERNELS = (*_POINTERS.values(), step, all_strains)
"""What `ready`, `advance`, `refresh` and `measure_strains` call: these, and what these call."""


def _pointer(record: Any) -> Any:
    """The record behind a pointer, and so those within it; arrays are shared, not copied."""
    within = {name: _pointer(part) for name, part in record._asdict().items() if type(part) in _POINTERS}
    return _POINTERS[type(record)](record._replace(**within))


class Ready(NamedTuple):
    """The two, for the functions below; and what these need to know of them themselves."""

    model: Any
    state: Any
    arrays: State
    projection: int


def ready(model: Model, state: State) -> Ready:
    """Both behind pointers. A changed Model (with_live_values) needs a new one; arrays are shared, not copied."""
    if numba.config.DISABLE_JIT:
        return Ready(model, state, state, model.projection)
    return Ready(_pointer(model), _pointer(state), state, model.projection)


def advance(both: Ready, targets: Floats, h: float) -> None:
    """See step.step."""
    step(both.model, both.state, targets, h)


def refresh(both: Ready) -> None:
    """Everything that follows from the state's positions, after they were set anew."""
    state = both.arrays
    state.quaternion[:, :3] = 0.0
    state.quaternion[:, 3] = 1.0
    state.tensor.bound[:] = np.inf
    kinematics(both.model, both.state)
    if both.projection != NONE:
        find_bounded(both.model, both.state)
    if both.projection not in (NONE, TENSOR):
        strain_ratio(both.model, both.state)


def measure_strains(both: Ready) -> None:
    """strain/limit of every tetrahedron into state.strain_ratio."""
    all_strains(both.model, both.state)

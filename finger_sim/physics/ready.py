"""`Ready`: a Model and a State as compiled code holds them, and what is done with the two (records.py)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.extending import overload

from ..arrays import Floats
from .apart import bound, needed_by
from .beside import compiled_beside
from .kinematics import kinematics
from .methods import NONE, TENSOR
from .model import Model, State
from .others import address_of, call_at
from .records import Pointed, changed
from .step import step
from .strain_limits import find_bounded, strain_ratio
from .svd import decompose
from .tensor_limit import all_strains

_REST = (types.float64[:, ::1], types.float64)
"""numba's types of what a step takes beside a Model and a State."""


def kernels(model: Model) -> tuple[Any, ...]:
    """What `advance`, `refresh` and `measure_strains` call for a model."""
    return (step, kinematics, find_bounded, strain_ratio, all_strains, *needed_by(model).values())


@contextlib.contextmanager
def step_beside(model: Model, state: State) -> Iterator[Model]:
    """A block for what does not need the step: meanwhile a second process compiles it, where it is not there yet.

    Gives the Model with all addresses that `ready` would find (apart.py).
    """
    if numba.config.DISABLE_JIT:
        yield model
        return
    body = Pointed(state).kind
    with compiled_beside(step, (Pointed(model).kind, body, *_REST)):
        yield bound(model, body)


class Ready(NamedTuple):
    """The two, for the functions below; and what these need to know of them themselves."""

    model: Any
    state: Any
    arrays: State
    projection: int
    run: Callable[[Any, Any, Floats, float], None]  # step.step; compiled, without the search for a fitting version
    address: int  # of its machine code, for `step_at`


def ready(model: Model, state: State, before: Ready | None = None) -> Ready:
    """Both as addresses; arrays are shared, not copied.

    A changed Model (with_live_values) needs a new one, which is soon made of the one before with the same State.
    """
    if numba.config.DISABLE_JIT:
        return Ready(model, state, state, model.projection, step, 0)
    if before is not None:
        return before._replace(model=changed(before.model, model))
    body = Pointed(state)
    pointed = Pointed(bound(model, body.kind))
    kinds = (pointed.kind, body.kind, *_REST)
    run = step.compile(kinds)  # type: ignore[attr-defined]
    return Ready(pointed, body, state, model.projection, run, address_of(step, kinds))


def step_at(address: int, model: Any, state: Any, targets: Floats, h: float) -> None:
    """`advance` for kernels: step.step by the address of its machine code, which is not linked in once more."""
    step(model, state, targets, h)


@overload(step_at)
def _step_at(address, model, state, targets, h):  # type: ignore  # numba compares this line with the next
    return lambda address, model, state, targets, h: call_at(address, model, state, targets, h)


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
    if both.projection not in (NONE, TENSOR):
        decompose(both.model, both.state)
    if both.projection != NONE:
        find_bounded(both.model, both.state)
    if both.projection not in (NONE, TENSOR):
        strain_ratio(both.model, both.state)


def strains_of(both: Ready, bounded: Floats, ratios: Floats) -> Floats:
    """strain/limit of every tetrahedron (T,), for copies of state.limit_strain and strain_ratio, flat."""
    if both.projection == TENSOR:
        copies = both.arrays._replace(limit_strain=bounded.reshape(both.arrays.limit_strain.shape), strain_ratio=ratios)
        all_strains(both.model, changed(both.state, copies))
    return ratios


def measure_strains(both: Ready) -> None:
    """strain/limit of every tetrahedron into state.strain_ratio."""
    all_strains(both.model, both.state)

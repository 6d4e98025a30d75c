"""Kernels that a step calls by address: compiled for the scenes that need them, when one first does.

Projected Gauss-Seidel and limits on principal stretches take a quarter of the time to compile a step, and most scenes
have neither; few relax. A Model has the addresses; 0: not needed (`bound`).
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import overload

from . import pgs, relaxation, strain_limits, svd
from .methods import NONE, PGS, TENSOR
from .model import Model, State
from .others import address_of, calls
from .records import Pointed


def needed_by(model: Model) -> dict[str, Any]:
    """Of the fields of the Model with addresses, those that its steps use, and the kernels."""
    needed: dict[str, Any] = {}
    if model.method == PGS:
        needed["sweeps_at"] = pgs.solve_by_sweeps
    if model.projection not in (NONE, TENSOR):
        needed["decompose_at"], needed["limit_rows_at"] = svd.decompose, strain_limits.limit_rows
    if len(model.relaxation):
        needed["relax_at"] = relaxation.relax
    return needed


def bound(model: Model, state: Any) -> Model:
    """The Model with the addresses, once all is compiled or loaded. state: numba's type of its State."""
    more = {"decompose_at": (), "limit_rows_at": _ROWS, "sweeps_at": _SWEEPS, "relax_at": _ROWS}
    addresses: dict[str, Any] = {}
    for field, kernel in needed_by(model).items():
        if getattr(model, field) != 0:
            continue
        given = (Pointed(model).kind, state, *more[field])
        kernel.compile(given)
        addresses[field] = address_of(kernel, given)
    return model._replace(**addresses)


_ROWS = (types.float64, types.int64)
_SWEEPS = (types.float64, types.int64, types.int64)
_no_result, _rows, _solution = calls(types.none), calls(types.int64), calls(types.Tuple((types.int64, types.float64)))


def decompose(model: Model, state: State) -> None:
    """svd.decompose."""
    svd.decompose(model, state)


def limit_rows(model: Model, state: State, h: float, contacts: int) -> int:
    """strain_limits.limit_rows."""
    return strain_limits.limit_rows(model, state, h, contacts)


def relax(model: Model, state: State, h: float, when: int) -> None:
    """relaxation.relax."""
    relaxation.relax(model, state, h, when)


def solve_by_sweeps(model: Model, state: State, h: float, contacts: int, rows: int) -> tuple[int, float]:
    """pgs.solve_by_sweeps."""
    return pgs.solve_by_sweeps(model, state, h, contacts, rows)


# numba compares the arguments of an overload with those of what it is for, and of what it returns
@overload(decompose)
def _decompose(model, state):  # type: ignore
    return lambda model, state: _no_result(model.decompose_at, model, state)


@overload(limit_rows)
def _limit_rows(model, state, h, contacts):  # type: ignore
    return lambda model, state, h, contacts: _rows(model.limit_rows_at, model, state, h, contacts)


@overload(relax)
def _relax(model, state, h, when):  # type: ignore
    return lambda model, state, h, when: _no_result(model.relax_at, model, state, h, when)


@overload(solve_by_sweeps)
def _solve_by_sweeps(model, state, h, contacts, rows):  # type: ignore
    return lambda model, state, h, contacts, rows: _solution(model.sweeps_at, model, state, h, contacts, rows)

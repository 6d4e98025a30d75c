r"""Rows along a direction d: how their gaps change, and how far there is still to go, for a few numbers a row.

At δ + s d a row has the gap g + s ġ, ġ = h J d. Of the residual r there (newton.py), the part along d,

    dᵀr = dᵀ(b − A (v + δ)) − s dᵀA d + Σ_i ġ_i λ_i(g_i + s ġ_i),

takes no sum at the nodes: a line search tries as many s as it likes, and forms r once.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .bone import bone_slope
from .compile import formula, stage
from .dilatation import patch_rates
from .lanes import lane, load4, maximum, pick4, splat4, store4, sum3
from .methods import TENSOR
from .model import Model, State
from .tensor_rows import CONSTANT, STIFFNESS, double_dot, load_group, rate_of
from .vectors import copy_first


@stage
def row_rates(model: Model, state: State, h: float, contacts: int, rows: int, direction: Floats) -> None:
    """ġ of all rows along `direction`, in slot order, into Newton.rate and Tensor.rate."""
    J, row_slot, row_tet, row_part, rates = state.J, state.row_slot, state.row_tet, state.row_part, state.newton.rate
    own, patched = model.patches, model.patches.volume.shape[0] > 0
    for row in range(contacts):
        rates[row] = h * sum3(load4(J, row, 0) * load4(direction, row_slot[row, 0], 0))
    if patched:
        patch_rates(model, state, own.slot, direction)
    if model.projection == TENSOR:
        tensor_rates(model, state, h, direction)
        return
    for row in range(contacts, rows):
        moved = load4(J, row, 0) * load4(direction, row_slot[row, 0], 0)
        for n in range(1, 4):
            moved = moved + load4(J, row, n) * load4(direction, row_slot[row, n], 0)
        rates[row] = h * sum3(moved)
        if patched:
            t = row_tet[row]
            rates[row] += h * row_part[row] * state.patch_rate[own.lane[t // 8, t % 8]]


@stage
def tensor_rates(model: Model, state: State, h: float, direction: Floats) -> None:
    """The same of the `tensor` limit's rows; state.patch_rate has that of patches."""
    tensor, own, swelling = state.tensor, model.patches, splat4(0.0)
    first, keys, patched = tensor.first, tensor.key, own.volume.shape[0] > 0
    for four in range(first.shape[0] - 1):
        if first[four] == first[four + 1]:
            continue
        b, half = four // 2, four % 2
        rate = rate_of(direction, model.lane_slot, model.lane_gradients, b, half)
        if patched:
            swelling = pick4(state.patch_rate, own.lane, b, half) * (1.0 / 3.0)
        for k in range(first[four], first[four + 1]):
            outwards = 2.0 * (keys[k] % 2) - 1.0
            total = double_dot(load_group(tensor.slope, k), rate)
            store4(tensor.rate, k, 0, h * (total + outwards * swelling))


@stage
def begin_gaps(model: Model, state: State, contacts: int, rows: int) -> None:
    """g at δ = 0."""
    tensor = state.tensor
    copy_first(state.newton.gap, state.constant, contacts if model.projection == TENSOR else rows)
    for k in range(tensor.first[tensor.first.shape[0] - 1]):
        store4(tensor.gap, k, 0, load4(tensor.row, k, CONSTANT))


@stage
def move_gaps(model: Model, state: State, contacts: int, rows: int, part: float) -> None:
    """g += part · ġ."""
    gaps, rates, tensor = state.newton.gap, state.newton.rate, state.tensor
    packed = contacts if model.projection == TENSOR else rows
    for row in range(packed):
        gaps[row] += part * rates[row]
    for k in range(tensor.first[tensor.first.shape[0] - 1]):
        store4(tensor.gap, k, 0, load4(tensor.gap, k, 0) + part * load4(tensor.rate, k, 0))


@stage
def row_slope(model: Model, state: State, h: float, contacts: int, rows: int, part: float) -> float:
    """Σ ġ λ at δ + part · d, with what spring and stop of a yielding bone give."""
    own, tensor, compliance = state.newton, state.tensor, state.compliance
    gaps, rates, total = own.gap, own.rate, 0.0
    for c in range(contacts // 3):
        row = 3 * c
        normal, a, b, share = pressed_by(
            model, state, c, gaps[row] + part * rates[row], gaps[row + 1] + part * rates[row + 1],
            gaps[row + 2] + part * rates[row + 2],
        )  # fmt: skip
        total += normal * rates[row] + share * (a * rates[row + 1] + b * rates[row + 2])
    if model.projection == TENSOR:
        sums = none = splat4(0.0)
        for k in range(tensor.first[tensor.first.shape[0] - 1]):
            rate = load4(tensor.rate, k, 0)
            gap = load4(tensor.gap, k, 0) + part * rate
            sums = sums + rate * maximum(-gap * load4(tensor.row, k, STIFFNESS), none)
        total += lane(sums, 0) + lane(sums, 1) + lane(sums, 2) + lane(sums, 3)
    else:
        for row in range(contacts, rows):
            total += rates[row] * max(0.0, -(gaps[row] + part * rates[row]) / compliance[row])
    if model.has_bone:
        total += bone_slope(model, state, h, own.change, own.direction, part)
    return total


@formula
def pressed_by(model: Model, state: State, c: int, n: float, p: float, q: float) -> tuple[float, float, float, float]:
    """Force of a contact at its gaps: normal, along both tangents if it sticks, and the share of these that is left."""
    own, row, compliance = state.newton, 3 * c, state.compliance
    normal = max(0.0, -n / compliance[row])
    cone = own.bound[c] if own.holds[0] != 0 else model.mu_friction * normal
    a, b = -p / compliance[row + 1], -q / compliance[row + 2]
    size, share = math.sqrt(a * a + b * b), 1.0 if cone > 0.0 else 0.0
    if size > cone:
        share = cone / size
    return normal, a, b, share

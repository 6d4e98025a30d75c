"""Sparse block LDLᵀ of a symmetric positive definite matrix of 3 × 3 blocks: ordered once, factored each step.

A = L D Lᵀ with L unit lower triangular, in an elimination order found once by minimum degree (on A's graph).
Block row and column numbers below are positions in that order ("slots"). See Davis, *Direct Methods for Sparse
Linear Systems*, ch. 4 and 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from ..arrays import Floats, Ints
from .compile import kernel

NODE_LANES = 16  # right-hand sides solved together are those of so many nodes:
LANES = 3 * NODE_LANES  # a fixed, contiguous inner loop that vectorises


class Pattern(NamedTuple):
    """Where the blocks of A and L are. `nf` block rows; `nnz` blocks of L below its diagonal."""

    order: Ints  # (nf,) graph node of each slot
    slot: Ints  # (nf,) slot of each graph node
    start: Ints  # (nf + 1,) first block of each column of L
    row: Ints  # (nnz,) slot of each block's row, ascending in a column
    target: Ints  # (updates,) block that each off-diagonal update of the factorisation subtracts from


def analyse(edges: Ints, nodes: int) -> Pattern:
    """Elimination order and fill for the graph with the given edges, (k, 2), over `nodes` nodes."""
    order = _minimum_degree(edges, nodes)
    slot = np.empty(nodes, np.int64)
    slot[order] = np.arange(nodes)
    below: list[set[int]] = [set() for _ in range(nodes)]
    for a, b in slot[edges.reshape(-1, 2)]:
        if a != b:
            below[min(a, b)].add(int(max(a, b)))
    columns = []
    for k in range(nodes):
        column = sorted(below[k])
        columns.append(column)
        if column:
            below[column[0]].update(column[1:])
    start = np.concatenate([[0], np.cumsum([len(c) for c in columns])]).astype(np.int64)
    position = [{r: int(start[k]) + i for i, r in enumerate(c)} for k, c in enumerate(columns)]
    target = [position[c[b]][c[a]] for c in columns for a in range(len(c) - 1, -1, -1) for b in range(a)]
    row = np.array([r for c in columns for r in c], np.int64)
    return Pattern(order.astype(np.int64), slot, start, row, np.array(target, np.int64))


def _minimum_degree(edges: Ints, nodes: int) -> Ints:
    """Minimum-degree order of AᵀA's cheaper sibling A + Aᵀ, as SuperLU computes it."""
    if nodes == 0:
        return np.empty(0, np.int64)
    ends = edges.reshape(-1, 2)
    ones = np.ones(len(ends))
    graph = scipy.sparse.coo_matrix((ones, (ends[:, 0], ends[:, 1])), shape=(nodes, nodes))
    dominant = graph + graph.T + scipy.sparse.identity(nodes) * (4.0 * nodes + 4.0)
    factor = scipy.sparse.linalg.splu(
        dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    order = np.empty(nodes, np.int64)
    order[factor.perm_c] = np.arange(nodes)
    return order


def block_of(pattern: Pattern, row_slot: int, column_slot: int) -> int:
    """Index of L's (and A's) block at (row, column), row > column, both slots; it must be in the pattern."""
    first, last = pattern.start[column_slot], pattern.start[column_slot + 1]
    return int(first + np.searchsorted(pattern.row[first:last], row_slot))


@kernel
def factor(pattern: Pattern, diagonal: Floats, lower: Floats, inverse: Floats) -> bool:
    """Turn A (diagonal, lower) into L (lower) and D⁻¹ (inverse), in place. False if A is not positive definite.

    diagonal (nf, 3, 3), lower (nnz, 3, 3), inverse (nf, 3, 3).
    """
    update = 0
    for k in range(diagonal.shape[0]):
        a, b, c = diagonal[k, 0, 0], diagonal[k, 1, 0], diagonal[k, 2, 0]
        d, e, f = diagonal[k, 1, 1], diagonal[k, 2, 1], diagonal[k, 2, 2]
        i00, i10, i20 = d * f - e * e, c * e - b * f, b * e - c * d
        minor = a * d - b * b
        det = a * i00 + b * i10 + c * i20
        if not (a > 0.0 and minor > 0.0 and det > 0.0):
            return False
        i00, i10, i20 = i00 / det, i10 / det, i20 / det
        i11, i21, i22 = (a * f - c * c) / det, (b * c - a * e) / det, minor / det
        inverse[k, 0, 0], inverse[k, 1, 1], inverse[k, 2, 2] = i00, i11, i22
        inverse[k, 0, 1] = inverse[k, 1, 0] = i10
        inverse[k, 0, 2] = inverse[k, 2, 0] = i20
        inverse[k, 1, 2] = inverse[k, 2, 1] = i21
        first = pattern.start[k]
        for p in range(pattern.start[k + 1] - 1, first - 1, -1):
            B = lower[p]
            x0, x1, x2 = B[0, 0], B[0, 1], B[0, 2]
            y0, y1, y2 = B[1, 0], B[1, 1], B[1, 2]
            z0, z1, z2 = B[2, 0], B[2, 1], B[2, 2]
            l00, l01, l02 = (
                x0 * i00 + x1 * i10 + x2 * i20,
                x0 * i10 + x1 * i11 + x2 * i21,
                x0 * i20 + x1 * i21 + x2 * i22,
            )
            l10, l11, l12 = (
                y0 * i00 + y1 * i10 + y2 * i20,
                y0 * i10 + y1 * i11 + y2 * i21,
                y0 * i20 + y1 * i21 + y2 * i22,
            )
            l20, l21, l22 = (
                z0 * i00 + z1 * i10 + z2 * i20,
                z0 * i10 + z1 * i11 + z2 * i21,
                z0 * i20 + z1 * i21 + z2 * i22,
            )
            for q in range(first, p + 1):
                B = lower[q]
                if q == p:
                    T = diagonal[pattern.row[p]]
                else:
                    T = lower[pattern.target[update]]
                    update += 1
                for j in range(3):
                    b0, b1, b2 = B[j, 0], B[j, 1], B[j, 2]
                    T[0, j] -= l00 * b0 + l01 * b1 + l02 * b2
                    T[1, j] -= l10 * b0 + l11 * b1 + l12 * b2
                    T[2, j] -= l20 * b0 + l21 * b1 + l22 * b2
            B = lower[p]
            B[0, 0], B[0, 1], B[0, 2] = l00, l01, l02
            B[1, 0], B[1, 1], B[1, 2] = l10, l11, l12
            B[2, 0], B[2, 1], B[2, 2] = l20, l21, l22
    return True


@kernel
def solve(pattern: Pattern, lower: Floats, inverse: Floats, y: Floats) -> None:
    """Replace y (nf, 3), in slot order, by A⁻¹ y."""
    nf = inverse.shape[0]
    for k in range(nf):
        y0, y1, y2 = y[k, 0], y[k, 1], y[k, 2]
        for p in range(pattern.start[k], pattern.start[k + 1]):
            L, i = lower[p], pattern.row[p]
            for r in range(3):
                y[i, r] -= L[r, 0] * y0 + L[r, 1] * y1 + L[r, 2] * y2
    for k in range(nf - 1, -1, -1):
        D = inverse[k]
        y0, y1, y2 = y[k, 0], y[k, 1], y[k, 2]
        z0 = D[0, 0] * y0 + D[0, 1] * y1 + D[0, 2] * y2
        z1 = D[1, 0] * y0 + D[1, 1] * y1 + D[1, 2] * y2
        z2 = D[2, 0] * y0 + D[2, 1] * y1 + D[2, 2] * y2
        for p in range(pattern.start[k], pattern.start[k + 1]):
            L, i = lower[p], pattern.row[p]
            x0, x1, x2 = y[i, 0], y[i, 1], y[i, 2]
            z0 -= L[0, 0] * x0 + L[1, 0] * x1 + L[2, 0] * x2
            z1 -= L[0, 1] * x0 + L[1, 1] * x1 + L[2, 1] * x2
            z2 -= L[0, 2] * x0 + L[1, 2] * x1 + L[2, 2] * x2
        y[k, 0], y[k, 1], y[k, 2] = z0, z1, z2


@kernel
def solve_lanes(pattern: Pattern, lower: Floats, inverse: Floats, first: int, reached: Ints, Y: Floats) -> None:
    """Replace the LANES right-hand sides Y (nf, 3, LANES) by A⁻¹ Y, from slot `first` on.

    Slots before `first` must be zero on entry; they are not computed. reached (nf,): 0 where Y is zero, so that
    the way down the elimination tree passes such slots over; changed on the way.
    """
    nf = inverse.shape[0]
    for k in range(first, nf):
        if reached[k] == 0:
            continue
        for p in range(pattern.start[k], pattern.start[k + 1]):
            L = lower[p]
            reached[pattern.row[p]] = 1
            _subtract(
                Y[pattern.row[p]], Y[k], L[0, 0], L[0, 1], L[0, 2], L[1, 0], L[1, 1], L[1, 2], L[2, 0], L[2, 1], L[2, 2]
            )
    for k in range(nf - 1, first - 1, -1):
        D, y = inverse[k], Y[k]
        d00, d10, d20, d11, d21, d22 = D[0, 0], D[1, 0], D[2, 0], D[1, 1], D[2, 1], D[2, 2]
        for l in range(LANES):
            y0, y1, y2 = y[0, l], y[1, l], y[2, l]
            y[0, l] = d00 * y0 + d10 * y1 + d20 * y2
            y[1, l] = d10 * y0 + d11 * y1 + d21 * y2
            y[2, l] = d20 * y0 + d21 * y1 + d22 * y2
        for p in range(pattern.start[k], pattern.start[k + 1]):
            L = lower[p]
            _subtract(
                y, Y[pattern.row[p]], L[0, 0], L[1, 0], L[2, 0], L[0, 1], L[1, 1], L[2, 1], L[0, 2], L[1, 2], L[2, 2]
            )


@kernel
def _subtract(
    y: Floats, x: Floats, a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, i: float
) -> None:
    """y −= [a b c; d e f; g h i] x for (3, LANES) arrays."""
    for l in range(LANES):
        x0, x1, x2 = x[0, l], x[1, l], x[2, l]
        y[0, l] = y[0, l] - a * x0 - b * x1 - c * x2
        y[1, l] = y[1, l] - d * x0 - e * x1 - f * x2
        y[2, l] = y[2, l] - g * x0 - h * x1 - i * x2

"""The order in which a sparse symmetric matrix of 3 × 3 blocks is factored, and what fills: found once for a graph.

Minimum degree on A's graph, or nested dissection where that fills less, put into postorder. Block row and column
numbers are positions in that order ("slots"). See Davis, *Direct Methods for Sparse Linear Systems*, ch. 4 and 7.

A *panel* is a run of neighbouring columns with the same rows below it (a fundamental supernode, or a part of one).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from ..arrays import Ints
from .dissection import Graph, dissect
from .lanes import aligned
from .model import Pattern

FEWEST_WORTH, PRODUCTS = 9, 6
"""Iterations that new factors are worth at least: their matrix costs some. Products of blocks that `factor` makes while
an iteration passes over a block of L."""
LARGE = 500  # nodes from which on a second order is tried: below, minimum degree is the better one
WIDEST = 16  # columns of a panel: two rows and two columns of it are read from a near cache again and again


def analyse(edges: Ints, nodes: int) -> Pattern:
    """Elimination order and fill for the graph with the given edges, (k, 2), over `nodes` nodes."""
    order, below = _least_filled(edges.reshape(-1, 2), nodes)
    post = _postorder(below)
    order, place = order[post], _inverse(post)
    columns = [np.sort(place[list(below[k])]) if below[k] else np.empty(0, np.int64) for k in post]
    lengths = np.array([len(c) for c in columns], np.int64)
    start = np.concatenate([[0], np.cumsum(lengths)])
    row = np.concatenate([*columns, np.empty(0, np.int64)])
    panel = _panels(columns)
    rows_below = [columns[last - 1] for last in panel[1:]]
    widths = np.diff(panel)
    wanted = [_updates(rows, int(w), nodes) for rows, w in zip(rows_below, widths, strict=True)]
    target = _places(np.concatenate([*wanted, np.empty(0, np.int64)]), np.repeat(np.arange(nodes), lengths), row, nodes)
    pairs = max((int(w * ((w + len(rows)) // 2 + 2)) for w, rows in zip(widths, rows_below, strict=True)), default=0)
    products = int((lengths * (lengths + 1)).sum()) // 2
    worth = max(FEWEST_WORTH, products // (PRODUCTS * max(1, len(row))))
    return Pattern(
        order, _inverse(order), start, row, panel, target, aligned(2 * pairs, 3, 4), aligned(pairs, 3, 8), worth
    )


def _inverse(permutation: Ints) -> Ints:
    inverse = np.empty(len(permutation), np.int64)
    inverse[permutation] = np.arange(len(permutation))
    return inverse


def _least_filled(edges: Ints, nodes: int) -> tuple[Ints, list[set[int]]]:
    """An order of the nodes, and the rows of each column of L in it (`_fill`): that which takes the fewer products."""
    if nodes == 0:
        return np.empty(0, np.int64), []
    ends = edges[edges[:, 0] != edges[:, 1]]
    once = scipy.sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(nodes, nodes))
    graph = scipy.sparse.csr_matrix(once + once.T)
    graph.data[:] = 1.0
    orders = [_minimum_degree(graph)]
    if nodes >= LARGE:
        orders.append(dissect(graph, _minimum_degree))
    filled = [(order, _fill(ends, order)) for order in orders]
    return min(filled, key=lambda found: sum(len(rows) * (len(rows) + 1) for rows in found[1]))


def _minimum_degree(graph: Graph) -> Ints:
    """Minimum-degree order of AᵀA's cheaper sibling A + Aᵀ, as SuperLU computes it."""
    nodes = graph.shape[0]
    dominant = graph + scipy.sparse.identity(nodes) * (4.0 * nodes + 4.0)
    factor = scipy.sparse.linalg.splu(
        dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return _inverse(factor.perm_c)


def _fill(edges: Ints, order: Ints) -> list[set[int]]:
    """Rows of each column of L, numbered by place in `order`: A's own, and those of the columns it is the parent of."""
    below: list[set[int]] = [set() for _ in order]
    for a, b in _inverse(order)[edges].tolist():
        below[min(a, b)].add(max(a, b))
    for column in below:
        if column:
            parent = min(column)
            below[parent] |= column - {parent}
    return below


def _postorder(below: list[set[int]]) -> Ints:
    """The columns with each one right after its descendants in the elimination tree, its fullest child last."""
    children: list[list[int]] = [[] for _ in range(len(below) + 1)]
    for k in sorted(range(len(below)), key=lambda k: len(below[k])):
        children[min(below[k], default=-1)].append(k)
    backwards, waiting = [], children[-1]
    while waiting:
        backwards.append(waiting.pop())
        waiting.extend(children[backwards[-1]])
    return np.array(backwards[::-1], np.int64)


def _panels(columns: list[Ints]) -> Ints:
    """First column of each panel, and the end: k joins k - 1 if k is its first row and has all of its other rows."""
    firsts = [0] if columns else []
    for k in range(1, len(columns)):
        before = columns[k - 1]
        joins = len(before) == len(columns[k]) + 1 and before[0] == k
        if not joins or k - firsts[-1] == WIDEST:
            firsts.append(k)
    return np.array([*firsts, len(columns)], np.int64)


def _updates(rows: Ints, width: int, nodes: int) -> Ints:
    """column * nodes + row of what `factor` subtracts a panel's products from: two columns and two rows at a time.

    rows: below the panel. −1: above the diagonal, or in no column or row below the panel.
    """
    first = width // 2
    column, row = np.triu_indices((width + len(rows) + 1) // 2 - first)
    at = np.concatenate([np.full(width - 2 * first, -1), rows, [-1]])
    c, r = (2 * column[:, None] + [0, 0, 1, 1], 2 * row[:, None] + [0, 1, 0, 1])
    c, r = np.where(r < c, -1, at[c]).reshape(-1), at[r].reshape(-1)
    return np.where((c < 0) | (r < 0), -1, c * nodes + r)


def _places(wanted: Ints, column: Ints, row: Ints, nodes: int) -> Ints:
    """Where `factor` has the blocks `wanted` (`_updates`), of L's blocks by columns and rows: see there."""
    below = nodes + np.searchsorted(column * nodes + row, wanted)
    place = np.where(wanted // nodes == wanted % nodes, wanted % nodes, below)
    return np.asarray(np.where(wanted < 0, nodes + len(row), place))


def block_of(pattern: Pattern, row_slot: int, column_slot: int) -> int:
    """Index of L's (and A's) block at (row, column), row > column, both slots; it must be in the pattern."""
    first, last = pattern.start[column_slot], pattern.start[column_slot + 1]
    return int(first + np.searchsorted(pattern.row[first:last], row_slot))

r"""Polar decomposition F = R U of eight tetrahedra side by side, without a singular value decomposition.

R is the rotation that maximises tr(RᵀF). With M = RᵀF = S + skew, S symmetric and a = axial(skew) the gradient,
R ← R exp([w]), (tr(S) I − S) w = a, is Newton's method on it; it converges cubically, since the function is even
about its maximum. tr(RᵀF) is a quadratic form of R's unit quaternion (Davenport), so that a stationary point with
tr(S) I − S positive definite is the maximum itself, also where F is inverted. Warm-started from the last step's
quaternion it takes one or two iterations. Where Newton is lost (a turn by 180°, a collapsed tetrahedron) the quaternion
is the dominant eigenvector of the 4 × 4 matrix of that form, by Jacobi's method; of several, the nearest to the last.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import formula, stage
from .jacobi import diagonalise4
from .lanes import Lanes, bits, lane, load8, splat8, sqrt, store8, where
from .turns import matrix_entries

Matrix = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]  # by rows
Quaternion = tuple[Lanes, Lanes, Lanes, Lanes]  # x y z w, at length one

_ITERATIONS = 6
_FLAT = 1e-12  # det (tr(S) I − S) / its trace³ up to which all rotations about an axis are as good, but for round-off
_SAME = 1e-12  # likewise, difference of eigenvalues in units of F's largest entry
_EXACT, _CLOSE = (
    1e-10,
    4e-6,
)  # angle² of the last iteration: the error after it is of order angle³, 1e-15 and 4e-9 rad


rotation = matrix_entries
"""R of unit quaternions, by rows."""


@formula
def transposed_times(A: Matrix, B: Matrix) -> Matrix:
    """Aᵀ B."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = A
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = B
    return (
        a0 * b0 + a3 * b3 + a6 * b6, a0 * b1 + a3 * b4 + a6 * b7, a0 * b2 + a3 * b5 + a6 * b8,
        a1 * b0 + a4 * b3 + a7 * b6, a1 * b1 + a4 * b4 + a7 * b7, a1 * b2 + a4 * b5 + a7 * b8,
        a2 * b0 + a5 * b3 + a8 * b6, a2 * b1 + a5 * b4 + a8 * b7, a2 * b2 + a5 * b5 + a8 * b8,
    )  # fmt: skip


@formula
def load_matrix(a: Floats, b: int) -> Matrix:
    """Eight matrices from entry b of a (B, 9, 8)."""
    return (
        load8(a, b, 0), load8(a, b, 1), load8(a, b, 2), load8(a, b, 3), load8(a, b, 4), load8(a, b, 5),
        load8(a, b, 6), load8(a, b, 7), load8(a, b, 8),
    )  # fmt: skip


@formula
def store_matrix(a: Floats, b: int, A: Matrix) -> None:
    """Write eight matrices to entry b of a (B, 9, 8)."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = A
    store8(a, b, 0, a0)
    store8(a, b, 1, a1)
    store8(a, b, 2, a2)
    store8(a, b, 3, a3)
    store8(a, b, 4, a4)
    store8(a, b, 5, a5)
    store8(a, b, 6, a6)
    store8(a, b, 7, a7)
    store8(a, b, 8, a8)


@stage
def polar(F: Matrix, quaternion: Floats, b: int, scratch: Floats, exact: bool) -> tuple[Matrix, Matrix]:
    """R and RᵀF of F, from the quaternions in entry b of `quaternion` (B, 4, 8), which are brought up to date.

    scratch (2, 4, 4). exact: to round-off.
    """
    q = load8(quaternion, b, 0), load8(quaternion, b, 1), load8(quaternion, b, 2), load8(quaternion, b, 3)
    undone = 0
    for _ in range(_ITERATIONS):
        q, lost, far = newton(F, q, _EXACT if exact else _CLOSE)
        undone = lost | far
        if far == 0:
            break
    x, y, z, w = q
    store8(quaternion, b, 0, x)
    store8(quaternion, b, 1, y)
    store8(quaternion, b, 2, z)
    store8(quaternion, b, 3, w)
    if undone != 0:
        for l in range(8):
            if (undone >> l) & 1:
                _from_scratch(F, l, scratch[0], scratch[1], quaternion[b])
        q = load8(quaternion, b, 0), load8(quaternion, b, 1), load8(quaternion, b, 2), load8(quaternion, b, 3)
    R = rotation(q)
    return R, transposed_times(R, F)


@formula
def newton(F: Matrix, q: Quaternion, close: float) -> tuple[Quaternion, int, int]:
    """One iteration. Also which lanes have no maximum near (they stay), and which moved too far to be done."""
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = transposed_times(rotation(q), F)
    a0, a1, a2 = m7 - m5, m2 - m6, m3 - m1
    t00, t11, t22 = m4 + m8, m0 + m8, m0 + m4
    t12, t02, t01 = -0.5 * (m5 + m7), -0.5 * (m2 + m6), -0.5 * (m1 + m3)
    c00, c01, c02 = t11 * t22 - t12 * t12, t02 * t12 - t01 * t22, t01 * t12 - t02 * t11
    c11, c12, c22 = t00 * t22 - t02 * t02, t01 * t02 - t00 * t12, t00 * t11 - t01 * t01
    det = t00 * c00 + t01 * c01 + t02 * c02
    trace = t00 + t11 + t22
    found = (t00 > 0.0) & (c22 > 0.0) & (det > _FLAT * (trace * trace * trace))
    half = 0.5 / where(found, det, splat8(1.0))
    w0, w1, w2 = (
        half * (c00 * a0 + c01 * a1 + c02 * a2),
        half * (c01 * a0 + c11 * a1 + c12 * a2),
        half * (c02 * a0 + c12 * a1 + c22 * a2),
    )
    size = w0 * w0 + w1 * w1 + w2 * w2
    found = found & (size < 1.0)
    zero = splat8(0.0)
    w0, w1, w2 = where(found, w0, zero), where(found, w1, zero), where(found, w2, zero)
    x, y, z, w = q
    nx, ny, nz = x + w * w0 + y * w2 - z * w1, y + w * w1 + z * w0 - x * w2, z + w * w2 + x * w1 - y * w0
    nw = w - x * w0 - y * w1 - z * w2
    scale = 1.0 / sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
    return (nx * scale, ny * scale, nz * scale, nw * scale), 255 - bits(found), bits(found & (size > 0.25 * close))


@stage
def _from_scratch(F: Matrix, l: int, N: Floats, V: Floats, quaternion: Floats) -> None:
    """Quaternion of lane l of F: the dominant eigenvector of N (4, 4), tr(RᵀF) = qᵀ N q; V (4, 4): scratch.

    Of several that are as good, as of a tetrahedron that is a mirror image or a point, the nearest to what it was:
    round-off would choose another one for each tetrahedron, and a body that is inside out would stay entangled.
    """
    largest = 0.0
    for k, entry in enumerate(F):
        N[k // 3, k % 3] = lane(entry, l)
        largest = max(largest, abs(N[k // 3, k % 3]))
    scale = 1.0 / largest if largest > 0.0 else 1.0
    for i in range(3):
        for j in range(3):
            N[i, j] *= scale
    trace = N[0, 0] + N[1, 1] + N[2, 2]
    N[0, 3], N[1, 3], N[2, 3] = N[2, 1] - N[1, 2], N[0, 2] - N[2, 0], N[1, 0] - N[0, 1]
    for i in range(3):
        for j in range(i):
            N[i, j] = N[j, i] = N[i, j] + N[j, i]
        N[i, i] = 2.0 * N[i, i] - trace
        N[3, i] = N[i, 3]
    N[3, 3] = trace
    diagonalise4(N, V)
    best = 0
    for k in range(1, 4):
        if N[k, k] > N[best, best]:
            best = k
    x = y = z = w = 0.0
    for k in range(4):
        if N[k, k] >= N[best, best] - _SAME:
            part = 0.0
            for i in range(4):
                part += V[i, k] * quaternion[i, l]
            x, y, z, w = x + part * V[0, k], y + part * V[1, k], z + part * V[2, k], w + part * V[3, k]
    size = math.sqrt(x * x + y * y + z * z + w * w)
    if not size > _SAME:
        x, y, z, w = V[0, best], V[1, best], V[2, best], V[3, best]
        size = math.sqrt(x * x + y * y + z * z + w * w)
    quaternion[0, l], quaternion[1, l], quaternion[2, l], quaternion[3, l] = x / size, y / size, z / size, w / size

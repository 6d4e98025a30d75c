r"""Jacobi's method: a symmetric matrix becomes diagonal by rotations that make one entry vanish at a time.

In the plane of axes p and q the rotation by θ, tan 2θ = 2 B_pq / (B_qq − B_pp), |θ| ≤ π/4, makes B_pq vanish (Golub &
Van Loan, *Matrix Computations*, ch. 8.5); axes keep their places. Sweeps over all planes converge quadratically.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import formula, kernel, stage
from .lanes import BATCH, Lanes, absolute, bits, load8, maximum, splat8, sqrt, store8, where

Symmetric = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]  # 00 11 22 12 02 01
Vector = tuple[Lanes, Lanes, Lanes]

_SWEEPS = 12  # 3 to 5 in practice
_ROUND_OFF = 1e-24  # off-diagonal part squared, of the diagonal's, that ends them: eigenvectors are good to 1e-12
_EXACT, _CLOSE = 1e-20, 1e-12  # the same of `eigen_from`, of eigenvalues near 1: eigenvectors are good to 1e-10, 1e-6
_LEAST = 1e-150  # in place of 0 below a fraction whose numerator is 0 too; its square is a number still
_ORTHOGONAL = 1e-15  # cosine of the angle between two columns that counts as 0


@formula
def load_symmetric(a: Floats, b: int) -> Symmetric:
    """Eight symmetric matrices from entry b of a (…, 6, 8)."""
    return load8(a, b, 0), load8(a, b, 1), load8(a, b, 2), load8(a, b, 3), load8(a, b, 4), load8(a, b, 5)


@formula
def load_vector(a: Floats, b: int, k: int) -> Vector:
    """Eight vectors from groups k, k + 1, k + 2 of entry b of a."""
    return load8(a, b, k), load8(a, b, k + 1), load8(a, b, k + 2)


@formula
def store_vector(a: Floats, b: int, k: int, v: Vector) -> None:
    """Write eight vectors to groups k, k + 1, k + 2 of entry b of a."""
    v0, v1, v2 = v
    store8(a, b, k, v0)
    store8(a, b, k + 1, v1)
    store8(a, b, k + 2, v2)


@formula
def turn(pp: Lanes, qq: Lanes, pq: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """cos θ, sin θ and tan θ · pq, which pp loses and qq gains, of the rotation that makes pq vanish, of lanes."""
    d, o = qq - pp, pq + pq
    size = absolute(d)
    root = sqrt(d * d + o * o)
    below = maximum(size + root, _LEAST)  # tan θ = ± o / below
    over = 1.0 / sqrt(below * below + o * o)
    back = d < 0.0
    moved = 0.5 * (root - size)
    return below * over, where(back, -o, o) * over, where(back, -moved, moved)


@formula
def _turn3(
    pp: Lanes, qq: Lanes, pq: Lanes, rp: Lanes, rq: Lanes, u: Vector, v: Vector
) -> tuple[Lanes, Lanes, Lanes, Lanes, Vector, Vector]:
    """A 3 × 3 matrix turned so that pq vanishes; u, v columns p and q of the eigenvectors."""
    c, s, moved = turn(pp, qq, pq)
    u0, u1, u2 = u
    v0, v1, v2 = v
    return (
        pp - moved, qq + moved, c * rp - s * rq, s * rp + c * rq,
        (c * u0 - s * v0, c * u1 - s * v1, c * u2 - s * v2), (s * u0 + c * v0, s * u1 + c * v1, s * u2 + c * v2),
    )  # fmt: skip


@formula
def _sweeps(
    B: Symmetric, u: Vector, v: Vector, w: Vector, round_off: float, least: float
) -> tuple[Vector, Vector, Vector, Vector]:
    """Sweeps until B is diagonal but for `round_off`, of |B|² or `least`; u, v, w turned along.

    Unrolled: what is in registers stays there.
    """
    b0, b1, b2, b3, b4, b5 = B
    zero = splat8(0.0)
    for _ in range(_SWEEPS):
        off = b3 * b3 + b4 * b4 + b5 * b5
        if bits(off > round_off * maximum(b0 * b0 + b1 * b1 + b2 * b2, least)) == 0:
            break
        b0, b1, b4, b3, u, v = _turn3(b0, b1, b5, b4, b3, u, v)
        b5 = zero
        b0, b2, b5, b3, u, w = _turn3(b0, b2, b4, b5, b3, u, w)
        b4 = zero
        b1, b2, b5, b4, v, w = _turn3(b1, b2, b3, b5, b4, v, w)
        b3 = zero
    return (b0, b1, b2), u, v, w


@stage
def eigen(B: Symmetric) -> tuple[Vector, Vector, Vector, Vector]:
    """Eigenvalues of eight B, each with the axis its eigenvector is nearest to, and unit eigenvectors by columns."""
    one, zero = splat8(1.0), splat8(0.0)
    return _sweeps(B, (one, zero, zero), (zero, one, zero), (zero, zero, one), _ROUND_OFF, 0.0)


@formula
def _ascending(p: Lanes, q: Lanes, u: Vector, v: Vector) -> tuple[Lanes, Lanes, Vector, Vector]:
    """Two eigenvalues and their vectors, the smaller one first."""
    swaps = p > q
    u0, u1, u2 = u
    v0, v1, v2 = v
    return (
        where(swaps, q, p), where(swaps, p, q),
        (where(swaps, v0, u0), where(swaps, v1, u1), where(swaps, v2, u2)),
        (where(swaps, u0, v0), where(swaps, u1, v1), where(swaps, u2, v2)),
    )  # fmt: skip


@formula
def eigen_from(B: Symmetric, frames: Floats, k: int, exact: bool) -> Vector:
    """Eigenvalues and eigenvectors of eight B into entry k of `frames` (…, 12, 8), and the eigenvalues, ascending.

    It begins with the eigenvectors that are there, of a B that was similar: one or two sweeps are left.
    """
    b0, b1, b2, b3, b4, b5 = B
    u0, u1, u2 = load_vector(frames, k, 3)
    v0, v1, v2 = load_vector(frames, k, 6)
    size = 1.5 - 0.5 * (u0 * u0 + u1 * u1 + u2 * u2)  # 1 / |u| near 1: round-off does not gather from step to step
    u0, u1, u2 = u0 * size, u1 * size, u2 * size
    along = u0 * v0 + u1 * v1 + u2 * v2
    v0, v1, v2 = v0 - along * u0, v1 - along * u1, v2 - along * u2
    size = 1.5 - 0.5 * (v0 * v0 + v1 * v1 + v2 * v2)
    v0, v1, v2 = v0 * size, v1 * size, v2 * size
    w0, w1, w2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    p0, p1, p2 = b0 * u0 + b5 * u1 + b4 * u2, b5 * u0 + b1 * u1 + b3 * u2, b4 * u0 + b3 * u1 + b2 * u2
    q0, q1, q2 = b0 * v0 + b5 * v1 + b4 * v2, b5 * v0 + b1 * v1 + b3 * v2, b4 * v0 + b3 * v1 + b2 * v2
    r0, r1, r2 = b0 * w0 + b5 * w1 + b4 * w2, b5 * w0 + b1 * w1 + b3 * w2, b4 * w0 + b3 * w1 + b2 * w2
    turned = (
        u0 * p0 + u1 * p1 + u2 * p2, v0 * q0 + v1 * q1 + v2 * q2, w0 * r0 + w1 * r1 + w2 * r2,
        v0 * r0 + v1 * r1 + v2 * r2, u0 * r0 + u1 * r1 + u2 * r2, u0 * q0 + u1 * q1 + u2 * q2,
    )  # fmt: skip
    (p, q, r), u, v, w = _sweeps(turned, (u0, u1, u2), (v0, v1, v2), (w0, w1, w2), _EXACT if exact else _CLOSE, 1.0)
    p, q, u, v = _ascending(p, q, u, v)
    q, r, v, w = _ascending(q, r, v, w)
    p, q, u, v = _ascending(p, q, u, v)
    values = (p, q, r)
    store_vector(frames, k, 0, values)
    store_vector(frames, k, 3, u)
    store_vector(frames, k, 6, v)
    store_vector(frames, k, 9, w)
    return values


@formula
def tangent(pp: float, qq: float, pq: float) -> float:
    """tan θ of the same rotation, of numbers; pq is not 0.

    Lanes need a form without a division by pq. Here it would square once more what are squared lengths already in
    `turn_columns`, which overflow and underflow earlier then; and the last bits of each are those of all its runs.
    """
    cotangent = (qq - pp) / (2.0 * pq)  # of 2 θ
    return (1.0 if cotangent >= 0.0 else -1.0) / (abs(cotangent) + math.sqrt(1.0 + cotangent * cotangent))


@stage
def diagonalise4(N: Floats, V: Floats) -> None:
    """N (4, 4), symmetric, becomes its eigenvalues on its diagonal; V (4, 4) out: unit eigenvectors, by columns.

    Its rotations come from 1 / tan 2θ as those of `turn_columns`, and its sweeps are a fixed number: a body that
    starts half round begins with this, and other last bits here are other last bits in all of its run.
    """
    for i in range(4):
        for j in range(4):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        for p in range(3):
            for q in range(p + 1, 4):
                _turn4(N, V, p, q)


@stage
def _turn4(N: Floats, V: Floats, p: int, q: int) -> None:
    """Turn rows and columns p, q of symmetric N (4, 4), and columns of V, so that N[p, q] vanishes."""
    if N[p, q] == 0.0:
        return
    t = tangent(N[p, p], N[q, q], N[p, q])
    cosine = 1.0 / math.sqrt(1.0 + t * t)
    sine = t * cosine
    for i in range(4):
        N[i, p], N[i, q] = cosine * N[i, p] - sine * N[i, q], sine * N[i, p] + cosine * N[i, q]
        V[i, p], V[i, q] = cosine * V[i, p] - sine * V[i, q], sine * V[i, p] + cosine * V[i, q]
    for i in range(4):
        N[p, i], N[q, i] = cosine * N[p, i] - sine * N[q, i], sine * N[p, i] + cosine * N[q, i]


@kernel
def turn_columns(b: Floats, c: Floats, v: Floats, w: Floats) -> int:
    """One-sided: the rotation for the matrix (F V)ᵀ F V, of which only columns are at hand.

    Turns columns b, c of F V and v, w of V, (3, BATCH), so that b and c are orthogonal. How many lanes had to.
    """
    turned = 0
    for l in range(BATCH):
        b0, b1, b2, c0, c1, c2 = b[0, l], b[1, l], b[2, l], c[0, l], c[1, l], c[2, l]
        beta = b0 * b0 + b1 * b1 + b2 * b2
        gamma = c0 * c0 + c1 * c1 + c2 * c2
        dot = b0 * c0 + b1 * c1 + b2 * c2
        askew = dot * dot > _ORTHOGONAL * _ORTHOGONAL * (beta * gamma)
        t = tangent(beta, gamma, dot if askew else 1.0)
        t = t if askew else 0.0
        cosine = 1.0 / math.sqrt(1.0 + t * t)
        sine = cosine * t
        b[0, l], c[0, l] = cosine * b0 - sine * c0, sine * b0 + cosine * c0
        b[1, l], c[1, l] = cosine * b1 - sine * c1, sine * b1 + cosine * c1
        b[2, l], c[2, l] = cosine * b2 - sine * c2, sine * b2 + cosine * c2
        v0, v1, v2, w0, w1, w2 = v[0, l], v[1, l], v[2, l], w[0, l], w[1, l], w[2, l]
        v[0, l], w[0, l] = cosine * v0 - sine * w0, sine * v0 + cosine * w0
        v[1, l], w[1, l] = cosine * v1 - sine * w1, sine * v1 + cosine * w1
        v[2, l], w[2, l] = cosine * v2 - sine * w2, sine * v2 + cosine * w2
        turned += 1 if askew else 0
    return turned

"""Rotation and Biot strain of every tetrahedron."""

from __future__ import annotations

from ..arrays import Floats, Ints
from .compile import formula, kernel, stage
from .jacobi import Vector, load_vector
from .lanes import bits, gather3, load8, store8
from .model import Model, State
from .polar import Matrix, polar, store_matrix


@kernel
def kinematics(model: Model, state: State) -> None:
    """R and Biot strain E of every tetrahedron at the state's positions: state.R, E, quaternion."""
    strains_at(model, state, True)


@stage
def strains_at(model: Model, state: State, exact: bool) -> None:
    """The same; exact: to round-off."""
    scratch = state.principal.turn.reshape(-1)[:32].reshape((2, 4, 4))
    x, r, nodes = state.x, model.lane_gradients, model.lane_node
    rotations, strains, quaternion = state.R, state.E, state.quaternion
    inverted = 0
    for b in range(rotations.shape[0]):
        F = edges_times(x, nodes, r, b)
        f0, f1, f2, f3, f4, f5, f6, f7, f8 = F
        det = f0 * (f4 * f8 - f5 * f7) + f1 * (f5 * f6 - f3 * f8) + f2 * (f3 * f7 - f4 * f6)
        inverted += bits(det < 0.0) != 0
        R, U = polar(F, quaternion, b, scratch, exact)
        store_matrix(rotations, b, R)
        u00, u01, u02, u10, u11, u12, u20, u21, u22 = U
        store8(strains, b, 0, u00 - 1.0)
        store8(strains, b, 1, u11 - 1.0)
        store8(strains, b, 2, u22 - 1.0)
        store8(strains, b, 3, 0.5 * (u12 + u21))
        store8(strains, b, 4, 0.5 * (u02 + u20))
        store8(strains, b, 5, 0.5 * (u01 + u10))
    state.inverted[0] = inverted


@stage
def turned_far(state: State, turn: float) -> bool:
    """Whether a tetrahedron has turned by more since A was formed; turn: cos² of half the angle."""
    now, then = state.quaternion, state.turned
    for b in range(now.shape[0]):
        along = load8(now, b, 0) * load8(then, b, 0) + load8(now, b, 1) * load8(then, b, 1)
        along = along + load8(now, b, 2) * load8(then, b, 2) + load8(now, b, 3) * load8(then, b, 3)
        if bits(along * along < turn) != 0:
            return True
    return False


@formula
def edges_times(w: Floats, nodes: Ints, gradients: Floats, b: int) -> Matrix:
    """Σ (w_n − w_4) r_nᵀ, by rows, of batch b: F of positions w (Eq. 3), Ḟ of velocities."""
    x4, y4, z4 = gather3(w, nodes, b, 3)
    x1, y1, z1 = gather3(w, nodes, b, 0)
    x2, y2, z2 = gather3(w, nodes, b, 1)
    x3, y3, z3 = gather3(w, nodes, b, 2)
    return products(
        (x1 - x4, y1 - y4, z1 - z4), load_vector(gradients, b, 0),
        (x2 - x4, y2 - y4, z2 - z4), load_vector(gradients, b, 3),
        (x3 - x4, y3 - y4, z3 - z4), load_vector(gradients, b, 6),
    )  # fmt: skip


@formula
def products(a: Vector, r: Vector, b: Vector, s: Vector, c: Vector, t: Vector) -> Matrix:
    """a rᵀ + b sᵀ + c tᵀ, by rows."""
    a0, a1, a2 = a
    b0, b1, b2 = b
    c0, c1, c2 = c
    r0, r1, r2 = r
    s0, s1, s2 = s
    t0, t1, t2 = t
    return (
        a0 * r0 + b0 * s0 + c0 * t0, a0 * r1 + b0 * s1 + c0 * t1, a0 * r2 + b0 * s2 + c0 * t2,
        a1 * r0 + b1 * s0 + c1 * t0, a1 * r1 + b1 * s1 + c1 * t1, a1 * r2 + b1 * s2 + c1 * t2,
        a2 * r0 + b2 * s0 + c2 * t0, a2 * r1 + b2 * s1 + c2 * t1, a2 * r2 + b2 * s2 + c2 * t2,
    )  # fmt: skip

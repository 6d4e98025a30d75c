"""What residuals have told of H since its factors were made: limited-memory BFGS on top of them.

Factors serve for many iterations and steps (newton.py), while other rows come to hold. Along a change s of the
velocities the residual fell by y, and y = H s of the H that is there now. Few such secants mend H⁻¹ of the factors,
which stays symmetric and positive definite: Nocedal and Wright, *Numerical Optimization*, 2nd ed., algorithm 7.4, with
the factors for its first matrix; Morales and Nocedal 2000, *Automatic preconditioning by limited memory quasi-Newton
updating*. They serve in later steps too, as the factors do, and are forgotten when there are new ones.
"""

from __future__ import annotations

from ..arrays import Floats
from .border import solve_all
from .compile import stage
from .model import Model, Secants, State
from .vectors import add, copy, inner

MOST = 4
# Part of the residual that an iteration leaves from which on it has something to tell. One that left less went along
# good factors: its secant would only push out another one.
_TELLS = 0.5


@stage
def mended_solve(model: Model, state: State, r: Floats, y: Floats) -> None:
    """y = H⁻¹ r, by the factors and what secants know better; r is kept for `learn`."""
    own = state.secants
    pairs, weight, part, new = own.pairs, own.weight, own.part, own.ring[1]
    places = weight.shape[0]
    copy(pairs[2 * new + 1], r)
    copy(y, r)
    for age in range(1, own.ring[0] + 1):
        k = (new - age) % places
        part[k] = weight[k] * inner(pairs[2 * k], y)
        add(y, y, pairs[2 * k + 1], -part[k])
    solve_all(model, state, y)
    for age in range(own.ring[0], 0, -1):
        k = (new - age) % places
        add(y, y, pairs[2 * k], part[k] - weight[k] * inner(pairs[2 * k + 1], y))


@stage
def learn(secants: Secants, change: Floats, tried: Floats, left: Floats, share: float) -> None:
    """Keep the secant from `change` to `tried`, where the residual is `left`, so much of that before; or not.

    Of a merit function that is convex sᵀy is positive; friction's is not.
    """
    if share <= _TELLS:
        return
    pairs, new, places = secants.pairs, secants.ring[1], secants.weight.shape[0]
    step, fell = pairs[2 * new], pairs[2 * new + 1]
    add(step, tried, change, -1.0)
    add(fell, fell, left, -1.0)
    along = inner(step, fell)
    if along > 0.0:
        secants.weight[new] = 1.0 / along
        secants.ring[0] = min(secants.ring[0] + 1, places - 1)
        secants.ring[1] = (new + 1) % places

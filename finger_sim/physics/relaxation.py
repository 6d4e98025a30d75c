r"""Stress that fades while a strain is held: a Prony series in the corotated frame (generalised Maxwell model).

With the shares g_i and times τ_i of material.relaxation, of the deviator e of the Biot strain (or of all of it), in
material axes, which turn with the tetrahedron,

    s(t) = 2 μ ((1 − Σ g_i) e + Σ g_i y_i),    ẏ_i = ė − y_i / τ_i,    y_i(0) = e(0),

y_i is the overstrain of a term: what its spring still feels of the strain while its damper yields. Over a step in which
the strain goes on a straight line it is exactly (Taylor, Pister & Goudreau 1970; Simo & Hughes 1998, Section 10.3)

    y_i⁺ = a_i y_i + c_i (e⁺ − e),    a_i = exp(−h/τ_i),    c_i = (1 − a_i) τ_i / h.

So the stress at a step's end, which is what backward Euler takes, is linear in the strain there,

    s⁺ = 2 γ μ e⁺ + 2 μ Σ g_i z_i,    γ = 1 − Σ g_i (1 − c_i),    z_i = a_i y_i − c_i e:

that of elasticity.py with the shear modulus γ μ, a constant of h, for the strain E + Σ g_i z_i / γ, whose second part
is one of the step. Nothing else changes: A has the same form and pattern and stays positive definite, and factors that
were kept are good as long as h is the same. Rayleigh's damping is β times that stiffness. Pressure is not touched, but
with `relaxes_pressure`: e is all of E then, K becomes γ K, and patches (dilatation.py) feel the mean of their
tetrahedra's. Limits bound E itself.

No step creates energy, whatever h: with ψ = ½ |y|² of a term, y⁺·(e⁺ − e) − (ψ⁺ − ψ) ≥ 0 is a form in y⁺ and y that is
nowhere negative where (1 − c)² + a² ≤ 1; and 0 < a ≤ c < 1.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import formula, kernel, stage
from .lanes import Lanes, absolute, lane, load8, maximum, splat8, store8
from .model import Model, State

BEGIN, MOVED, END = range(3)
"""Of a step, for `relax`: at its start; where x and E have changed within it; at its end."""


@kernel
def relax(model: Model, state: State, h: float, when: int) -> None:
    """What the terms of the series have to do in a step of h [s]; when: BEGIN, MOVED or END.

    After BEGIN and MOVED state.felt_strain has what stress is made of, with the moduli of `step_moduli`.
    """
    if when == BEGIN:
        recall(model, state, h)
    elif when == MOVED:
        feel(state)
    else:
        remember(model, state)


@formula
def step_moduli(model: Model, state: State) -> tuple[float, float, float]:
    """λ, μ of tetrahedra and K of patches [Pa] in this step."""
    own = state.relaxing.moduli
    if own.shape[0] > 0:
        return own[0], own[1], own[2]
    return model.lame_lambda, model.lame_mu, model.patches.bulk


@stage
def recall(model: Model, state: State, h: float) -> None:
    """Overstrains y to z, their sum with the strain into state.felt_strain; the step's moduli."""
    own, terms, felt, strains = state.relaxing, model.relaxation, state.felt_strain, state.E
    overstrain, memory, factors = own.overstrain, own.memory, own.factors
    left = 1.0
    for i in range(terms.shape[0]):
        steps = h / terms[i, 0]
        factors[i, 0], factors[i, 1] = math.exp(-steps), -math.expm1(-steps) / steps
        left -= terms[i, 1] * (1.0 - factors[i, 1])
    moduli = own.moduli
    moduli[1] = left * model.lame_mu
    if model.relaxes_pressure:
        moduli[0], moduli[2] = left * model.lame_lambda, left * model.patches.bulk
    else:
        moduli[0] = model.lame_lambda + 2.0 / 3.0 * (model.lame_mu - moduli[1])
        moduli[2] = model.patches.bulk
    for b in range(strains.shape[0]):
        mean = _untouched(model, strains, b)
        for c in range(6):
            strain = load8(strains, b, c)
            e = strain - mean if c < 3 else strain
            total = splat8(0.0)
            for i in range(terms.shape[0]):
                z = load8(overstrain, b, 6 * i + c) * factors[i, 0] - e * factors[i, 1]
                store8(overstrain, b, 6 * i + c, z)
                total = total + z * terms[i, 1]
            total = total * (1.0 / left)
            store8(memory, b, c, total)
            store8(felt, b, c, strain + total)


@stage
def feel(state: State) -> None:
    """State.felt_strain of the strain that there is now."""
    memory, felt, strains = state.relaxing.memory, state.felt_strain, state.E
    for b in range(strains.shape[0]):
        for c in range(6):
            store8(felt, b, c, load8(strains, b, c) + load8(memory, b, c))


@stage
def remember(model: Model, state: State) -> None:
    """Overstrains z to y, of the strain at the step's end; how fast the fastest of them fades."""
    own, terms, strains = state.relaxing, model.relaxation, state.E
    overstrain, factors = own.overstrain, own.factors
    rate = 0.0
    largest = splat8(0.0)
    for b in range(strains.shape[0]):
        mean = _untouched(model, strains, b)
        for c in range(6):
            strain = load8(strains, b, c)
            e = strain - mean if c < 3 else strain
            for i in range(terms.shape[0]):
                y = load8(overstrain, b, 6 * i + c) + e * factors[i, 1]
                store8(overstrain, b, 6 * i + c, y)
                largest = maximum(largest, absolute(y) * (1.0 / terms[i, 0]))
    for l in range(8):
        rate = max(rate, lane(largest, l))
    own.rate[0] = rate


@formula
def _untouched(model: Model, strains: Floats, b: int) -> Lanes:
    """What of the normal strains of batch b does not relax: their mean, or nothing."""
    if model.relaxes_pressure:
        return splat8(0.0)
    return (load8(strains, b, 0) + load8(strains, b, 1) + load8(strains, b, 2)) * (1.0 / 3.0)


def suddenly(model: Model, state: State) -> None:
    """Overstrains of a body that has just been deformed as it is now: nothing of its stress has faded."""
    own, E = state.relaxing, state.E
    e = E.copy()
    if not model.relaxes_pressure:
        e[:, :3] -= E[:, :3].mean(axis=1, keepdims=True)
    terms = len(model.relaxation)
    own.overstrain.reshape(len(E), terms, 6, 8)[:] = e[:, None]
    own.rate[0] = max((abs(e).max() / time for time in model.relaxation[:, 0]), default=0.0)

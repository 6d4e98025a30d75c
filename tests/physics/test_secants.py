"""Secants on top of kept factors, against BFGS written with dense matrices; when they are kept and when forgotten."""

from __future__ import annotations

import numpy as np
from cases import for_each
from physics_helpers import Array
from small_fingers import small

from finger_sim import Pose, Scene, Simulator
from finger_sim.physics.border import solve_all
from finger_sim.physics.secants import MOST, learn, mended_solve


def factored() -> Simulator:
    """A finger in air: factors are at hand, and no secant."""
    sim = Simulator(small("finger_haptic"))
    sim.step()
    assert sim._state.newton.factors[0] != 0
    assert sim._state.secants.ring[0] == 0
    return sim


def padded(x: Array, sim: Simulator) -> Array:
    """Numbers of free nodes as the vectors of `newton` have them."""
    out = np.zeros_like(sim._state.newton.direction)
    free = len(sim._model.free)
    out[:free, :3] = x.reshape(free, 3)
    return out


def solved(sim: Simulator, r: Array) -> Array:
    y = np.zeros_like(sim._state.newton.direction)
    mended_solve(sim._model, sim._state, padded(r, sim), y)
    assert (y[:, 3] == 0.0).all()
    return np.array(y[: len(sim._model.free), :3].ravel())


def old_inverse(sim: Simulator) -> Array:
    """H⁻¹ of the factors, column by column."""
    size = 3 * len(sim._model.free)
    columns = np.array([padded(e, sim) for e in np.eye(size)])
    for y in columns:
        solve_all(sim._model, sim._state, y)
    return columns[:, : size // 3, :3].reshape(size, size)


def told(sim: Simulator, s: Array, y: Array, share: float = 1.0) -> None:
    """What `newton` does: a direction from a residual, and what is left of it after a change s."""
    residual = np.random.default_rng(1).normal(size=len(s))
    solved(sim, residual)
    at = np.random.default_rng(2).normal(size=len(s))
    learn(sim._state.secants, padded(at, sim), padded(at + s, sim), padded(residual - y, sim), share)


@for_each("count", [0, 1, 3, MOST, MOST + 3])
def test_the_inverse_is_that_of_bfgs(count: int) -> None:
    """Secants from the oldest on: H⁻¹ ← (I − ρ s yᵀ) H⁻¹ (I − ρ y sᵀ) + ρ s sᵀ, ρ = 1 / sᵀy."""
    sim, rng = factored(), np.random.default_rng(count)
    inverse = old_inverse(sim)
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-9 * np.abs(inverse).max())
    size = len(inverse)
    true = np.linalg.inv(inverse)
    root = rng.normal(size=(size, size // 2)) * np.sqrt(np.diag(true).mean() / size)
    true = true + root @ root.T
    secants = [(s := rng.normal(size=size), true @ s) for _ in range(count)]
    for s, y in secants:
        told(sim, s, y)
    assert sim._state.secants.ring[0] == min(count, MOST)
    one = np.eye(size)
    for s, y in secants[-MOST:]:
        rho = 1.0 / (s @ y)
        inverse = (one - rho * np.outer(s, y)) @ inverse @ (one - rho * np.outer(y, s)) + rho * np.outer(s, s)
    for r in rng.normal(size=(3, size)):
        np.testing.assert_allclose(solved(sim, r), inverse @ r, rtol=1e-7, atol=1e-9 * np.abs(inverse @ r).max())
    if count:
        np.testing.assert_allclose(solved(sim, secants[-1][1]), secants[-1][0], rtol=1e-7, atol=1e-9)


def test_what_tells_nothing_is_not_kept() -> None:
    """An iteration that left half of the residual or less went along good factors; sᵀy < 0 is of no convex function."""
    sim = factored()
    s = np.random.default_rng(0).normal(size=3 * len(sim._model.free))
    told(sim, s, s, share=0.5)
    told(sim, s, -s)
    assert sim._state.secants.ring[0] == 0
    told(sim, s, s, share=0.51)
    assert sim._state.secants.ring[0] == 1


def test_new_factors_need_no_secants() -> None:
    """They are kept from step to step with the factors that they mend, and forgotten with them and by `reset`."""
    sim = Simulator(Scene.load("finger_haptic"))
    orientation, secants = sim.scene.initial_pose.orientation, sim._state.secants
    sim.reset(Pose((0.0, 0.0, 0.0085), orientation))
    kept = forgotten = 0
    for k in range(220):
        before, factors = int(secants.ring[0]), sim.work["factorisations"]
        out = sim.step(Pose((2e-5 * max(0, k - 150), 0.0, 0.0085 - 2e-5 * min(k, 150)), orientation))
        if sim.work["factorisations"] == factors:
            assert before <= secants.ring[0] <= before + out.iterations
            kept += before > 0
        elif out.iterations <= 1:
            assert secants.ring[0] <= out.iterations
            forgotten += before > secants.ring[0]
    assert kept > 15
    assert forgotten > 3
    assert secants.ring[0] > 0
    sim.reset()
    assert secants.ring[0] == 0

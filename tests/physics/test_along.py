"""Rows along a direction: what a line search sees of them, against the forces that they give nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, pose
from step_problem import LIMITS

from finger_sim import Simulator
from finger_sim.physics.along import begin_gaps, move_gaps, row_rates, row_slope
from finger_sim.physics.border import spread
from finger_sim.physics.compile import kernel
from finger_sim.physics.newton import evaluate
from finger_sim.physics.vectors import add, clear, inner
from finger_sim.physics.work import CONTACT_ROWS
from finger_sim.physics.work import LIMITS as LIMIT_ROWS

PARTS = np.array([0.0, 0.05, 0.3, 1.0, 2.5])


@kernel
def slopes(model: Any, state: Any, h: float, contacts: int, rows: int, parts: Array, out: Array) -> None:
    """out[0]: row_slope at each part; out[1]: the same from the forces of `evaluate`."""
    own = state.newton
    if model.has_bone:
        spread(model, state, own.direction)
    row_rates(model, state, h, contacts, rows, own.direction)
    begin_gaps(model, state, contacts, rows)
    clear(own.change)
    for k in range(parts.shape[0]):
        out[0, k] = row_slope(model, state, h, contacts, rows, parts[k])
    for k in range(parts.shape[0]):
        begin_gaps(model, state, contacts, rows)
        move_gaps(model, state, contacts, rows, parts[k])
        add(own.tried, own.change, own.direction, parts[k])
        clear(own.next_residual)
        evaluate(model, state, h, contacts, rows, own.tried)
        out[1, k] = inner(own.direction, own.next_residual)


VIRTUAL = {"coupling": {"type": "virtual", "stiffness": 2e4, "damping": 20.0, "rotational_stiffness": 10.0}}


@for_each("projection", ["tensor", "hyperbolic", "linear"])
@for_each("values", [{}, {"volumetric": "patch"}, VIRTUAL])
@for_each("held", [False, True])
def test_slopes_are_those_of_the_forces(projection: str, values: Any, held: bool) -> None:
    """Σ ġ λ of a random direction in a pressed, slid block, with rows that come to hold and let go along it."""
    patch = "volumetric" in values
    scene = beam_scene(
        (0.04, 0.04, 0.02),
        (3, 3, 2),
        young=2e4,
        poisson=0.45,
        damping=(0.0, 0.002),
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
        plane={"point": [0, 0, 0], "friction": 0.4},
        limits=LIMITS[projection] | {"stiffness": 30.0},
        solver={"method": "newton", "tolerance": 1e-10, "max_iterations": 200, "settle": False},
        **({} if patch else values),
    )
    if patch:
        scene = scene.with_values({"material.volumetric": "patch"})
    sim = Simulator(scene)
    for k in range(30):
        before = sim._state.work.copy()
        sim.step(pose((4e-5 * max(0, k - 20), 0.0, 1e-4 - 3e-5 * min(k, 20))))
    model, state = sim._ready.model, sim._ready.state
    contacts, limits = (int(n) for n in (sim._state.work - before)[[CONTACT_ROWS, LIMIT_ROWS]])
    assert min(contacts, limits) > 5
    rng = np.random.default_rng(5)
    direction = sim._state.newton.direction
    direction[:] = 0.0
    free = len(sim._model.free)
    direction[:free, :3] = 0.05 * rng.standard_normal((free, 3))
    if sim._model.has_bone:
        direction[free + 1 : free + 3, :3] = rng.standard_normal((2, 3)) * [[0.02], [0.5]]
        bone = sim._state.yielding  # its spring comes to its limits on the way, and it to its stop
        bone.base[:] = np.repeat(sim._model.spring_limit, 3) / np.sqrt(3.0)
        bone.stop[6] = -0.3 * scene.dt * np.vdot(bone.stop[:6], direction[free + 1 : free + 3, :3])
    sim._state.newton.holds[0] = int(held)
    sim._state.newton.bound[:] = 0.01
    out = np.zeros((2, len(PARTS)))
    slopes(model, state, scene.dt, contacts, contacts + limits, PARTS, out)
    assert_allclose(out[0], out[1], rtol=1e-9, atol=1e-12 * np.abs(out).max())
    curved = np.diff(out[1]) / np.diff(PARTS)
    assert np.abs(np.diff(curved)).max() > 1e-3 * np.abs(curved).max()  # rows came or went

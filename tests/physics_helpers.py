"""Scenes, poses and checkers that the physics tests share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from small_fingers import small

from finger_sim import Pose, Scene, Simulator, Status, StepResult
from finger_sim.physics.compile import kernel
from finger_sim.physics.elimination import analyse
from finger_sim.physics.tensor_rows import pack_rows

Array = np.ndarray[Any, np.dtype[np.float64]]

UNFIT = Status.NONFINITE | Status.STEP_REJECTED | Status.ITERATION_LIMIT | Status.ROW_LIMIT | Status.INVERTED


def beam_scene(
    size: Any = (0.4, 0.2, 0.2),
    cells: Any = (2, 1, 1),
    *,
    young: float = 1e5,
    poisson: float = 0.3,
    density: float = 1000.0,
    damping: tuple[float, float] = (0.0, 0.0),
    **blocks: Any,
) -> Scene:
    """A scene with a generated beam; without gravity, damping, drive, limits and plane unless asked for."""
    data = {
        "mesh": {"beam": {"size": list(size), "cells": list(cells)}},
        "material": {
            "density": density,
            "young": young,
            "poisson": poisson,
            "damping": {"mass": damping[0], "stiffness": damping[1]},
        },
        "gravity": [0.0, 0.0, 0.0],
    }
    return Scene.from_dict(data | blocks)


def finger_scene(**values: Any) -> Scene:
    """The shipped everyday finger, dotted keys changed (dots written as __)."""
    return small("finger").with_values({k.replace("__", "."): v for k, v in values.items()})


def pose(position: Any = (0.0, 0.0, 0.0), turn: Rotation | None = None) -> Pose:
    q = (turn or Rotation.identity()).as_quat()
    return Pose(tuple(float(p) for p in position), tuple(float(c) for c in q))  # type: ignore[arg-type]


def rotations(count: int, seed: int) -> list[Rotation]:
    """Half turns about the axes, and random rotations."""
    half = [Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3)]
    return half + list(Rotation.random(count, random_state=seed))


def random_F(rng: np.random.Generator, s: Any) -> Array:
    """A deformation gradient with the singular values `s` (signed) in random directions."""
    U, V = Rotation.random(2, random_state=int(rng.integers(2**31))).as_matrix()
    F: Array = U @ np.diag(s) @ V.T
    return F


def assert_derivative(
    function: Callable[[Array], Array],
    derivative: Array,
    at: Array,
    *,
    step: float,
    rtol: float,
    atol: float,
) -> None:
    """`derivative` (m, *at.shape) is that of `function`: at → (m,), by central differences of sixth order.

    Compared as a whole, relative to the largest entry of each of the m gradients.
    """
    if len(derivative) == 0:
        assert function(at).shape == (0,)
        return
    numeric = np.zeros((len(derivative), at.size))
    for k in range(at.size):
        offset = np.zeros(at.size)
        offset[k] = step
        offset = offset.reshape(at.shape)
        for weight, times in ((0.75, 1), (-0.15, 2), (1.0 / 60.0, 3)):
            numeric[:, k] += weight * (function(at + times * offset) - function(at - times * offset)) / step
    numeric = numeric.reshape(derivative.shape)
    size = np.abs(numeric).reshape(len(derivative), -1).max(axis=1)
    error = np.abs(derivative - numeric).reshape(len(derivative), -1).max(axis=1)
    np.testing.assert_array_less(error, rtol * size + atol)


def nodal_forces(scene: Scene, positions: Array) -> Array:
    """Elastic forces (n, 3) [N] that the simulator puts on the nodes of a free, undamped body at `positions`.

    The velocity that one very short step gives a heavy body at rest, times mass over time: off by (h ω)², 1e-8 or so.
    """
    assert scene.driven is None
    assert scene.plane is None
    short = scene.with_values(
        {
            "dt": 1e-6,
            "gravity": [0, 0, 0],
            "material.density": 1e5,
            "material.damping.mass": 0.0,
            "material.damping.stiffness": 0.0,
        }
    )
    sim = Simulator(short)
    sim.set_state(positions, np.zeros_like(positions))
    sim.step()
    return sim.velocities * lumped_mass(short, sim.mesh)[:, None] / 1e-6


def assembled(
    scene: Scene, x: Array, h: float, before: Callable[[Simulator], None] | None = None
) -> tuple[Array, Array]:
    """A and b of a step of h from x at rest, dense and in node order of the free nodes (3 nf); `before` the step."""
    sim = Simulator(scene.with_values({"dt": h, "solver.method": "newton"}))  # which leaves b as it was
    sim.set_state(x, np.zeros_like(x))
    if before is not None:
        before(sim)
    sim.step()
    model, state = sim._model, sim._state
    nf = len(model.free)
    A = np.zeros((nf, 3, nf, 3))
    for k in range(nf):
        A[k, :, k, :] = state.A[k, :, :3].T  # blocks lie by columns, each padded to four numbers
    for p, (row, column) in enumerate(zip(model.block_row, model.block_column, strict=True)):
        block = state.A[nf + p, :, :3].T
        A[row, :, column, :], A[column, :, row, :] = block, block.T
    assert (state.A[:, :, 3] == 0.0).all()
    by_node = np.argsort(model.free)
    return A[by_node][:, :, by_node].reshape(3 * nf, 3 * nf), state.rhs[by_node, :3].ravel()


def lumped_mass(scene: Scene, mesh: Any) -> Array:
    """A quarter of each tetrahedron's mass at each of its nodes [kg]."""
    mass = np.zeros(len(mesh.points))
    for nodes in mesh.tets:
        a, b, c, d = mesh.points[nodes]
        mass[nodes] += scene.material.density * abs(np.dot(np.cross(b - a, c - a), d - a)) / 24.0
    return mass


def run(sim: Simulator, steps: int, command: Pose | None = None) -> StepResult:
    """The last of so many steps under one command."""
    for _ in range(steps):
        out = sim.step(command)
    return out


def settle(sim: Simulator, command: Pose | None = None, *, speed: float = 1e-9, steps: int = 4000) -> StepResult:
    """Step until no node moves faster than `speed` [m/s]."""
    for _ in range(steps):
        out = sim.step(command)
        if np.abs(sim.velocities).max() < speed:
            return out
    raise AssertionError(f"not at rest after {steps} steps: {np.abs(sim.velocities).max():.2e} m/s")


@kernel
def _packed(model: Any, state: Any, first: int) -> int:
    return pack_rows(model, state, first, False)


def pack(sim: Simulator) -> None:
    """The limit rows of the last step one after the other in State, where `newton` has those of `tensor` in lanes.

    Before the step, State.row_tet is to be filled with what no row has: what is left of it has no row.
    """
    scene, state = sim.scene, sim._state
    if scene.limits is None or scene.limits.projection != "tensor" or scene.solver.method != "newton":
        return
    first = 0
    while first < len(state.row_tet) and -len(sim.positions) <= state.row_tet[first] < 0:
        first += 1
    held = state.row_tet[:first].copy(), state.newton.stiffness.copy()
    rows = _packed(sim._ready.model, sim._ready.state, first)
    assert rows >= first
    state.newton.stiffness[:] = held[1]


def healthy(out: StepResult) -> bool:
    """No status bit that speaks of a solve that failed."""
    return not out.status & UNFIT


def loaded(edges: Any, A: Array) -> tuple[Any, Array, Array, Array]:
    """The pattern of the graph, A's blocks in its slots, by columns, those below the diagonal again, and room for D⁻¹.

    What pads blocks, and the block that nobody wants, is rubbish to be ignored.
    """
    nodes = len(A) // 3
    blocks = A.reshape(nodes, 3, nodes, 3)
    pattern = analyse(edges, nodes)
    order = pattern.order
    given = np.full((nodes + len(pattern.row) + 1, 3, 4), 7.0)
    diagonal, lower = given[:nodes], given[nodes:-1]
    for column in range(nodes):
        diagonal[column, :, :3] = blocks[order[column], :, order[column], :].T
        for p in range(pattern.start[column], pattern.start[column + 1]):
            lower[p, :, :3] = blocks[order[pattern.row[p]], :, order[column], :].T
    return pattern, given, lower, np.zeros((nodes, 3, 4))

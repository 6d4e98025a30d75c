"""The order of tetrahedra in lanes. That nothing of it is seen from outside, test_tensor_limit.py tells."""

from __future__ import annotations

import numpy as np
from cases import for_each

from finger_sim import Pose, Scene, Simulator
from finger_sim.physics.neighbours import side_by_side
from finger_sim.physics.tensor_rows import STIFFNESS


@for_each("count", [1, 3, 4, 7, 8, 9, 12, 100, 1003])
def test_each_tetrahedron_is_there_once(count: int) -> None:
    rng = np.random.default_rng(count)
    order = side_by_side(rng.normal(size=(count + 4, 3)), rng.integers(0, count + 4, (count, 4)))
    assert sorted(order.tolist()) == list(range(count))


def test_groups_are_of_neighbours() -> None:
    """Two heaps of four tetrahedra at each corner of a cube: whatever their numbers, each comes out together."""
    rng = np.random.default_rng(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    heaps = np.repeat(np.concatenate([[corner, corner + [0.1, 0.0, 0.0]] for corner in corners]), 16, axis=0)
    points = heaps + rng.uniform(0.0, 0.01, heaps.shape)
    number = rng.permutation(64)
    found = number[side_by_side(points, np.arange(256).reshape(64, 4)[number])]
    assert {tuple(set(eight)) for eight in (found.reshape(8, 8) // 8).tolist()} == {(k,) for k in range(8)}
    assert {tuple(set(four)) for four in (found.reshape(16, 4) // 4).tolist()} == {(k,) for k in range(16)}


def test_rows_of_neighbours_fill_their_groups() -> None:
    """Half of the lanes of groups have a row in a press of the everyday finger; in the order of the mesh a third."""
    sim = Simulator(Scene.load("finger_haptic"))
    orientation, tensor = sim.scene.initial_pose.orientation, sim._state.tensor
    sim.reset(Pose((0.0, 0.0, 0.0085), orientation))
    for k in range(130):
        sim.step(Pose((0.0, 0.0, 0.0085 - 2e-5 * k), orientation))
    groups = int(tensor.first[-1])
    assert groups > 200
    assert (tensor.row[:groups, STIFFNESS] > 0.0).mean() > 0.5
    near = tensor.near.any(axis=(1, 2))
    assert near.sum() > 20
    assert (np.diff(tensor.frames[::2][near, :3], axis=1) >= 0.0).all(), "eigenvalues ascend"

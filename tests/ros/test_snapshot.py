"""Copies for other threads: whole, of the present, and none where the loop does not answer."""

from __future__ import annotations

import os
import threading
from typing import Any

import numba
import numpy as np
import pytest

pytest.importorskip("rclpy")
from small_fingers import small

from finger_sim import Simulator
from finger_sim.physics.atomics import load_acquire
from finger_sim.physics.compile import kernel
from finger_sim.physics.records import held
from finger_sim.ros.accounts import nothing_counted
from finger_sim.ros.snapshot import Snapshot, hand_over, is_there, take_counted

POSES = 200


@kernel
def turn(state: Any, body: Any, copied: Any, counted: Any, stop: Any) -> int:
    """Steps in which all numbers become that of the step."""
    k = 0
    while stop[0] == 0:
        k += 1
        for n in range(state.x.shape[0]):
            for i in range(3):
                state.x[n, i] = state.v[n, i] = state.contact_force[n, i] = k
        for i in range(7):
            body.pose[i] = k
        body.steps[0] = k
        counted.steps[0] += 1
        if load_acquire(copied.asked, 0) != 0:
            hand_over(copied, state, body, body.pose[:6], k, k)
            take_counted(copied, counted)
            is_there(copied)
    return k


@pytest.fixture(name="sim", scope="module")
def _sim() -> Simulator:
    return Simulator(small("finger_coupled"))


def bare(record: Any) -> Any:
    """What a record as kernels take it was made of."""
    return getattr(record, "record", record)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the thread of the loop is to be without the interpreter")
def test_copies_are_whole_while_steps_go_on(sim: Simulator) -> None:
    """Each is of one step, a later one than that before; every step is counted in one of them."""
    snapshot, stop, counted = Snapshot(bare(sim.compiled.state)), np.zeros(1, np.int64), nothing_counted()
    arguments = (sim.compiled.state, held(sim.compiled.body), held(snapshot.record), held(counted), stop)
    made: list[int] = []
    loop = threading.Thread(target=lambda: made.append(turn(*arguments)))
    loop.start()
    try:
        before = total = 0
        for _ in range(POSES):
            assert snapshot.take(60.0)
            copied = snapshot.record
            (step,) = copied.steps.tolist()
            assert step > before
            for part in (
                copied.positions.reshape(-1, 4)[:, :3],
                copied.velocities.reshape(-1, 4)[:, :3],
                copied.forces,
            ):
                assert (part == step).all()
            assert (copied.pose == step).all()
            assert (copied.device == step).all()
            assert copied.stamp[0] == copied.at[0] == step
            assert copied.counted.steps[0] == step - before
            total += int(copied.counted.steps[0])
            before = step
    finally:
        stop[0] = 1
        loop.join()
    assert counted.steps[0] + total == made[0]


def test_a_loop_that_does_not_answer_is_given_up_and_asked_anew(sim: Simulator) -> None:
    """What it answers too late is not taken for a copy of the present."""
    snapshot = Snapshot(bare(sim.compiled.state))
    assert not snapshot.take(0.01)
    assert snapshot.record.asked[0] == 0
    os.eventfd_write(snapshot.record.event, 1)  # too late
    assert not snapshot.take(0.01)


def test_a_copy_shows_what_the_simulator_has() -> None:
    """Positions, forces, strain of a press with a plane that has been moved."""
    sim = Simulator(small("finger_coupled"))
    snapshot = Snapshot(bare(sim.compiled.state))
    own = snapshot.record
    assert snapshot.shown(sim, True) is None
    for k in range(40):
        pose = sim.scene.initial_pose
        x, y, z = pose.position
        sim.step(type(pose)((x, y, z - 2e-4 * k), pose.orientation))
    device = np.arange(6.0)
    hand_over(own, bare(sim.compiled.state), sim.compiled.body, device, 11, 12)
    shown = snapshot.shown(sim, True)
    assert shown is not None
    assert (shown.stamp, shown.at) == (11, 12)
    np.testing.assert_array_equal(shown.device, device)
    assert shown.pose == sim.pose
    assert shown.plane == sim.plane_pose
    np.testing.assert_array_equal(shown.positions, sim.positions)
    np.testing.assert_array_equal(shown.forces, sim.contact_forces)
    np.testing.assert_array_equal(shown.strain, sim.strain_ratio)
    assert shown.strain.max() > 0.0
    assert snapshot.imprint(sim).touch() == type(snapshot.imprint(sim)).of(sim).touch()

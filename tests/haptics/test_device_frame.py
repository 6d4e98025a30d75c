"""A device's frame: poses in and wrenches out by other means (scipy), power on both sides, and the clutch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from finger_sim.haptics.device_frame import build_frame, handle_at, index, to_device, to_handle, to_world

NUMBERS = st.floats(-0.5, 0.5)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS).map(np.array)
TURNS = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1).map(Rotation.from_quat)
SCALES = st.floats(0.05, 20.0)


def frame_of(turn, scale, offset, tool):
    return build_frame(tuple(turn.as_quat()), scale, tuple(offset), tuple(tool.as_quat()))


def in_world(frame, position, orientation):
    """Position and rotation that a handle commands."""
    out = np.empty(7)
    to_world(frame, np.array([*position, *orientation.as_quat()]), out)
    return out[:3], Rotation.from_quat(out[3:])


def close(a: Rotation, b: Rotation) -> bool:
    return (a.inv() * b).magnitude() < 1e-9


@settings(deadline=None)  # the first call compiles
@given(TURNS, SCALES, VECTORS, TURNS, VECTORS, TURNS)
def test_poses_and_wrenches_are_mapped_as_said(turn, scale, offset, tool, position, orientation) -> None:
    """p' = o + s R p and q' = R q T; f_d = s Rᵀ f and τ_d = Rᵀ τ, and along the handle's axes."""
    frame = frame_of(turn, scale, offset, tool)
    p, q = in_world(frame, position, orientation)
    np.testing.assert_allclose(p, offset + scale * turn.apply(position), atol=1e-9)
    assert close(q, turn * orientation * tool)
    wrench = np.array([1.0, -2.0, 0.5, 0.01, 0.02, -0.03])
    out, handle = np.empty(6), np.empty(6)
    to_device(frame, wrench, out)
    np.testing.assert_allclose(out[:3], scale * turn.inv().apply(wrench[:3]), atol=1e-9)
    np.testing.assert_allclose(out[3:], turn.inv().apply(wrench[3:]), atol=1e-9)
    to_handle(np.array([*position, *orientation.as_quat()]), out, handle)
    np.testing.assert_allclose(handle[:3], orientation.inv().apply(out[:3]), atol=1e-9)
    np.testing.assert_allclose(handle[3:], orientation.inv().apply(out[3:]), atol=1e-9)


@settings(deadline=None)  # the first call compiles
@given(TURNS, SCALES, VECTORS, TURNS, VECTORS, TURNS, VECTORS, VECTORS, st.booleans())
def test_power_is_the_same_on_both_sides(
    turn, scale, offset, tool, position, orientation, velocity, spin, indexed
) -> None:
    """f_d · v_d = f · v' and τ_d · ω_d = τ · ω', at any scale, after the clutch too: velocities by differences."""
    frame = frame_of(turn, scale, offset, tool)
    if indexed:
        held = np.array([0.01, 0.02, -0.03, *Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_quat()])
        index(frame, np.array([*position, *orientation.as_quat()]), held)
    h = 1e-6
    ends = [in_world(frame, position + d * velocity, Rotation.from_rotvec(d * spin) * orientation) for d in (-h, h)]
    v = (ends[1][0] - ends[0][0]) / (2 * h)
    w = (ends[1][1] * ends[0][1].inv()).as_rotvec() / (2 * h)
    wrench = np.array([3.0, -1.0, 2.0, 0.1, -0.2, 0.05])
    out = np.empty(6)
    to_device(frame, wrench, out)
    size = 1.0 + np.linalg.norm(v) + np.linalg.norm(w)
    assert out[:3] @ velocity == pytest.approx(wrench[:3] @ v, abs=1e-7 * size)
    assert out[3:] @ spin == pytest.approx(wrench[3:] @ w, abs=1e-7 * size)


@settings(deadline=None)  # the first call compiles
@given(TURNS, SCALES, VECTORS, TURNS, VECTORS, TURNS, VECTORS, TURNS, VECTORS, VECTORS)
def test_after_the_clutch_the_finger_goes_on_from_where_it_was(
    turn, scale, offset, tool, position, orientation, held_at, held_turn, way, spin
) -> None:
    """Nothing jumps. Motion is what it was without the clutch: s R times the way, and the same turn in the world."""
    frame = frame_of(turn, scale, offset, tool)
    index(frame, np.array([*position, *orientation.as_quat()]), np.array([*held_at, *held_turn.as_quat()]))
    p, q = in_world(frame, position, orientation)
    np.testing.assert_allclose(p, held_at, atol=1e-8)
    assert close(q, held_turn)
    moved, turned = in_world(frame, position + way, Rotation.from_rotvec(spin) * orientation)
    np.testing.assert_allclose(moved - p, scale * turn.apply(way), atol=1e-8)
    assert close(turned * q.inv(), Rotation.from_rotvec(turn.apply(spin)))


@settings(deadline=None)  # the first call compiles
@given(TURNS, TURNS, TURNS)
def test_a_fixed_finger_is_where_it_is_wanted(turn, tool, wanted) -> None:
    frame = frame_of(turn, 1.0, (0.0, 0.0, 0.0), tool)
    _, q = in_world(frame, np.zeros(3), Rotation.from_quat(handle_at(frame, tuple(wanted.as_quat()))))
    assert close(q, wanted)

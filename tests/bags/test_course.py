"""What is told of a course of poses, by hand; and what in it no finger does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from finger_sim.bags.course import Course, doubts, figures, rows
from finger_sim.bags.reader import read_commands
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.resources import shipped

FLAT = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""The nail up: the mesh's y is the world's z."""


def straight(seconds: NDArray[np.float64], x: NDArray[np.float64], height: float = 0.006) -> Course:
    """Poses with the nail up, along x."""
    position = np.stack([x, np.zeros_like(x), np.full_like(x, height)], axis=1)
    return Course(np.round(seconds * 1e9).astype(np.int64), position, np.tile(FLAT, (len(x), 1)))


def pulp(axis: int = 1) -> float:
    """How far what is soft of the shipped finger reaches below its frame with the nail up, or another axis [m]."""
    mesh = TetMesh.load(shipped("config") / "meshes" / "finger.vtu")
    free = [i for i in range(len(mesh.points)) if i not in set(mesh.node_sets["bone"].tolist())]
    return -float(mesh.points[free, axis].min())


def test_figures_by_hand() -> None:
    """Ten intervals of 10 ms, one of 30 and one of 11; a repeated stamp, a sign flip, one fast step, a quarter turn."""
    steps = np.array([10, 10, 10, 11, 10, 0, 10, 31, 10, 10, 10, 10, 10]) * 1e-3
    x = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 21, 22]) * 1e-3
    course = straight(np.append(0.0, np.cumsum(steps)), x)
    course.orientation[13] = (0.5, 0.5, 0.5, 0.5)  # turned by 90° about the world's z, in 10 ms
    course.orientation[4] *= -1.0
    found = figures(course, plane=0.001)
    assert (found.poses, found.gaps, found.repeated_stamps, found.sign_flips) == (14, 1, 1, 2)
    assert (found.duration, found.rate) == pytest.approx((0.142, 100.0))
    assert found.jitter == pytest.approx(np.percentile([0.0] * 10 + [1e-3, 21e-3], 90))
    assert (found.longest_gap.value, found.longest_gap.at) == pytest.approx((0.031, 0.061))
    assert (found.low, found.high) == ((0.0, 0.0, 0.006), (0.022, 0.0, 0.006))
    assert found.median_speed == pytest.approx(0.1)
    assert (found.top_speed.value, found.top_speed.at) == pytest.approx((1.0, 0.112))
    assert (found.top_turning.value, found.top_turning.at) == pytest.approx((0.5 * math.pi / 0.01, 0.132))
    assert found.depth.value == pytest.approx(0.001 + pulp() - 0.006, abs=1e-12)
    assert found.touching == 1.0
    assert rows(found)["rate"] == "100 Hz, 90 % of intervals within 9 % of that"
    assert not doubts(found)


def test_depth_of_a_shipped_press() -> None:
    """press_flat goes 2 mm below first touch, which is at a height of about 7 mm; its tremor adds less than 0.05 mm."""
    commands = read_commands(shipped("bags") / "press_flat")
    found = figures(Course(commands.receipt_ns, commands.position, commands.orientation))
    assert found.depth.value == pytest.approx(2e-3, abs=0.06e-3)
    assert pulp() == pytest.approx(7e-3, abs=0.5e-3)
    tip_up = np.array([[0.0, -math.sqrt(0.5), 0.0, math.sqrt(0.5)]])  # the cut end, which follows the bone, is below
    standing = figures(Course(np.zeros(1, dtype=np.int64), np.zeros((1, 3)), tip_up))
    assert standing.depth.value == pytest.approx(pulp(0), abs=1e-12)
    assert not doubts(found)


def test_one_pose_has_no_rate_and_no_speed() -> None:
    """Nothing is divided by zero."""
    found = figures(straight(np.zeros(1), np.zeros(1)))
    assert (found.rate, found.jitter, found.median_speed, found.top_speed.value, found.gaps) == (0.0, 0.0, 0.0, 0.0, 0)
    assert rows(found)["rate"] == "0 Hz"
    same = figures(straight(np.zeros(3), np.arange(3.0)))
    assert (same.rate, same.repeated_stamps, same.top_speed.value) == (0.0, 2, 0.0)


def test_what_no_finger_does() -> None:
    """Metres of motion, speeds of a bullet, a jump, odd rates, air and depth: each with what may be the matter."""
    t = np.arange(200) * 0.01
    far = doubts(figures(straight(t, 50.0 * t * t)))
    assert [text.partition(":")[0] for text in far] == [
        "moves 198 m along x, farther than a hand reaches",
        "moves at 198 m/s at 1.980 s (median 99.5 m/s), faster than a hand",
    ]
    assert all("millimetres" in text and "--scale 0.001" in text for text in far)
    (jump,) = doubts(figures(straight(t, np.where(t < 1.0, 0.0, 0.2))))
    assert jump == "moves at 20 m/s at 0.990 s (median 0 m/s), faster than a hand: a jump in the recording?"
    (slow,) = doubts(figures(straight(100.0 * t, 0.1 * np.sin(t))))
    assert slow == "1 poses a second: times in another unit? import --time-unit"
    (air,) = doubts(figures(straight(t, 0.01 * t, height=0.5)))
    assert air == f"never touches: import --offset z={pulp() - 0.5:.4f} brings the lowest pose to the plane"
    (deep,) = doubts(figures(straight(t, 0.01 * t, height=-0.1)))
    assert deep.startswith(f"presses {1e3 * (pulp() + 0.1):.3g} mm into the plane")
    assert f"--offset z={pulp() + 0.1:.4f} brings the deepest pose to the plane" in deep

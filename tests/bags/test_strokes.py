"""Strokes move as hands do; shipped bags are small and repeatable; recordings keep their quirks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from cases import for_each

from finger_sim.bags.reader import START, BagReader, read_commands
from finger_sim.bags.strokes import (
    FLAT,
    RATE,
    SIDE,
    STROKES,
    TREMOR,
    Stroke,
    main,
    make_bags,
    minimum_jerk,
    touch_height,
    trace,
    tremor,
)
from finger_sim.physics.rotations import matrix
from finger_sim.scene.finger_shape import first_touch
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.resources import shipped

BAGS = ("press_flat", "press_side", "press_slide")


def test_minimum_jerk_is_at_rest_at_both_ends() -> None:
    """From 0 to 1, monotone; velocity and acceleration vanish at the ends; peaks are 15/8 and 10/√3."""
    s = np.linspace(0.0, 1.0, 100_001)
    x = minimum_jerk(s)
    v = np.gradient(x, s)
    a = np.gradient(v, s)
    assert (x[0], x[-1]) == (0.0, 1.0)
    assert (np.diff(x) >= 0.0).all()
    np.testing.assert_allclose([v[0], v[-1]], 0.0, atol=1e-8)
    np.testing.assert_allclose([a[2], a[-3]], 0.0, atol=2e-3)
    np.testing.assert_allclose(v.max(), 15.0 / 8.0, rtol=1e-6)
    np.testing.assert_allclose(np.abs(a).max(), 10.0 / math.sqrt(3.0), rtol=1e-4)
    np.testing.assert_array_equal(minimum_jerk(np.array([-1.0, 2.0])), [0.0, 1.0])


def test_strokes_meet_their_ends() -> None:
    """At the end of each stroke the path is where the stroke says, and a repeated end is a hold."""
    strokes = (
        Stroke(0.5, (0, 0, 1)),
        Stroke(1.0, (1, 2, 3)),
        Stroke(0.25, (1, 2, 3)),
        Stroke(2.0, (0, 0, 0)),
    )
    place = trace(strokes, np.array([0.0, 0.5, 1.0, 1.5, 1.6, 1.75, 3.75, 9.0]))
    expected = [[0, 0, 1], [0, 0, 1], [0.5, 1, 2], [1, 2, 3], [1, 2, 3], [1, 2, 3], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_allclose(place, expected, atol=1e-14)


def test_tremor_is_that_of_a_hand() -> None:
    """About 10 Hz, 0.05 mm, zero at both ends, nothing outside 6 to 14 Hz, the same for the same seed."""
    t = np.arange(3001) / RATE
    shake = tremor(t, seed=3)
    np.testing.assert_allclose(shake[[0, -1]], 0.0, atol=1e-18)
    np.testing.assert_allclose(np.abs(shake).max(axis=0), TREMOR, rtol=1e-12)
    power = np.abs(np.fft.rfft(shake, axis=0)) ** 2
    f = np.fft.rfftfreq(len(t), 1.0 / RATE)
    centre = (f[:, None] * power).sum(axis=0) / power.sum(axis=0)
    np.testing.assert_allclose(centre, 10.0, atol=1.0)
    outside = (f < 6.0) | (f > 14.0)
    assert (power[outside].sum(axis=0) < 1e-3 * power.sum(axis=0)).all()
    np.testing.assert_array_equal(shake, tremor(t, seed=3))
    assert np.abs(shake - tremor(t, seed=4)).max() > TREMOR / 4


def test_touch_height_of_a_box() -> None:
    """Flat, the lowest y carries; on the side, the lowest z, the tip tilted down by 8 degrees."""
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-2.0, 5.0) for z in (-3.0, 7.0)])
    assert touch_height(corners, FLAT) == pytest.approx(2.0, abs=1e-14)
    tilt = math.radians(8.0)
    assert touch_height(corners, SIDE) == pytest.approx(3.0 * math.cos(tilt) + math.sin(tilt), abs=1e-14)


@for_each("name", BAGS)
def test_shipped_bag(name: str) -> None:
    """4 to 8 s at 500 Hz in less than 400 kB, in the world frame, as deep as its name says below the finest mesh."""
    path = shipped("bags") / name
    assert sum(file.stat().st_size for file in path.iterdir()) < 400_000
    assert sorted(file.name for file in path.iterdir()) == ["metadata.yaml", f"{name}_0.mcap"]
    reader = BagReader(path)
    assert [topic.name for topic in reader.topics] == ["/command_pose"]
    assert 4.0 <= reader.duration <= 8.0
    commands = read_commands(path)
    np.testing.assert_array_equal(np.diff(commands.receipt_ns), 10**9 // RATE)
    np.testing.assert_allclose(commands.receipt, commands.stamp, atol=1e-12)
    assert (commands.frame_id, commands.refused, commands.start) == ("world", 0, START)
    np.testing.assert_allclose(commands.orientation, [STROKES[name][0]] * len(commands), atol=1e-15)
    points = TetMesh.load(shipped("config") / "meshes" / "finger_16000.vtu").points
    height = commands.position[:, 2] - touch_height(points, STROKES[name][0])
    depth = 1e-3 if name == "press_side" else 2e-3
    np.testing.assert_allclose(height.min(), -depth, atol=1.1 * TREMOR + 2e-5)
    np.testing.assert_allclose(height[[0, -1]], 3e-3, atol=2e-5)
    above = commands.position[[0, -1], 2] - first_touch(matrix(STROKES[name][0]))
    np.testing.assert_allclose(above, 3e-3, atol=1e-8)
    slid = np.ptp(commands.position[:, :2], axis=0)
    travel = 20e-3 if name == "press_slide" else 0.0
    np.testing.assert_allclose(slid, travel, atol=2.1 * TREMOR)
    speed = np.linalg.norm(np.diff(commands.position, axis=0), axis=1) * RATE
    assert speed.max() < 0.045


def test_bags_are_made_the_same_every_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command makes exactly the shipped files, and refuses to overwrite."""
    assert main([str(tmp_path / "made")]) == 0
    for name in BAGS:
        for file in (f"{name}_0.mcap", "metadata.yaml"):
            ours, made = shipped("bags") / name / file, tmp_path / "made" / name / file
            if file.endswith(".mcap"):
                assert list(BagReader(ours)) == list(BagReader(made))
            else:
                assert ours.read_text() == made.read_text()
    make_bags(tmp_path / "again")
    for file in (tmp_path / "made").rglob("*.*"):
        assert file.read_bytes() == (tmp_path / "again" / file.relative_to(tmp_path / "made")).read_bytes()
    assert main([str(tmp_path / "made")]) == 1
    assert "exists already" in capsys.readouterr().err

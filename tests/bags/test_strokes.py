"""Strokes move as hands do; shipped bags are small and repeatable; recordings keep their quirks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from finger_sim.bags.imports import PAUSE, ImportSummary, import_csv
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
from finger_sim.errors import BagError
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
    """4 to 8 s at 500 Hz in less than 400 kB, in the world frame, pressing as deep as its name says."""
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
    points = TetMesh.load(shipped("config") / "meshes" / "finger.vtu").points
    height = commands.position[:, 2] - touch_height(points, STROKES[name][0])
    depth = 1e-3 if name == "press_side" else 2e-3
    np.testing.assert_allclose(height.min(), -depth, atol=1.1 * TREMOR)
    np.testing.assert_allclose(height[[0, -1]], 3e-3, atol=1e-8)
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


def csv(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    return path


def imported(tmp_path: Path, text: str, **options: object) -> ImportSummary:
    number = len(list(tmp_path.glob("bag*")))
    return import_csv(csv(tmp_path, text), tmp_path / f"bag{number}", **options)  # type: ignore[arg-type]


def poses(summary: ImportSummary) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    commands = read_commands(summary.path)
    return commands.receipt, commands.position, commands.orientation


QUIRKS = """# a recording of a robot
# two comment lines

t,x,y,z,qx,qy,qz,qw,fx
0.0125,-0.1,0.2,0.3,0.5,0.5,0.5,0.5,9
0.0250,-0.1,0.2,0.3,-0.5,-0.5,-0.5,-0.5,nan
0.0250,-0.1,0.2,0.4,0.5,0.5,0.5,0.5,what
# a comment between
0.0375,-0.1,0.2,0.3,0.5,0.5,0.5,0.5,
1.0375,5.0,0.2,0.3,1,1,1,1,9
"""


def test_quirks_of_real_recordings_go_through(tmp_path: Path) -> None:
    """Sign flips, repeated stamps, gaps, jumps and columns of no use: kept and counted."""
    summary = imported(tmp_path, QUIRKS)
    assert (summary.poses, summary.sign_flips, summary.repeated_stamps, summary.gaps) == (5, 2, 1, 1)
    assert summary.longest_gap == pytest.approx(1.0)
    assert summary.duration == pytest.approx(1.025)
    assert summary.rate == pytest.approx(80.0)
    assert summary.defaulted == ()
    t, position, orientation = poses(summary)
    np.testing.assert_allclose(t, [0.0, 0.0125, 0.0125, 0.025, 1.025], atol=1e-12)
    np.testing.assert_array_equal(position[:, 0], [-0.1, -0.1, -0.1, -0.1, 5.0])
    np.testing.assert_array_equal(orientation[:, 0], [0.5, -0.5, 0.5, 0.5, 0.5])


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", " , ", "   "])
def test_separators(tmp_path: Path, separator: str) -> None:
    """Comma, semicolon, tab and blanks separate alike; names come in any order."""
    rows = [("z", "t", "qw"), ("0.25", "1e1", "1"), ("-.5", "10.5", "2")]
    summary = imported(tmp_path, "\ufeff" + "\n".join(separator.join(row) for row in rows))
    t, position, orientation = poses(summary)
    np.testing.assert_allclose(t, [0.0, 0.5])
    np.testing.assert_array_equal(position, [[0.0, 0.0, 0.25], [0.0, 0.0, -0.5]])
    np.testing.assert_array_equal(orientation, [[0.0, 0.0, 0.0, 1.0]] * 2)
    assert summary.defaulted == ("x", "y", "qx", "qy", "qz")


def test_constants_and_offsets(tmp_path: Path) -> None:
    """Constants stand for columns, there or not; offsets are added to what stands then."""
    summary = imported(
        tmp_path,
        "t,x,y\n0,1,2\n1,3,4\n",
        constants={"z": 0.006, "y": 7.0, "qx": 1.0, "qw": 0.0},
        offset={"x": -1.0, "z": 0.001},
        topic="tool",
        frame_id="base",
    )
    _, position, orientation = poses(summary)
    np.testing.assert_allclose(position, [[0.0, 7.0, 0.007], [2.0, 7.0, 0.007]], rtol=1e-15)
    np.testing.assert_array_equal(orientation[0], [1.0, 0.0, 0.0, 0.0])
    assert (summary.topic, summary.defaulted) == ("/tool", ("qy", "qz"))
    assert read_commands(summary.path).frame_id == "base"
    for options, text in (
        ({"constants": {"fx": 1.0}}, "constants: got column 'fx', allowed: x, y, z"),
        ({"offset": {"t": 1.0}}, "offset: got column 't'"),
        ({"offset": {"x": math.nan}}, "offset: x: got nan, allowed: a finite number"),
        ({"constants": {"qw": 0.0}}, ":2: orientation: got .0.0, 0.0, 0.0, 0.0."),
    ):
        with pytest.raises(BagError, match=text):
            imported(tmp_path, "t,x\n0,1\n", **options)


REPEATS = "rep,t,x\n0,0.0,1\n0,0.1,2\n1,0.0,3\n1,0.1,4\n2,0.05,5\n"


def test_repeats(tmp_path: Path) -> None:
    """Where t starts anew the user is told how to take one repeat or all; both then work."""
    with pytest.raises(BagError) as caught:
        imported(tmp_path, REPEATS)
    assert "poses.csv:4: column t: got 0 s after 0.1 s, allowed: times that never fall" in str(caught.value)
    assert "rep goes from 0 to 1 here" in str(caught.value)
    assert "--where rep=0" in str(caught.value)
    t, position, _ = poses(imported(tmp_path, REPEATS, where={"rep": "1.0"}))
    np.testing.assert_allclose(t, [0.0, 0.1])
    np.testing.assert_array_equal(position[:, 0], [3.0, 4.0])
    summary = imported(tmp_path, REPEATS, concatenate="rep")
    t, position, _ = poses(summary)
    np.testing.assert_allclose(t, [0.0, 0.1, 0.1 + PAUSE, 0.2 + PAUSE, 0.2 + 2 * PAUSE], atol=1e-12)
    np.testing.assert_array_equal(position[:, 0], [1, 2, 3, 4, 5])
    assert summary.repeats == 3
    with pytest.raises(BagError, match=r"has no rows with rep=9"):
        imported(tmp_path, REPEATS, where={"rep": "9"})
    with pytest.raises(BagError, match=r"no column 'trial'; found rep, t, x"):
        imported(tmp_path, REPEATS, where={"trial": "9"})


@for_each(
    "text, error",
    [
        ("", "poses.csv: is empty"),
        ("# only a comment\n", "poses.csv: is empty"),
        ("t,x\n", "poses.csv: has no rows"),
        ("x,y\n1,2\n", r"poses.csv:1: got columns x, y, allowed: t \[s\] and any of x, y, z"),
        ("0,1,2\n1,2,3\n", r"poses.csv:1: got columns 0, 1, 2, allowed: t"),
        ("t,x,x\n0,1,1\n", "poses.csv:1: got columns t, x, x, allowed: every name once"),
        ("t,x\n0,1\n1,nan\n", r"poses.csv:3:2: column x: got 'nan', allowed: a finite number \[m\]"),
        ("t,x\n0,-inf\n", "poses.csv:2:2: column x: got '-inf'"),
        ("t,x\n0,1e999\n", "poses.csv:2:2: column x: got '1e999'"),
        ("t,x\n0,\n", "poses.csv:2:2: column x: got ''"),
        ("t,x\n# c\n\n0,abc\n", "poses.csv:4:2: column x: got 'abc'"),
        ("t;x\n0;0,5\n", "poses.csv:2:2: column x: got '0,5'"),
        ("x,t\n0,noon\n", r"poses.csv:2:2: column t: got 'noon', allowed: a finite number \[s\]"),
        ("t,x\n0,1,2\n", "poses.csv:2: got 3 cells, allowed: 2"),
        ("t,x\n0\n", "poses.csv:2: got 1 cells, allowed: 2"),
        ("t,x\n1,0\n0.5,0\n", "poses.csv:3: column t: got 0.5 s after 1 s, allowed: times that never fall"),
        ("t,x\n0,0\n1e9,0\n", "poses.csv:3: column t: got 1e[+]09, .* t is in seconds"),
        ("t,qw\n0,0\n", "poses.csv:2: orientation: got .0.0, 0.0, 0.0, 0.0."),
    ],
)
def test_bad_files_are_refused_by_line_and_column(tmp_path: Path, text: str, error: str) -> None:
    """Every wrong cell is named by file, line, column and value; nothing is written."""
    with pytest.raises(BagError, match=error):
        imported(tmp_path, text)
    assert not list(tmp_path.glob("bag*"))


def test_binary_and_missing_files_are_refused(tmp_path: Path) -> None:
    """Neither a picture nor a path to nowhere ends in a traceback."""
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(BagError, match="not a text file"):
        import_csv(tmp_path / "picture.csv", tmp_path / "bag")
    with pytest.raises(BagError, match=r"nowhere\.csv: cannot be read: No such file"):
        import_csv(tmp_path / "nowhere.csv", tmp_path / "bag")


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e4, 1e4, allow_subnormal=False), min_size=1, max_size=20))
def test_numbers_survive_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    """What a CSV says of a position is in the bag to the last bit."""
    text = "t,x\n" + "".join(f"{k},{value!r}\n" for k, value in enumerate(values))
    _, position, _ = poses(imported(tmp_path_factory.mktemp("numbers"), text))
    assert position[:, 0].tolist() == values

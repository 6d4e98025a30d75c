"""Text files of poses: formats are told apart by what stands in them, recordings keep their quirks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import for_each
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from finger_sim.bags.imports.columns import PAUSE
from finger_sim.bags.imports.poses import Changes, Imported, import_poses
from finger_sim.bags.imports.recorded import Reading
from finger_sim.bags.reader import read_commands
from finger_sim.errors import BagError


def csv(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    return path


def imported(tmp_path: Path, text: str, **options: Any) -> Imported:
    """A bag of a text; options go where they belong."""
    number = len(list(tmp_path.glob("bag*")))
    reading = {name: options.pop(name) for name in list(options) if name in Reading.__dataclass_fields__}
    changes = {name: options.pop(name) for name in list(options) if name in Changes.__dataclass_fields__}
    bag = tmp_path / f"bag{number}"
    return import_poses(csv(tmp_path, text), bag, reading=Reading(**reading), changes=Changes(**changes), **options)


def poses(summary: Imported) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
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
    found = summary.figures
    assert (found.poses, found.sign_flips, found.repeated_stamps, found.gaps) == (5, 2, 1, 1)
    assert (found.longest_gap.value, found.longest_gap.at) == pytest.approx((1.0, 0.025))
    assert (found.duration, found.rate) == pytest.approx((1.025, 80.0))
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
    assert "poses.csv:4: column t: got 0.0 s after 0.1 s, allowed: times that never fall" in str(caught.value)
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
        (
            "0,1,2\n1,2,3\n",
            r"poses.csv:1: got a row of 3 numbers .* and no names; .* --columns t=1 x=2; expected: ",
        ),
        ("t,x,x\n0,1,1\n", "poses.csv:1: got columns t, x, x, of which x, x may be x, allowed: every name once"),
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
        (
            "t,x\n0,0\n1e9,0\n",
            "poses.csv:3: column t: got 1e9, 1e[+]09 s after the first .* in s, .*--time-unit",
        ),
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
        import_poses(tmp_path / "picture.csv", tmp_path / "bag")
    with pytest.raises(BagError, match=r"nowhere\.csv: cannot be read: No such file"):
        import_poses(tmp_path / "nowhere.csv", tmp_path / "bag")


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e4, 1e4, allow_subnormal=False), min_size=1, max_size=20))
def test_numbers_survive_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    """What a CSV says of a position is in the bag to the last bit."""
    text = "t,x\n" + "".join(f"{k},{value!r}\n" for k, value in enumerate(values))
    _, position, _ = poses(imported(tmp_path_factory.mktemp("numbers"), text))
    assert position[:, 0].tolist() == values


TUM_ROWS = "1305031098.665900025 1.5 -2.5 3.5 0.0 0.6 0.0 0.8\n1305031098.675900127 1.5 -2.5 4.5 0.0 0.0 0.6 0.8\n"
EUROC_ROWS = """1403715524907143168,1.5,-2.5,3.5,0.8,0.0,0.6,0.0,-0.1,0.2
1403715524917143270,1.5,-2.5,4.5,0.8,0.0,0.0,0.6,-0.1,0.2
"""
EUROC_HEAD = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [],"
    " v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1]\n"
)
ECHO = (
    "%time,field.header.stamp,field.pose.position.x,field.pose.position.y,field.pose.position.z,"
    "field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w\n"
    "1403715524907143168,0,1.5,-2.5,3.5,0.0,0.6,0.0,0.8\n1403715524917143270,0,1.5,-2.5,4.5,0.0,0.0,0.6,0.8\n"
)


@for_each(
    "text, format, options",
    [
        ("# ground truth\n# timestamp tx ty tz qx qy qz qw\n" + TUM_ROWS, "TUM", {}),
        ("# TF frame: /optical (data: /optical)\n" + TUM_ROWS, "TUM", {}),
        (TUM_ROWS, "TUM", {"format": "tum"}),
        ("timestamp tx ty tz qx qy qz qw\n" + TUM_ROWS, "TUM", {}),
        (EUROC_HEAD + EUROC_ROWS, "EuRoC/ASL", {}),
        (EUROC_HEAD.replace(" [ns]", "") + EUROC_ROWS, "EuRoC/ASL", {}),
        (EUROC_ROWS, "EuRoC/ASL", {"format": "euroc"}),
        ("#time(ns),px,py,pz,qw,qx,qy,qz,vx,bwx\n" + EUROC_ROWS, "CSV", {}),
        ("# timestamp(s) tx ty tz qx qy qz qw\n" + TUM_ROWS, "TUM", {}),
        (ECHO, "CSV of `rostopic echo -p`", {}),
        (
            "Take,hand\n,,Rigid Body\nFrame,Time,a,b,c,d,e,f,g\n"
            "0,5.0,1.5,-2.5,3.5,0.0,0.6,0.0,0.8\n1,5.010000102,1.5,-2.5,4.5,0.0,0.0,0.6,0.8\n",
            "text, columns by number",
            {"columns": {name: str(i) for i, name in enumerate(("t", "x", "y", "z", "qx", "qy", "qz", "qw"), start=2)}},
        ),
        (
            "clock [ms],px [mm],py [mm],pz [mm],quat_x,quat_y,quat_z,quat_w\n"
            "5,1500,-2500,3500,0.0,0.6,0.0,0.8\n15.000102,1500,-2500,4500,0.0,0.0,0.6,0.8\n",
            "CSV",
            {"columns": {"t": "clock"}},
        ),
    ],
)
def test_formats_are_recognised(tmp_path: Path, text: str, format: str, options: dict[str, Any]) -> None:
    """The same two poses, 10.000102 ms apart to the nanosecond, of whatever header, order and unit."""
    summary = imported(tmp_path, text, **options)
    assert summary.format == format
    assert summary.defaulted == ()
    commands = read_commands(summary.path)
    np.testing.assert_array_equal(commands.receipt_ns, [0, 10_000_102])
    np.testing.assert_allclose(commands.position, [[1.5, -2.5, 3.5], [1.5, -2.5, 4.5]], rtol=1e-15)
    np.testing.assert_allclose(commands.orientation, [[0.0, 0.6, 0.0, 0.8], [0.0, 0.0, 0.6, 0.8]], rtol=1e-15)


KITTI = "1 0 0 1.5 0 1 0 -2.5 0 0 1 3.5\n0 -1 0 1.5 1 0 0 -2.5 0 0 1 4.5\n"


def test_kitti_needs_its_times(tmp_path: Path) -> None:
    """Rows of matrices and a file of times; what is missing or does not fit is said."""
    times = tmp_path / "times.txt"
    times.write_text("0.000000e+00\n1.036224e-01\n")
    commands = read_commands(imported(tmp_path, KITTI, times=times).path)
    np.testing.assert_array_equal(commands.receipt_ns, [0, 103_622_400])
    np.testing.assert_array_equal(commands.position, [[1.5, -2.5, 3.5], [1.5, -2.5, 4.5]])
    half = math.sqrt(0.5)
    np.testing.assert_allclose(commands.orientation, [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, half, half]], atol=1e-15)
    with pytest.raises(BagError, match=r"poses.csv:1: KITTI poses carry no times: .* --times FILE"):
        imported(tmp_path, KITTI)
    with pytest.raises(BagError, match=r"poses.csv:2: its first three columns are no rotation"):
        imported(tmp_path, KITTI.replace("0 -1 0 1.5", "0 1 0 1.5"), times=times)
    times.write_text("0.0\n")
    with pytest.raises(BagError, match=r"times.txt: got 1 times, allowed: 2"):
        imported(tmp_path, KITTI, times=times)
    with pytest.raises(BagError, match=r"poses.csv:1: --times is for KITTI poses"):
        imported(tmp_path, TUM_ROWS, times=times)


def test_what_was_assumed_is_said(tmp_path: Path) -> None:
    """Units and columns that nobody named, and what is not there; nothing where all is said."""
    notes = imported(tmp_path, "time,px\n0,1\n1,1\n").notes
    assert notes == (
        "t in s", "columns t = time, x = px", "not in the file: y, z, qx, qy, qz, qw, taken as 0, qw as 1",
        "the finger lies on its side; --set qx=0.7071 --set qw=0.7071 lays its pad on the table",
    )  # fmt: skip
    assert imported(tmp_path, "t [s],x [m],y,z,qx,qy,qz,qw\n0,1,1,1,0,0,0,1\n").notes == ()
    assert imported(tmp_path, "t [ms],x\n0,1\n10,1\n").figures.duration == pytest.approx(0.01)
    for text, options, error in (
        ("t,x\n0,1\n", {"columns": {"x": "px"}}, "poses.csv:1: no column 'px' for x; found t, x"),
        ("t,x\n0,1\n", {"columns": {"fx": "x"}}, "--columns: got column 'fx', allowed: t, x, y"),
        ("t,px,tx\n0,1,2\n", {}, "of which px, tx may be x, .* --columns x=2"),
        ("t,x [mm],y [cm]\n0,1,2\n", {}, "poses.csv:1: got lengths in cm, mm, allowed: one unit"),
        ("0,1\n", {"columns": {"x": "2"}}, "--columns: got x=2, allowed: t and any of"),
        ("t,x\n0,2e7\n", {}, "poses.csv:2: position: got .*; --scale or --offset may bring it near"),
        ("t,x\n0,1\n", {"from_topic": "pose"}, "--from-topic is for bags: a rosbag2 folder"),
        ("t,x\n0,1\n", {"scale": -1.0}, "scale: got -1.0, allowed: a finite number > 0"),
    ):
        with pytest.raises(BagError, match=error):
            imported(tmp_path, text, **options)


def rotation(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix of a quaternion xyzw, from q v q* of the three axes."""

    def times(a: Any, b: Any) -> Any:
        u, w, v, s = np.array(a[:3]), a[3], np.array(b[:3]), b[3]
        return [*(w * v + s * u + np.cross(u, v)), w * s - u @ v]

    conjugate = [-q[0], -q[1], -q[2], q[3]]
    return np.array([times(times(q, [*axis, 0.0]), conjugate)[:3] for axis in np.eye(3)]).T


DEVICE = "t,x,y,z,qx,qy,qz,qw\n0,100,200,300,0.1,0.2,0.3,0.9\n"


def test_device_axes_become_ours(tmp_path: Path) -> None:
    """Millimetres, then R p and R q, then the finger on the tool, then offsets: by matrices of the axes as named."""
    q = np.array([0.1, 0.2, 0.3, 0.9])
    device = rotation(q / np.linalg.norm(q))
    ours = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # our x is the device's -y, our y its x
    finger = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # columns: the finger's axes on the tool
    half = math.sqrt(0.5)
    for rotate in ("x=-y y=x z=z", f"0 0 {half} {half}"):
        for tool in ("x=z y=-x z=-y", "0.5 -0.5 0.5 0.5", None):
            made = imported(tmp_path, DEVICE, scale=0.001, rotate=rotate, tool=tool, offset={"z": -0.25})
            _, position, orientation = poses(made)
            np.testing.assert_allclose(position[0], [-0.2, 0.1, 0.05], atol=1e-15)
            expected = ours @ device @ (np.eye(3) if tool is None else finger)
            np.testing.assert_allclose(rotation(orientation[0]), expected, atol=1e-14)
    _, _, orientation = poses(imported(tmp_path, "t,x\n0,1\n", rotate="x=-y y=x z=z"))
    np.testing.assert_array_equal(orientation[0], [0.0, 0.0, 0.0, 1.0])  # not recorded, so not turned
    for turn, error in (
        ("x=y y=x z=z", "--rotate: got 'x=y y=x z=z', which is a mirror image"),
        ("x=y y=-x", "--rotate: got 'x=y y=-x', allowed: three axes such as"),
        ("x=y y=-y z=z", "allowed: three axes"),
        ("0 0 0 0", "a quaternion .* that is not zero"),
        ("90", "allowed: three axes"),
    ):
        with pytest.raises(BagError, match=error):
            imported(tmp_path, DEVICE, rotate=turn)


def test_resampling_draws_lines_and_arcs(tmp_path: Path) -> None:
    """A turn by 90° about z, signs flipped, and a line, at 4 Hz: angles and places by the rule of three."""
    half = math.sqrt(0.5)
    text = f"t,x,qz,qw\n0,0,0,1\n1,2,{half},{half}\n1,4,{-half},{-half}\n1.6,10,{half},{half}\n"
    made = imported(tmp_path, text, resample=4.0)
    t, position, orientation = poses(made)
    np.testing.assert_allclose(t, np.arange(7) / 4.0, atol=1e-12)
    np.testing.assert_allclose(position[:, 0], [0.0, 1.0, 2.0, 3.0, 4.0, 6.5, 9.0], atol=1e-12)
    turn = np.degrees(2.0 * np.arctan2(orientation[:, 2], orientation[:, 3]))
    np.testing.assert_allclose(turn, [0.0, 22.5, 45.0, 67.5, 90.0, 90.0, 90.0], atol=1e-9)
    assert (made.figures.sign_flips, made.figures.repeated_stamps) == (0, 0)
    with pytest.raises(BagError, match=r"resample: got 1e\+09 Hz, which makes 1600000001 poses"):
        imported(tmp_path, text, resample=1e9)

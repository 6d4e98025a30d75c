"""Comparing bags: what is the same says so, each kind of difference is found, measured and placed in time."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from finger_sim.bags import cdr
from finger_sim.bags.compare import compare
from finger_sim.bags.comparison import TopicComparison
from finger_sim.bags.layout import POINT_DTYPE
from finger_sim.bags.reader import BagReader, BagWriter, read_commands
from finger_sim.bags.verdict import verdict
from finger_sim.cli import main
from finger_sim.errors import BagError
from finger_sim.pictures.info import info

START = 1_700_000_000_000_000_000
MS = 1_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)


def wrenches(
    path: Path,
    force: Callable[[float], float] = lambda t: t,
    *,
    n: int = 100,
    period: int = MS,
    start: int = START,
    frame: str = "finger",
    commands: int = 0,
    **changes: int,
) -> Path:
    """A bag of n wrenches, every `period` ns from `start`, with force z force(t) and torque x 0.5.

    commands : of these there are so many, on another topic
    changes  : `publish_time`, `sequence` of message 50
    """
    with BagWriter(path) as bag:
        bag.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        if commands:
            bag.add_topic("hand/command_pose", cdr.POSE_STAMPED)
        for k in range(n):
            time = start + k * period
            data = cdr.wrench_stamped(time, frame, (0.0, 0.0, force(1e-9 * k * period), 0.5, 0.0, 0.0))
            bag.write("contact_wrench", data, time, **(changes if k == 49 else {}))
            if k < commands:
                bag.write("hand/command_pose", cdr.pose_stamped(0, "world", (0.0, 0.0, 0.0), LEVEL), time)
    return path


def only(a: Path, b: Path, **options: object) -> TopicComparison:
    """The comparison of the one topic of two bags."""
    (topic,) = compare(a, b, **options).topics  # type: ignore[arg-type]
    return topic


def test_a_bag_is_equal_to_its_copy(tmp_path: Path) -> None:
    """Identical, with no difference in any quantity, and the peaks are those of the bag."""
    found = compare(wrenches(tmp_path / "a", commands=3), wrenches(tmp_path / "b", commands=3))
    assert found.equal
    assert [topic.identical for topic in found.topics] == [True, True]
    assert [topic.messages for topic in found.topics] == [(100, 100), (3, 3)]
    force, torque = found.topics[0].differences
    assert (force.rms, force.max, force.peak) == (0.0, 0.0, pytest.approx(0.099))
    assert (torque.rms, torque.max, torque.peak) == (0.0, 0.0, 0.5)


def test_one_bit_is_a_difference_and_its_place_is_told(tmp_path: Path) -> None:
    """A force that differs by one unit in the last place, in message 51."""
    a = wrenches(tmp_path / "a")
    b = wrenches(tmp_path / "b", lambda t: t if t != 0.05 else np.nextafter(t, 1.0))
    topic = only(a, b)
    assert not topic.equal
    assert topic.first == "bytes at 0.050000 s (message 51)"
    assert topic.differences[0].max == np.nextafter(0.05, 1.0) - 0.05
    assert topic.differences[0].max_time == pytest.approx(0.05)
    assert only(a, b, tolerance=1e-15).equal
    assert not only(a, b, tolerance=0.0).equal


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"publish_time": 7}, "publish time at 0.049000 s (message 50)"),
        ({"sequence": 99}, "number at 0.049000 s (message 50)"),
        ({"n": 99}, "only in A at 0.099000 s (message 100)"),
        ({"n": 101}, "only in B at 0.100000 s (message 101)"),
        ({"start": START + 1}, "bytes at 0.000000 s (message 1)"),
    ],
)
def test_times_numbers_and_counts_count_bit_by_bit(tmp_path: Path, change: dict[str, int], says: str) -> None:
    """The same wrenches, but one thing about a message is not the same."""
    topic = only(wrenches(tmp_path / "a"), wrenches(tmp_path / "b", **change))  # type: ignore[arg-type]
    assert not topic.equal
    assert topic.first == says


def test_rms_and_max_of_a_known_difference(tmp_path: Path) -> None:
    """A sine of 0.3 N over whole periods: rms 0.3/√2, largest 0.3 at a quarter, first above 0.1 N at asin(1/3)."""
    wave = lambda t: t + 0.3 * math.sin(2.0 * math.pi * t / 0.1)  # noqa: E731
    a, b = wrenches(tmp_path / "a"), wrenches(tmp_path / "b", wave)
    topic = only(a, b, tolerance=0.1)
    assert topic.differences[0].rms == pytest.approx(0.3 / math.sqrt(2.0), rel=1e-12)
    assert topic.differences[0].max == pytest.approx(0.3, rel=1e-12)
    assert min(abs(topic.differences[0].max_time - t) for t in (0.025, 0.075)) < 1e-9
    assert topic.differences[1].max == 0.0
    assert not topic.equal
    assert str(topic.first).startswith("force by 0.1")
    assert f"at {math.ceil(1e3 * 0.1 / (2 * math.pi) * math.asin(1.0 / 3.0)) * 1e-3:.6f} s" in str(topic.first)
    assert only(a, b, tolerance=0.3 + 1e-12).equal


def test_other_rates_are_compared_at_the_same_time(tmp_path: Path) -> None:
    """A force that rises linearly is the same at 1 kHz and at 300 Hz shifted by 0.4 ms; a late bag is not."""
    a = wrenches(tmp_path / "a")
    b = wrenches(tmp_path / "b", lambda t: t + 0.0004, n=25, period=3_333_333, start=START + 400_000)
    topic = only(a, b, tolerance=1e-12, overlap=True)
    assert topic.equal
    assert not topic.identical
    assert topic.messages == (100, 25)
    assert (topic.outside, topic.compared) == ((1 + 19, 0), 80)
    topic = only(a, b, tolerance=1e-12)
    assert not topic.equal
    assert topic.first == "20 messages of A and 0 of B have no counterpart"
    late = wrenches(tmp_path / "late", start=START + 2 * MS)
    topic = only(a, late, tolerance=1e-3, overlap=True)
    assert not topic.equal
    assert topic.differences[0].max == pytest.approx(0.002)
    assert topic.outside == (2, 2)


def test_bags_of_other_times_count_from_their_first_command(tmp_path: Path) -> None:
    """A recording made an hour later, whose command came 5 ms later, is compared from its command on."""
    a = wrenches(tmp_path / "a", commands=1)
    hour = 3_600_000 * MS
    with BagWriter(tmp_path / "b") as bag:
        bag.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        bag.add_topic("hand/command_pose", cdr.POSE_STAMPED)
        for k in range(-5, 95):
            time = START + hour + k * MS
            force = max(1e-3 * k, 0.0)
            bag.write("contact_wrench", cdr.wrench_stamped(0, "finger", (0, 0, force, 0.5, 0, 0)), time)
            if k == 0:
                bag.write("hand/command_pose", cdr.pose_stamped(0, "world", (0.0, 0.0, 0.0), LEVEL), time)
    found = compare(a, tmp_path / "b", tolerance=1e-12, overlap=True)
    assert found.equal
    assert found.topics[0].outside == (5, 5)


def test_equal_times_are_compared_one_with_one(tmp_path: Path) -> None:
    """Two wrenches at one time are not held against each other."""
    for name in "ab":
        with BagWriter(tmp_path / name) as bag:
            bag.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
            for force in (1.0, 5.0):
                bag.write("contact_wrench", cdr.wrench_stamped(0, "finger", (0, 0, force, 0, 0, 0)), START)
    topic = only(tmp_path / "a", tmp_path / "b")
    assert topic.compared == 2
    assert topic.differences[0].max == 0.0
    assert topic.differences[0].peak == 5.0


def test_frames_and_what_is_no_number_are_never_equal(tmp_path: Path) -> None:
    """The same numbers in another frame, or NaN, are beyond every tolerance; JSON says null."""
    a = wrenches(tmp_path / "a")
    for name, bag in (
        ("frame", wrenches(tmp_path / "frame", frame="world")),
        ("nan", wrenches(tmp_path / "nan", lambda _: math.nan)),
    ):
        found = compare(a, bag, tolerance=1e9)
        assert not found.equal, name
        assert found.topics[0].differences[0].max == math.inf
        assert found.as_plain()["topics"][0]["differences"][0]["max"] is None
        assert str(found.topics[0].first).endswith("at 0.000000 s (message 1)")


def test_poses_clouds_and_meshes_are_measured(tmp_path: Path) -> None:
    """A turn of 0.2 rad whichever sign its quaternion has, points 3-4-0 mm apart, one vertex moved."""
    for name, half, sign, shift in (("a", 0.3, 1.0, 0.0), ("b", 0.4, -1.0, 1.0)):
        points = np.zeros(4, dtype=POINT_DTYPE)
        points["x"][2], points["y"][2] = 3e-3 * shift, 4e-3 * shift
        points["strain"] = 0.25 * shift
        turned = (0.0, 0.0, sign * math.sin(half), sign * math.cos(half))
        with BagWriter(tmp_path / name) as bag:
            bag.add_topic("pose", cdr.POSE_STAMPED)
            bag.add_topic("mesh_points", cdr.POINT_CLOUD)
            bag.add_topic("mesh_topology", cdr.MESH)
            bag.write("pose", cdr.pose_stamped(0, "world", (0.1, 0.0, 0.0), turned), START)
            bag.write("mesh_points", cdr.point_cloud(0, "world", points), START)
            mesh = cdr.mesh(np.eye(3) * (1.0 + 0.01 * shift * np.eye(3)[0]), np.array([[0, 1, 2]]))
            bag.write("mesh_topology", mesh, START)
    found = compare(tmp_path / "a", tmp_path / "b", tolerance=0.0)
    largest = {(t.name, d.quantity): d.max for t in found.topics for d in t.differences}
    expected = {
        ("/pose", "position"): 0.0,
        ("/pose", "orientation"): 0.2,
        ("/mesh_points", "points"): 5e-3,
        ("/mesh_points", "displacement"): 0.0,
        ("/mesh_points", "force"): 0.0,
        ("/mesh_points", "strain/limit"): 0.25,
        ("/mesh_topology", "vertices"): 0.01,
        ("/mesh_topology", "triangles"): 0.0,
    }
    assert largest == pytest.approx(expected, rel=1e-6, abs=1e-12)
    rms = {(t.name, d.quantity): d.rms for t in found.topics for d in t.differences}
    assert rms["/mesh_points", "points"] == pytest.approx(5e-3 / 2.0, rel=1e-6)  # one of four points
    assert compare(tmp_path / "a", tmp_path / "b", tolerance=0.26).equal


def test_a_topic_that_only_one_has_is_a_difference(tmp_path: Path) -> None:
    """Unless the other topics are asked for; a name that neither has is a mistake, as is overlap alone."""
    a, b = wrenches(tmp_path / "a", commands=2), wrenches(tmp_path / "b")
    found = compare(a, b)
    assert {topic.name: topic.first for topic in found.topics if not topic.equal} == {"/hand/command_pose": "only in A"}
    assert compare(a, b, topics=["contact_wrench"]).equal
    with pytest.raises(BagError, match="no topic /force in either; found /contact_wrench, /hand/command_pose"):
        compare(a, b, topics=["force"])
    with pytest.raises(BagError, match="needs a tolerance"):
        compare(a, b, overlap=True)


def test_what_only_a_live_node_writes_is_left_out(tmp_path: Path) -> None:
    """And what only one bag has and cannot be measured; each is named with its reason, and counts where asked for."""
    a, b = tmp_path / "a", wrenches(tmp_path / "b", n=2)
    with BagWriter(a) as bag:
        bag.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
        bag.add_topic("plane_pose", cdr.POSE_STAMPED)
        for name, kind in (("diagnostics", "diagnostic_msgs/msg/DiagnosticArray"), ("tf", "tf2_msgs/msg/TFMessage")):
            bag.add_topic(name, kind, definition=("", ""))
            bag.write(name, b"any", START)
        for k in range(2):
            data = cdr.wrench_stamped(START + k * MS, "finger", (0.0, 0.0, 1e-3 * k, 0.5, 0.0, 0.0))
            bag.write("contact_wrench", data, START + k * MS)
    found = compare(a, b)
    assert found.equal
    assert {topic.name: topic.reason.split(",")[0] for topic in found.left_out} == {
        "/plane_pose": "only in A",
        "/diagnostics": "only a live node writes it",
        "/tf": "only in A",
    }
    assert [topic["name"] for topic in found.as_plain()["left_out"]] == [topic.name for topic in found.left_out]
    assert "left out: " in str(verdict(found)[-2])
    every = compare(a, b, everything=True)
    assert {topic.name for topic in every.topics if not topic.equal} == {"/plane_pose", "/diagnostics", "/tf"}
    assert not compare(a, b, topics=["diagnostics"]).equal
    only_live = tmp_path / "live"
    with BagWriter(only_live) as bag:
        bag.add_topic("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", definition=("", ""))
        bag.write("diagnostics", b"any", START)
    assert verdict(compare(only_live, only_live))[-1] == "not equal: nothing was compared"


def test_it_says_how_many_messages_it_compared_and_why_not_more(tmp_path: Path) -> None:
    """Of A's hundred, two begin before B and one comes after it; of B, one lies between the last two of A."""
    a = wrenches(tmp_path / "a")
    b = wrenches(tmp_path / "b", n=97, start=START + 2 * MS)
    (topic,) = (found := compare(a, b, tolerance=1.0, overlap=True)).topics
    assert (topic.before, topic.after, topic.outside) == ((2, 0), (1, 0), (3, 0))
    said = "2 of A begin before the first of B, 1 of A come after the last of B"
    assert f"/contact_wrench: compared 97 of 100 messages: {said}" in verdict(found)


def test_a_topic_with_one_message_holds_for_the_whole_bag(tmp_path: Path) -> None:
    """The topology of a mesh is the same whenever it was sent; another is not."""
    for name, time, size in (("a", 0, 1.0), ("b", 5 * MS, 1.0), ("c", 5 * MS, 1.1)):
        with BagWriter(tmp_path / name) as bag:
            bag.add_topic("mesh_topology", cdr.MESH)
            bag.write("mesh_topology", cdr.mesh(size * np.eye(3), np.array([[0, 1, 2]])), START + time)
    assert only(tmp_path / "a", tmp_path / "b", tolerance=0.0, overlap=True).equal
    other = only(tmp_path / "c", tmp_path / "b", tolerance=0.01, overlap=True)
    assert (other.equal, other.compared, other.outside) == (False, 1, (0, 0))
    assert other.differences[0].max == pytest.approx(0.1)


def wave(t: float) -> float:
    """A force that never repeats itself within a tenth of a second [N]."""
    return math.sin(8.0 * t) + 0.5 * math.sin(19.0 * t + 1.0)


@pytest.mark.parametrize(("late", "n"), [(3.7e-3, 6000), (-12.2e-3, 900)])
def test_the_lag_is_told_and_what_remains_without_it(tmp_path: Path, late: float, n: int) -> None:
    """Of a wave sampled at other times, longer or shorter than a block; without its lag next to nothing is left."""
    a = wrenches(tmp_path / "a", wave, n=n)
    b = wrenches(tmp_path / "b", lambda t: wave(t + 0.0004 - late), n=n, start=START + 400_000)
    (topic,) = (found := compare(a, b)).topics
    assert topic.lag is not None
    assert topic.lag.seconds == pytest.approx(late, abs=2e-5)
    assert not topic.lag.beyond
    assert topic.lag.rest < 0.01 * topic.lag.rms
    side = f"{1e3 * abs(topic.lag.seconds):.2f} ms {'after' if late > 0.0 else 'before'} A"
    assert any(f"/contact_wrench: B lies {side}" in str(line) for line in verdict(found))


def test_of_what_stands_still_no_lag_is_told(tmp_path: Path) -> None:
    """Nor of what is too short, or no number; a lag beyond those tried is said to be."""
    for name, force, n in (("still", lambda _: 1.0, 900), ("short", wave, 3), ("nan", lambda _: math.nan, 900)):
        a = wrenches(tmp_path / f"a_{name}", force, n=n)
        assert only(a, wrenches(tmp_path / f"b_{name}", lambda t: 1.0 + force(t), n=n)).lag is None, name  # noqa: B023
    far = only(wrenches(tmp_path / "a", n=900), wrenches(tmp_path / "b", lambda t: t - 0.5, n=900)).lag
    assert far is not None
    assert (far.seconds, far.beyond) == (pytest.approx(0.1), True)


def test_a_broken_message_is_equal_to_itself_only(tmp_path: Path) -> None:
    """It ends no comparison, is never equal within a tolerance to what has other bytes, and is named."""
    a = wrenches(tmp_path / "a")
    for name, broken in (("b", b"\x00\x01\x00\x00abc"), ("c", b"\x00\x01\x00\x00abd")):
        with BagWriter(tmp_path / name) as bag:
            bag.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
            for number, message in enumerate(BagReader(a), start=1):
                bag.write("contact_wrench", broken if number == 7 else message.data, message.log_time)
    for one, other in (("a", "b"), ("b", "a"), ("b", "c")):
        for tolerance in (None, 1e9):
            found = compare(tmp_path / one, tmp_path / other, tolerance=tolerance)
            assert not found.equal
            assert "(message 7)" in str(found.topics[0].first)
    assert compare(tmp_path / "b", tmp_path / "b", tolerance=0.0).equal
    assert compare(tmp_path / "b", tmp_path / "b").equal


def test_days_between_two_messages_are_no_signal(tmp_path: Path) -> None:
    """The lag is that of what was recorded on both sides of a gap of 30 years; nothing is taken in between."""

    def far(t: float) -> float:
        return math.sin(20.0 * t)

    for name, lag in (("a", 0.0), ("b", 0.012)):
        with BagWriter(tmp_path / name) as bag:
            bag.add_topic("contact_wrench", cdr.WRENCH_STAMPED)
            for begin in (0.0, 1e9):
                for k in range(400):
                    t = 0.005 * k
                    data = cdr.wrench_stamped(0, "world", [far(t - lag), 0.0, 0.0, 0.0, 0.0, 0.0])
                    bag.write("contact_wrench", data, round((begin + t) * 1e9))
    found = compare(tmp_path / "a", tmp_path / "b", tolerance=10.0).topics[0].lag
    assert found is not None
    assert found.seconds == pytest.approx(0.012, abs=1e-3)


POSE = "geometry_msgs/msg/Pose"


def channels(path: Path, *kept: tuple[str, str, list[bytes]]) -> Path:
    """A bare file with a channel for each name, type and its messages, 1 ms apart."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for name, kind, data in kept:
            schema = writer.register_schema(kind, "ros2msg", b"")
            channel = writer.register_channel(name, "cdr", schema, {})
            for k, each in enumerate(data):
                writer.add_message(channel, START + k * MS, each, START + k * MS)
        writer.finish()
    return path


def stamped(z: float, n: int = 60) -> list[bytes]:
    return [cdr.pose_stamped(START + k * MS, "world", (0.0, 0.0, z), LEVEL) for k in range(n)]


def pose(z: float) -> bytes:
    """A Pose without a stamp."""
    return b"\x00\x01\x00\x00" + np.array([0.0, 0.0, z, *LEVEL]).tobytes()


def test_one_name_with_two_types_is_two_topics(tmp_path: Path) -> None:
    """Whichever type comes last, and with or without the slash: what is a metre apart is so, what is not is not."""
    extra = ("/command_pose", POSE, [pose(0.0)])
    for order in (1, -1):
        a = channels(tmp_path / "a.mcap", *[("/command_pose", cdr.POSE_STAMPED, stamped(0.0)), extra][::order])
        b = channels(tmp_path / "b.mcap", *[("command_pose", cdr.POSE_STAMPED, stamped(1.0)), extra][::order])
        found = compare(a, b, tolerance=1e-9)
        assert not found.equal
        assert {topic.type: (topic.equal, topic.messages) for topic in found.topics} == {
            cdr.POSE_STAMPED: (False, (60, 60)),
            POSE: (True, (1, 1)),
        }
        assert verdict(found)[-1] == f"not equal within 1e-09: /command_pose ({cdr.POSE_STAMPED})"
        assert compare(a, b, tolerance=1.0).equal
        assert read_commands(a, "command_pose").position.shape == (60, 3)
        rows = [column for title, table in info(str(a)) if title == "topics" for column in table.columns]
        rates = dict(zip(rows[1].cells, rows[3].cells, strict=True))
        assert rates == {cdr.POSE_STAMPED: "1000", POSE: "–"}


@pytest.mark.parametrize(
    ("ours", "theirs", "first"),
    [
        ((POSE, [pose(0.0)]), (POSE, [pose(1.0)]), "bytes at 0.000000 s (message 1)"),
        ((POSE, [pose(0.0)] * 3), (POSE, [pose(0.0)] * 4), "0 messages of A and 1 of B have no counterpart"),
        ((POSE, [pose(0.0)]), ("std_msgs/msg/Empty", [b"\0\1\0\0\0"]), f"{POSE} in A, std_msgs/msg/Empty in B"),
    ],
)
def test_what_has_no_numbers_or_another_type_is_never_within_a_tolerance(
    tmp_path: Path, ours: tuple[str, list[bytes]], theirs: tuple[str, list[bytes]], first: str
) -> None:
    """A type whose numbers are not known, other counts of it, and types that no bag shares."""
    same = ("/contact_wrench", cdr.WRENCH_STAMPED, [cdr.wrench_stamped(START, "finger", (0.0,) * 6)])
    a, b = (channels(tmp_path / name, same, ("/hand", *kept)) for name, kept in (("a", ours), ("b", theirs)))
    found = compare(a, b, tolerance=1e9)
    assert {topic.first for topic in found.topics if not topic.equal and topic.type == ours[0]} == {first}
    assert main(["compare", str(a), str(b), "--tolerance", "1e9"]) == 1
    assert compare(a, a, tolerance=0.0).equal


def test_what_is_not_in_cdr_is_never_equal(tmp_path: Path) -> None:
    """Beside what is; unless the other topics are asked for. `info` names it."""
    with (path := tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for name, encoding, data in (("/pose", "cdr", stamped(0.0, 1)[0]), ("/hand", "json", b"{}")):
            schema = writer.register_schema(cdr.POSE_STAMPED, "ros2msg", b"")
            writer.add_message(writer.register_channel(name, encoding, schema, {}), START, data, START)
        writer.finish()
    for tolerance in (None, 1e9):
        found = compare(path, path, tolerance=tolerance)
        assert {topic.name: topic.first for topic in found.topics if not topic.equal} == {
            "/hand": "is in json in B, which cannot be compared"
        }
        assert not found.equal
        assert compare(path, path, tolerance=tolerance, topics=["pose"]).equal
    (_, about), *_ = info(str(path))
    assert f"/hand ({cdr.POSE_STAMPED}): messages in json, not of ROS 2 (cdr)" in list(about.columns[1].cells)


def test_a_tolerance_that_is_no_number_is_a_mistake(tmp_path: Path) -> None:
    """Nothing is larger than NaN."""
    a, b = wrenches(tmp_path / "a", n=3), wrenches(tmp_path / "b", lambda t: t + 1.0, n=3)
    for tolerance in (math.nan, math.inf, -1.0):
        with pytest.raises(BagError, match=f"tolerance: got {tolerance}, allowed: a finite number >= 0"):
            compare(a, b, tolerance=tolerance)


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit codes 0, 1 and 2; a table, or JSON with the same numbers; a cut-off bag is told."""
    a, b = str(wrenches(tmp_path / "a")), str(wrenches(tmp_path / "b", lambda t: t + 0.125))
    assert main(["compare", a, a]) == 0
    assert capsys.readouterr().out.endswith("equal bit by bit\n")
    assert main(["compare", a, b]) == 1
    text = capsys.readouterr().out
    assert re.search(r"^/contact_wrench +100 +100 +100 +no +force +0\.125 N +0\.125 N", text, re.MULTILINE)
    assert text.endswith("not equal bit by bit: /contact_wrench\n")
    assert main(["compare", a, b, "--tolerance", "0.2"]) == 0
    assert capsys.readouterr().out.endswith("equal within 0.2\n")
    assert main(["compare", a, b, "--json"]) == 1
    plain = json.loads(capsys.readouterr().out)
    assert plain["equal"] is False
    assert plain["topics"][0]["differences"][0]["rms"] == pytest.approx(0.125)
    assert main(["compare", a, b, "--all", "--topic", "contact_wrench", "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == plain
    for mistake in ([a, "nowhere"], [a, b, "--topic", "force"], [a, b, "--overlap"]):
        assert main(["compare", *mistake]) == 2
        assert capsys.readouterr().err.startswith("finger_sim: error: ")
    with pytest.raises(SystemExit, match="2"):
        main(["compare", a, b, "--tolerance", "-1"])
    file = next(Path(b).glob("*.mcap"))
    os.truncate(file, file.stat().st_size // 2)
    assert main(["compare", a, b]) == 1
    assert "cut off" in capsys.readouterr().err

"""Bags: other people's readers see what was written; cut, foreign or empty ones never end in a traceback."""

from __future__ import annotations

import json
import os
import random
import signal
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from finger_sim.bags import cdr
from finger_sim.bags.layout import POINT_DTYPE
from finger_sim.bags.reader import (
    FLUSH_PERIOD,
    BagReader,
    BagWriter,
    Compression,
    Qos,
    commands_of,
    plane_poses_of,
    read_commands,
)
from finger_sim.errors import BagError

START = 1_700_000_000_000_000_000
PERIOD = 2_000_000
Q = (0.0, 0.6, 0.0, 0.8)


def pose(k: int, **changes: object) -> bytes:
    values = {
        "stamp": START + k * PERIOD,
        "frame_id": "world",
        "position": (0.001 * k, -2.0, 0.5),
        "orientation": Q,
    }
    return cdr.pose_stamped(**{**values, **changes})  # type: ignore[arg-type]


def write_poses(path: Path, n: int = 1500, topic: str = "command_pose") -> Path:
    with BagWriter(path) as bag:
        bag.add_topic(topic, cdr.POSE_STAMPED)
        for k in range(n):
            bag.write(topic, pose(k), START + k * PERIOD, START + k * PERIOD - 1000)
    return path


def mcap_file(bag: Path) -> Path:
    return bag / f"{bag.name}_0.mcap"


def test_rosbags_reads_what_was_written(tmp_path: Path) -> None:
    """Values, types, times and counts survive into the `rosbags` library, an independent reader."""
    path = write_poses(tmp_path / "bag", 700)
    with AnyReader([path]) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == ("/command_pose", cdr.POSE_STAMPED)
        assert reader.message_count == 700
        for k, (_, time_, raw) in enumerate(reader.messages()):
            message = reader.deserialize(raw, cdr.POSE_STAMPED)
            assert time_ == START + k * PERIOD
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_
            assert (message.header.frame_id, message.pose.position.x) == ("world", 0.001 * k)
            assert (message.pose.orientation.y, message.pose.orientation.w) == (0.6, 0.8)


def test_mcap_ros2_decodes_every_kind_from_the_schema_in_the_file(tmp_path: Path) -> None:
    """The schema text in the file is whole: a decoder that knows no ROS type decodes all kinds."""
    points = np.zeros(3, dtype=POINT_DTYPE)
    points["strain"] = (0.25, 0.5, 1.0)
    with BagWriter(tmp_path / "bag") as bag:
        for topic, kind in (
            ("pose", cdr.POSE_STAMPED),
            ("wrench", cdr.WRENCH_STAMPED),
            ("cloud", cdr.POINT_CLOUD),
            ("mesh", cdr.MESH),
        ):
            bag.add_topic(topic, kind, qos=Qos(depth=1, transient_local=topic == "mesh"))
        bag.write("pose", pose(3), START)
        bag.write("wrench", cdr.wrench_stamped(START, "finger", (1, 2, 3, np.float32(0.5), 5, 6)), START)
        bag.write("cloud", cdr.point_cloud(START, "world", points), START)
        bag.write("mesh", cdr.mesh(np.eye(3), np.array([[0, 1, 2]])), START)
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = {channel.topic: m for _, channel, _, m in reader.iter_decoded_messages()}
        summary = reader.get_summary()
        names = [record.name for record in reader.iter_metadata()]
    assert found["/pose"].pose.position.x == 0.003
    force, torque = found["/wrench"].wrench.force, found["/wrench"].wrench.torque
    assert (force.x, force.y, force.z, torque.x, torque.y, torque.z) == (1, 2, 3, 0.5, 5, 6)
    cloud = found["/cloud"]
    assert (cloud.width, cloud.height, cloud.point_step, cloud.row_step) == (3, 1, 40, 120)
    strain = next(field for field in cloud.fields if field.name == "strain")
    assert (strain.offset, strain.datatype, strain.count) == (36, 7, 1)
    assert np.frombuffer(cloud.data, "<f4").reshape(3, 10)[:, 9].tolist() == [0.25, 0.5, 1.0]
    assert list(found["/mesh"].triangles[0].vertex_indices) == [0, 1, 2]
    assert found["/mesh"].vertices[1].y == 1.0
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 4
    assert names == ["rosbag2"]
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    for channel in summary.channels.values():
        (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        latched = channel.topic == "/mesh"
        assert profile["durability"] == ("transient_local" if latched else "volatile")
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")


def test_rclpy_and_we_read_each_other() -> None:
    """rclpy reads our CDR, and we read its own (whose padding bytes hold whatever was in memory)."""
    serialization = pytest.importorskip("rclpy.serialization")
    messages = pytest.importorskip("geometry_msgs.msg")
    ours = cdr.wrench_stamped(START + 7, "finger_world_aligned", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    message = serialization.deserialize_message(ours, messages.WrenchStamped)
    assert (message.wrench.force.x, message.wrench.torque.z) == (1.0, 6.0)
    assert message.header.stamp.nanosec == 7
    theirs = serialization.serialize_message(message)
    assert len(theirs) == len(ours)
    assert cdr.deserialize(theirs, cdr.WRENCH_STAMPED) == cdr.deserialize(ours, cdr.WRENCH_STAMPED)


def test_metadata_yaml_is_rosbag2_version_9(tmp_path: Path) -> None:
    """metadata.yaml carries what rosbag2 Jazzy writes; the file inside repeats it."""
    path = tmp_path / "bag"
    with BagWriter(path, custom_data={"scene": "finger"}) as bag:
        bag.add_topic("/a/pose", cdr.POSE_STAMPED)
        bag.add_topic("silent", cdr.WRENCH_STAMPED)
        for k in (5, 9):
            bag.write("a/pose", pose(k), START + k)
    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["starting_time"] == {"nanoseconds_since_epoch": START + 5}
    assert information["duration"] == {"nanoseconds": 4}
    assert information["message_count"] == 2
    assert information["files"][0]["message_count"] == 2
    assert information["custom_data"] == {"scene": "finger"}
    assert information["ros_distro"] == "jazzy"
    topics = {t["topic_metadata"]["name"]: t for t in information["topics_with_message_count"]}
    assert {name: t["message_count"] for name, t in topics.items()} == {"/a/pose": 2, "/silent": 0}
    store = get_typestore(Stores.ROS2_JAZZY)
    assert topics["/a/pose"]["topic_metadata"]["type_description_hash"] == store.hash_rihs01(cdr.POSE_STAMPED)
    with mcap_file(path).open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    assert yaml.safe_load(record.metadata["serialized_metadata"]) == information


def test_same_input_same_bytes(tmp_path: Path) -> None:
    """Two writers given the same messages make the same two files."""
    one, two = write_poses(tmp_path / "a" / "bag"), write_poses(tmp_path / "b" / "bag")
    for name in ("bag_0.mcap", "metadata.yaml"):
        assert (one / name).read_bytes() == (two / name).read_bytes()


def test_a_dropped_message_shows_as_a_gap(tmp_path: Path) -> None:
    """Numbers go up by one; a number that its writer skipped is counted as lost."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("pose", cdr.POSE_STAMPED)
        bag.add_topic("other", cdr.POSE_STAMPED)
        for k, number in enumerate((None, None, 5, None, 9)):
            bag.write("pose", pose(k), START + k, sequence=number)
            bag.write("other", pose(k), START + k)
    reader = BagReader(tmp_path / "bag")
    assert [m.sequence for m in reader.messages(["pose"])] == [1, 2, 5, 6, 9]
    assert [m.sequence for m in reader.messages(["other"])] == [1, 2, 3, 4, 5]
    assert {t.name: t.lost for t in reader.topics} == {"/pose": 4, "/other": 0}
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        numbers = [m.sequence for _, c, m in make_reader(stream).iter_messages(topics=["/pose"])]
    assert numbers == [1, 2, 5, 6, 9]


def test_reader_gives_log_time_order(tmp_path: Path) -> None:
    """Messages written out of order, across chunks, come out by log time; equal times as written."""
    order = list(range(0, 3_000_000_000, 7_000_000)) * 2
    random.Random(1).shuffle(order)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("pose", cdr.POSE_STAMPED)
        for number, t in enumerate(order, start=1):
            bag.write("pose", pose(0), START + t, START, sequence=number)
    messages = list(BagReader(tmp_path / "bag"))
    assert [(m.log_time, m.sequence) for m in messages] == sorted(
        (START + t, number) for number, t in enumerate(order, start=1)
    )
    assert {m.publish_time for m in messages} == {START}


@pytest.mark.slow
def test_cut_anywhere_all_whole_chunks_are_read(tmp_path: Path) -> None:
    """A file cut at any byte: all of its whole chunks is read and the cut is told; never a traceback."""
    bag = write_poses(tmp_path / "bag")
    data = mcap_file(bag).read_bytes()
    with mcap_file(bag).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) >= 6
    whole = [m.data for m in BagReader(bag)]
    cuts = sorted({len(data) * i // 40 for i in range(40)} | {len(data) - i for i in range(1, 40)} | set(range(60)))
    for cut in cuts:
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[:cut])
        chunks = [c for c in summary.chunk_indexes if c.chunk_start_offset + c.chunk_length <= cut]
        last = max((c.message_end_time for c in chunks), default=-1)
        expected = whole[: sum(START + k * PERIOD <= last for k in range(len(whole)))]
        try:
            reader = BagReader(path)
        except BagError:
            assert not expected
            continue
        assert [m.data for m in reader] == expected
        assert reader.truncated
        assert "cut off" in str(reader.warning)
        assert _recovered(path) >= len(expected)
        if expected:
            commands = read_commands(path)
            assert len(commands) == len(expected)
            assert commands.warning
        else:
            with pytest.raises(BagError, match="cut off"):
                read_commands(path)


def _recovered(path: Path) -> int:
    """Messages that the mcap library reads front to back before it meets the cut."""
    count = 0
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                count += isinstance(record, McapMessage)
        except (McapError, struct.error, zstandard.ZstdError):
            pass
    return count


def test_folder_without_metadata_is_read(tmp_path: Path) -> None:
    """What a killed recorder leaves, a folder with only the .mcap, is a bag."""
    bag = write_poses(tmp_path / "bag", 300)
    (bag / "metadata.yaml").unlink()
    assert BagReader(bag).message_count == 300
    os.truncate(mcap_file(bag), mcap_file(bag).stat().st_size * 2 // 3)
    assert BagReader(bag).truncated


def test_damaged_bytes_never_end_in_a_traceback(tmp_path: Path) -> None:
    """300 files with random bytes overwritten are read in part or refused with BagError, nothing else."""
    data = mcap_file(write_poses(tmp_path / "bag", 600)).read_bytes()
    dice = random.Random(7)
    path = tmp_path / "damaged.mcap"
    for _ in range(300):
        broken = bytearray(data)
        for _ in range(dice.choice((1, 3, 30))):
            broken[dice.randrange(len(data))] = dice.randrange(256)
        path.write_bytes(broken)
        try:
            for message in BagReader(path):
                assert message.topic
            read_commands(path)
        except BagError:
            pass


RECORD_FOREVER = """
import sys, time
from finger_sim.bags import cdr
from finger_sim.bags.writer import BagWriter
bag = BagWriter(sys.argv[1])
bag.add_topic("pose", cdr.POSE_STAMPED)
while True:
    now = time.time_ns()
    bag.write("pose", cdr.pose_stamped(now, "world", (0, 0, 0), (0, 0, 0, 1)), now)
    print(now, flush=True)
    time.sleep(0.002)
"""


def test_kill_loses_at_most_one_second(tmp_path: Path) -> None:
    """SIGKILL in the middle of a recording: all but the last second is in the bag."""
    command = [sys.executable, "-c", RECORD_FOREVER, str(tmp_path / "bag")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = int(process.stdout.readline())
        while int(process.stdout.readline()) < first + 2_300_000_000:
            pass
        process.send_signal(signal.SIGKILL)
        written = [first] + [int(line) for line in process.stdout.read().split() if len(line) == 19]
    assert process.returncode == -signal.SIGKILL
    reader = BagReader(tmp_path / "bag")
    assert reader.truncated
    assert reader.start_time == first
    assert reader.end_time is not None
    assert written[-1] - reader.end_time <= 1_000_000_000
    sequence = [m.sequence for m in reader]
    assert sequence == list(range(1, len(sequence) + 1))


def test_chunks_span_no_more_than_the_flush_period(tmp_path: Path) -> None:
    """No chunk holds more log time than FLUSH_PERIOD, and `flush` puts all that was written on the disk."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("pose", cdr.POSE_STAMPED)
        for k in range(1000):
            bag.write("pose", pose(k), START + k * PERIOD)
        bag.flush()
        assert BagReader(tmp_path / "bag").message_count == 1000
        bag.flush()
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert max(c.message_end_time - c.message_start_time for c in summary.chunk_indexes) < FLUSH_PERIOD * 1e9
    assert len(summary.chunk_indexes) == 4


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_chunks_are_compressed_as_asked(tmp_path: Path, compression: Compression) -> None:
    """The file says so in every chunk, other readers and we read it alike, cut off too."""
    with BagWriter(tmp_path / "bag", compression=compression) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k in range(1000):
            bag.write("command_pose", pose(k), START + k * PERIOD)
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert {c.compression for c in summary.chunk_indexes} == {"" if compression == "none" else compression}
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        assert [ros.pose.position.x for *_, ros in decoded] == [0.001 * k for k in range(1000)]
    size = mcap_file(tmp_path / "bag").stat().st_size
    assert (size > 100_000) == (compression == "none")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [bytes(raw) for _, _, raw in reader.messages()] == [pose(k) for k in range(1000)]
    assert [m.data for m in BagReader(tmp_path / "bag")] == [pose(k) for k in range(1000)]
    os.truncate(mcap_file(tmp_path / "bag"), size // 2)
    assert 250 <= BagReader(tmp_path / "bag").message_count < 1000
    data = bytearray(mcap_file(tmp_path / "bag").read_bytes())
    data[size // 4 : size // 4 + 8] = b"\xff" * 8
    mcap_file(tmp_path / "bag").write_bytes(data)
    assert BagReader(tmp_path / "bag").truncated


def split(path: Path, n: int = 1000, **options: float) -> Path:
    """A bag of n poses and, first of all, one latched mesh; the pose with number 501 was lost on the way."""
    with BagWriter(path, compression="none", **options) as bag:  # type: ignore[arg-type]
        bag.add_topic("mesh_topology", cdr.MESH, qos=Qos(depth=1, transient_local=True))
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.write("mesh_topology", cdr.mesh(np.eye(3), np.array([[0, 1, 2]])), START)
        for k in range(n):
            bag.write("command_pose", pose(k), START + k * PERIOD, sequence=k + 1 + (k >= 500))
    return path


def test_split_by_time_is_read_as_one_bag(tmp_path: Path) -> None:
    """Four files of half a second, each whole in itself; metadata.yaml names all, as rosbag2's does."""
    path = split(tmp_path / "bag", split_seconds=0.5)
    names = [f"bag_{i}.mcap" for i in range(4)]
    assert sorted(file.name for file in path.iterdir()) == [*names, "metadata.yaml"]
    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == names
    assert [f["path"] for f in information["files"]] == names
    assert [f["message_count"] for f in information["files"]] == [251, 250, 250, 250]
    starts = [START + i * 500_000_000 for i in range(4)]
    assert [f["starting_time"]["nanoseconds_since_epoch"] for f in information["files"]] == starts
    assert {f["duration"]["nanoseconds"] for f in information["files"]} == {498_000_000}
    assert information["starting_time"] == {"nanoseconds_since_epoch": START}
    assert information["duration"] == {"nanoseconds": 1_998_000_000}
    assert information["message_count"] == 1001
    for i, name in enumerate(names):
        with (path / name).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            times = [message.log_time for *_, message, _ in reader.iter_decoded_messages(topics=["/command_pose"])]
            (record,) = reader.iter_metadata()
        assert times == [START + (250 * i + k) * PERIOD for k in range(250)]
        assert yaml.safe_load(record.metadata["serialized_metadata"])["message_count"] == 251 + 250 * i
    with AnyReader([path]) as other:
        assert other.message_count == 1001
        assert {c.topic: c.msgcount for c in other.connections} == {"/mesh_topology": 1, "/command_pose": 1000}
        found = [bytes(raw) for c, _, raw in other.messages() if c.topic == "/command_pose"]
    assert found == [pose(k) for k in range(1000)]
    ours = BagReader(path)
    assert ours.warning is None
    assert {t.name: (t.count, t.lost) for t in ours.topics} == {"/mesh_topology": (1, 0), "/command_pose": (1000, 1)}
    assert [m.data for m in ours.messages(["command_pose"])] == found


def test_split_by_size_bounds_the_files(tmp_path: Path) -> None:
    """No file is larger than the size asked for plus a chunk of half a second; the last begins where it must."""
    path = split(tmp_path / "bag", n=2000, split_bytes=60_000)
    sizes = [file.stat().st_size for file in sorted(path.glob("*.mcap"))]
    chunk = 250 * (len(pose(0)) + 60)
    assert len(sizes) >= 4
    assert all(60_000 <= size < 60_000 + chunk + 20_000 for size in sizes[:-1])
    with AnyReader([path]) as reader:
        assert reader.message_count == 2001


def test_a_split_bag_that_was_killed_is_read(tmp_path: Path) -> None:
    """No metadata.yaml, the last file cut off, or made and still empty: all that came before is there."""
    path = split(tmp_path / "bag", split_seconds=0.5)
    (path / "metadata.yaml").unlink()
    for size, count in ((20_000, 751), (5, 751), (0, 751)):
        os.truncate(path / "bag_3.mcap", size)
        reader = BagReader(path)
        assert reader.message_count == count
        assert "bag_3.mcap" in str(reader.warning)
        assert len(list(reader)) == count


def test_many_writers_to_one_path_make_one_bag(tmp_path: Path) -> None:
    """Of eight threads that begin at once exactly one gets the path, whether its parent is there or not."""
    for round_ in range(20):
        path = tmp_path / str(round_) / "bag"
        made, refused = _race(path)
        (bag,) = made
        assert len(refused) == 7
        assert all("exists" in reason and str(path) in reason for reason in refused)
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.write("command_pose", pose(0), START)
        bag.close()
        assert BagReader(path).message_count == 1


def _race(path: Path) -> tuple[list[BagWriter], list[str]]:
    """Eight threads make a bag at `path` at once: the writers that were made, and the reasons of the others."""
    made: list[BagWriter] = []
    refused: list[str] = []
    gate = threading.Barrier(8)

    def begin() -> None:
        gate.wait()
        try:
            made.append(BagWriter(path))
        except BagError as error:
            refused.append(str(error))

    threads = [threading.Thread(target=begin) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return made, refused


def test_clocks_that_jump_lose_nothing(tmp_path: Path) -> None:
    """An hour back, a day on: all is read in the order of its times, chunks stay short, the span is told right."""
    hour, day = 3_600 * 10**9, 86_400 * 10**9
    times = [START + k * PERIOD + jump for jump in (0, -hour, day) for k in range(300)]
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k, time_ in enumerate(times):
            bag.write("command_pose", pose(k), time_)
        bag.flush()
        assert BagReader(tmp_path / "bag").message_count == 900
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [time_ for _, time_, _ in reader.messages()] == sorted(times)
        assert (reader.start_time, reader.end_time - 1) == (min(times), max(times))
    assert [m.log_time for m in BagReader(tmp_path / "bag")] == sorted(times)
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["duration"]["nanoseconds"] == max(times) - min(times)
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert max(c.message_end_time - c.message_start_time for c in summary.chunk_indexes) < FLUSH_PERIOD * 1e9


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_foxglove_reads_what_was_written(tmp_path: Path, foxglove: tuple[str, ...], compression: Compression) -> None:
    """Foxglove's reader, in JavaScript: profile, values and times, decoded with the schema in the file."""
    with BagWriter(tmp_path / "bag", compression=compression) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k in range(600):
            bag.write("command_pose", pose(k), START + k * PERIOD)
    done = subprocess.run([*foxglove, str(mcap_file(tmp_path / "bag"))], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["profile"], found["count"]) == ("ros2", 600)
    assert found["x"] == [0.001 * k for k in range(600)]
    assert [int(time_) for time_ in found["times"]] == [START + k * PERIOD for k in range(600)]


FILL_DISK = """
import resource, sys
from finger_sim.bags import cdr
from finger_sim.bags.reader import BagReader, BagWriter
from finger_sim.errors import BagError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
bag = BagWriter(sys.argv[1], compression="none")
bag.add_topic("pose", cdr.POSE_STAMPED)
try:
    for k in range(100_000):
        bag.write("pose", cdr.pose_stamped(k, "world", (0, 0, 0), (0, 0, 0, 1)), k * 2_000_000)
except BagError as error:
    print(error)
try:
    bag.write("pose", b"", 0)
except BagError as error:
    print(error)
try:
    bag.cut("it was full")
    print("finished")
except BagError as error:
    print(error)
print(bag.saved)
"""


@pytest.mark.parametrize(("limit", "end"), [(60_000, "too short for an end"), (200_000, "finished")])
def test_full_disk_is_told_and_the_rest_stays_readable(tmp_path: Path, limit: int, end: str) -> None:
    """When the system refuses to write, the reason is in the error, and what reached the disk is read and counted.

    Cut there, the bag is finished where that leaves room for its end; where it does not, nothing is taken from it.
    """
    path = tmp_path / "bag"
    arguments = [sys.executable, "-c", FILL_DISK, str(path), str(limit)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    first, second, third, count = done.stdout.splitlines()
    assert "File too large" in first
    assert "closed" in second
    assert end in third
    reader = BagReader(path)
    assert reader.message_count == len(list(reader)) == int(count) >= 250
    assert (reader.truncated, reader.cut) == ((False, "it was full") if end == "finished" else (True, None))


def test_a_disk_that_fills_up_between_two_files_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """/dev/full stands for the second file: the error names it and the reason; the first file is whole."""
    real = Path.open
    monkeypatch.setattr(
        Path, "open", lambda path, *mode: real(Path("/dev/full") if path.stem == "bag_1" else path, "wb")
    )
    bag = BagWriter(tmp_path / "bag", split_seconds=0.5)
    bag.add_topic("command_pose", cdr.POSE_STAMPED)
    for k in range(250):
        bag.write("command_pose", pose(k), START + k * PERIOD)
    with pytest.raises(BagError, match=r"bag_1.mcap: cannot be written: No space left on device"):
        bag.write("command_pose", pose(250), START + 250 * PERIOD)
    assert bag.counts == {"/command_pose": 250}
    with pytest.raises(BagError, match="closed"):
        bag.write("command_pose", pose(0), START)
    monkeypatch.undo()
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == 250
    bag.cut("full")
    reader = BagReader(tmp_path / "bag")
    assert (reader.warning, reader.cut, reader.message_count, bag.saved) == (None, "full", 250, 250)


def test_existing_and_impossible_outputs_are_refused(tmp_path: Path) -> None:
    """Nothing is overwritten; a path that cannot be made says why."""
    bag = write_poses(tmp_path / "bag", 3)
    before = mcap_file(bag).read_bytes()
    with pytest.raises(BagError, match="exists already"):
        BagWriter(bag)
    assert mcap_file(bag).read_bytes() == before
    (tmp_path / "file").write_text("x")
    with pytest.raises(BagError, match="Not a directory"):
        BagWriter(tmp_path / "file" / "bag")


def test_writer_refuses_misuse(tmp_path: Path) -> None:
    """Unknown types and topics, two types on a topic, negative times, writing after close are BagErrors."""
    with BagWriter(tmp_path / "bag") as bag:
        assert bag.add_topic("pose", cdr.POSE_STAMPED) == bag.add_topic("/pose", cdr.POSE_STAMPED) == "/pose"
        with pytest.raises(BagError, match="not a ROS 2 Jazzy type"):
            bag.add_topic("odd", "odd_msgs/msg/Odd")
        with pytest.raises(BagError, match="cannot be geometry_msgs/msg/WrenchStamped too"):
            bag.add_topic("pose", cdr.WRENCH_STAMPED)
        with pytest.raises(BagError, match="was not announced; have /pose"):
            bag.write("wrench", b"", START)
        with pytest.raises(BagError, match="got -1, -1"):
            bag.write("pose", pose(0), -1)
    bag.close()
    with pytest.raises(BagError, match="closed"):
        bag.write("pose", pose(0), START)


def test_an_exception_leaves_a_readable_unfinished_bag(tmp_path: Path) -> None:
    """After an exception the messages are there, but the bag does not pretend to be whole."""

    def record() -> None:
        with BagWriter(tmp_path / "bag") as bag:
            bag.add_topic("command_pose", cdr.POSE_STAMPED)
            bag.write("command_pose", pose(0), START)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    assert BagReader(tmp_path / "bag").truncated
    assert len(read_commands(tmp_path / "bag")) == 1


def test_sqlite_bags_are_read_alike(tmp_path: Path) -> None:
    """A sqlite3 bag, made by another writer, gives the same commands."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(tmp_path / "db", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/command_pose", cdr.POSE_STAMPED, typestore=store)
        for k in range(50):
            bag.write(connection, START + k * PERIOD, pose(k))
    ours, theirs = read_commands(write_poses(tmp_path / "bag", 50)), read_commands(tmp_path / "db")
    np.testing.assert_array_equal(ours.position, theirs.position)
    np.testing.assert_array_equal(ours.receipt_ns, theirs.receipt_ns)
    reader = BagReader(tmp_path / "db")
    assert reader.start_time == START
    assert reader.duration == pytest.approx(49 * 0.002)
    assert not reader.truncated
    database = next((tmp_path / "db").glob("*.db3"))
    database.write_bytes(database.read_bytes()[:3000])
    with pytest.raises(BagError, match="cut off at byte 3000 of"):
        read_commands(tmp_path / "db")


def test_mcap_of_other_writers_is_read(tmp_path: Path) -> None:
    """MCAP bags of `rosbags`, and files without chunks, are read alike."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(tmp_path / "theirs", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/command_pose", cdr.POSE_STAMPED, typestore=store)
        for k in range(50):
            bag.write(connection, START + k * PERIOD, pose(k))
    assert len(read_commands(tmp_path / "theirs")) == 50
    with (tmp_path / "flat.mcap").open("wb") as stream:
        flat = McapWriter(stream, use_chunking=False)
        flat.start("ros2", "other")
        schema = flat.register_schema(cdr.POSE_STAMPED, "ros2msg", b"")
        channel = flat.register_channel("/command_pose", "cdr", schema)
        for k in range(50):
            flat.add_message(channel, START + k * PERIOD, pose(k), START)
        flat.finish()
    commands = read_commands(tmp_path / "flat.mcap")
    assert len(commands) == 50
    assert commands.warning is None


def _foreign(path: Path, profile: str, encoding: str) -> Path:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile, "other")
        schema = writer.register_schema("geometry_msgs/PoseStamped", "ros1msg", b"")
        channel = writer.register_channel("/command_pose", encoding, schema)
        writer.add_message(channel, 1, b"abc", 1)
        writer.finish()
    return path


def test_empty_foreign_and_missing_bags_are_refused(tmp_path: Path) -> None:
    """Each kind of wrong input has its own clear BagError that names the path."""
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "noise.mcap").write_bytes(random.Random(3).randbytes(5000))
    (tmp_path / "folder").mkdir()
    (tmp_path / "yaml").mkdir()
    (tmp_path / "yaml" / "metadata.yaml").write_text("a: [")
    gone = write_poses(tmp_path / "gone", 3)
    mcap_file(gone).unlink()
    _foreign(tmp_path / "ros1.mcap", "ros1", "ros1")
    _foreign(tmp_path / "json.mcap", "", "json")
    for name, text in {
        "empty.mcap": "is empty",
        "noise.mcap": "not an MCAP file",
        "missing": "no such bag",
        "folder": "not a bag",
        "yaml": "not a bag",
        "gone": "gone_0.mcap is named in metadata.yaml but is not there",
        "ros1.mcap": "profile 'ros1'",
        "json.mcap": "no ROS 2 messages",
    }.items():
        with pytest.raises(BagError, match=text) as caught:
            BagReader(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)


def test_which_topic_commands(tmp_path: Path) -> None:
    """command_pose wins, in any namespace; else the only pose; else the user chooses."""

    def bag(name: str, *topics: tuple[str, str]) -> Path:
        with BagWriter(tmp_path / name) as writer:
            for topic, kind in topics:
                writer.add_topic(topic, kind)
                data = pose(1) if kind == cdr.POSE_STAMPED else cdr.wrench_stamped(1, "f", (0,) * 6)
                writer.write(topic, data, START)
        return tmp_path / name

    poses, wrench = cdr.POSE_STAMPED, cdr.WRENCH_STAMPED
    both = bag("both", ("pose", poses), ("command_pose", poses))
    assert read_commands(both).topic == "/command_pose"
    assert read_commands(both, "pose").topic == "/pose"
    assert read_commands(both, "/pose").topic == "/pose"
    assert read_commands(bag("one", ("tool", poses), ("w", wrench))).topic == "/tool"
    assert read_commands(bag("ns", ("left/command_pose", poses), ("p", poses))).topic == "/left/command_pose"
    with pytest.raises(BagError, match=r"several topics of poses: /a, /b; choose one with --topic"):
        read_commands(bag("two", ("a", poses), ("b", poses)))
    with pytest.raises(BagError, match=r"topic /w is geometry_msgs/msg/WrenchStamped, allowed: .*PoseStamped"):
        read_commands(bag("wrong", ("w", wrench), ("p", poses)), "w")
    with pytest.raises(BagError, match=r"no topic of type .*PoseStamped; found /w \(geometry_msgs"):
        read_commands(bag("none", ("w", wrench)))
    with pytest.raises(BagError, match=r"no topic /q; found /pose"):
        read_commands(both, "q")
    with BagWriter(tmp_path / "silent") as writer:
        writer.add_topic("command_pose", poses)
    with pytest.raises(BagError, match=r"command_pose has no message|no topic of type"):
        read_commands(tmp_path / "silent")


def test_which_topic_moves_the_plane(tmp_path: Path) -> None:
    """plane_pose, beside the commands if it is in several namespaces; it never commands unless asked to."""

    def bag(name: str, *topics: str, silent: tuple[str, ...] = ()) -> BagReader:
        with BagWriter(tmp_path / name) as writer:
            for topic in topics:
                writer.write(writer.add_topic(topic, cdr.POSE_STAMPED), pose(1), START)
            for topic in silent:
                writer.add_topic(topic, cdr.POSE_STAMPED)
        return BagReader(tmp_path / name)

    def chosen(reader: BagReader, topic: str | None = None, plane: str | None = None) -> tuple[str, str | None]:
        commands = commands_of(reader, topic)
        poses = plane_poses_of(reader, commands, plane)
        return commands.topic, poses.topic if poses is not None else None

    live = bag("live", "pose", "command_pose", "plane_pose")
    assert chosen(live) == ("/command_pose", "/plane_pose")
    assert chosen(live, "pose", "command_pose") == ("/pose", "/command_pose")
    assert chosen(bag("unmoved", "pose", "command_pose", silent=("plane_pose",))) == ("/command_pose", None)
    assert chosen(bag("remapped", "device/pose", "plane_pose")) == ("/device/pose", "/plane_pose")
    two = bag("two", "left/plane_pose", "left/command_pose", "right/plane_pose")
    assert chosen(two) == ("/left/command_pose", "/left/plane_pose")
    with pytest.raises(BagError, match=r"several topics of poses: /device/pose, /pose; choose one with --topic"):
        chosen(bag("several", "device/pose", "plane_pose", "pose"))
    with pytest.raises(BagError, match=r"/left/plane_pose, /right/plane_pose; choose one with --plane-topic"):
        chosen(bag("apart", "command_pose", "left/plane_pose", "right/plane_pose"))
    with pytest.raises(BagError, match=r"/command_pose cannot hold both"):
        chosen(live, None, "command_pose")
    with pytest.raises(BagError, match=r"no topic /table; found /pose"):
        chosen(live, None, "table")
    alone = bag("alone", "plane_pose")
    with pytest.raises(BagError, match=r"no topic of type .*PoseStamped; found /plane_pose"):
        chosen(alone)
    assert chosen(alone, "plane_pose") == ("/plane_pose", None)


def test_commands_keep_what_hands_and_robots_do(tmp_path: Path) -> None:
    """Repeated stamps, gaps and sign flips stay; bad commands are refused one by one and counted."""
    good = [
        (0, {}),
        (0, {}),
        (500, {"orientation": (0.0, -1.2, 0.0, -1.6)}),
        (501, {"position": (9.0, 9.0, 9.0)}),
    ]
    bad = [
        {"position": (float("nan"), 0.0, 0.0)},
        {"orientation": (0.0, 0.0, 0.0, 0.0)},
        {"frame_id": "map"},
        {"orientation": (0.0, float("inf"), 0.0, 1.0)},
    ]
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.write("command_pose", pose(0, **bad[0]), START - 5)
        for k, changes in good:
            bag.write("command_pose", pose(k, **changes), START + k * PERIOD)
        for changes in bad[1:]:
            bag.write("command_pose", pose(502, **changes), START + 502 * PERIOD)
    commands = read_commands(tmp_path / "bag")
    assert (len(commands), commands.refused, commands.frame_id) == (4, 4, "world")
    assert "message 1: position: got (nan" in str(commands.refusal)
    np.testing.assert_allclose(commands.receipt, [0.0, 0.0, 1.0, 1.002], rtol=1e-12)
    np.testing.assert_allclose(commands.stamp, [0.0, 0.0, 1.0, 1.002], rtol=1e-12)
    np.testing.assert_allclose(commands.orientation[2], [0.0, -0.6, 0.0, -0.8], rtol=1e-15)
    with BagWriter(tmp_path / "hopeless") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.write("command_pose", pose(0, **bad[0]), START)
    with pytest.raises(BagError, match=r"no good command; message 1: position: got \(nan"):
        read_commands(tmp_path / "hopeless")
    with BagWriter(tmp_path / "short") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.write("command_pose", pose(0)[:40], START)
    with pytest.raises(BagError, match="topic /command_pose, message 1: "):
        read_commands(tmp_path / "short")


def test_broken_clocks_are_refused(tmp_path: Path) -> None:
    """Log times that jump from 1970 to now would be years of simulation: said, not begun."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for time_ in (0, START, 2**64 - 1):
            bag.write("command_pose", pose(0), time_)
    with pytest.raises(BagError, match=r"/command_pose: log times span 1.84e\+10 s, allowed: 1e\+06 s"):
        read_commands(tmp_path / "bag")
    for name, time_ in (("old", 0), ("late", 2**64 - 1)):
        with BagWriter(tmp_path / name) as bag:
            bag.write(bag.add_topic("command_pose", cdr.POSE_STAMPED), pose(0), START)
            bag.write(bag.add_topic("plane_pose", cdr.POSE_STAMPED), pose(0), time_)
        reader = BagReader(tmp_path / name)
        with pytest.raises(BagError, match=r"/plane_pose: a log time is .* s away from the first command"):
            plane_poses_of(reader, commands_of(reader))

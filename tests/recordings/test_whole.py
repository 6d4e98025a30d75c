"""Recordings with nothing wrong: each format, with all that recorders put into one, is read as it was written."""

from __future__ import annotations

from pathlib import Path

import pytest
from recordings.content import COMMANDS, CONTENTS, NUMBERED, START, Content, plain, two_types
from recordings.formats import FORMATS, Recording, read_metadata, write, write_metadata
from recordings.judges import assert_commands, assert_explained, judges, read, seen

from finger_sim.bags.compare import compare
from finger_sim.bags.reader import BagReader, read_commands
from finger_sim.errors import BagError

WITHOUT_PROMISE = [name for name, format in FORMATS.items() if format.compressed and not format.folder]
"""Compressed by rosbag2 or by hand and without the words that say so: such a file is read or explained."""


def made(name: str, content: Content, folder: Path) -> Recording:
    return write(FORMATS[name], folder, content)


PAIRS = [
    (name, content)
    for name, format in FORMATS.items()
    for content in CONTENTS
    if name not in WITHOUT_PROMISE and (format.storage == "mcap" or content not in NUMBERED)
]


@pytest.mark.parametrize(("name", "content"), PAIRS)
def test_read_as_written(name: str, content: str, tmp_path: Path) -> None:
    """By us and by all who can: the same messages, ours in the order of time, and no warning."""
    recording = made(name, CONTENTS[content](), tmp_path)
    put = recording.content
    for judge in judges(recording):
        assert sorted(judge(recording)) == sorted(m.seen for m in put.put)
    reader, messages = read(recording.path)
    assert messages == [m.seen for m in put.ordered]
    assert (
        {(m.topic, m.type) for m in put.put} <= {(topic.name, topic.type) for topic in reader.topics} <= {*put.topics}
    )
    assert (reader.warning, reader.notes) == (None, ())
    if recording.format.storage == "mcap":
        assert [m.sequence for m in reader] == [m.sequence for m in put.ordered]
        lost = sum(topic.lost or 0 for topic in reader.topics)
        assert lost == (put.lost or 0)
    if put.commands:
        assert_commands(recording.path, put.commands, put.refused)
    else:
        with pytest.raises(BagError) as caught:
            read_commands(recording.path, COMMANDS)
        assert_explained(caught.value, recording.path, "no ")


@pytest.mark.parametrize("suffix", ["", ".mcap", ".db3"])
@pytest.mark.parametrize("name", WITHOUT_PROMISE)
def test_bare_compressed_files_are_read_or_explained(name: str, suffix: str, tmp_path: Path) -> None:
    """Whatever they are called: by what their bytes say."""
    recording = made(name, plain(), tmp_path)
    path = recording.path
    if suffix:
        path = recording.path.rename(tmp_path / f"recording{suffix}")
    try:
        reader, messages = read(path)
    except BagError as error:
        assert_explained(error, path, recording.format.outside or recording.format.messages)
    else:
        assert messages == [m.seen for m in recording.content.ordered]
        assert reader.warning is None
        assert_commands(path, recording.content.commands)


@pytest.mark.parametrize("name", ["mcap", "mcap zstd messages", "mcap split", "db3 schema 2", "db3 split"])
@pytest.mark.parametrize("wrong", ["duration", "start", "counts", "full disk"])
def test_metadata_that_disagrees_is_told_and_not_believed(name: str, wrong: str, tmp_path: Path) -> None:
    recording = made(name, plain(), tmp_path)
    words = read_metadata(recording.path)
    if wrong == "duration":
        words["duration"]["nanoseconds"] //= 2
    elif wrong == "start":
        words["starting_time"]["nanoseconds_since_epoch"] -= 5_000_000_000
    else:
        more = -7 if wrong == "counts" else 1000
        words["message_count"] += more
        words["topics_with_message_count"][0]["message_count"] += more
    write_metadata(recording.path, words)
    reader, messages = read(recording.path)
    assert messages == [m.seen for m in recording.content.ordered]
    said = " ".join([reader.warning or "", *reader.notes])
    assert "metadata.yaml" in said
    assert (reader.warning is None) == (wrong != "full disk")


@pytest.mark.parametrize("name", ["mcap", "db3 schema 4"])
def test_two_types_on_a_topic_are_compared_each_with_its_own(name: str, tmp_path: Path) -> None:
    """Poses that are a metre apart are not equal because another type is on their topic."""
    ours = two_types()
    apart = [
        m._replace(data=m.data[:-56] + CONTENTS["plain"]().put[5].data[-56:]) if len(m.data) > 70 else m
        for m in ours.put
    ]
    one = made(name, ours, tmp_path / "one").path
    same = made(name, ours, tmp_path / "same").path
    other = made(name, Content(tuple(apart), ours.topics), tmp_path / "other").path
    assert compare(one, same, tolerance=0.0).equal
    assert not compare(one, other, tolerance=1e-4).equal


def test_every_format_compares_equal_with_every_other(tmp_path: Path) -> None:
    """What a replay and a comparison see does not depend on how it was recorded."""
    one = made("mcap", plain(), tmp_path / "one").path
    for number, name in enumerate(name for name in FORMATS if name not in WITHOUT_PROMISE):
        other = made(name, plain(), tmp_path / str(number)).path
        assert compare(one, other, tolerance=0.0).equal, name


@pytest.mark.parametrize(
    ("name", "content", "lost"),
    [
        ("mcap", "plain", 0),
        ("mcap", "several_publishers", 0),
        ("mcap", "numbers_mixed", None),
        ("db3 schema 4", "plain", None),
    ],
)
def test_missing_numbers_are_claimed_where_one_writer_numbers(
    name: str, content: str, lost: int | None, tmp_path: Path
) -> None:
    recording = made(name, CONTENTS[content](), tmp_path)
    (commands,) = (topic for topic in BagReader(recording.path).topics if topic.name == COMMANDS)
    assert commands.lost == lost


def test_a_bag_and_its_copy_in_sqlite3_are_the_same_bit_by_bit(tmp_path: Path) -> None:
    """sqlite3 keeps no numbers: a message is as many as it is on its topic."""
    one, other = (made(name, plain(), tmp_path / name).path for name in ("mcap", "db3 schema 4"))
    assert compare(one, other).equal


def test_messages_can_be_read_again_and_by_topic(tmp_path: Path) -> None:
    for number, name in enumerate(name for name in FORMATS if name not in WITHOUT_PROMISE):
        recording = made(name, plain(), tmp_path / str(number))
        reader = BagReader(recording.path)
        for _ in range(2):
            wanted = [m.seen for m in recording.content.ordered if m.topic == COMMANDS]
            assert seen(reader.messages([COMMANDS])) == wanted, name
        assert reader.start_time == START

"""Recordings with something wrong: what reached the file is read, and what is wrong is said."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from recordings.content import START, Content, plain
from recordings.damage import chunks, flip, killed, killed_while_rolling, log_times, state
from recordings.formats import FORMATS, Format, Recording, read_metadata, write, write_metadata
from recordings.judges import Seen, assert_commands, assert_explained, by_sqlite, read

from finger_sim.errors import BagError

CUTS = 8
"""Places at which a file is cut off, evenly over its bytes."""
NEAR = 0.005
"""How exactly a warning must name a time [s]."""


def expected(recording: Recording, times: list[int], but: bool = False) -> list[Seen]:
    """What was put in at these log times, or at all but these, in the order of time."""
    return [m.seen for m in recording.content.ordered if (m.log_time in times) != but]


def assert_names_span(warning: str, first: int, last: int) -> None:
    """The warning has both ends of a span, in seconds from the start of the recording or since 1970."""
    found = [float(text) for text in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", warning)]
    for time in (first, last):
        assert any(abs(value - (time - zero) * 1e-9) <= NEAR for value in found for zero in (START, 0)), warning


@pytest.mark.parametrize("checkpointed", [None, 0, 33])
@pytest.mark.parametrize("place", ["bare", "folder", "folder with metadata"])
@pytest.mark.parametrize("schema", [2, 3, 4])
def test_log_of_a_killed_recorder_is_read(schema: int, place: str, checkpointed: int | None, tmp_path: Path) -> None:
    """All that was committed, whatever of it is in the database; and nothing beside the recording changes."""
    format = Format("sqlite3", schema=schema, folder=place != "bare", metadata=False)
    recording = killed(tmp_path, format, plain(), checkpointed)
    if place == "folder with metadata":
        whole = write(FORMATS[f"db3 schema {schema}"], tmp_path / "whole", plain())
        write_metadata(recording.path, read_metadata(whole.path))
    folder = recording.files[0].parent
    os.chmod(folder, 0o555)
    before = state(folder)
    try:
        reader, messages = read(recording.path)
        assert messages == [m.seen for m in recording.content.ordered]
        assert_commands(recording.path, recording.content.commands)
        assert reader.warning is None
        assert state(folder) == before
    finally:
        os.chmod(folder, 0o755)
    assert sorted(by_sqlite(recording, "mode=rw")) == sorted(m.seen for m in recording.content.put)


def test_log_that_is_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    """The machine stopped too: the last pages of the log are not whole."""
    recording = killed(tmp_path, Format("sqlite3", folder=False), plain(), 20)
    log = recording.path.with_name(recording.path.name + "-wal")
    os.truncate(log, log.stat().st_size * 2 // 3)
    _, messages = read(recording.path)
    assert sorted(messages) == sorted(by_sqlite(recording, "mode=rw"))
    assert 20 < len(messages) < len(recording.content.put)


def test_transaction_that_was_not_committed_is_taken_back(tmp_path: Path) -> None:
    recording = killed_while_rolling(tmp_path, Format("sqlite3", folder=False), plain(), 30)
    before = state(tmp_path)
    _, messages = read(recording.path)
    assert messages == [m.seen for m in recording.content.ordered]
    assert state(tmp_path) == before
    assert sorted(by_sqlite(recording, "mode=rw")) == sorted(messages)


@pytest.mark.parametrize("name", [name for name, f in FORMATS.items() if f.storage == "mcap" and not f.compressed])
def test_mcap_cut_off_anywhere(name: str, tmp_path: Path) -> None:
    """All whole chunks before the cut are read, or all whole messages outside of chunks; the cut is told."""
    recording = write(FORMATS[name], tmp_path, plain())
    file = recording.files[-1]
    data = file.read_bytes()
    others = [m for other in recording.files[:-1] for m in log_times(other.read_bytes(), 0, len(other.read_bytes()))]
    for cut in {len(data) * k // CUTS for k in range(CUTS)} | {len(data) - 1, len(data) - 8, 40}:
        file.write_bytes(data[:cut])
        wanted = expected(recording, others + log_times(data, 0, cut))
        try:
            reader, messages = read(recording.path)
        except BagError as error:
            assert not wanted
            assert_explained(error, file)
            continue
        assert messages[: len(wanted)] == wanted
        assert messages == [m.seen for m in recording.content.ordered][: len(messages)]
        assert file.name in str(reader.warning)


@pytest.mark.parametrize("name", [name for name, f in FORMATS.items() if f.storage == "sqlite3" and not f.compressed])
def test_sqlite_cut_off_anywhere(name: str, tmp_path: Path) -> None:
    """A part that is told to be one, or a clear error."""
    recording = write(FORMATS[name], tmp_path, plain())
    file = recording.files[-1]
    data = file.read_bytes()
    for cut in {len(data) * k // CUTS for k in range(CUTS)} | {len(data) - 1}:
        file.write_bytes(data[:cut])
        try:
            reader, messages = read(recording.path)
        except BagError as error:
            assert_explained(
                error, file if recording.format.files == 1 and not recording.format.folder else file.parent
            )
            continue
        assert set(messages) <= {m.seen for m in recording.content.put}
        assert reader.warning


CHECKED = [name for name, format in FORMATS.items() if format.covered and not format.compressed]


@pytest.mark.parametrize("which", ["second", "middle", "last"])
@pytest.mark.parametrize("name", CHECKED)
def test_one_damaged_chunk_is_left_out(name: str, which: str, tmp_path: Path) -> None:
    """The others are read; the warning names the span that is missing."""
    recording = write(FORMATS[name], tmp_path, plain())
    file = recording.files[len(recording.files) // 2]
    data = file.read_bytes()
    found = chunks(data)
    chunk = found[{"second": 1, "middle": len(found) // 2, "last": -1}[which]]
    flip(file, (chunk.inside + chunk.end) // 2)
    lost = log_times(data, chunk.begin, chunk.end)
    reader, messages = read(recording.path)
    assert messages == expected(recording, lost, but=True)
    warning = str(reader.warning)
    assert file.name in warning
    assert_names_span(warning, chunk.first, chunk.last)
    if not recording.format.chunks:
        assert "checksum" in warning
    assert_commands(recording.path, [m for m in recording.content.commands if m.log_time not in lost])


@pytest.mark.parametrize("name", [name for name in CHECKED if FORMATS[name].summary])
def test_damaged_first_chunk_takes_no_other_with_it(name: str, tmp_path: Path) -> None:
    """The channels, which it is the first to name, are named by the summary too."""
    recording = write(FORMATS[name], tmp_path, plain())
    data = recording.files[0].read_bytes()
    chunk = chunks(data)[0]
    flip(recording.files[0], (chunk.inside + chunk.end) // 2)
    reader, messages = read(recording.path)
    assert messages == expected(recording, log_times(data, chunk.begin, chunk.end), but=True)
    assert reader.warning


@pytest.mark.parametrize("name", ["mcap", "mcap lz4", "mcap zstd", "mcap without summary"])
def test_two_damaged_chunks_and_a_cut(name: str, tmp_path: Path) -> None:
    """Each is told."""
    recording = write(FORMATS[name], tmp_path, plain())
    file = recording.files[0]
    data = file.read_bytes()
    found = chunks(data)
    for chunk in (found[2], found[5]):
        flip(file, chunk.inside + 3)
    os.truncate(file, found[-2].end - 20)
    reader, messages = read(recording.path)
    kept = [found[k] for k in (0, 1, 3, 4, *range(6, len(found) - 2))]
    assert messages == expected(recording, [time for c in kept for time in log_times(data, c.begin, c.end)])
    for chunk in (found[2], found[5]):
        assert_names_span(str(reader.warning), chunk.first, chunk.last)


@pytest.mark.parametrize("name", [name for name, format in FORMATS.items() if format.messages and format.folder])
@pytest.mark.parametrize("how", ["flipped", "cut short", "empty", "not compressed"])
def test_damaged_message_of_a_bag_compressed_by_messages(name: str, how: str, tmp_path: Path) -> None:
    """What came before it is read, and the damage is told."""
    bad = 70
    content = plain()
    damaged = recompressed(FORMATS[name], tmp_path / "damaged", bad, how)
    try:
        reader, messages = read(damaged.path)
    except BagError as error:
        pytest.fail(f"nothing is read: {error}")
    wanted = [m.seen for m in content.ordered[:bad]]
    assert messages[:bad] == wanted
    if how in ("flipped", "cut short"):
        assert content.ordered[bad].seen not in messages
        assert set(messages) <= {m.seen for m in content.put}
        assert reader.warning


def recompressed(format: Format, folder: Path, bad: int, how: str) -> Recording:
    """A recording one of whose compressed messages is not what it should be."""
    from recordings import formats

    codec, content = formats.CODECS["zstd"], plain()
    target = content.put[bad].data

    def compress(data: bytes) -> bytes:
        whole = codec(data)
        if data != target:
            return whole
        middle = len(whole) // 2
        return {
            "flipped": whole[:6] + b"\xff" * 6 + whole[12:], "cut short": whole[:middle], "empty": b"",
            "not compressed": data,
        }[how]  # fmt: skip

    formats.CODECS["zstd"] = compress
    try:
        return write(format, folder, content)
    finally:
        formats.CODECS["zstd"] = codec


@pytest.mark.parametrize("name", [name for name, format in FORMATS.items() if format.outside])
@pytest.mark.parametrize("how", ["cut", "flipped", "magic", "empty"])
def test_damaged_file_of_a_bag_compressed_by_files(name: str, how: str, tmp_path: Path) -> None:
    """What came before the damage is read and the damage told, or the error names the file and its compression."""
    recording = write(FORMATS[name], tmp_path, plain())
    file = recording.files[-1]
    data = file.read_bytes()
    for part in range(1, 8):
        place = len(data) * part // 8
        if how == "cut":
            file.write_bytes(data[:place])
        elif how == "flipped":
            file.write_bytes(data[:place] + bytes(b ^ 0xFF for b in data[place : place + 3]) + data[place + 3 :])
        else:
            file.write_bytes(b"" if how == "empty" else b"\0\0\0\0" + data[4:])
        try:
            reader, messages = read(recording.path)
        except BagError as error:
            words = [recording.format.outside] if how in ("cut", "flipped") else []
            assert_explained(error, file, *words)
            continue
        if recording.format.covered:
            assert set(messages) <= {m.seen for m in recording.content.put}
        assert reader.warning or len(messages) == len(recording.content.put)


@pytest.mark.parametrize("name", ["mcap", "mcap lz4", "mcap zstd messages", "db3 schema 3", "db3 split"])
def test_messages_that_did_not_reach_a_full_disk(name: str, tmp_path: Path) -> None:
    """metadata.yaml counts more than there is: every count is of what is there, and the difference is told."""
    content = plain()
    recording = write(FORMATS[name], tmp_path, content)
    half = write(FORMATS[name], tmp_path / "half", Content(content.put[:50]))
    write_metadata(half.path, read_metadata(recording.path))
    reader, messages = read(half.path)
    assert messages == [m.seen for m in half.content.ordered]
    text = str(reader.warning)
    assert "metadata.yaml" in text
    assert str(len(content.put)) in text
    assert str(50) in text


@pytest.mark.parametrize("name", ["mcap split", "mcap split without metadata", "db3 split", "mcap zstd file"])
def test_one_file_of_several_is_damaged(name: str, tmp_path: Path) -> None:
    """The messages of the others are read and the damage told, or the error names that file."""
    recording = write(FORMATS[name], tmp_path, plain())
    file = recording.files[-1]
    for data in (b"", file.read_bytes()[:10], b"\0" * 5000):
        file.write_bytes(data)
        try:
            reader, messages = read(recording.path)
        except BagError as error:
            assert_explained(error, file)
            continue
        count = -(-len(recording.content.put) // recording.format.files) * (recording.format.files - 1)
        assert sorted(messages) == sorted(m.seen for m in recording.content.put[:count])
        assert file.name in str(reader.warning)


@pytest.mark.parametrize("name", ["mcap split", "db3 split"])
def test_one_file_of_several_is_gone(name: str, tmp_path: Path) -> None:
    recording = write(FORMATS[name], tmp_path, plain())
    recording.files[1].unlink()
    with pytest.raises(BagError) as caught:
        read(recording.path)
    assert_explained(caught.value, recording.files[1])

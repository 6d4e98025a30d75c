"""Where the messages of a bag come from: what lies at a path, by its content, and what its metadata.yaml says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from ..errors import BagError
from ..scene.resources import BAGS, PACKED
from .message import Source
from .metadata import CUT, origin_in
from .packing import Scratch, Stored, stored

_CLOSE_ENOUGH = 1_000_000
"""Times in a metadata.yaml may be that far from those of the messages [ns]: some writers count to behind the last."""

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The one written in C is ten times as quick, and bounds how deep values are nested."""


class Opened:
    """The source of a bag, and what its metadata.yaml says beside."""

    def __init__(self, path: Path) -> None:
        self.cut: str | None = None
        """Why its writer ended it early, as its metadata says; it is whole all the same."""
        self.notes: list[str] = []
        """What its metadata.yaml says otherwise than its messages do, or fails to say."""
        try:
            information = self._information(path)
            self.source = _source(path, information)
        except OSError as error:
            raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
        custom = information.get("custom_data")
        if isinstance(custom, dict) and CUT in custom:
            self.cut = str(custom[CUT])
        self.source.origin = self.source.origin | origin_in(custom)
        self._compare(information)

    def _information(self, path: Path) -> dict[str, Any]:
        """The bag information of a folder; empty where there is none."""
        metadata = path / "metadata.yaml"
        if not metadata.is_file():
            return {}
        reason = "no rosbag2_bagfile_information"
        try:
            content = yaml.load(metadata.read_text(encoding="utf-8"), _LOADER)
            information = content["rosbag2_bagfile_information"]
            if isinstance(information, dict):
                return information
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            reason = f"not YAML: {' '.join(str(error).split())}"
        except (TypeError, KeyError):
            pass
        self.notes.append(f"metadata.yaml is left out: {reason}")
        return {}

    def _compare(self, information: dict[str, Any]) -> None:
        """Notes where the metadata says something else than the messages; messages that are missing are a warning."""
        source = self.source
        said, found = _messages(information), sum(topic.count for topic in source.topics)
        if isinstance(said, int) and said > found:
            source.warnings.append(f"metadata.yaml tells of {said} messages, {found} can be read")
        elif isinstance(said, int) and said < found:
            self.notes.append(f"metadata.yaml tells of {said} messages, there are {found}")
        if not found or source.start is None or source.end is None:
            return
        for key, unit, there in (
            ("starting_time", "nanoseconds_since_epoch", source.start),
            ("duration", "nanoseconds", source.end - source.start),
        ):
            block = information.get(key)
            told = block.get(unit) if isinstance(block, dict) else None
            if isinstance(told, int) and abs(told - there) > _CLOSE_ENOUGH:
                what = key.replace("_", " ")
                self.notes.append(f"metadata.yaml tells of a {what} of {1e-9 * told:.3f} s, it is {1e-9 * there:.3f} s")


def _messages(information: dict[str, Any]) -> Any:
    """How many messages of ROS 2 a metadata.yaml tells of."""
    said = information.get("message_count")
    try:
        topics = information["topics_with_message_count"]
        others = [each for each in topics if each["topic_metadata"]["serialization_format"] != "cdr"]
        return said - sum(each["message_count"] for each in others)
    except (TypeError, KeyError):
        return said


def _source(path: Path, information: dict[str, Any]) -> Source:
    """The reader for the files of a bag. Raises OSError and BagError."""
    scratch = Scratch()
    if not path.exists():
        raise BagError(f"{path}: no such bag; give a rosbag2 folder or an .mcap file")
    paths = list(_files(path, information)) if path.is_dir() else [path]
    if not paths:
        raise BagError(f"{path}: not a bag: holds no .mcap and no .db3 file")
    files = [stored(file, scratch) for file in paths]
    kinds = {file.kind for file in files}
    if "ros1" in kinds:
        ours, theirs = f"finger_sim import {path} -o NAME", f"rosbags-convert --src {path} --dst FOLDER"
        raise BagError(f"{path}: a ROS 1 bag: `{ours}` makes a bag of its poses, `{theirs}` one of all topics")
    if {"mcap", "sqlite3"} <= kinds:
        raise BagError(f"{path}: holds MCAP files and sqlite3 files; give one of them")
    if "sqlite3" in kinds or any(_awaits_log(file) for file in files):
        from .sqlite_files import SqliteSource

        return SqliteSource(files, scratch)
    from .mcap_files import McapSource

    return McapSource(files, scratch)


def _files(path: Path, information: dict[str, Any]) -> Iterator[Path]:
    """The files of a bag in a folder, in their order."""
    names = information.get("relative_file_paths")
    if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
        for name in names:
            plain = path / Path(name).name
            found = next((file for ending in PACKED if (file := Path(f"{plain}{ending}")).is_file()), None)
            if found is None:
                raise BagError(f"{path}: {plain.name} is named in metadata.yaml but is not there")
            yield found
        return
    named = {file.name: file for file in path.iterdir() if file.name.endswith(BAGS[1:]) and file.is_file()}
    twice = {f"{name}{ending}" for name in named for ending in PACKED[1:]}  # its recorder was still packing it
    yield from (named[name] for name in sorted(named.keys() - twice, key=_part_number))


def _awaits_log(file: Stored) -> bool:
    """Whether a file is still empty, with all that is to be in it in a log beside it."""
    log = Path(f"{file.path}-wal")
    return file.kind is None and file.path.stat().st_size == 0 and log.is_file() and log.stat().st_size > 0


def _part_number(name: str) -> tuple[int, str]:
    """Sorts bag_2.mcap before bag_10.mcap."""
    number = name.partition(".")[0].rpartition("_")[2]
    return (int(number) if number.isdigit() else 0, name)

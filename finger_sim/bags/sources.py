"""Where the messages of a bag come from: MCAP files, whole or cut off, and what `rosbags` reads (sqlite3)."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from ..errors import BagError
from .mcap_files import McapSource
from .message import Message, Source, Topic
from .metadata import CUT, origin_in

ROS1_MAGIC = b"#ROSBAG V"
"""What bags of ROS 1 begin with."""


def open_source(path: Path) -> Source:
    """The reader for what lies at `path`."""
    try:
        if path.is_file():
            _refuse_ros1(path)
            return _RosbagsSource(path) if path.suffix == ".db3" else McapSource([path])
        if not path.is_dir():
            raise BagError(f"{path}: no such bag; give a rosbag2 folder or an .mcap file")
        metadata = path / "metadata.yaml"
        if metadata.is_file():
            return _open_folder(path, _information(metadata))
        files = sorted(path.glob("*.mcap"), key=_part_number)
        if files:
            return McapSource(files)
        databases = sorted(path.glob("*.db3"))
        if len(databases) == 1:
            return _RosbagsSource(databases[0])
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
    raise BagError(f"{path}: not a bag: holds neither metadata.yaml nor an .mcap file")


def _refuse_ros1(path: Path) -> None:
    """Raises BagError for a bag of ROS 1, with what converts it."""
    with path.open("rb") as stream:
        if stream.read(len(ROS1_MAGIC)) == ROS1_MAGIC:
            ours, theirs = f"finger_sim import {path} -o NAME", f"rosbags-convert --src {path} --dst FOLDER"
            raise BagError(f"{path}: a ROS 1 bag: `{ours}` makes a bag of its poses, `{theirs}` one of all topics")


def _open_folder(path: Path, information: dict[str, Any]) -> Source:
    custom = information.get("custom_data")
    origin = origin_in(custom)
    compressed = information.get("compression_mode") not in ("", "NONE", "none", None)
    if information.get("storage_identifier") != "mcap" or compressed:
        return _RosbagsSource(path, origin)
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        key = f"{path / 'metadata.yaml'}: relative_file_paths"
        raise BagError(f"{key}: got {names!r}, allowed: a list of file names")
    files = [path / Path(name).name for name in names]
    for file in files:
        if not file.is_file():
            raise BagError(f"{path}: {file.name} is named in metadata.yaml but is not there")
    cut = str(custom[CUT]) if isinstance(custom, dict) and CUT in custom else None
    return McapSource(files, cut, origin)


def _information(metadata: Path) -> dict[str, Any]:
    """The bag information in a metadata.yaml."""
    advice = "give the .mcap file itself to read the bag without it"
    try:
        content = yaml.safe_load(metadata.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise BagError(f"{metadata}: not YAML: {reason}; {advice}") from None
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"{metadata}: has no rosbag2_bagfile_information; {advice}")
    return information


def _part_number(path: Path) -> tuple[int, str]:
    """Sorts bag_2.mcap before bag_10.mcap."""
    number = path.stem.rpartition("_")[2]
    return (int(number) if number.isdigit() else 0, path.name)


class _RosbagsSource:
    """Bags that are not plain MCAP (sqlite3, compressed files), read with the `rosbags` library."""

    def __init__(self, path: Path, origin: Mapping[str, str] | None = None) -> None:
        from rosbags.rosbag2 import Reader

        self.path = path
        self.warning: str | None = None
        self.cut: str | None = None
        self.origin = dict(origin or {})
        counts: Counter[tuple[str, str]] = Counter()
        with self._reporting(), Reader(path) as reader:
            for connection in reader.connections:
                counts[connection.topic, connection.msgtype] += connection.msgcount
            some = reader.message_count > 0
            self.start = reader.start_time if some else None
            self.end = reader.end_time - 1 if some else None
        self.topics = tuple(Topic(name, type, count) for (name, type), count in counts.items())

    def messages(self) -> Iterator[Message]:
        from rosbags.rosbag2 import Reader

        numbers: defaultdict[str, int] = defaultdict(int)
        with self._reporting(), Reader(self.path) as reader:
            for connection, time, data in reader.messages():
                numbers[connection.topic] += 1
                number = numbers[connection.topic]
                yield Message(connection.topic, connection.msgtype, time, time, bytes(data), number)

    def _reporting(self) -> _Reporting:
        return _Reporting(self.path)


class _Reporting:
    """Turns whatever broken bytes make `rosbags` and its databases raise into BagError."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, BagError):
            raise BagError(f"{self.path}: cannot be read: {error}") from None

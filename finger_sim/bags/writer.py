"""Writes rosbag2 MCAP folders, as rosbag2 Jazzy does. Imports little: a process that only writes starts with this."""

from __future__ import annotations

import contextlib
import math
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal, Self

import yaml
from mcap.writer import CompressionType, Writer

from ..errors import BagError
from .metadata import CUT, ORIGIN, Part, Qos, RecordedTopic, information, with_origin, yaml_text

FLUSH_PERIOD = 0.5
"""Longest time [s] of messages that a killed writer loses."""

_METADATA, _UNFINISHED = "metadata.yaml", "metadata.yaml.tmp"

Compression = Literal["zstd", "lz4", "none"]
"""Of chunks: zstd is smaller, lz4 takes less time, none is read by everyone."""

_COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


class BagWriter:
    """Writes one rosbag2 folder; use it in a `with` block, from one thread.

    Messages are kept in chunks of at most FLUSH_PERIOD of log time; each finished chunk goes to the operating
    system at once, so a process killed while messages come in loses no more than that. Where messages may
    stop coming, call `flush` on a clock of your own. The same input makes the same file, byte for byte.

    path          : folder to make; BagError if it exists or cannot be made
    compression   : of the chunks
    split_bytes   : a new file begins once one has that size; it has grown by up to a chunk more (1 MiB)
    split_seconds : a new file begins with the first message that much log time away from the first of its file [s]
    custom_data   : words of yours for the bag's metadata, such as the scene it was made for
    origin        : what makes the bag (`bags.origin`), for its metadata and for a record at the beginning of each file
    """

    def __init__(
        self,
        path: str | Path,
        *,
        compression: Compression = "zstd",
        split_bytes: float = math.inf,
        split_seconds: float = math.inf,
        custom_data: Mapping[str, str] | None = None,
        origin: Mapping[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        self._origin, self._at_end = dict(origin or {}), dict[str, str]()
        self.custom_data = dict(custom_data or {})
        self._compression, self._split_bytes, self._split_ns = compression, split_bytes, split_seconds * 1e9
        self._recorded: dict[str, RecordedTopic] = {}
        self._schemas: dict[str, int] = {}
        self._parts: list[Part] = []
        self._chunk_start: int | None = None
        self._open = False
        self.saved = 0
        """Messages that have reached the operating system: what a kill or a full disk leaves."""
        require_absent(self.path)
        self._folders = [self.path, *(folder for folder in self.path.parents if not folder.exists())]
        try:
            self.path.mkdir(parents=True)
        except OSError as error:
            raise BagError(f"{self.path}: cannot be made: {error.strerror}") from None
        try:
            self._begin_file()
        except BagError:
            self.discard()
            raise
        self._open = True

    @property
    def files(self) -> list[Path]:
        """Files begun so far."""
        return [part.file for part in self._parts]

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, by topic."""
        return {topic: recorded.count for topic, recorded in self._recorded.items()}

    def add_topic(
        self, topic: str, type: str, *, qos: Qos | None = None, definition: tuple[str, str] | None = None
    ) -> str:
        """Announces a topic of a ROS 2 type ("geometry_msgs/msg/PoseStamped") and returns its absolute name.

        A name without a leading slash gets one. Announcing the same topic again does nothing; with another
        type, or for a type that Jazzy does not have, it is a BagError.

        definition : the type's full text and hash, as `cdr.definition` gives it; looked up there if left out
        """
        name = absolute(topic)
        known = self._recorded.get(name)
        if known is not None:
            if known.type != type:
                raise BagError(f"{self.path}: topic {name} is {known.type}, cannot be {type} too")
            return name
        self._require_open()
        if definition is None:
            from .cdr import definition as look_up  # brings NumPy and rosbags, which nothing else here needs

            definition = look_up(type)
        recorded = RecordedTopic(0, type, definition, qos or Qos())
        try:
            recorded.channel_id = self._register(name, recorded)
        except OSError as error:
            raise self._failed(error) from None
        self._recorded[name] = recorded
        return name

    def write(
        self,
        topic: str,
        data: bytes,
        log_time: int,
        publish_time: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Appends one message of CDR bytes.

        publish_time : `log_time` if left out
        sequence     : number of the message on its topic, from 1; one more than the last if left out.
                       Whoever drops messages skips their numbers, so that the loss shows in the bag.
        Raises BagError for a topic that was not announced, a negative time, and when the disk refuses.
        """
        self._require_open()
        name = absolute(topic)
        recorded = self._recorded.get(name)
        if recorded is None:
            known = ", ".join(self._recorded) or "none"
            raise BagError(f"{self.path}: topic {topic} was not announced; have {known}")
        sent = log_time if publish_time is None else publish_time
        if not (0 <= log_time < 2**64 and 0 <= sent < 2**64):
            raise BagError(f"{self.path}: topic {topic}: times must be 0 to 2^64 ns, got {log_time}, {sent}")
        number = recorded.next_sequence if sequence is None else sequence
        if self._parts[-1].counts and self._full(log_time):
            self._finish_file()
            self._begin_file()
        try:
            if self._chunk_start is not None and abs(log_time - self._chunk_start) >= FLUSH_PERIOD * 1e9:
                self.flush()
            if self._chunk_start is None:
                self._chunk_start = log_time
            self._writer.add_message(
                channel_id=recorded.channel_id,
                log_time=log_time,
                data=data,
                publish_time=sent,
                sequence=number & 0xFFFFFFFF,
            )
        except OSError as error:
            raise self._failed(error) from None
        recorded.next_sequence = number + 1
        recorded.count += 1
        self._parts[-1].add(name, log_time)

    def say_at_end(self, origin: Mapping[str, str]) -> None:
        """More of what made the bag, known only now: for its metadata, and a record at the end of its last file."""
        self._at_end.update(origin)

    def flush(self) -> None:
        """Finishes the current chunk and hands it to the operating system: all so far survives a kill."""
        self._require_open()
        try:
            self._writer.flush()
        except OSError as error:
            raise self._failed(error) from None
        self._chunk_start = None
        self.saved = sum(self.counts.values())

    def close(self) -> None:
        """Writes index and metadata.yaml and closes; closing again does nothing."""
        if not self._open:
            return
        self._finish_file(last=True)
        self._open = False
        self.saved = sum(self.counts.values())
        try:
            self._write_metadata()
        except OSError as error:
            raise self._failed(error) from None

    def cut(self, why: str) -> None:
        """Closes the bag where it is; `why` stands in its metadata under CUT, in metadata.yaml and the last file.

        Where the disk has refused a message, the bag ends with the last whole chunk that leaves room for the end of
        the file; that end has no index, which readers do without.
        Raises BagError when not even that can be written, and when no message is left; what is there can be read then.
        """
        self.custom_data[CUT] = why
        if self._open:
            self.close()
            return
        from .mcap_end import finish_cut_off, readable

        try:
            self._count_last(*readable(self._parts[-1].file))
            if self._parts[-1].counts:
                self._count_last(*finish_cut_off(self._parts[-1].file))
            elif len(self._parts) > 1:
                self._parts.pop().file.unlink(missing_ok=True)
            if not self.saved:
                raise BagError(f"{self.path}: no message is left")
            self._write_metadata()
        except OSError as error:
            raise BagError(f"{self.path}: cannot be finished: {error.strerror}") from None

    def _count_last(self, counts: Counter[str], first: int, last: int) -> None:
        """The last file holds these messages [by topic], between these log times [ns], and no others."""
        part = self._parts[-1]
        for name, topic in self._recorded.items():
            topic.count -= part.counts[name] - counts[name]
        part.counts, part.first, part.last = counts, first, last
        self.saved = sum(self.counts.values())

    def abort(self) -> None:
        """Stops where it is: what was written stays readable, without index and metadata.yaml."""
        if self._open:
            with contextlib.suppress(OSError):
                self._writer.flush()
            self._drop()

    def discard(self) -> None:
        """Stops and removes what was made: the files, and the folders that were made for them."""
        if self._open:
            self._drop()
        for file in (*self.files, self.path / _UNFINISHED, self.path / _METADATA):
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)
        for folder in self._folders:
            with contextlib.suppress(OSError):
                folder.rmdir()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes; after an exception aborts, so that a half-made bag does not look whole."""
        if kind is None:
            self.close()
        else:
            self.abort()

    def _write_metadata(self) -> None:
        """Writes metadata.yaml, whole or not at all."""
        whole = yaml_text({"rosbag2_bagfile_information": self._information()})
        unfinished = self.path / _UNFINISHED
        unfinished.write_text(whole, encoding="utf-8")
        unfinished.replace(self.path / _METADATA)

    def _information(self) -> dict[str, Any]:
        custom_data = with_origin(self.custom_data, self._origin | self._at_end)
        return information(self._recorded, self._parts, custom_data)

    def _require_open(self) -> None:
        if not self._open:
            raise BagError(f"{self.path}: the bag is closed")

    def _begin_file(self) -> None:
        """Makes the next file and announces in it what was announced before."""
        part = Part(self.path / f"{self.path.name}_{len(self._parts)}.mcap")
        self._parts.append(part)
        self._chunk_start = None
        self._schemas.clear()
        try:
            self._stream = part.file.open("xb")
        except OSError as error:
            self._open = False
            raise BagError(f"{part.file}: cannot be made: {error.strerror}") from None
        try:
            self._writer = _mcap_writer(self._stream, self._compression)
            self._writer.start(profile="ros2", library="finger_sim")
            if self._origin:
                number = {"part": str(len(self._parts) - 1)} if len(self._parts) > 1 else {}
                self._writer.add_metadata(ORIGIN, self._origin | number)
            self._writer.flush()
            for name, recorded in self._recorded.items():
                recorded.channel_id = self._register(name, recorded)
        except OSError as error:
            raise self._failed(error) from None

    def _finish_file(self, last: bool = False) -> None:
        """Writes the rest of a file, the bag's metadata up to its end, and the index."""
        try:
            self._writer.flush()
            if last and self._at_end:
                self._writer.add_metadata(ORIGIN, self._at_end)
            text = yaml_text(self._information())
            self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
            self._writer.finish()
            self._stream.close()
        except OSError as error:
            raise self._failed(error) from None

    def _register(self, name: str, recorded: RecordedTopic) -> int:
        """Announces a topic in the present file; its channel there."""
        type = recorded.type
        text, type_hash = recorded.definition
        if type not in self._schemas:
            self._schemas[type] = self._writer.register_schema(type, "ros2msg", text.encode())
        profiles = yaml.safe_dump([recorded.qos.as_rosbag2()], sort_keys=False).strip()
        metadata = {"offered_qos_profiles": profiles, "topic_type_hash": type_hash}
        channel: int = self._writer.register_channel(name, "cdr", self._schemas[type], metadata)
        return channel

    def _full(self, log_time: int) -> bool:
        """Whether a message of that time belongs into a new file."""
        if abs(log_time - self._parts[-1].begin) >= self._split_ns:
            return True
        return self._stream.tell() >= self._split_bytes

    def _drop(self) -> None:
        """Closes the file; what could not be written is lost, the chunks before it are on the disk."""
        self._open = False
        with contextlib.suppress(OSError):
            self._stream.close()

    def _failed(self, error: OSError) -> BagError:
        self._drop()
        reason = error.strerror or str(error)
        return BagError(f"{self._parts[-1].file}: cannot be written: {reason}")


def require_absent(path: str | Path) -> None:
    """Raises BagError when there is something at `path`: no bag is ever overwritten."""
    if os.path.lexists(path):
        raise BagError(f"{path}: exists already; give another name or remove it")


def _mcap_writer(stream: BinaryIO, compression: Compression) -> Any:
    """The mcap library's writer; Any because its methods carry no types."""
    return Writer(stream, compression=_COMPRESSIONS[compression])


def absolute(topic: str) -> str:
    """The topic name with its leading slash."""
    return topic if topic.startswith("/") else f"/{topic}"

"""How recordings are written: rosbag2's formats as its versions and other recorders write them, from the same content.

Nothing here is of finger_sim: MCAP comes of the `mcap` library, sqlite3 of Python's own, metadata.yaml is written out.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import lz4.frame
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from .content import COMMANDS, FOREIGN, Content, Put

Codec = Literal["", "zstd", "lz4"]
CODECS: dict[Codec, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lambda data: bytes(lz4.frame.compress(data)),
}

DEFINITIONS = {
    FOREIGN: "int64 time\n",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
}
"""Texts of the types that a recorder knows, as far as anyone looks at them here."""

QOS = (
    "- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n  deadline: {sec: 0, nsec: 0}\n"
    "  lifespan: {sec: 0, nsec: 0}\n  liveliness: 1\n  liveliness_lease_duration: {sec: 0, nsec: 0}\n"
    "  avoid_ros_namespace_conventions: false"
)
"""offered_qos_profiles up to metadata version 8."""

CHUNK_SIZE = 900
"""Bytes from which on a chunk is ended: a whole recording has about a dozen."""


@dataclass(frozen=True)
class Format:
    """One way to write a recording."""

    storage: Literal["mcap", "sqlite3"] = "mcap"
    schema: int = 4
    """Version of rosbag2's tables."""
    definitions: bool = True
    """Whether the recorder knew the texts of all types; else it wrote `unknown` in the place of some."""
    files: int = 1
    folder: bool = True
    """Whether the recording is a folder; else its only file."""
    metadata: bool = True
    messages: Codec = ""
    """How rosbag2 compressed each message."""
    outside: Codec = ""
    """How each file was compressed as a whole."""
    chunks: Codec = ""
    """How MCAP chunks are compressed."""
    chunked: bool = True
    summary: bool = True
    message_index: bool = True
    checksums: bool = True

    @property
    def covered(self) -> bool:
        """Whether a checksum covers every message."""
        return self.storage == "mcap" and self.chunked and self.checksums

    @property
    def compressed(self) -> bool:
        """Whether someone compressed it around its storage: a bare file may be explained instead of read."""
        return bool(self.messages or self.outside)


@dataclass(frozen=True)
class Recording:
    """A recording, and what was put into it."""

    path: Path
    files: tuple[Path, ...]
    content: Content
    format: Format = field(repr=False)


FORMATS: dict[str, Format] = {
    "db3 schema 2": Format("sqlite3", schema=2),
    "db3 schema 3": Format("sqlite3", schema=3),
    "db3 schema 4": Format("sqlite3"),
    "db3 unknown type": Format("sqlite3", definitions=False),
    "db3 unknown type bare": Format("sqlite3", definitions=False, folder=False),
    "db3 bare": Format("sqlite3", folder=False),
    "db3 without metadata": Format("sqlite3", schema=3, metadata=False),
    "db3 split": Format("sqlite3", files=3),
    "db3 split without metadata": Format("sqlite3", files=3, metadata=False),
    "db3 zstd messages": Format("sqlite3", messages="zstd"),
    "db3 zstd file": Format("sqlite3", files=2, outside="zstd"),
    "db3 zstd file bare": Format("sqlite3", folder=False, outside="zstd"),
    "mcap": Format(),
    "mcap bare": Format(folder=False),
    "mcap without metadata": Format(metadata=False),
    "mcap lz4": Format(chunks="lz4"),
    "mcap zstd": Format(chunks="zstd"),
    "mcap unchunked": Format(chunked=False),
    "mcap unchunked bare": Format(chunked=False, folder=False),
    "mcap without summary": Format(chunks="zstd", summary=False),
    "mcap without summary bare": Format(summary=False, folder=False),
    "mcap without message index": Format(chunks="lz4", message_index=False),
    "mcap without checksums": Format(checksums=False),
    "mcap split": Format(files=3, chunks="zstd"),
    "mcap split without metadata": Format(files=3, metadata=False),
    "mcap zstd messages": Format(messages="zstd"),
    "mcap zstd messages bare": Format(messages="zstd", folder=False),
    "mcap zstd file": Format(files=2, outside="zstd"),
    "mcap zstd file bare": Format(folder=False, outside="zstd"),
    "mcap lz4 file bare": Format(folder=False, outside="lz4"),
}


def write(format: Format, folder: Path, content: Content) -> Recording:
    """The recording `folder`/recording, or its only file."""
    place = folder / "recording" if format.folder else folder
    place.mkdir(parents=True, exist_ok=True)
    suffix = ".db3" if format.storage == "sqlite3" else ".mcap"
    outer = f".{format.outside}" if format.outside else ""
    files, parts = [], _parts(content.put, format.files)
    for number, part in enumerate(parts):
        plain = place / f"recording_{number}{suffix}"
        (write_sqlite if format.storage == "sqlite3" else write_mcap)(plain, format, content, part)
        files.append(plain)
        if format.outside:
            files[-1] = plain.with_name(plain.name + outer)
            files[-1].write_bytes(CODECS[format.outside](plain.read_bytes()))
            plain.unlink()
    if format.folder and format.metadata:
        write_metadata(place, metadata(format, content, files, parts))
    return Recording(place if format.folder else files[0], tuple(files), content, format)


def _parts(put: Sequence[Put], count: int) -> list[Sequence[Put]]:
    """As many runs of messages as there are files, in the order of writing."""
    size = -(-len(put) // count)
    return [put[i * size : (i + 1) * size] for i in range(count)]


def tables(schema: int) -> str:
    """The SQL of rosbag2's tables: 2 is of Foxy, 3 has words on itself, 4 the definitions of its types."""
    text = ["CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
            "data BLOB NOT NULL)", "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"]  # fmt: skip
    columns = "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL"
    if schema >= 2:
        columns += ", offered_qos_profiles TEXT NOT NULL"
    if schema >= 3:
        text += ["CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)",
                 f"INSERT INTO schema VALUES ({schema}, '{ {3: 'humble', 4: 'jazzy'}[schema] }')",
                 "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, "
                 "metadata TEXT NOT NULL)"]  # fmt: skip
    if schema >= 4:
        columns += ", type_description_hash TEXT NOT NULL"
        text.append(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, "
            "encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)"
        )
    return ";".join([*text, f"CREATE TABLE topics({columns})"]) + ";"


def add_topics(database: sqlite3.Connection, format: Format, content: Content) -> dict[tuple[str, str], int]:
    """The rows of topics and definitions; returns the ids by name and type."""
    schema = format.schema
    database.execute("PRAGMA synchronous=OFF")
    database.executescript(f"BEGIN;{tables(schema)}COMMIT;")
    ids = {topic: number for number, topic in enumerate(content.topics, start=1)}
    for (name, type), number in ids.items():
        row = [number, name, type, "cdr", QOS if name == COMMANDS else "", ""][: 4 + (schema >= 2) + (schema >= 4)]
        database.execute(f"INSERT INTO topics VALUES ({', '.join('?' * len(row))})", row)
    if schema >= 4:
        for number, type in enumerate(dict.fromkeys(type for _, type in ids), start=1):
            known = format.definitions or type != FOREIGN
            definition = [number, type, "ros2msg" if known else "unknown", DEFINITIONS[type] if known else "", ""]
            database.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", definition)
    return ids


def write_sqlite(path: Path, format: Format, content: Content, part: Sequence[Put]) -> None:
    compress = CODECS[format.messages]
    with sqlite3.connect(path) as database:
        ids = add_topics(database, format, content)
        database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            [(ids[m.topic, m.type], m.log_time, compress(m.data)) for m in part],
        )
    database.close()


def write_mcap(path: Path, format: Format, content: Content, part: Sequence[Put]) -> None:
    compress = CODECS[format.messages]
    compression = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}[format.chunks]
    index = (IndexType.ALL if format.message_index else IndexType.CHUNK) if format.summary else IndexType.NONE
    writer = Writer(
        str(path), chunk_size=CHUNK_SIZE, compression=compression, index_types=index, repeat_channels=format.summary,
        repeat_schemas=format.summary, use_chunking=format.chunked, use_statistics=format.summary,
        use_summary_offsets=format.summary, enable_crcs=format.checksums,
    )  # fmt: skip
    writer.start("ros2", "tests")
    schemas = {
        type: writer.register_schema(type, "ros2msg", DEFINITIONS[type].encode())
        for type in dict.fromkeys(type for _, type in content.topics)
    }
    publishers = {(name, type, 0): None for name, type in content.topics}
    publishers |= {(m.topic, m.type, m.publisher): None for m in content.put}
    channels = {each: writer.register_channel(each[0], "cdr", schemas[each[1]]) for each in publishers}
    for m in part:
        channel = channels[m.topic, m.type, m.publisher]
        writer.add_message(channel, m.log_time, compress(m.data), m.log_time, m.sequence)
    writer.finish()


def metadata(format: Format, content: Content, files: Sequence[Path], parts: Sequence[Sequence[Put]]) -> dict[str, Any]:
    """What a recorder that ended well says of its recording, in the words of the version that wrote it."""
    version = {2: 4, 3: 5, 4: 9}[format.schema]
    counts = Counter((m.topic, m.type) for m in content.put)
    qos: Any = yaml.load(QOS, yaml.CSafeLoader) if version >= 9 else QOS
    topics = [
        {
            "topic_metadata": {"name": name, "type": type_name, "serialization_format": "cdr"}
            | {"offered_qos_profiles": qos if name == COMMANDS and format.storage == "sqlite3" else type(qos)()}
            | ({"type_description_hash": ""} if version >= 7 else {}),
            "message_count": counts[name, type_name],
        }
        for name, type_name in content.topics
    ]
    own = [
        {"path": file.name, **_times(part), "message_count": len(part)} for file, part in zip(files, parts, strict=True)
    ]
    return {
        "version": version,
        "storage_identifier": format.storage,
        **_times(content.put),
        "message_count": len(content.put),
        "topics_with_message_count": topics,
        "compression_format": "zstd" if format.compressed else "",
        "compression_mode": "FILE" if format.outside else "MESSAGE" if format.messages else "",
        "relative_file_paths": [file.name for file in files],
        **({"files": own} if version >= 5 else {}),
        **({"custom_data": None} if version >= 6 else {}),
        **({"ros_distro": "jazzy"} if version >= 8 else {}),
    }


def _times(put: Sequence[Put]) -> dict[str, Any]:
    """Start and duration as rosbag2 writes them: of no message 2⁶³ - 1 and 0."""
    first = min((m.log_time for m in put), default=2**63 - 1)
    last = max((m.log_time for m in put), default=first)
    return {"starting_time": {"nanoseconds_since_epoch": first}, "duration": {"nanoseconds": last - first}}


def write_metadata(folder: Path, information: dict[str, Any]) -> None:
    text = yaml.dump({"rosbag2_bagfile_information": information}, Dumper=yaml.CSafeDumper, sort_keys=False)
    (folder / "metadata.yaml").write_text(text, encoding="utf-8")


def read_metadata(folder: Path) -> dict[str, Any]:
    """The bag information that a test changes."""
    content = yaml.load((folder / "metadata.yaml").read_bytes(), yaml.CSafeLoader)
    information: dict[str, Any] = content["rosbag2_bagfile_information"]
    return information

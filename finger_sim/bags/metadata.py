"""What a rosbag2 folder's metadata.yaml says, as rosbag2 Jazzy writes it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

CUT = "cut"
"""Word in the metadata of a bag that ends before what was to be recorded; why and where stands behind it."""

ORIGIN = "finger_sim"
"""Name of the MCAP metadata records that say what made a bag (`bags.origin`), and beginning of such words' names."""

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class Qos:
    """What a recorded topic offered: rosbag2 plays it back with the same."""

    depth: int = 10
    reliable: bool = True
    transient_local: bool = False

    def as_rosbag2(self) -> dict[str, Any]:
        """The profile in the words of rosbag2's metadata version 9."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": "reliable" if self.reliable else "best_effort",
            "durability": "transient_local" if self.transient_local else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass
class RecordedTopic:
    """One channel being written."""

    channel_id: int
    type: str
    definition: tuple[str, str]
    qos: Qos
    count: int = 0
    next_sequence: int = 1


@dataclass
class Part:
    """One file of a bag being written: its messages, and their log times [ns]."""

    file: Path
    counts: Counter[str] = field(default_factory=Counter)
    """Messages, by topic."""
    begin: int = 0
    """Of the first message written; clocks that jump back bring earlier ones after it."""
    first: int = 2**64
    last: int = 0

    @property
    def count(self) -> int:
        """Messages on all topics."""
        return self.counts.total()

    def add(self, topic: str, log_time: int) -> None:
        """One more message."""
        if not self.counts:
            self.begin = log_time
        self.counts[topic] += 1
        self.first, self.last = min(self.first, log_time), max(self.last, log_time)


def information(
    topics: Mapping[str, RecordedTopic], parts: Sequence[Part], custom_data: Mapping[str, str]
) -> dict[str, Any]:
    """rosbag2's bag information, metadata version 9."""
    count = sum(part.count for part in parts)
    times = _times(parts)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": times["duration"],
        "starting_time": times["starting_time"],
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [topic.qos.as_rosbag2()],
                    "type_description_hash": topic.definition[1],
                },
                "message_count": topic.count,
            }
            for name, topic in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.file.name for part in parts],
        "files": [{"path": part.file.name, **_times([part]), "message_count": part.count} for part in parts],
        "custom_data": dict(custom_data) or None,
        "ros_distro": "jazzy",
    }


def with_origin(custom_data: Mapping[str, str], origin: Mapping[str, str]) -> dict[str, str]:
    """A bag's custom data, with the words on its making under their longer names."""
    return {**custom_data, **{f"{ORIGIN}.{name}": text for name, text in origin.items()}}


def origin_in(custom_data: Any) -> dict[str, str]:
    """The words on its making in a bag's custom data, or in what stands in its place."""
    if not isinstance(custom_data, dict):
        return {}
    prefix = f"{ORIGIN}."
    return {
        name.removeprefix(prefix): str(text)
        for name, text in custom_data.items()
        if isinstance(name, str) and name.startswith(prefix)
    }


def yaml_text(content: Any) -> str:
    """YAML in which texts of several lines stay readable."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False)


class _Dumper(yaml.SafeDumper):
    """Writes a text of several lines as such."""

    def represent_str(self, data: str) -> yaml.ScalarNode:
        return self.represent_scalar("tag:yaml.org,2002:str", data, style="|" if "\n" in data else None)


_Dumper.add_representer(str, _Dumper.represent_str)


def _times(parts: Sequence[Part]) -> dict[str, Any]:
    """Start and duration of files in rosbag2's words; 2^63 - 1 and 0 where there is no message."""
    used = [part for part in parts if part.count]
    first = min((part.first for part in used), default=2**63 - 1)
    last = max((part.last for part in used), default=first)
    return {"starting_time": {"nanoseconds_since_epoch": first}, "duration": {"nanoseconds": last - first}}

"""Which topics of a bag hold the commands, and which the plane's poses."""

from __future__ import annotations

from ..errors import BagError
from . import cdr
from .bag import BagReader
from .writer import absolute


def command_topic(reader: BagReader, topic: str | None) -> str:
    """Name of the topic with the commands."""
    if topic is not None:
        return _named_topic(reader, topic)
    poses = [name for name in _pose_topics(reader) if not name.endswith("/plane_pose")]
    commands = [name for name in poses if name.endswith("/command_pose")]
    if "/command_pose" in commands:
        return "/command_pose"
    candidates = commands or poses
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        cut = f"; {reader.warning}" if reader.warning else ""
        raise BagError(f"{reader.path}: no topic of type {cdr.POSE_STAMPED}; found {_found(reader)}{cut}")
    several = ", ".join(candidates)
    raise BagError(f"{reader.path}: several topics of poses: {several}; choose one with --topic")


def plane_topic(reader: BagReader, commands: str, topic: str | None) -> str | None:
    """Name of the topic with the plane's poses, beside the one with the commands; None if there is none."""
    if topic is not None:
        name = _named_topic(reader, topic)
        if name == commands:
            raise BagError(f"{reader.path}: topic {name} cannot hold both the commands and the plane's poses")
        return name
    candidates = [name for name in _pose_topics(reader, counted=True) if name.endswith("/plane_pose")]
    candidates = [name for name in candidates if name != commands]
    beside = f"{commands.rpartition('/')[0]}/plane_pose"
    if beside in candidates:
        return beside
    if len(candidates) > 1:
        several = ", ".join(candidates)
        raise BagError(f"{reader.path}: several topics of the plane's poses: {several}; choose one with --plane-topic")
    return candidates[0] if candidates else None


def _named_topic(reader: BagReader, topic: str) -> str:
    """The absolute name of a topic of poses that was asked for."""
    name = absolute(topic)
    types = [each.type for each in reader.topics if absolute(each.name) == name]
    if not types:
        raise BagError(f"{reader.path}: no topic {name}; found {_found(reader)}")
    if cdr.POSE_STAMPED not in types:
        raise BagError(f"{reader.path}: topic {name} is {types[0]}, allowed: {cdr.POSE_STAMPED}")
    return name


def _pose_topics(reader: BagReader, *, counted: bool = False) -> list[str]:
    """Names of topics of poses, each once; `counted`: of those with messages."""
    poses = (topic for topic in reader.topics if topic.type == cdr.POSE_STAMPED and (topic.count or not counted))
    return list(dict.fromkeys(absolute(topic.name) for topic in poses))


def _found(reader: BagReader) -> str:
    """What topics there are."""
    return ", ".join(f"{absolute(topic.name)} ({topic.type})" for topic in reader.topics) or "no topic"

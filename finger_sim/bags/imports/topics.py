"""Poses on a topic of a bag, of ROS 2 or ROS 1."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import BagError
from ..message import Topic
from ..reader import absolute
from .arrivals import Bag, open_bag
from .formats import Clock
from .frames import frame_pairs, read_frames
from .recorded import Reading, Recorded
from .samples import POSES, TRANSFORM, TRANSFORMS, TWISTS, clocked, sample


def read_bag(source: Path, reading: Reading) -> Recorded:
    """The poses on a topic, or of one frame in another. Raises BagError where there are none, or several to choose."""
    for option, given in (
        ("--columns", reading.columns), ("--where", reading.where), ("--concatenate", reading.concatenate),
        ("--times", reading.times), ("--time-unit", reading.time_unit),
    ):  # fmt: skip
        if given:
            raise BagError(f"{source}: is a bag; {option} is for text files")
    bag = open_bag(source)
    if reading.tf is not None:
        if reading.from_topic is not None:
            raise BagError("--tf and --from-topic: allowed: one of them")
        return read_frames(bag, reading.tf, reading.clock)
    return _read_topic(bag, _chosen(bag, reading.from_topic), reading.clock)


def _chosen(bag: Bag, topic: str | None) -> Topic:
    """The topic that was asked for, or the only one with poses."""
    cut = f"; {bag.warning}" if bag.warning else ""
    if topic is not None:
        named = [each for each in bag.topics if each.name == absolute(topic)]
        found = next((each for each in named if each.type in POSES), named[0] if named else None)
        if found is None:
            raise BagError(f"{bag.path}: no topic {absolute(topic)}; found {listed(bag.topics)}{cut}")
        if found.type in TRANSFORMS:
            raise BagError(f"{bag.path}: topic {found.name} holds transforms: say which with --tf PARENT CHILD")
        if found.type not in POSES:
            raise BagError(f"{bag.path}: topic {found.name} is {found.type}, allowed: {', '.join(POSES)}{_why(found)}")
        return found
    poses = [each for each in bag.topics if each.type in POSES and each.count]
    if len(poses) == 1:
        return poses[0]
    if poses:
        raise BagError(f"{bag.path}: several topics of poses: {listed(poses)}; choose one with --from-topic")
    if any(each.type in TRANSFORMS and each.count for each in bag.topics):
        pairs = "; ".join(frame_pairs(bag))
        raise BagError(f"{bag.path}: poses are in transforms only: say which with --tf PARENT CHILD; found {pairs}")
    why = next((text for each in bag.topics if (text := _why(each))), "")
    raise BagError(
        f"{bag.path}: no topic of poses, allowed: {', '.join(POSES)}, or transforms with --tf; "
        f"found {listed(bag.topics)}{why}{cut}"
    )


def listed(topics: Sequence[Topic]) -> str:
    """Topics with their types and counts."""
    return ", ".join(f"{each.name} ({each.type}, {each.count} messages)" for each in topics) or "no topic"


def _why(topic: Topic) -> str:
    velocities = "velocities say no place: record the device's PoseStamped, TransformStamped, Odometry or /tf"
    return f"; {velocities}" if topic.type in TWISTS else ""


def _read_topic(bag: Bag, topic: Topic, clock: Clock | None) -> Recorded:
    """All good poses of a topic in its frame; the others are left out and counted."""
    samples = [sample(each.number, each.log_time, each.message) for each in bag.arrivals([topic])]
    if not samples:
        raise BagError(f"{bag.path}: topic {topic.name} has no message")
    where = f"{bag.path}: topic {topic.name}"
    children = sorted({each.child for each in samples})
    if topic.type == TRANSFORM and len(children) > 1:
        raise BagError(f"{where}: moves several frames: {', '.join(children)}; choose one with --tf PARENT CHILD")
    frame = Counter(each.frame for each in samples).most_common(1)[0][0]
    good, refusals = [], []
    for each in samples:
        reason = f"frame {each.frame!r}, not {frame!r}" if each.frame != frame else each.refusal()
        if reason:
            refusals.append(f"message {each.number}: {reason}")
        else:
            good.append(each)
    if not good:
        raise BagError(f"{where}: has no good pose; {refusals[0]}")
    by_header, note = clocked([each.stamp for each in good], clock, where)
    times = [each.stamp if by_header else each.receipt for each in good]
    warnings = [f"{len(refusals)} messages are left out; {refusals[0]}"] if refusals else []
    return Recorded(
        format=f"{topic.type} on {topic.name}" + (f", {children[0]}" if children[0] else "") + f" in {frame!r}",
        time=[time - times[0] for time in times],
        position=np.array([each.position for each in good]),
        orientation=np.array([each.orientation for each in good]),
        places=[f"{where}, message {each.number}" for each in good],
        notes=(note,),
        warnings=(*warnings, *([bag.warning] if bag.warning else [])),
    )

"""How two bags differ, topic by topic: bit for bit, and by what their numbers are apart.

A topic is a name with a type: where one name holds messages of two types, they are two topics. What cannot be compared
is never equal.

Bags that overlap in time are compared at the same log time; others count from their first command each (without
one, from their first message). Each message of A is compared with B at its time, B being interpolated between its
two messages around it; where both have the same times that is message by message. A topic with one message in each
bag, as the topology of a mesh, holds for the whole bag.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from ..errors import BagError
from . import cdr
from .comparison import Comparison, LeftOut, TopicComparison
from .quantities import KINDS
from .reader import BagReader, Message, absolute
from .topic_pair import TopicPair

LIVE = {
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "visualization_msgs/msg/Marker",
}
"""Types of what only a live node writes: of itself and its machine, and for those who look on."""
Key = tuple[str, str]
"""Absolute name and type."""


def compare(
    a: str | Path,
    b: str | Path,
    *,
    topics: Collection[str] | None = None,
    tolerance: float | None = None,
    overlap: bool = False,
    everything: bool = False,
) -> Comparison:
    """Compares the bag `b` with the bag `a`.

    topics     : to compare; if left out all of either, but for what only a live node writes, and for what is in one bag
                 only and holds no wrench, pose, cloud or mesh: `left_out` names these
    everything : compare them too
    tolerance  : None: every message must be the same bit by bit, in bytes, times and number. Else the largest
                 difference in wrenches, poses, clouds and meshes, in their SI units, that still is equal; a message
                 of another type must then have the bytes of one of the two of B around it
    overlap    : messages at times that only one of the bags holds do not count; needs a tolerance
    Raises BagError for a bag that cannot be read, a topic that neither has, a tolerance that is negative or no number,
    and an overlap without a tolerance.
    """
    if tolerance is not None and not 0.0 <= tolerance < math.inf:
        raise BagError(f"tolerance: got {tolerance}, allowed: a finite number >= 0")
    if overlap and tolerance is None:
        raise BagError("overlap: needs a tolerance: bags of different spans are not bit-identical")
    readers = BagReader(a), BagReader(b)
    have = _counts(readers[0]), _counts(readers[1])
    foreign = {
        (absolute(name), kind): f"is in {encoding} in {'AB'[side]}, which cannot be compared"
        for side, reader in enumerate(readers)
        for (name, kind), encoding in reader.foreign.items()
    }
    keys = list(dict.fromkeys([*have[0], *have[1], *foreign]))
    if topics is not None:
        names = list(dict.fromkeys(name for name, _ in keys))
        wanted = list(dict.fromkeys(absolute(topic) for topic in topics))
        for name in wanted:
            if name not in names:
                raise BagError(f"{a}, {b}: no topic {name} in either; found {', '.join(names) or 'none'}")
        keys = [key for name in wanted for key in keys if key[0] == name]
    repeated = tolerance is not None and all(reader.origin for reader in readers)
    compared = [key for key in keys if key not in foreign]
    left_out = [] if topics is not None or everything else list(_left_out(compared, have, repeated))
    zeros = _zeros(readers)
    overlapping = _overlap(readers, zeros)
    pairs = {}
    done = []
    for key in (key for key in keys if key not in {(topic.name, topic.type) for topic in left_out}):
        out = TopicComparison(*key, (have[0].get(key, 0), have[1].get(key, 0)))
        done.append(out)
        if key in foreign:
            out.identical = out.equal = False
            out.first = foreign[key]
        elif all(key in topics_of for topics_of in have):
            pairs[key] = TopicPair(out, (Path(a), Path(b)), tolerance, overlapping)
        else:
            out.identical = out.equal = False
            out.first = _alone(key, have)
    for side, time, message in _merged(readers, pairs, zeros):
        pairs[absolute(message.topic), message.type].take(side, time, message)
    for pair in pairs.values():
        pair.finish(overlap)
    warnings = [reader.warning for reader in readers if reader.warning]
    warnings += [text for pair in pairs.values() for text in pair.broken.values()]
    return Comparison(Path(a), Path(b), tolerance, done, warnings, left_out)


def _counts(reader: BagReader) -> Counter[Key]:
    """Messages of each topic, none of a topic that is only announced."""
    counts: Counter[Key] = Counter()
    for topic in reader.topics:
        counts[absolute(topic.name), topic.type] += topic.count
    return counts


def _left_out(keys: Collection[Key], have: tuple[Counter[Key], Counter[Key]], repeated: bool) -> Iterator[LeftOut]:
    """What does not count unless it is asked for.

    repeated : whether transforms only repeat what other topics of the bags tell
    """
    for key in keys:
        one, other = (key in topics for topics in have)
        count = have[0].get(key, 0), have[1].get(key, 0)
        place = "" if one and other else "only in A" if one else "only in B"
        if place and sum(count) == 0:
            reason = f"{place}, without a message"
        elif place and _types(key[0], have[1 if one else 0]):
            continue  # of another type there, it is a difference
        elif key[1] in LIVE:
            reason = "only a live node writes it"
        elif place and key[1] not in KINDS:
            reason = f"{place}, no wrench, pose, cloud or mesh"
        elif repeated and key[1] == cdr.TF_MESSAGE:
            reason = "repeats pose and plane_pose"
        else:
            continue
        yield LeftOut(*key, count, reason)


def _types(name: str, topics: Collection[Key]) -> list[str]:
    """Types of the messages under a name."""
    return [kind for known, kind in topics if known == name]


def _alone(key: Key, have: tuple[Counter[Key], Counter[Key]]) -> str:
    """What to say of a topic that is in one bag only."""
    name, kind = key
    here, there = (0, 1) if key in have[0] else (1, 0)
    others = ", ".join(other for other in _types(name, have[there]) if (name, other) not in have[here])
    return f"{kind} in {'AB'[here]}, {others} in {'AB'[there]}" if others else f"only in {'AB'[here]}"


def _zeros(readers: tuple[BagReader, BagReader]) -> tuple[int, int]:
    """Log times [ns] of A and B that are the start of A."""
    ours = readers[0].start_time or 0
    if not _apart(*readers):
        return ours, ours
    begin, later = (_first_command(reader) or reader.start_time or 0 for reader in readers)
    return ours, later - begin + ours


def _overlap(readers: tuple[BagReader, BagReader], zeros: tuple[int, int]) -> int:
    """Time that both bags cover [ns]."""
    spans = [((r.start_time or 0) - zero, (r.end_time or 0) - zero) for r, zero in zip(readers, zeros, strict=True)]
    return max(0, min(end for _, end in spans) - max(start for start, _ in spans))


def _merged(
    readers: tuple[BagReader, BagReader], topics: Collection[Key], zeros: tuple[int, int]
) -> Iterator[tuple[int, int, Message]]:
    """Messages of A (0) and B (1) on one time [ns] since the start of A, A first where both have the same."""

    def stream(side: int) -> Iterator[tuple[int, int, Message]]:
        for message in readers[side].messages({name for name, _ in topics}):
            if (absolute(message.topic), message.type) in topics:
                yield side, message.log_time - zeros[side], message

    return heapq.merge(stream(0), stream(1), key=lambda item: item[1])


def _apart(one: BagReader, other: BagReader) -> bool:
    """Whether two bags have no time in common."""
    if one.start_time is None or one.end_time is None or other.start_time is None or other.end_time is None:
        return False
    return one.end_time < other.start_time or other.end_time < one.start_time


def _first_command(reader: BagReader) -> int | None:
    """Log time of the first pose on a topic `command_pose` [ns], in any namespace."""
    names = [topic.name for topic in reader.topics if absolute(topic.name).endswith("/command_pose")]
    return next((message.log_time for message in reader.messages(names, cdr.POSE_STAMPED)), None)

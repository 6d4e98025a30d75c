"""How two bags differ, topic by topic: bit for bit, and by what their numbers are apart.

Bags that overlap in time are compared at the same log time; others count from their first command each (without
one, from their first message). Each message of A is compared with B at its time, B being interpolated between its
two messages around it; where both have the same times that is message by message. A topic with one message in each
bag, as the topology of a mesh, holds for the whole bag.
"""

from __future__ import annotations

import hashlib
import heapq
import math
from collections import deque
from collections.abc import Collection, Iterator
from pathlib import Path

from ..errors import BagError
from . import cdr
from .comparison import Comparison, Difference, LeftOut, TopicComparison
from .lag import LagMeter
from .quantities import KINDS, TURN, Kind, Value, apart_by, largest_of
from .reader import BagReader, Message, Topic, absolute

LIVE = {
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "visualization_msgs/msg/Marker",
}
"""Types of what only a live node writes: of itself and its machine, and for those who look on."""
TIMED = {cdr.WRENCH_STAMPED, cdr.POSE_STAMPED}
"""Types whose lag is told."""


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
                 difference in wrenches, poses, clouds and meshes, in their SI units, that still is equal; topics of
                 other types do not count then
    overlap    : messages at times that only one of the bags holds do not count; needs a tolerance
    Raises BagError for a bag that cannot be read, a topic that neither has, and an overlap without a tolerance.
    """
    if overlap and tolerance is None:
        raise BagError("overlap: needs a tolerance: bags of different spans are not bit-identical")
    readers = BagReader(a), BagReader(b)
    have: tuple[dict[str, Topic], ...] = tuple({absolute(t.name): t for t in reader.topics} for reader in readers)
    names = list(dict.fromkeys([*have[0], *have[1]]))
    left_out = [] if topics is not None or everything else list(_left_out(names, have))
    if topics is not None:
        wanted = list(dict.fromkeys(absolute(topic) for topic in topics))
        for name in wanted:
            if name not in names:
                raise BagError(f"{a}, {b}: no topic {name} in either; found {', '.join(names) or 'none'}")
        names = wanted
    zeros = _zeros(readers)
    overlapping = _overlap(readers, zeros)
    pairs = {}
    done = []
    for name in (name for name in names if name not in {topic.name for topic in left_out}):
        one, other = (topics_of.get(name) for topics_of in have)
        known = one or other
        assert known is not None
        out = TopicComparison(name, known.type, (one.count if one else 0, other.count if other else 0))
        done.append(out)
        if one is None or other is None:
            out.identical = out.equal = False
            out.first = f"only in {'A' if other is None else 'B'}"
        elif one.type != other.type:
            out.identical = out.equal = False
            out.first = f"{one.type} in A, {other.type} in B"
        else:
            pairs[name] = _Pair(out, (Path(a), Path(b)), tolerance, overlapping)
    for side, time, message in _merged(readers, pairs, zeros):
        pairs[absolute(message.topic)].take(side, time, message)
    for pair in pairs.values():
        pair.finish(overlap)
    warnings = [reader.warning for reader in readers if reader.warning]
    return Comparison(Path(a), Path(b), tolerance, done, warnings, left_out)


def _left_out(names: Collection[str], have: tuple[dict[str, Topic], ...]) -> Iterator[LeftOut]:
    """What does not count unless it is asked for."""
    for name in names:
        one, other = (topics.get(name) for topics in have)
        known = one or other
        assert known is not None
        place = "only in A" if other is None else "only in B" if one is None else ""
        if known.type in LIVE:
            reason = "only a live node writes it"
        elif place and known.count == 0:
            reason = f"{place}, without a message"
        elif place and known.type not in KINDS:
            reason = f"{place}, no wrench, pose, cloud or mesh"
        else:
            continue
        yield LeftOut(name, known.type, (one.count if one else 0, other.count if other else 0), reason)


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
    readers: tuple[BagReader, BagReader], topics: Collection[str], zeros: tuple[int, int]
) -> Iterator[tuple[int, int, Message]]:
    """Messages of A (0) and B (1) on one time [ns] since the start of A, A first where both have the same."""

    def stream(side: int) -> Iterator[tuple[int, int, Message]]:
        return ((side, message.log_time - zeros[side], message) for message in readers[side].messages(topics))

    return heapq.merge(stream(0), stream(1), key=lambda item: item[1])


def _apart(one: BagReader, other: BagReader) -> bool:
    """Whether two bags have no time in common."""
    if one.start_time is None or one.end_time is None or other.start_time is None or other.end_time is None:
        return False
    return one.end_time < other.start_time or other.end_time < one.start_time


def _first_command(reader: BagReader) -> int | None:
    """Log time of the first message on a topic `command_pose` [ns], in any namespace."""
    names = [topic.name for topic in reader.topics if absolute(topic.name).endswith("/command_pose")]
    return next((message.log_time for message in reader.messages(names)), None)


class _Moment:
    """A message at a time, its numbers decoded when they are first asked for."""

    def __init__(self, path: Path, time: int, number: int, message: Message) -> None:
        self.path, self.time, self.number, self.message = path, time, number, message
        self._value: Value | None = None

    def value(self, kind: Kind) -> Value:
        """Its numbers; none, far from all others, where its bytes are not what its type says.

        Raises BagError for numbers that cannot be compared.
        """
        if self._value is None:
            where = f"{self.path}: topic {self.message.topic}, message {self.number}"
            try:
                self._value = kind.value(cdr.deserialize(self.message.data, self.message.type))
            except BagError as error:
                raise BagError(f"{where}: {error}") from None
            except ValueError:
                self._value = Value("", ())
        return self._value


class _Pair:
    """One topic of both bags while its messages come in, in the order of time."""

    def __init__(self, out: TopicComparison, paths: tuple[Path, Path], tolerance: float | None, overlap: int) -> None:
        self.out, self.tolerance = out, tolerance
        self._single = out.messages == (1, 1)
        self._meter = LagMeter(overlap) if out.type in TIMED else None
        self._paths = paths
        self._kind = KINDS.get(out.type)
        out.differences = [Difference(*quantity) for quantity in self._kind.quantities] if self._kind else []
        self._squares = [0.0] * len(out.differences)
        self._rows = [0] * len(out.differences)
        self._unpaired: tuple[deque[_Moment], deque[_Moment]] = (deque(), deque())
        self._waiting: deque[_Moment] = deque()
        self._before: _Moment | None = None
        self._last_a: int | None = None
        self._numbers = [0, 0]
        self._before_a = self._since_a = self._before_b = self._after_b = 0

    def take(self, side: int, time: int, message: Message) -> None:
        """The next message of A (0) or B (1)."""
        self._numbers[side] += 1
        moment = _Moment(self._paths[side], time, self._numbers[side], message)
        if self.out.identical:
            digest = hashlib.blake2b(message.data, digest_size=16).digest()  # one bag may be far ahead of the other
            self._unpaired[side].append(_Moment(moment.path, time, moment.number, message._replace(data=digest)))
            if self._unpaired[1 - side]:
                self._match(*(queue.popleft() for queue in self._unpaired))
        if self._meter is not None and self._kind is not None and (parts := moment.value(self._kind).parts):
            self._meter.take(side, time, parts[0][0])
        if self._single:
            self._take_single(side, moment)
        elif side == 0:
            self._last_a, self._since_a = time, 0
            self._take_a(moment)
        else:
            self._before_a += self._last_a is None
            self._since_a += self._last_a is not None and time > self._last_a
            self._take_b(moment)

    def finish(self, overlap: bool) -> None:
        """All messages are in: the verdict."""
        out = self.out
        for side, queue in enumerate(self._unpaired):
            if queue:
                self._differs(queue[0], f"only in {'AB'[side]}")
        for i, difference in enumerate(out.differences):
            difference.rms = math.sqrt(self._squares[i] / self._rows[i]) if self._rows[i] else 0.0
        out.before, out.after = (self._before_b, self._before_a), (self._after_b + len(self._waiting), self._since_a)
        outside = out.before[0] + out.after[0], out.before[1] + out.after[1]
        out.outside = outside if out.compared else out.messages
        if self._meter is not None and all(math.isfinite(difference.max) for difference in out.differences):
            out.lag = self._meter.lag()
        if self.tolerance is None:
            out.equal = out.identical
        elif self._kind is not None:
            out.equal = out.first is None
            if sum(out.outside) and (not overlap or not out.compared):
                out.equal = False
                out.first = out.first or f"{out.outside[0]} messages of A and {out.outside[1]} of B have no counterpart"

    def _match(self, a: _Moment, b: _Moment) -> None:
        """The k-th messages of both: are they the same?"""
        for what in ("data", "log_time", "publish_time", "sequence"):
            if getattr(a.message, what) != getattr(b.message, what):
                self._differs(a, _WORDS[what])
                return

    def _differs(self, moment: _Moment, what: str) -> None:
        """The bags are not bit-identical from here on."""
        self.out.identical = False
        if self.tolerance is None:
            self.out.first = _when(moment, what)
        for queue in self._unpaired:
            queue.clear()

    def _take_single(self, side: int, moment: _Moment) -> None:
        """The only message of a bag: at whatever time, it is compared with the only one of the other."""
        self._waiting.append(moment)
        if len(self._waiting) == 2:
            other = self._waiting.popleft()
            a, b = (moment, other) if side == 0 else (other, moment)
            self._waiting.clear()
            self._compare(a, b, b, 0.0)

    def _take_a(self, moment: _Moment) -> None:
        """Has it wait for B, where B may still come to its time; of those before B only the newest can have it."""
        before, waiting = self._before, self._waiting
        if before is not None and self._numbers[1] == self.out.messages[1] and moment.time > before.time:
            self._after_b += 1
            return
        while before is None and waiting and waiting[0].time < moment.time:
            waiting.popleft()
            self._before_b += 1
        waiting.append(moment)

    def _take_b(self, after: _Moment) -> None:
        """Compares what of A waits for B up to the time of `after`; of equal times one with one."""
        before = self._before
        while self._waiting and self._waiting[0].time < after.time:
            a = self._waiting.popleft()
            if before is None:
                self._before_b += 1
            else:
                self._compare(a, before, after, (a.time - before.time) / (after.time - before.time))
        if self._waiting and self._waiting[0].time == after.time:
            self._compare(self._waiting.popleft(), after, after, 0.0)
        self._before = after

    def _compare(self, a: _Moment, before: _Moment, after: _Moment, share: float) -> None:
        self.out.compared += 1
        kind = self._kind
        if kind is None:
            return
        one = a.value(kind)
        same = share == 0.0 and a.message.data == before.message.data
        low = one if same else before.value(kind)
        high = after.value(kind) if share > 0.0 else low
        if not (one.parts and low.parts and high.parts):
            if not same:
                for difference in self.out.differences:
                    difference.max, difference.max_time = math.inf, 1e-9 * a.time
                self.out.first = self.out.first or _when(a, "a message that cannot be decoded")
            return
        for i, difference in enumerate(self.out.differences):
            turn = kind.quantities[i] == TURN
            difference.peak = max(difference.peak, largest_of(one.parts[i], turn))
            self._rows[i] += len(one.parts[i])
            if same:
                continue
            apart = apart_by(one, low, high, share, i, turn)
            largest = float(apart.max(initial=0.0))
            self._squares[i] += float(apart @ apart)
            if largest > difference.max:
                difference.max, difference.max_time = largest, 1e-9 * a.time
            if self.tolerance is not None and largest > self.tolerance and self.out.first is None:
                self.out.first = _when(a, f"{difference.quantity} by {largest:.3g} {difference.unit}")


_WORDS = {"data": "bytes", "log_time": "log time", "publish_time": "publish time", "sequence": "number"}


def _when(moment: _Moment, what: str) -> str:
    return f"{what} at {1e-9 * moment.time:.6f} s (message {moment.number})"

"""One topic of two bags: its messages in the order of time, held against each other."""

from __future__ import annotations

import hashlib
import math
from collections import deque
from pathlib import Path

from ..errors import BagError
from . import cdr
from .comparison import Difference, TopicComparison
from .lag import LagMeter
from .message import Message
from .quantities import KINDS, TURN, Kind, Value, apart_by, largest_of

TIMED = {cdr.WRENCH_STAMPED, cdr.POSE_STAMPED}
"""Types whose lag is told."""


class Moment:
    """A message at a time, its numbers decoded when they are first asked for."""

    def __init__(self, path: Path, time: int, number: int, message: Message) -> None:
        self.path, self.time, self.number, self.message = path, time, number, message
        self._value: Value | None = None

    def value(self, kind: Kind) -> Value:
        """Its numbers. Raises BagError when its bytes are not what its type says."""
        if self._value is None:
            where = f"{self.path}: topic {self.message.topic}, message {self.number}"
            try:
                self._value = kind.value(cdr.deserialize(self.message.data, self.message.type))
            except (BagError, ValueError) as error:
                raise BagError(f"{where}: {error}") from None
        return self._value


class TopicPair:
    """One topic of both bags while its messages come in, in the order of time.

    broken : of a bag with messages that cannot be read, where the first one is and why
    """

    def __init__(self, out: TopicComparison, paths: tuple[Path, Path], tolerance: float | None, overlap: int) -> None:
        self.out, self.tolerance = out, tolerance
        self._single = out.messages == (1, 1)
        self._meter = LagMeter(overlap) if out.type in TIMED else None
        self._paths = paths
        self._kind = KINDS.get(out.type)
        out.differences = [Difference(*quantity) for quantity in self._kind.quantities] if self._kind else []
        self._squares = [0.0] * len(out.differences)
        self._rows = [0] * len(out.differences)
        self._unpaired: tuple[deque[Moment], deque[Moment]] = (deque(), deque())
        self._waiting: deque[Moment] = deque()
        self._before: Moment | None = None
        self._last_a: int | None = None
        self._numbers = [0, 0]
        self.broken: dict[Path, str] = {}
        self._before_a = self._since_a = self._before_b = self._after_b = 0

    def take(self, side: int, time: int, message: Message) -> None:
        """The next message of A (0) or B (1)."""
        self._numbers[side] += 1
        moment = Moment(self._paths[side], time, self._numbers[side], message)
        if self.out.identical:
            digest = hashlib.blake2b(message.data, digest_size=16).digest()  # one bag may be far ahead of the other
            self._unpaired[side].append(Moment(moment.path, time, moment.number, message._replace(data=digest)))
            if self._unpaired[1 - side]:
                self._match(*(queue.popleft() for queue in self._unpaired))
        if self._meter is not None and self._kind is not None:
            value = self._value(moment, self._kind)
            if value is not None:
                self._meter.take(side, time, value.parts[0][0])
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
        out.messages = (self._numbers[0], self._numbers[1])
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
        elif not out.identical:
            if sum(out.outside) and (not overlap or not out.compared):
                out.first = out.first or f"{out.outside[0]} messages of A and {out.outside[1]} of B have no counterpart"
            elif self._kind is None and not overlap and out.messages[0] != out.messages[1]:
                out.first = out.first or f"{out.messages[0]} messages in A, {out.messages[1]} in B"
            out.equal = out.first is None

    def _match(self, a: Moment, b: Moment) -> None:
        """The k-th messages of both: are they the same?"""
        for what in ("data", "log_time", "publish_time", "sequence"):
            if getattr(a.message, what) != getattr(b.message, what):
                self._differs(a, _WORDS[what])
                return

    def _differs(self, moment: Moment, what: str) -> None:
        """The bags are not bit-identical from here on."""
        self.out.identical = False
        if self.tolerance is None:
            self.out.first = _when(moment, what)
        for queue in self._unpaired:
            queue.clear()

    def _take_single(self, side: int, moment: Moment) -> None:
        """The only message of a bag: at whatever time, it is compared with the only one of the other."""
        self._waiting.append(moment)
        if len(self._waiting) == 2:
            other = self._waiting.popleft()
            a, b = (moment, other) if side == 0 else (other, moment)
            self._waiting.clear()
            self._compare(a, b, b, 0.0)

    def _take_a(self, moment: Moment) -> None:
        """Has it wait for B, where B may still come to its time; of those before B only the newest can have it."""
        before, waiting = self._before, self._waiting
        if before is not None and self._numbers[1] == self.out.messages[1] and moment.time > before.time:
            self._after_b += 1
            return
        while before is None and waiting and waiting[0].time < moment.time:
            waiting.popleft()
            self._before_b += 1
        waiting.append(moment)

    def _take_b(self, after: Moment) -> None:
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

    def _compare(self, a: Moment, before: Moment, after: Moment, share: float) -> None:
        self.out.compared += 1
        kind = self._kind
        if kind is None:
            if a.message.data not in (before.message.data, after.message.data):
                self._beyond(a, "bytes")
            return
        same = share == 0.0 and a.message.data == before.message.data
        one = self._value(a, kind)
        low = one if same else self._value(before, kind)
        high = self._value(after, kind) if share > 0.0 else low
        if one is None or low is None or high is None:
            if not same:
                self._beyond(a, "cannot be read")
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

    def _value(self, moment: Moment, kind: Kind) -> Value | None:
        """The numbers of a message; None where they cannot be read."""
        try:
            return moment.value(kind)
        except BagError as error:
            self.broken.setdefault(moment.path, str(error))
            return None

    def _beyond(self, a: Moment, what: str) -> None:
        """How far a message of A is from B cannot be told: it is more than any tolerance."""
        for difference in self.out.differences:
            if difference.max < math.inf:
                difference.max, difference.max_time = math.inf, 1e-9 * a.time
        if self.tolerance is not None and self.out.first is None:
            self.out.first = _when(a, what)


_WORDS = {"data": "bytes", "log_time": "log time", "publish_time": "publish time", "sequence": "number"}


def _when(moment: Moment, what: str) -> str:
    return f"{what} at {1e-9 * moment.time:.6f} s (message {moment.number})"

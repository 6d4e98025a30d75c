"""A process that writes bags, one after the other, for another that must not wait.

`python -m finger_sim.bags.process DESCRIPTOR` takes messages from the Memory in that file. Its standard input says what
to do, its standard output what came of it; both are lines of JSON. An `Order` begins a bag, and an `Ending` finishes it
when all messages put before are in it. The answers are {"opened": true}, {"closed": true}, and {"error": why the bag
ended}.

When the other process is gone its end of the pipe closes, and the bag is finished with all that it put: so this one
ignores the signals that end a terminal's processes together.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from typing import Any, TypedDict

from ..errors import BagError
from .metadata import Qos
from .ring import Memory
from .writer import BagWriter

TAKE_PERIOD = 0.005
"""Time between two looks at the memory during a recording [s]: half of the longest time that a message waits there."""
FLUSH_PERIOD = 0.4
"""Longest time that a message stays in the memory of this process [s]."""
NICENESS = 5
"""Added to the other process's: where the cores are busy, steps come first."""


class OrderedTopic(TypedDict):
    """A topic to announce; messages carry its place in the order as their number."""

    name: str
    type: str
    definition: tuple[str, str]
    """Full text and hash of the type."""
    qos: tuple[int, bool, bool]
    """Fields of `Qos`."""


class Order(TypedDict):
    """The bag to make."""

    path: str
    topics: list[OrderedTopic]
    options: dict[str, Any]
    """Of BagWriter."""


class Ending(TypedDict):
    """The end of a bag."""

    origin: dict[str, str]
    """What is known only now of what made it (`bags.origin`)."""


class Scribe:
    """Writes what is put into the memory; `answer` is told what came of an order."""

    def __init__(self, memory: Memory, answer: Callable[[dict[str, Any]], None]) -> None:
        self._memory, self._answer = memory, answer
        self._bag: BagWriter | None = None
        self._topics: list[str] = []
        self._flushed = 0.0

    @property
    def busy(self) -> bool:
        """Whether there is a bag to write."""
        return self._bag is not None

    def begin(self, order: Order) -> None:
        """Begins a bag."""
        self._safely(lambda: self._begin(order))

    def finish(self, ending: Ending) -> None:
        """Finishes the bag, if there is one."""
        self._safely(lambda: self._finish(ending))

    def write(self) -> None:
        """Writes what was there a call before; what this process has kept for long goes to the operating system."""
        self._safely(self._write)

    def _safely(self, do: Callable[[], object]) -> None:
        """Whatever goes wrong ends the bag and is told."""
        try:
            do()
        except Exception as error:
            bag, self._bag = self._bag, None
            reason = str(error) if isinstance(error, BagError) else repr(error)
            if bag is not None:
                with contextlib.suppress(BagError):
                    bag.cut(reason)
                self._memory.saved = bag.saved
                reason = reason if isinstance(error, BagError) else f"{bag.path}: {reason}"
                reason += "; what was recorded before stays readable"
            self._answer({"error": reason})

    def _begin(self, order: Order) -> None:
        self._memory.begin_anew()
        self._bag = BagWriter(order["path"], **order["options"])
        self._topics = [topic["name"] for topic in order["topics"]]
        for topic in order["topics"]:
            text, type_hash = topic["definition"]
            self._bag.add_topic(topic["name"], topic["type"], qos=Qos(*topic["qos"]), definition=(text, type_hash))
        self._answer({"opened": True})

    def _write(self, whole: bool = False) -> None:
        if self._bag is None:
            return
        for topic, sequence, log_time, data in self._memory.take(whole):
            self._bag.write(self._topics[topic], data, log_time, sequence=sequence)
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self._bag.flush()
            self._memory.saved = self._bag.saved
            self._flushed = time.monotonic()

    def _finish(self, ending: Ending) -> None:
        if self._bag is not None:
            self._write(whole=True)
            self._bag.say_at_end(ending["origin"])
            self._bag.close()
            self._memory.saved = self._bag.saved
            self._bag = None
            self._answer({"closed": True})


def main() -> int:
    """Serves until the other end closes; 0."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    memory = Memory(int(sys.argv[-1]))
    answers = os.dup(1)
    os.dup2(2, 1)  # what a library prints is no answer

    def answer(what: dict[str, Any]) -> None:
        with contextlib.suppress(BrokenPipeError):  # nobody is left to hear it
            os.write(answers, json.dumps(what).encode() + b"\n")

    scribe = Scribe(memory, answer)
    orders = select.poll()
    orders.register(0, select.POLLIN)
    heard = b""
    while True:
        if orders.poll(1e3 * TAKE_PERIOD if scribe.busy else None):
            data = os.read(0, 1 << 16)
            if not data:
                break
            *lines, heard = (heard + data).split(b"\n")
            for line in lines:
                order = json.loads(line)
                if "path" in order:
                    scribe.begin(order)
                else:
                    scribe.finish(order)
        scribe.write()
    scribe.finish({"origin": {}})
    return 0


if __name__ == "__main__":
    sys.exit(main())

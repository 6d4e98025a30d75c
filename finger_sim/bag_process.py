"""A process that writes bags, one after the other, for another that must not wait: `python -m finger_sim.bag_process`.

Frames come in by its standard input, answers go out by its standard output. A frame is HEAD and so many bytes:
a message, or with the topic number OPEN what to begin, as JSON (`Order`), or with CLOSE nothing. An answer is a
line of JSON: {"opened": true}, {"written": messages so far}, {"closed": true}, or {"error": why the bag ended}.

When the other process is gone its end of the pipe closes, and the bag is finished properly: so this one ignores the
signals that end a terminal's processes together.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import struct
import sys
import time
from collections.abc import Callable
from typing import Any, TypedDict

from .bag_writer import BagWriter, Qos
from .errors import BagError

HEAD = struct.Struct("<IHIQ")
"""Of a frame: size of what follows [byte], number of the topic, sequence of the message, its log time [ns]."""
OPEN, CLOSE = 0xFFFF, 0xFFFE
"""Instead of the number of a topic."""

FLUSH_PERIOD = 0.4
"""Longest time that a message stays in the memory of this process [s]."""
NICENESS = 5
"""Added to the other process's: where the cores are busy, steps come first."""
READ = 1 << 20
"""Most that is read at once [byte]."""


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


class Scribe:
    """Carries out frames as they come; `answer` is told what came of them."""

    def __init__(self, answer: Callable[[dict[str, Any]], None]) -> None:
        self._answer = answer
        self._bag: BagWriter | None = None
        self._topics: list[str] = []
        self._written = 0
        self._flushed = 0.0
        self._data = bytearray()

    def take(self, data: bytes) -> None:
        """The next bytes of the stream of frames."""
        self._data += data
        before, begin = self._written, 0
        while begin + HEAD.size <= len(self._data):
            size, number, sequence, log_time = HEAD.unpack_from(self._data, begin)
            end = begin + HEAD.size + size
            if end > len(self._data):
                break
            self._safely(self._carry_out, number, bytes(self._data[begin + HEAD.size : end]), log_time, sequence)
            begin = end
        del self._data[:begin]
        if self._bag is not None and self._written != before:
            self._answer({"written": self._written})
        self.rest()

    def rest(self) -> None:
        """Hands what has been in memory for long to the operating system; to be called often."""
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self._flushed = time.monotonic()
            self._safely(lambda: self._bag.flush() if self._bag is not None else None)

    def end(self) -> None:
        """Finishes the bag, if there is one."""
        self._safely(self._finish)

    def _safely(self, do: Callable[..., object], *arguments: Any) -> None:
        """Whatever goes wrong ends the bag and is told."""
        try:
            do(*arguments)
        except Exception as error:
            bag, self._bag = self._bag, None
            where = f"{bag.path}: " if bag is not None else ""
            if bag is not None:
                bag.abort()
            self._answer({"error": str(error) if isinstance(error, BagError) else f"{where}{error!r}"})

    def _carry_out(self, number: int, data: bytes, log_time: int, sequence: int) -> None:
        if number == OPEN:
            self._begin(json.loads(data))
        elif number == CLOSE:
            self._finish()
        elif self._bag is not None:
            self._bag.write(self._topics[number], data, log_time, sequence=sequence)
            self._written += 1

    def _begin(self, order: Order) -> None:
        self._bag = BagWriter(order["path"], **order["options"])
        self._topics = [topic["name"] for topic in order["topics"]]
        for topic in order["topics"]:
            definition = (topic["definition"][0], topic["definition"][1])
            self._bag.add_topic(topic["name"], topic["type"], qos=Qos(*topic["qos"]), definition=definition)
        self._written = 0
        self._answer({"opened": True})

    def _finish(self) -> None:
        if self._bag is not None:
            self._bag.close()
            self._bag = None
            self._answer({"written": self._written})
            self._answer({"closed": True})


def main() -> int:
    """Serves until the other end closes; 0."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    frames, answers = os.dup(0), os.dup(1)
    os.dup2(2, 1)  # what a library prints is no answer

    def answer(what: dict[str, Any]) -> None:
        with contextlib.suppress(BrokenPipeError):  # nobody is left to hear it
            os.write(answers, json.dumps(what).encode() + b"\n")

    scribe = Scribe(answer)
    waiting = select.poll()
    waiting.register(frames, select.POLLIN)
    while True:
        if waiting.poll(1e3 * FLUSH_PERIOD):
            data = os.read(frames, READ)
            if not data:
                break
            scribe.take(data)
        else:
            scribe.rest()
    scribe.end()
    return 0


if __name__ == "__main__":
    sys.exit(main())

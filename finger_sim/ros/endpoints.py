"""Publishers with the messages that they send, and subscriptions: for compiled code where rcl fits, else for Python."""

from __future__ import annotations

import contextlib
import time
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import types

from ..arrays import Ints
from ..bags.template import Template
from ..errors import FingerSimError
from ..physics.records import direct, held
from . import rclpy_private
from .memory import bytes_at
from .rcl import Rcl, clock, find, listed, meaning
from .rclpy_private import Taken
from .wire import (
    ADDRESS,
    ALLOCATOR,
    CAPACITY,
    GUARDED,
    LENGTH,
    NOTHING,
    RECEIVED,
    SENT,
    UNFIT,
    WORDS,
    Incoming,
    Outgoing,
    publish,
    take,
)

ROOM = 512
"""Bytes of an incoming message for which there is room from the start: a pose with a name of any usual length."""


class Endpoints:
    """Sends the messages of Templates as they are filled, and takes what comes; of one thread at a time.

    outgoing, incoming : for wire.publish and wire.take, and for records of which they become part
    lack               : why rcl does not fit, for a user; empty: it does. Where it does not, compiled code can fill
                         messages, but neither publish nor take: use `send` and `take`, which work in any case.

    Until `release` the handles of rclpy cannot end, whoever destroys publisher, node or context: compiled code must
    have come to its end before that. Afterwards the records hold no address of an endpoint: what they send fails. Who
    uses the records keeps the Endpoints.
    """

    def __init__(self, outgoing: Sequence[tuple[Any, Template]], incoming: Sequence[Any] = ()) -> None:
        """Publishers and what they send, and subscriptions that are raw; both are numbered in this order."""
        self.lack = ""
        self._publishers, self._templates = [p for p, _ in outgoing], [t for _, t in outgoing]
        self._subscriptions = list(incoming)
        keep = contextlib.ExitStack()
        try:
            self._hold(find(), keep)
        except FingerSimError as error:
            keep.close()
            self.lack = str(error)
            self._hold(None, keep)
        self.release = weakref.finalize(self, keep.close)
        """Lets the handles go; what is called later does nothing."""

    def send(self, k: int) -> None:
        """Message k, as it was filled last. Raises FingerSimError where it cannot be sent."""
        if self.lack:
            try:
                self._publishers[k].publish(self._templates[k].bytes.tobytes())
            except rclpy_private.failures() as error:
                raise FingerSimError(f"{self._publishers[k].topic}: cannot be sent: {error}") from None
        elif (code := self._publish(self._held_outgoing, k)) != 0:
            raise FingerSimError(f"{self._publishers[k].topic}: cannot be sent: {meaning(code)}")

    def delivered(self, seconds: float) -> bool:
        """Whether reliable readers have all that was sent; waits so long for it at most [s]."""
        end = time.monotonic() + seconds
        return all(rclpy_private.acknowledged(p, max(0.0, end - time.monotonic())) for p in self._publishers)

    def take(self, k: int) -> Taken | None:
        """The oldest message that lies in subscription k; None where there is none. Raises FingerSimError."""
        if self.lack:
            try:
                return rclpy_private.take(self._subscriptions[k])
            except rclpy_private.failures() as error:
                raise FingerSimError(f"{self._subscriptions[k].topic}: cannot be heard: {error}") from None
        length = self._take(self._held_incoming, k)
        if length >= 0 or length == UNFIT:
            return self.taken(k)
        if length == NOTHING:
            return None
        raise FingerSimError(f"{self._subscriptions[k].topic}: cannot be heard: {meaning(-length)}")

    def taken(self, k: int) -> Taken:
        """What compiled code took last from subscription k, for Python to look at.

        Where that was UNFIT, rclpy does it all from now on, and the time of receipt is the present.
        """
        words, info = self.incoming.messages[k], self.incoming.infos[k]
        data = bytes_at(words[ADDRESS], words[LENGTH]).tobytes()
        if self.incoming.fits[0] != 0:
            return Taken(data, int(info[RECEIVED]), int(info[SENT]))
        self.lack = f"rmw_message_info_t is another structure: {listed(info)}"
        return Taken(data, time.time_ns(), 0)

    def _hold(self, rcl: Rcl | None, keep: contextlib.ExitStack) -> None:
        """Makes the records, with no address where there is no rcl; `keep` undoes all. Raises FingerSimError."""
        publishers, subscriptions = (
            np.zeros(len(entities), np.int64) for entities in (self._publishers, self._subscriptions)
        )
        sent, heard = (np.zeros((len(entities), WORDS), np.int64) for entities in (publishers, subscriptions))
        for words, template in zip(sent, self._templates, strict=True):
            words[ADDRESS] = template.bytes.ctypes.data
            words[LENGTH] = words[CAPACITY] = len(template.bytes)
        if rcl is not None:
            for addresses, entities in ((publishers, self._publishers), (subscriptions, self._subscriptions)):
                keep.callback(addresses.fill, 0)
                addresses[:] = [rclpy_private.held_address(entity, keep) for entity in entities]
            sent[:, ALLOCATOR:] = rcl.allocator
            for words in heard:
                rcl.make(words, ROOM)
                keep.callback(_remove, rcl, words)
        infos = np.full((len(heard), 2 * WORDS), GUARDED, np.int64)
        numbers = np.array([template.blocks[0] if template.blocks else 0 for template in self._templates], np.int64)
        fits = np.zeros(1, np.int64)
        publish_at, take_at, reset = (rcl.publish, rcl.take, rcl.reset_error) if rcl is not None else (0, 0, 0)
        self.outgoing = Outgoing(publish_at, reset, publishers, sent, numbers)
        self.incoming = Incoming(take_at, reset, subscriptions, heard, infos, time.time_ns(), fits, clock())
        self._held_outgoing, self._held_incoming = held(self.outgoing), held(self.incoming)
        self._publish = direct(publish, self._held_outgoing, types.int64)
        self._take = direct(take, self._held_incoming, types.int64)


def _remove(rcl: Rcl, words: Ints) -> None:
    rcl.remove(words)
    words[:] = 0

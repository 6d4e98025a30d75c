"""Messages that compiled code puts into a recording, without the interpreter: see ring.py."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from ..arrays import Bytes, Ints
from ..physics.atomics import fence, load_acquire, store_release
from ..physics.compile import formula, kernel
from .ring import ACCEPTED, DONE, HEAD, LOOP, OF_RING, OTHERS, PUT, TAKEN, Memory

ACTIVE, INSIDE, CAPACITY, ZERO, BEGAN, DROPPED = range(6)
"""Places in `Recording.control`.

ACTIVE   : 1 from the beginning to the end of the recording
INSIDE   : 1 while `put` is at work
CAPACITY : messages that may wait in both rings together
ZERO     : log time less steady time [ns]
BEGAN    : steady time from which messages are taken [ns]
DROPPED  : messages of the loop that found no room
"""
_HEAD = HEAD.size
_LOOP, _OTHERS = LOOP * OF_RING, OTHERS * OF_RING
_PAUSE = 1e-5
"""Between two looks at whether compiled code is in the middle of a message [s]."""


class Recording(NamedTuple):
    """Where compiled code puts the messages of one recording.

    Whoever holds it may use it for ever: it holds its memory, and nothing comes of it after the recording's end.

    words    : (512,) words of the memory; see ring.py
    data     : (size,) bytes of the loop's ring
    control  : (6,) whether and which messages are taken; see ACTIVE
    sequence : (topics,) of the last message on each topic, whoever put it. One at a time may put messages of a topic.
    """

    words: Ints
    data: Bytes
    control: Ints
    sequence: Ints


def no_recording() -> Recording:
    """One that takes nothing."""
    words, control, sequence = (np.zeros(size, np.int64) for size in (1, 6, 1))
    return Recording(words, np.zeros(1, np.uint8), control, sequence)


def build_recording(memory: Memory, topics: int, capacity: int, zero: int) -> Recording:
    """One that has not begun; see there."""
    control = np.zeros(6, np.int64)
    control[CAPACITY], control[ZERO] = capacity, zero
    data = np.frombuffer(memory.rings[LOOP].data, np.uint8)
    return Recording(np.frombuffer(memory.words, np.int64), data, control, np.zeros(topics, np.int64))


def begin(recording: Recording, began: int) -> None:
    """From now on messages of a steady time from `began` on [ns] are taken."""
    recording.control[BEGAN] = began
    store_release(recording.control, ACTIVE, 1)


def end(recording: Recording, timeout: float) -> bool:
    """From now on no message is taken, counted or dropped; what was taken is whole.

    False where the thread that puts one was in the middle of it, and still is after `timeout` [s].
    """
    recording.control[ACTIVE] = 0
    fence()
    until = time.monotonic() + timeout
    while load_acquire(recording.control, INSIDE):
        if time.monotonic() >= until:
            return False
        time.sleep(_PAUSE)
    return True


@kernel
def put(recording: Recording, topic: int, steady: int, data: Bytes, size: int) -> bool:
    """Puts a message where there is room for it; False if there is none, if too many wait, and beside a recording.

    For one thread at a time.

    topic  : number of its topic
    steady : steady time of the message [ns]
    data   : its first `size` bytes are the message, in CDR
    """
    control = recording.control
    store_release(control, INSIDE, 1)
    fence()  # whoever ends the recording sees that, or is seen here
    accepted = False
    if load_acquire(control, ACTIVE) != 0 and steady >= control[BEGAN]:
        recording.sequence[topic] += 1
        accepted = _put(recording, topic, recording.sequence[topic], steady + control[ZERO], data, size)
        if not accepted:
            control[DROPPED] += 1
    store_release(control, INSIDE, 0)
    return accepted


@formula
def _put(recording: Recording, topic: int, sequence: int, log_time: int, data: Bytes, size: int) -> bool:
    """What `Ring.put` does; it takes a place before it writes the bytes, not after."""
    words, ring = recording.words, recording.data
    total, whole, begin = ring.shape[0], _HEAD + size, words[_LOOP + PUT]
    accepted = words[_LOOP + ACCEPTED] + 1
    room = total - (begin - load_acquire(words, _LOOP + TAKEN))
    done = load_acquire(words, _LOOP + DONE) + load_acquire(words, _OTHERS + DONE)
    store_release(words, _LOOP + ACCEPTED, accepted)
    fence()  # of two who take the last place at the same time, one at least sees the other
    waiting = accepted + load_acquire(words, _OTHERS + ACCEPTED) - done
    if whole > room or waiting > recording.control[CAPACITY]:
        store_release(words, _LOOP + ACCEPTED, accepted - 1)
        return False
    at = begin % total
    for value, count in ((size, 4), (topic, 2), (sequence, 4), (log_time, 8)):
        for _ in range(count):
            ring[at] = value & 0xFF
            value >>= 8
            at = at + 1 if at + 1 < total else 0
    first = min(size, total - at)
    for i in range(first):
        ring[at + i] = data[i]
    for i in range(first, size):
        ring[i - first] = data[i]
    store_release(words, _LOOP + PUT, begin + whole)
    return True

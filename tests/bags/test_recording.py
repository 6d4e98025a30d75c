"""What compiled code puts into a recording: as Python puts it, whole whenever one looks, nothing after the end."""

from __future__ import annotations

import gc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np
import pytest
from rings import begun, shared

from finger_sim.bags import recording
from finger_sim.bags import ring as bag_ring
from finger_sim.bags.recording import ACTIVE, DROPPED, INSIDE, Recording, put
from finger_sim.bags.ring import ACCEPTED, LOOP, OF_RING, OTHERS, PUT, TAKEN, Record, Ring
from finger_sim.physics import atomics
from finger_sim.physics.atomics import load_acquire, store_release
from finger_sim.physics.compile import kernel
from finger_sim.physics.records import held

Putting = Callable[[int, int, int, Any], bool]
TIMEOUT = 60.0
"""Longest wait for another thread [s]."""
MESSAGES = 3_000
LONGEST = 10_000
"""Of these messages [byte]."""
BYTES = np.random.default_rng(1).integers(0, 256, 256).astype(np.uint8)


def test_bytes_are_those_that_python_puts() -> None:
    """Messages of every length from every place of the ring on, and sequences beyond 32 bits."""
    compiled, plain = shared(61, 7), shared(61, 7)
    made, sequence, zero = begun(compiled[0], topics=60_000, zero=2**60), 2**32 - 500, 2**60
    made.sequence[:] = sequence
    handle, by_python = held(made), plain[0].rings[LOOP]
    for length in range(61 - 17):
        for k in range(61):
            topic, sequence = 59_999, sequence + 1
            assert put(handle, topic, k, BYTES, length)
            assert by_python.put(topic, sequence, zero + k, BYTES[:length].tobytes())
            assert bytes(compiled[0].rings[LOOP].data) == bytes(by_python.data)
            assert compiled[0].words.tolist() == plain[0].words.tolist()
            (record,) = compiled[1].rings[LOOP].take()
            assert record == Record(topic, sequence % 2**32, zero + k, BYTES[:length].tobytes())
            list(plain[1].rings[LOOP].take())
    assert made.control[DROPPED] == 0


def test_what_finds_no_room_is_what_python_refuses() -> None:
    """By bytes and by messages of both rings; it leaves a gap in its topic's numbers, and is counted."""
    compiled, plain = shared(300, 300), shared(300, 300)
    made, refused, sequences = begun(compiled[0], capacity=6), 0, [0, 0, 0]
    plain[0].rings[LOOP].capacity = 6
    handle, random = held(made), np.random.default_rng(1)
    for k in range(5000):
        topic, length = int(random.integers(3)), int(random.integers(100))
        if random.random() < 0.3:
            for here, _ in (compiled, plain):
                here.rings[OTHERS].put(topic, k, k, bytes(length))
        else:
            sequences[topic] += 1
            there = plain[0].rings[LOOP].put(topic, sequences[topic], k, BYTES[:length].tobytes())
            assert put(handle, topic, k, BYTES, length) == there
            refused += not there
        if random.random() < 0.2:
            assert list(compiled[1].take()) == list(plain[1].take())
        assert compiled[0].words.tolist() == plain[0].words.tolist()
    assert made.sequence.tolist() == sequences
    assert made.control[DROPPED] == refused
    assert 500 < refused < 2500


class Words:
    """Words of a memory, for those that watch what is written there."""

    def __init__(self, words: Any) -> None:
        self.words = words

    def __getitem__(self, k: int) -> int:
        return int(self.words[k])

    def __setitem__(self, k: int, value: int) -> None:
        self.words[k] = value


class Watched(Words):
    """When PUT is written, the bytes are what they were at the last fence.

    told : how often that was
    """

    def __init__(self, words: Any, data: Any) -> None:
        super().__init__(words)
        self.data, self.told = data, 0

    def fence(self) -> None:
        self.fenced = bytes(self.data)

    def __setitem__(self, k: int, value: int) -> None:
        if k == PUT:
            self.told += 1
            assert bytes(self.data) == self.fenced
        super().__setitem__(k, value)


class Contested(Words):
    """The other writer takes a place just when this one does."""

    def __setitem__(self, k: int, value: int) -> None:
        super().__setitem__(k, value)
        if k == LOOP * OF_RING + ACCEPTED:
            super().__setitem__(OTHERS * OF_RING + ACCEPTED, 1)


def uncompiled(monkeypatch: pytest.MonkeyPatch, made: Recording, ring: Ring, words: Any) -> tuple[Putting, Putting]:
    """What compiled code does, and what Python does, with other words; both take topic, sequence, time and bytes."""
    monkeypatch.setattr(ring, "_words", words)
    monkeypatch.setattr(recording, "_put", getattr(recording._put, "py_func", recording._put))
    plain, other = getattr(put, "py_func", put), made._replace(words=words)
    return (
        lambda topic, sequence, time, data: plain(other, topic, time, data, len(data)),
        lambda topic, sequence, time, data: ring.put(topic, sequence, time, data.tobytes()),
    )


@pytest.mark.parametrize("by_python", [True, False])
def test_a_message_is_whole_when_it_is_told_of(monkeypatch: pytest.MonkeyPatch, by_python: bool) -> None:
    """Uncompiled: the last of its bytes comes before a fence, and that before the word that tells of them."""
    here, there = shared(61, 7)
    ring, watched = here.rings[LOOP], Watched(here.words, here.rings[LOOP].data)
    put_uncompiled = uncompiled(monkeypatch, begun(here), ring, watched)[by_python]
    for module in (atomics, recording, bag_ring):
        monkeypatch.setattr(module, "fence", watched.fence)
    for k in range(1, 100):
        data = BYTES[k : k + 1 + k % 40]
        assert put_uncompiled(1, k, k, data)
        assert bytes(ring.data) == watched.fenced
        assert watched.told == k
        assert list(there.rings[LOOP].take()) == [Record(1, k, k, data.tobytes())]


@pytest.mark.parametrize("by_python", [True, False])
@pytest.mark.parametrize(("capacity", "taken"), [(1, False), (2, True)])
def test_two_who_take_the_last_place_do_not_both_get_it(
    monkeypatch: pytest.MonkeyPatch, by_python: bool, capacity: int, taken: bool
) -> None:
    """Uncompiled: one that finds that there was none has taken none."""
    here, there = shared(61, 7)
    ring = here.rings[LOOP]
    ring.capacity = capacity
    put_uncompiled = uncompiled(monkeypatch, begun(here, capacity=capacity), ring, Contested(here.words))[by_python]
    assert put_uncompiled(1, 1, 1, BYTES[:10]) == taken
    assert here.words[LOOP * OF_RING + ACCEPTED] == taken
    assert len(list(there.take(whole=True))) == taken


@kernel
def put_many(handle: Any, data: Any, halted: Any) -> int:
    """Message k has k % LONGEST bytes that are all k & 255, its topic is k % 3; tried until there is room. Tries.

    Each waits a little for the last to be taken: whoever reads waits then for the next.
    """
    tries = 0
    for k in range(MESSAGES):
        for i in range(k % LONGEST):
            data[i] = k & 255
        for _ in range(1000):
            if load_acquire(handle.words, TAKEN) == handle.words[PUT]:
                break
        while not put(handle, k % 3, k, data, k % LONGEST):
            tries += 1
            if load_acquire(halted, 0) != 0:
                return tries
        tries += 1
    return tries


@kernel
def read_many(words: Any, data: Any, halted: Any) -> int:
    """Reads each message the moment it is there, from its end; how many there are before one that is not whole."""
    total, at = data.shape[0], 0
    for k in range(MESSAGES):
        while load_acquire(words, PUT) == at:
            if load_acquire(halted, 0) != 0:
                return k
        length, good = k % LONGEST, True
        for i in range(17 + length, -1, -1):
            byte = data[(at + i) % total]
            if i < 4:
                good = good and byte == length >> (8 * i) & 255
            elif i < 6:
                good = good and byte == (k % 3) >> (8 * (i - 4)) & 255
            elif i >= 18:
                good = good and byte == k & 255
            elif i >= 10:
                good = good and byte == k >> (8 * (i - 10)) & 255
        for i in range(18 + length):
            data[(at + i) % total] = 0
        at += 18 + length
        store_release(words, TAKEN, at)
        if not good:
            store_release(halted, 0, 1)
            return k
    return MESSAGES


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="threads of the interpreter take turns")
def test_no_half_message_is_seen() -> None:
    """One thread reads and wipes messages while another puts them, both without the interpreter."""
    here, there = shared(199_999, 7)
    made, halted = begun(here), np.zeros(1, np.int64)
    words, data = np.frombuffer(there.words, np.int64), np.frombuffer(there.rings[LOOP].data, np.uint8)
    with ThreadPoolExecutor(2) as threads:
        reading = threads.submit(read_many, words, data, halted)
        putting = threads.submit(put_many, held(made), np.zeros(LONGEST, np.uint8), halted)
        try:
            tries = putting.result(TIMEOUT)
            assert reading.result(TIMEOUT) == MESSAGES
        finally:
            halted[0] = 1
    assert made.sequence.sum() == tries
    assert made.control[DROPPED] == tries - MESSAGES


@kernel
def put_on(handle: Any, data: Any, tries: Any, halted: Any) -> None:
    """Puts messages until halted; tells how often it has tried."""
    while load_acquire(halted, 0) == 0:
        put(handle, 0, 0, data, 100)
        store_release(tries, 0, tries[0] + 1)


def test_nothing_comes_after_the_end() -> None:
    """A thread that puts messages all the time is not stopped, but what it does has no effect from the end on."""
    here, _ = shared(100_000, 7)
    made, tries, halted = begun(here), np.zeros(1, np.int64), np.zeros(1, np.int64)

    def await_tries(count: int) -> None:
        begin = tries[0]
        while load_acquire(tries, 0) < begin + count:
            assert not thread.done()

    def state() -> list[Any]:
        return [here.words.tolist(), bytes(here.rings[LOOP].data), made.sequence.tolist(), made.control[DROPPED]]

    with ThreadPoolExecutor(1) as threads:
        thread = threads.submit(put_on, held(made), BYTES, tries, halted)
        try:
            for k in range(20):
                await_tries(1 + k)
                assert recording.end(made, TIMEOUT)
                ended = state()
                await_tries(300)
                assert state() == ended
                here.begin_anew()
                recording.begin(made, 0)
        finally:
            halted[0] = 1
        thread.result(TIMEOUT)
    assert made.sequence[0] > 20


class Logged(Words):
    """What is done with words, in order."""

    def __init__(self, words: Any) -> None:
        super().__init__(words)
        self.log: list[tuple[str, int]] = []

    def fence(self) -> None:
        self.log.append(("fence", -1))

    def __getitem__(self, k: int) -> int:
        self.log.append(("read", k))
        return super().__getitem__(k)

    def __setitem__(self, k: int, value: int) -> None:
        self.log.append(("write", k))
        super().__setitem__(k, value)


def test_who_puts_and_who_ends_cannot_miss_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each writes its word and then looks at the other's, a fence between; `put` says at last that it is out."""
    here, _ = shared(1000, 7)
    made = begun(here)
    control = Logged(made.control)
    handle = made._replace(control=control)
    uncompiled(monkeypatch, made, here.rings[LOOP], made.words)
    for module in (atomics, recording):
        monkeypatch.setattr(module, "fence", control.fence)
    for act, own, its in (
        (lambda: getattr(put, "py_func", put)(handle, 0, 0, BYTES, 10), INSIDE, ACTIVE),
        (lambda: recording.end(handle, 0.0), ACTIVE, INSIDE),
    ):
        control.log.clear()
        assert act()
        wrote, looked = control.log.index(("write", own)), control.log.index(("read", its))
        assert ("fence", -1) in control.log[wrote:looked]
        if own == INSIDE:
            assert control.log[-1] == ("write", INSIDE)
            assert made.control[INSIDE] == 0


def test_who_ends_a_recording_waits_for_the_end_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for ever: it is told when it does not come."""
    here, _ = shared(1000, 7)
    made = begun(here)
    made.control[INSIDE] = 1
    assert not recording.end(made, 0.01)
    assert made.control[ACTIVE] == 0
    waits = iter([1, 1, 0])
    monkeypatch.setattr(recording.time, "sleep", lambda _: made.control.__setitem__(INSIDE, next(waits)))
    assert recording.end(made, TIMEOUT)
    assert list(waits) == []


def test_beside_a_recording_nothing_is_taken_or_counted() -> None:
    """Before its beginning, of a time before that, after its end, and where there is none."""
    here, there = shared(1000, 7)
    made = recording.build_recording(here, 1, 10, 1000)
    handle = held(made)
    assert not put(handle, 0, 50, BYTES, 10)
    recording.begin(made, 50)
    assert not put(handle, 0, 49, BYTES, 10)
    assert put(handle, 0, 50, BYTES, 10)
    assert recording.end(made, 0.0)
    assert not put(handle, 0, 51, BYTES, 10)
    assert list(there.take(whole=True)) == [Record(0, 1, 1050, BYTES[:10].tobytes())]
    assert (made.sequence[0], made.control[DROPPED]) == (1, 0)
    assert not put(held(recording.no_recording()), 5, 2**60, BYTES, 10)


def test_the_memory_lasts_as_long_as_it_may_be_written_to() -> None:
    """Nothing but what a loop holds is left of the recording; what it puts still arrives."""
    here, there = shared(1_000_000, 7)
    handle = held(begun(here))
    del here
    gc.collect()
    assert all(put(handle, 0, k, BYTES, 200) for k in range(1000))
    assert [record.log_time for record in there.take(whole=True)] == list(range(1000))

"""The ring gives what was put into it, in order, whole or not at all."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from rings import shared

from finger_sim.bags.ring import LOOP, OTHERS, Record, Ring

SIZE = 1000


@pytest.fixture
def ends() -> tuple[Ring, Ring]:
    """Both ends of a small ring."""
    here, there = shared(7, SIZE)
    return here.rings[OTHERS], there.rings[OTHERS]


def test_what_is_put_is_taken(ends: tuple[Ring, Ring]) -> None:
    """Records of any length, empty ones too, over many rounds of the ring; those refused leave no trace."""
    here, there = ends
    random = np.random.default_rng(1)
    waiting: deque[Record] = deque()
    refused = taken = 0
    for k in range(5000):
        record = Record(k % 7, k, 2**63 + k, random.bytes(int(random.integers(0, 300))))
        if here.put(*record):
            waiting.append(record)
        else:
            refused += 1
            assert sum(len(r.data) + 18 for r in waiting) + len(record.data) + 18 > SIZE
        if random.random() < 0.2:
            for found in there.take():
                assert found == waiting.popleft()
                taken += 1
            assert not waiting
            assert here.done == taken
    assert min(refused, taken) > 300


def test_a_record_just_fits_or_does_not(ends: tuple[Ring, Ring]) -> None:
    """As large as the ring it is taken, a byte larger never."""
    here, there = ends
    assert not here.put(0, 1, 0, bytes(SIZE - 17))
    assert here.put(0, 2, 0, bytes(SIZE - 18))
    assert not here.put(0, 3, 0, b"")
    assert [record.sequence for record in there.take()] == [2]
    assert here.put(0, 4, 0, bytes(SIZE - 18))


def test_a_record_may_lie_anywhere(ends: tuple[Ring, Ring]) -> None:
    """Every length from every place of the ring on, head and bytes across its end anywhere."""
    here, there = shared(7, 61)
    put, take = here.rings[OTHERS].put, there.rings[OTHERS].take
    begin, seen = 0, set()
    for length in range(61 - 17):
        for k in range(61):
            record = Record(k % 7, k, 2**62 + length, bytes(range(length)))
            assert put(*record)
            assert list(take()) == [record]
            seen.add((length, begin))
            begin = (begin + 18 + length) % 61
    assert len(seen) >= 61 * 43  # one length goes round at once: it is in one place only


def test_records_can_be_forgotten() -> None:
    """What was left of one recording, in either ring, is not in the next, whose records count from 0."""
    here, there = shared(SIZE, SIZE)
    for ring in here.rings:
        for k in range(3):
            ring.put(0, k, 0, b"old")
    there.saved = 5
    list(there.take())
    next(there.take())
    there.begin_anew()
    assert list(there.take()) == list(there.take()) == []
    assert [ring.done for ring in here.rings] == [0, 0]
    assert here.saved == 0
    here.rings[LOOP].capacity = 1
    assert here.rings[LOOP].put(1, 7, 0, b"new")
    assert not here.rings[LOOP].put(1, 8, 0, b"new")
    assert list(there.take(whole=True)) == [Record(1, 7, 0, b"new")]
    assert [ring.done for ring in here.rings] == [1, 0]


def test_a_record_that_could_not_be_dealt_with_is_not_done(ends: tuple[Ring, Ring]) -> None:
    """Who takes it gets it again."""
    here, there = ends
    here.put(0, 1, 0, b"a")
    here.put(0, 2, 0, b"b")
    records = there.take()
    next(records), next(records)
    del records
    assert here.done == 1
    assert [record.sequence for record in there.take()] == [2]


def times(records: list[Record]) -> list[tuple[int, int]]:
    """Ring, which these tests give as the topic, and log time of records."""
    return [(record.topic, record.log_time) for record in records]


def test_two_rings_are_taken_in_the_order_of_log_times() -> None:
    """Each in its own order whatever the times; the loop first where they are equal."""
    here, there = shared(SIZE, SIZE)
    for number, log_times in ((LOOP, (10, 30, 30)), (OTHERS, (20, 30, 5, 40))):
        for k, log_time in enumerate(log_times):
            assert here.rings[number].put(number, k, log_time, b"")
    found = times(list(there.take(whole=True)))
    assert found == [(LOOP, 10), (OTHERS, 20), (LOOP, 30), (LOOP, 30), (OTHERS, 30), (OTHERS, 5), (OTHERS, 40)]


def test_what_comes_late_has_one_call_to_come_in_its_place() -> None:
    """A record waits for one call, so that the other ring's earlier ones come before it."""
    here, there = shared(SIZE, SIZE)
    loop, others = here.rings
    assert loop.put(LOOP, 1, 10, b"")
    assert list(there.take()) == []
    assert others.put(OTHERS, 1, 5, b"")
    assert others.put(OTHERS, 2, 20, b"")
    assert times(list(there.take())) == [(OTHERS, 5), (LOOP, 10)]
    assert others.put(OTHERS, 3, 15, b"")
    assert times(list(there.take())) == [(OTHERS, 20)]
    assert times(list(there.take())) == [(OTHERS, 15)]


def test_only_what_comes_late_is_out_of_order() -> None:
    """Two rings of rising times, put into between any calls: each record comes once, by the second call after it."""
    here, there = shared(SIZE, SIZE)
    random = np.random.default_rng(2)
    clock, calls = [0, 0], 0
    put: list[dict[int, int]] = [{}, {}]  # by ring: the call after which each time was put
    taken: list[tuple[int, int, int]] = []
    for _ in range(20_000):
        number = int(random.integers(2))
        clock[number] += 1 + int(random.integers(20) if clock[number] <= clock[1 - number] else random.integers(5))
        if here.rings[number].put(number, 0, clock[number], b""):
            put[number][clock[number]] = calls
        if random.random() < 0.1:
            calls += 1
            taken += [(*found, calls) for found in times(list(there.take()))]
    calls += 1
    taken += [(*found, calls) for found in times(list(there.take(whole=True)))]
    assert min(map(len, put)) > 5000
    for number in (LOOP, OTHERS):
        assert [time for ring, time, _ in taken if ring == number] == list(put[number])
    assert all(call - put[number][time] <= 2 for number, time, call in taken)
    latest, given_by = 0, 0
    for number, time, call in taken:
        assert time >= latest or put[number][time] >= given_by  # it was put after the call that gave the later one
        latest, given_by = max((latest, given_by), (time, call))


def test_both_rings_share_one_capacity() -> None:
    """So many records may wait in the two together; refused ones take no place."""
    here, there = shared(SIZE, SIZE)
    loop, others = here.rings
    loop.capacity = others.capacity = 3
    put = [ring.put(0, 1, 0, b"") for ring in (loop, others, loop, others, loop)]
    assert put == [True, True, True, False, False]
    records = there.take(whole=True)
    next(records), next(records)  # the first is done with
    assert [ring.put(0, 1, 0, b"") for ring in (others, loop)] == [True, False]
    del records
    assert len(list(there.take(whole=True))) == 3
    assert not loop.put(0, 1, 0, bytes(SIZE))
    assert [ring.put(0, 1, 0, b"") for ring in (others, others, others, others)] == [True, True, True, False]

"""The ring gives what was put into it, in order, whole or not at all."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator

import numpy as np
import pytest

from finger_sim.bags import ring as bag_ring
from finger_sim.bags.ring import Record, Ring, make_file

SIZE = 1000


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Ring, Ring]]:
    """Both ends of a small ring."""
    monkeypatch.setattr(bag_ring, "SIZE", SIZE)
    file = make_file()
    yield Ring(file), Ring(file)
    os.close(file)


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


def test_records_can_be_forgotten(ends: tuple[Ring, Ring]) -> None:
    """What was left of one recording is not in the next, whose records count from 0."""
    here, there = ends
    for k in range(3):
        here.put(0, k, 0, b"old")
    next(there.take())
    there.begin_anew()
    assert (list(there.take()), here.done) == ([], 0)
    here.put(1, 7, 0, b"new")
    assert list(there.take()) == [Record(1, 7, 0, b"new")]
    assert here.done == 1


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

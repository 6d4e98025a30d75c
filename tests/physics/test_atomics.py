"""Atomics: the order of reads and writes that other threads see, compiled and uncompiled."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np
import pytest

from finger_sim.physics.atomics import fence, load_acquire, store_release
from finger_sim.physics.compile import FASTMATH

ROUNDS = 20_000
TRIES = 30
APART = 16
"""Words of two cache lines."""


def publish(words: Any, k: int, value: int) -> int:
    """Writes a word, and reads it back."""
    store_release(words, k, value)
    fence()
    return load_acquire(words, k)


def meet(mine: Any, its: Any, seen: Any, waits: Any) -> None:
    """In each round: writes a word of its own, then reads the other's.

    A round begins when the other one's does, or soon, with a wait that lets now the one, now the other be first: a
    thread that has waited for another sees late that this one has come.
    """
    for k in range(ROUNDS):
        load_acquire(its, k * APART)
        store_release(mine, ROUNDS * APART, k)
        for _ in range(1000):
            if load_acquire(its, ROUNDS * APART) >= k:
                break
        for _ in range(waits[k]):
            load_acquire(seen, k)
        store_release(mine, k * APART, 1)
        fence()
        seen[k] = load_acquire(its, k * APART)


@pytest.mark.parametrize("words", [np.zeros(3, np.int64), memoryview(bytearray(24)).cast("q")])
def test_a_word_is_written_and_read(words: Any) -> None:
    """Uncompiled, in an array and in a memoryview."""
    assert publish(words, 1, -(2**62)) == -(2**62)
    assert list(words) == [0, -(2**62), 0]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="looks at compiled code")
def test_compiled_they_are_instructions_that_keep_the_order() -> None:
    """As any processor has them: on one that keeps most orders by itself, no run would show that they are missing."""
    function = numba.njit(fastmath=FASTMATH)(publish)
    words = np.zeros(3, np.int64)
    assert function(words, 1, -(2**62)) == -(2**62)
    assert list(words) == [0, -(2**62), 0]
    (code,) = function.inspect_llvm().values()
    for instruction in ("store atomic i64", "fence seq_cst", "load atomic i64"):
        assert instruction in code
    orders = [line.rpartition(", align")[0].split()[-1] for line in code.splitlines() if " atomic i64" in line]
    assert orders == ["release", "acquire"] * (len(orders) // 2)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="threads of the interpreter take turns")
def test_of_two_who_write_and_then_look_one_sees_the_other() -> None:
    """Two threads without the interpreter: without a fence a processor reads before others see what it wrote.

    Until they have run at the same time, as rounds show in which each saw the other; on a busy machine they may not.
    """
    function = numba.njit(nogil=True, fastmath=FASTMATH)(meet)
    seen, waits = np.zeros((2, ROUNDS), np.int64), np.random.default_rng(1).integers(0, 400, (2, ROUNDS))
    words = np.zeros((2, (ROUNDS + 1) * APART), np.int64)
    function(*words.copy(), seen[0], waits[0])
    with ThreadPoolExecutor(2) as threads:
        for _ in range(TRIES):
            words[:] = 0
            words[:, ROUNDS * APART] = -1
            list(threads.map(lambda i: function(words[i], words[1 - i], seen[i], waits[i]), range(2)))
            assert seen.any(axis=0).all()
            if seen.all(axis=0).sum() >= 10:
                break

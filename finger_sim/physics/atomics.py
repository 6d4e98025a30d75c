"""Memory that several threads or processes use at once: in which order each sees what the others write there.

A compiler and a processor may swap what one thread reads and writes, as long as that thread itself sees no difference.
Other threads do see one, unless the functions here keep the order. Compiled they are an instruction or two
(lowering.py). Below they are plain Python, for words of 64 bits in a NumPy array or a memoryview.
"""

from __future__ import annotations

import threading
from typing import Any


class _Held(threading.local):
    """A lock that each thread holds for itself."""

    def __init__(self) -> None:
        lock = threading.Lock()
        lock.acquire()
        self.release, self.acquire = lock.release, lock.acquire


_lock = _Held()


def fence() -> None:
    """All that this thread read and wrote before comes before all that it reads and writes later."""
    _lock.release()  # nothing from before moves down past this
    _lock.acquire()  # nothing from later moves up past this


def load_acquire(words: Any, k: int) -> int:
    """words[k]; all that this thread reads and writes later comes after that."""
    value = int(words[k])
    fence()
    return value


def store_release(words: Any, k: int, value: int) -> None:
    """words[k] = value; all that this thread read and wrote before comes before that."""
    fence()
    words[k] = value

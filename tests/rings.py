"""Memories with small rings."""

from __future__ import annotations

import os

from finger_sim.bags import recording
from finger_sim.bags.recording import Recording
from finger_sim.bags.ring import Memory, make_file

PLENTY = 2**40
"""A capacity that no test reaches."""


def shared(*sizes: int) -> tuple[Memory, Memory]:
    """A memory with rings of these sizes, as two processes have it."""
    file = make_file(sizes)
    try:
        return Memory(file), Memory(file)
    finally:
        os.close(file)


def begun(memory: Memory, topics: int = 3, capacity: int = PLENTY, zero: int = 0, since: int = 0) -> Recording:
    """A recording that takes messages of steady times from `since` on [ns]."""
    made = recording.build_recording(memory, topics, capacity, zero)
    recording.begin(made, since)
    return made

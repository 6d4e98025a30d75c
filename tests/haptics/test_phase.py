"""Deadlines that are moved to when commands come, against a sender and a loop of plain numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from finger_sim.haptics.phase import moved, no_phase

PERIOD = 1e-3
STEPS = 12_000


def followed(
    came: NDArray[np.float64], steps: int, interval: float = PERIOD, moves: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Of each step: how long its command waited [s], −1: none came; how many came for it; the move after it [s]."""
    phase, shift, newest = no_phase(PERIOD), 0.0, -1
    wait, count, by = np.full(steps, -1.0), np.zeros(steps, np.int64), np.zeros(steps)
    for k in range(steps):
        begins = shift + k * PERIOD
        before, newest = newest, int(np.searchsorted(came, begins, "right")) - 1
        count[k] = newest - before
        if count[k] > 0:
            wait[k] = begins - came[newest]
        by[k] = moved(phase, PERIOD, interval, wait[k])
        shift += by[k] if moves else 0.0
    return wait, count, by


def waits(interval: float, jitter: float, moves: bool = True) -> tuple[NDArray[np.float64], int, float]:
    """Of the commands of the last 4,000 steps [s], how many of these had none, and how far deadlines were moved [s]."""
    came = 0.3 * PERIOD + interval * np.arange(int(STEPS * PERIOD / interval) + 100)
    came = np.sort(came + np.abs(np.random.default_rng(0).normal(0.0, jitter, len(came))))
    wait, _, by = followed(came, STEPS, interval, moves)
    found = moves and abs(interval - PERIOD) < 1e-3 * PERIOD
    assert np.abs(by).max() <= PERIOD / 200.0
    assert np.abs(by[-4000:]).max() <= PERIOD / (500.0 if found else 200.0)
    last = wait[-4000:]
    return last[last >= 0.0], int((last < 0.0).sum()), float(by.sum()) if moves else 0.0


@pytest.mark.parametrize("interval", [PERIOD, 1.0003 * PERIOD, 0.9997 * PERIOD])
@pytest.mark.parametrize("jitter", [2e-5, 1e-4])
def test_commands_wait_no_longer_than_their_jitter_asks_for(interval: float, jitter: float) -> None:
    """Of a clock that is equal, slower or faster by 300 ppm; deadlines that stay have them wait up to a period."""
    wait, without, shift = waits(interval, jitter)
    assert np.median(wait) < 5e-5 + 2.5 * jitter
    assert np.percentile(wait, 99) < 1e-4 + 4.0 * jitter
    assert without < 0.01 * 4000
    drift = STEPS * (interval - PERIOD)
    assert shift == pytest.approx(drift, abs=PERIOD)
    if interval != PERIOD:
        stays, _, _ = waits(interval, jitter, moves=False)
        assert np.percentile(stays, 99) > 0.9 * PERIOD


@pytest.mark.parametrize("interval", [2.0 * PERIOD, 5.3 * PERIOD, 15.0 * PERIOD])
def test_slower_commands_move_nothing(interval: float) -> None:
    """Where most steps have no command of their own the grid stays where it is."""
    assert waits(interval, 1e-4)[2] == 0.0


@pytest.mark.parametrize("interval", [0.97 * PERIOD, 1.04 * PERIOD])
def test_another_rate_moves_them_to_and_fro(interval: float) -> None:
    """Real time is kept to 0.1 % where commands come at another rate than steps can follow."""
    assert abs(waits(interval, 5e-5)[2]) < 1e-3 * STEPS * PERIOD


def test_a_sender_that_begins_anew_is_found_soon() -> None:
    """Commands come half a period elsewhere from one step to the next: soon they wait about as little as before."""
    phase, shift, out = no_phase(PERIOD), 0.0, []
    random = np.random.default_rng(1)
    for k in range(2200):
        phase_of_it = 0.2 * PERIOD if k < 2000 else 0.7 * PERIOD
        wait = (shift - phase_of_it - abs(random.normal(0.0, 2e-5))) % PERIOD
        out.append(wait)
        shift += moved(phase, PERIOD, PERIOD, wait)
    assert np.median(out[1900:2000]) < 1.2e-4
    assert np.median(out[2120:]) < 1.6e-4


def test_a_whole_period_is_none() -> None:
    """A wait and the same with a period more move deadlines alike: to the nearer way."""
    for wait in (0.0, 2e-4, 5e-4, 9e-4):
        one, other = (no_phase(PERIOD) for _ in range(2))
        nearer, farther = moved(one, PERIOD, PERIOD, wait), moved(other, PERIOD, PERIOD, wait + PERIOD)
        assert nearer == pytest.approx(farther, abs=1e-15)


@pytest.mark.parametrize("seed", range(4))
def test_commands_that_come_just_as_steps_begin_are_found(seed: int) -> None:
    """Half of the steps have none then, and others two: their rate is that of steps all the same."""
    random = np.random.default_rng(seed)
    came = np.sort(PERIOD * np.arange(3000) + random.normal(0.0, 1e-4, 3000))
    _, count, _ = followed(came, 2900)
    assert np.count_nonzero(count[1:31] != 1) > 5
    assert np.count_nonzero(count[-1000:] != 1) < 150

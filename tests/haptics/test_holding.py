"""Commands that come as often as steps, unevenly: what `auto` makes of them, against the hand itself, and by force."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from cases import for_each
from numpy.typing import NDArray
from physics_helpers import pose
from scipy.spatial.transform import Rotation
from small_fingers import small

from finger_sim import Pose, Simulator
from finger_sim.haptics.following import Follower

MS = 0.001
SECONDS = 2.0
FLAT = Rotation.from_euler("x", 90, degrees=True)
Array = NDArray[np.float64]
Stream = list[tuple[float, Pose]]
"""Commands with the times of their receipt."""


def hand(t: float) -> Pose:
    """Sets off from rest and draws loops at up to 0.3 m/s."""
    s = 1.0 - np.exp(-((t / 0.3) ** 2))
    x, y, z = (a * s * np.sin(2 * np.pi * f * t) for a, f in ((0.04, 0.9), (0.025, 1.3), (0.01, 1.1)))
    return pose((x, y, 0.1 + z), FLAT)


def stream(kind: str, late: bool = False, path: Callable[[float], Pose] = hand) -> Stream:
    """A thousand a second: sampled when they come, or evenly and only late on their way (`late`).

    even; jitter: up to half a millisecond late; hiccups: so, and every 0.15 to 0.4 s nothing for 6 ms, then all at
    once; skips: so late that one step in about thirty has none, and the next one two; bursts: five at a time.
    """
    random = np.random.default_rng(3)
    sampled = np.arange(int(1000 * SECONDS) + 100) * MS
    n, received = len(sampled), sampled.copy()
    if kind in ("jitter", "hiccups"):
        received[1:] += 0.5 * MS * random.random(n - 1)
    if kind == "skips":
        received[1:] += 0.3 * MS * random.exponential(size=n - 1)
    if kind == "hiccups":
        k = 100
        while k < n:
            received[k : k + 6] = np.maximum(received[k : k + 6], received[k] + 5 * MS)
            k += int(random.integers(150, 400))
    if kind == "bursts":
        received = sampled[np.minimum(5 * (np.arange(n) // 5) + 4, n - 1)]
    received = np.maximum.accumulate(received)
    return [(float(r), path(float(s if late else r))) for s, r in zip(sampled, received, strict=True)]


def positions(commands: Stream, begins: Array | None = None) -> tuple[Array, Array]:
    """(n, 3) of the bone after each step [m], and (n,) whether it is held then."""
    follower, waiting, out, holds = Follower(commands[0][1]), list(commands), [], []
    for now in np.arange(round(SECONDS / MS)) * MS if begins is None else begins:
        while waiting and waiting[0][0] <= now + 1e-12:
            received, command = waiting.pop(0)
            follower.hear(command, received)
        out.append(follower.advance("auto", float(now), MS).position)
        holds.append(follower.mode("auto") == "hold")
    return np.array(out), np.array(holds)


def behind(path: Array, begin: int) -> float:
    """By how much a path is best shifted to lie on the hand's, which is reached a step after it was there [s]."""
    lags = np.arange(0.0, 0.015, 1e-4)
    steps = np.arange(begin, len(path))
    off = []
    for lag in lags:
        true = np.array([hand(max(k * MS - lag, 0.0)).position for k in steps])
        off.append(np.abs(path[begin:] - true).sum())
    return float(lags[np.argmin(off)])


@for_each("kind", ["jitter", "skips", "hiccups"])
def test_commands_as_often_as_steps_are_held(kind: str) -> None:
    """However uneven: at no time is the bone led along a path, and it is a step late at most, as far as hands tell."""
    for late in (False, True):
        path, holds = positions(stream(kind, late))
        assert holds[20:].all()
        assert behind(path, 300) <= 1.1 * MS + (0.5 * MS if late else 0.0)


def test_commands_that_come_at_once_or_seldom_are_led() -> None:
    """Five at a time, and every second one: a path, after less than a tenth of a second."""
    for commands in (stream("bursts"), stream("even")[::2]):
        _, holds = positions(commands)
        assert not holds[100:].any()


def test_a_change_of_rate_is_followed() -> None:
    """From 1 kHz to 200 Hz and back: led in between, held in the end."""
    even = stream("even")
    commands = even[:600] + even[600:1100:5] + even[1100:]
    _, holds = positions(commands)
    assert holds[100:600].all()
    assert not holds[650:1100].any()
    assert holds[1500:].all()


def test_a_hiccup_delays_for_some_hundredths_of_a_second() -> None:
    """Nothing for 7 ms of even commands, then all: the bone goes half as fast again at most till it is there."""
    held_up = [(1.007 if 1.0 <= r < 1.007 else r, p) for r, p in stream("even", path=lambda t: pose((0.2 * t, 0, 0)))]
    path, holds = positions(held_up)
    x = path[:, 0]
    true = 0.2 * MS * np.arange(len(x))
    assert holds[20:].all()
    assert true[1007] - x[1007] > 0.2 * 5 * MS
    assert np.diff(x)[100:].max() < 1.6 * 0.2 * MS
    assert np.diff(x).min() >= 0.0
    np.testing.assert_allclose(x[1060:], true[1060:], atol=0.2 * 0.5 * MS)


@for_each("skipped", [1, 2, 30])
def test_skipped_steps_are_made_up_for_without_haste(skipped: int) -> None:
    """A loop that misses deadlines: no step goes half as far again as the hand, and the bone is there soon."""
    commands = stream("even", path=lambda t: pose((0.2 * t, 0, 0)))
    begins = np.arange(1700) * MS
    begins[1000:] += skipped * MS
    path, _ = positions(commands, begins)
    assert np.diff(path[100:, 0]).max() < 1.5 * 0.2 * MS
    after = 1000 + (20 if skipped < 3 else 400)
    np.testing.assert_allclose(path[after:, 0], 0.2 * begins[after:], atol=0.2 * 0.5 * MS)


@cache
def kicks(kind: str, late: bool, following: str, presses: bool = False) -> float:
    """Largest change of a device's force in a step [N]: in free air, or of a press by 3 mm a second."""
    sim = Simulator(small("finger_coupled").with_values({"coupling.following": following}))
    commands = stream(kind, late, press if presses else hand)
    sim.reset(commands[0][1])
    forces = []
    for k in range(round(SECONDS / MS)):
        while commands[0][0] <= k * MS + 1e-12:
            received, command = commands.pop(0)
            sim.hear(command, received)
        forces.append(sim.step(now=k * MS).device_wrench[:3])
    return float(np.linalg.norm(np.diff(forces, axis=0), axis=1).max())


def press(t: float) -> Pose:
    """Down by 3 mm from right above the plane, once a second."""
    return pose((0.0, 0.0, 0.0075 - 0.0015 * (1.0 - np.cos(2 * np.pi * t))), FLAT)


@for_each("late", [False, True])
def test_uneven_commands_do_not_kick_in_free_air(late: bool) -> None:
    """What `hold` makes of jitter is gone; of a hiccup at 0.3 m/s at most a third of its kick is left."""
    assert kicks("jitter", late, "auto") < 0.05
    assert kicks("skips", late, "auto") < 0.3 < 0.5 * kicks("skips", late, "hold")
    assert kicks("hiccups", late, "auto") < min(0.4, kicks("hiccups", late, "hold") / 3.0)


@for_each("late", [False, True])
def test_uneven_commands_do_not_kick_in_a_press(late: bool) -> None:
    """No change above three times that of even commands, with hiccups; `hold` makes eight times as much of them."""
    even = kicks("even", False, "hold", presses=True)
    assert kicks("jitter", late, "auto", presses=True) < 1.5 * even
    assert kicks("hiccups", late, "auto", presses=True) < 3.0 * even
    assert kicks("hiccups", late, "hold", presses=True) > 5.0 * even


def test_commands_of_one_time_and_of_a_jump_give_no_speed_beyond_the_limit() -> None:
    """Two commands at once after a rest, and one that is 1 cm away: the damper feels no more than max_speed."""
    sim = Simulator(small("finger_coupled"))
    sim.reset(pose((0, 0, 0.1), FLAT))
    for k in range(120):
        if k == 30 or k > 60:
            sim.hear(pose((1e-5 * k, 0, 0.1), FLAT), k * MS)
            sim.hear(pose((1e-5 * k + 2e-3 * (k > 80), 0, 0.1), FLAT), k * MS)
        sim.step(now=k * MS)
        assert np.linalg.norm(sim._state.target[7:10]) <= sim.scene.coupling.max_speed * (1.0 + 1e-9)


def test_the_speed_of_a_sender_that_falls_silent_ends() -> None:
    """As fast for some steps, then slower and slower, never at once; after 20 ms the bone is at rest."""
    sim, speeds = Simulator(small("finger_coupled")), []
    sim.reset(pose((0, 0, 0.1), FLAT))
    for k in range(100):
        if k < 60:
            sim.hear(pose((2e-4 * k, 0, 0.1), FLAT), k * MS)
        sim.step(now=k * MS)
        speeds.append(sim._state.target[7])
    assert speeds[30:67] == pytest.approx([0.2] * 37)
    assert np.abs(np.diff(speeds[40:])).max() < 0.2 / 7.0
    assert speeds[80:] == [0.0] * 20

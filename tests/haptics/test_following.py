"""Commands that come when they come: the path through them, against paths made with NumPy and SciPy."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from cases import for_each
from numpy.typing import NDArray
from physics_helpers import pose
from scipy.spatial.transform import Rotation, Slerp
from small_fingers import small

from finger_sim import Pose, SceneError, Simulator
from finger_sim.haptics.following import HEARD, LONGEST_WINDOW, Follower, Following
from finger_sim.haptics.path import KNOTS

MS = 0.001
FLAT = Rotation.from_euler("x", 90, degrees=True)
Array = NDArray[np.float64]
Stream = list[tuple[float, Pose]]
"""Commands with the times of their receipt."""


def hand(t: float) -> Pose:
    """A hand that sets off from rest and draws loops at up to 0.3 m/s and 10 m/s², turning by ±10 degrees."""
    s = 1.0 - np.exp(-((t / 0.3) ** 2))
    x, y, z = (a * s * np.sin(2 * np.pi * f * t) for a, f in ((0.04, 0.9), (0.025, 1.3), (0.01, 1.1)))
    return pose((x, y, 0.1 + z), Rotation.from_rotvec([0, 0, 0.17 * s * np.sin(4.4 * t)]) * FLAT)


def stream(
    rate: float, jitter: float, seconds: float, *, late: bool = False, path: Callable[[float], Pose] = hand
) -> Stream:
    """Of so many a second, each up to `jitter` of an interval later: sampled later, or only on its way (`late`)."""
    random = np.random.default_rng(7)
    sampled = np.arange(int(rate * seconds)) / rate
    received = sampled + jitter / rate * random.random(len(sampled)) * (sampled > 0.0)
    return [(float(r), path(float(s if late else r))) for s, r in zip(sampled, received, strict=True)]


def followed(commands: Stream, following: Following, seconds: float, begins: Array | None = None) -> Iterator[Follower]:
    """A follower after each step; steps begin every millisecond, or when it is said."""
    follower, waiting = Follower(commands[0][1]), list(commands)
    for now in np.arange(round(seconds / MS)) * MS if begins is None else begins:
        while waiting and waiting[0][0] <= now + 1e-12:
            received, command = waiting.pop(0)
            follower.hear(command, received)
        follower.advance(following, float(now), MS)
        yield follower


def positions(commands: Stream, following: Following, seconds: float, begins: Array | None = None) -> Array:
    """(n, 3) where the bone is wanted at the end of each step [m]."""
    return np.array([follower.pose.position for follower in followed(commands, following, seconds, begins)])


def jerk(path: Array) -> float:
    """Largest change of the velocity of a path from one step to the next [m/s]."""
    return float(np.linalg.norm(np.diff(path, 2, axis=0), axis=1).max() / MS)


def test_a_command_for_every_step_is_followed_at_once() -> None:
    """The very pose, in every mode that does not predict: nothing is waited for, and nothing computed."""
    commands = [(k * MS, hand(k * MS)) for k in range(200)]
    for following in ("auto", "hold", "linear"):
        for k, follower in enumerate(followed(commands, following, 0.2)):  # type: ignore[arg-type]
            assert follower.pose == commands[k][1]
            assert follower.delay(following) == 0.0  # type: ignore[arg-type]
        assert follower.mode("auto") == "hold"


@for_each("rate", [20.0, 50.0, 200.0])
def test_even_commands_are_joined_by_straight_lines(rate: float) -> None:
    """One interval late, corners taken off by a mean over the window; turns as SciPy's Slerp, with sign flips."""
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.02 * k * k % 2.0] for k in range(40)])
    at = np.random.default_rng(1).normal(size=(40, 3)) * 0.01
    commands = [
        (k / rate, Pose(tuple(at[k]), tuple((-1) ** k * turns[k].as_quat())))  # type: ignore[arg-type]
        for k in range(40)
    ]
    window = min(1.0 / rate - MS, LONGEST_WINDOW)
    times = np.arange(40) / rate
    for k, follower in enumerate(followed(commands, "linear", 39 / rate)):
        end = (k + 1) * MS - 1.0 / rate
        if end - window < 0.0 or k < 60 or k % 7:
            continue
        assert follower.delay("linear") == pytest.approx(1.0 / rate - MS + 0.5 * window, abs=1e-6)
        fine = np.linspace(end - window, end, 2001)
        mean = np.array([np.interp(fine, times, at[:, c]).mean() for c in range(3)])
        np.testing.assert_allclose(follower.pose.position, mean, atol=5e-6)
        turn = Slerp(times, turns)(fine).mean()
        assert (turn.inv() * Rotation.from_quat(follower.pose.orientation)).magnitude() < 5e-3


@for_each("late", [False, True])
@for_each("jitter", [0.0, 0.2, 0.5])
@for_each("rate", [20.0, 66.0, 250.0, 500.0])
def test_a_smooth_hand_is_followed_smoothly(rate: float, jitter: float, late: bool) -> None:
    """However its poses come: 3 N s/m of a coupling feel no change of 0.05 N in a step, 0.1 N at 20 Hz."""
    commands = stream(rate, jitter, 3.0, late=late)
    path = positions(commands, "auto", 2.8)
    assert 3.0 * jerk(path) < (0.05 if rate > 60.0 else 0.1)
    true = np.array([hand(k * MS).position for k in range(-150, len(path))])
    behind = min(np.linalg.norm(path[500:] - true[650 - lag : len(true) - lag], axis=1).max() for lag in range(120))
    assert behind < 2e-4 + 0.1 / rate
    if rate < 500.0 and jitter == 0.2 and late:
        assert 3.0 * jerk(positions(commands, "hold", 2.8)) > 0.3


def test_the_delay_is_no_longer_than_commands_make_it() -> None:
    """Of even ones one interval and half the window, of uneven ones the longest interval; none for one a step."""
    for rate, jitter, least, most in (
        (20.0, 0.0, 0.061, 0.062), (66.0, 0.0, 0.021, 0.023), (500.0, 0.0, 0.0014, 0.0016),
        (66.0, 0.5, 0.021, 0.036), (1000.0, 0.5, 0.0005, 0.001), (1000.0, 0.0, 0.0, 0.0),
    ):  # fmt: skip
        *_, follower = followed(stream(rate, jitter, 2.1), "auto", 2.0)
        assert least <= follower.delay("auto") <= most, (rate, jitter)


def test_bursts_and_lost_commands_make_no_kick() -> None:
    """Of a regular sampling that arrives four at a time; and one of ten that does not arrive."""
    even = stream(66.0, 0.0, 4.0)
    bursts = [(even[min(4 * (k // 4) + 3, len(even) - 1)][0], command) for k, (_, command) in enumerate(even)]
    some = [item for k, item in enumerate(even) if k % 10 != 7]
    for commands in (bursts, some):
        assert 3.0 * jerk(positions(commands, "auto", 3.8)[700:]) < 0.05


def test_a_pause_ends_in_rest_and_resuming_ramps() -> None:
    """At the last pose itself, without overshoot; then on to a hand that has gone 5 cm elsewhere."""
    first = stream(66.0, 0.2, 1.0, path=lambda t: pose((0.1 * t, 0, 0)))
    then = [(2.0 + r, pose((0.25 + 0.1 * r, 0, 0))) for r, _ in stream(66.0, 0.2, 1.0)]
    for following in ("auto", "linear", "predict"):
        path = positions(first + then, following, 2.9)  # type: ignore[arg-type]
        rest = first[-1][1].position[0]
        assert path[1300:2000, 0] == pytest.approx(np.full(700, rest), abs=1e-12)
        if following != "predict":
            assert path[:2000, 0].max() <= rest
        assert np.diff(path[:, 0]).max() < 1.8 * MS  # 15 cm in a tenth of a second
        assert path[-1, 0] == pytest.approx(0.25 + 0.1 * 0.9, abs=4e-3)


@for_each("rate", [1000.0, 66.0])
def test_skipped_steps_do_not_merge_commands(rate: float) -> None:
    """Thirty steps are skipped: the bone catches up with the hand a little faster than it, not in one jump."""
    commands = [(r, pose((0.2 * r, 0, 0))) for r, _ in stream(rate, 0.0, 3.0)]
    begins = np.arange(2000) * MS
    begins[1000:] += 30 * MS
    for following in ("auto", "linear", "hold"):
        if following == "hold" and rate < 1000.0:
            continue
        path = positions(commands, following, 0.0, begins)[:, 0]  # type: ignore[arg-type]
        steps = np.diff(path)[100:]
        assert steps.max() < 1.5 * 0.2 * MS, following
        *_, follower = followed(commands, following, 0.0, begins)  # type: ignore[arg-type]
        assert path[-1] == pytest.approx(0.2 * (begins[-1] - follower.delay(following)), abs=2e-4)  # type: ignore[arg-type]


@for_each("rate", [1000.0, 66.0])
def test_a_loop_at_half_its_rate_goes_as_fast_as_the_hand(rate: float) -> None:
    """Each step of 1 ms takes 2 ms: the bone makes twice the way in a step, evenly, some tenths of a second late."""
    commands = [(r, pose((0.2 * r, 0, 0))) for r, _ in stream(rate, 0.0, 4.2)]
    begins = np.arange(2000) * 2 * MS
    path = positions(commands, "auto", 0.0, begins)[:, 0]
    steps = np.diff(path)
    assert steps.max() < 2.4 * 0.2 * MS
    assert steps[1000:] == pytest.approx(np.full(999, 2.0 * 0.2 * MS), rel=0.1)
    assert 0.2 * begins[-1] - path[-1] < 0.2 * 0.25


def test_prediction_is_where_the_hand_is() -> None:
    """A hand at an even speed is predicted without delay, a stopped one not for longer than it took until now."""
    commands = [(r, pose((0.1 * r, 0, 0))) for r, _ in stream(50.0, 0.0, 1.0)]
    path = positions(commands, "predict", 1.5)[:, 0]
    ends = np.arange(1, 1501) * MS
    np.testing.assert_allclose(path[500:980], 0.1 * ends[500:980], atol=1e-6)
    assert path.max() < commands[-1][1].position[0] + 0.1 * 1.6 * 0.02
    assert path[-1] == commands[-1][1].position[0]


def test_the_time_of_a_command_is_what_makes_the_hand_smooth() -> None:
    """Even where only the way here was uneven, that of receipt where the hand was sampled unevenly."""
    for late in (False, True):
        commands = stream(66.0, 0.5, 4.0, late=late)
        cadences = [f.cadence for f in followed(commands, "linear", 3.99)]
        times = {c.received: c.time for c in cadences if c is not None}
        received, meant = np.array([*times.items()]).T
        off_even = np.ptp((meant - np.arange(len(times)) / 66.0)[100:])
        off_receipt = np.abs(meant - received)[100:].max()
        cadence = cadences[-1]
        assert cadence is not None
        assert (off_even < 0.004) == late
        assert (off_receipt < 0.001) != late
        assert cadence.interval == pytest.approx(1 / 66.0, rel=0.03)
        assert 0.0005 < cadence.jitter < 0.005


def wrenches(commands: Stream, following: Following, seconds: float) -> tuple[Array, Array]:
    """(n, 3) force on the device and of the plane, of `finger_coupled` [N]."""
    sim = Simulator(small("finger_coupled").with_values({"coupling.following": following}))
    sim.reset(commands[0][1])
    waiting, device, contact = list(commands), [], []
    for k in range(round(seconds / MS)):
        while waiting and waiting[0][0] <= k * MS + 1e-12:
            received, command = waiting.pop(0)
            sim.hear(command, received)
        out = sim.step(now=k * MS)
        device.append(out.device_wrench[:3])
        contact.append(out.contact_wrench[:3])
    return np.array(device), np.array(contact)


def largest_change(forces: Array) -> float:
    return float(np.linalg.norm(np.diff(forces, axis=0), axis=1).max())


@for_each("rate", [20.0, 66.0])
def test_a_coupled_finger_in_free_air_is_not_kicked(rate: float) -> None:
    smooth, _ = wrenches(stream(1000.0, 0.0, 2.0), "auto", 1.9)
    device, _ = wrenches(stream(rate, 0.2, 2.0), "auto", 1.9)
    assert np.linalg.norm(device, axis=1).max() < np.linalg.norm(smooth, axis=1).max() + 0.1
    assert largest_change(device) < (0.05 if rate > 60.0 else 0.1)


def press(t: float) -> Pose:
    """Down by 3 mm from right above the plane, twice."""
    return pose((0.0, 0.0, 0.0075 - 0.0015 * (1.0 - np.cos(2 * np.pi * t))), FLAT)


def test_a_coupled_finger_pressed_is_not_kicked() -> None:
    """No change above twice that of the same press at 1 kHz; held, it is fifty times as much."""
    smooth, contact = wrenches(stream(1000.0, 0.0, 2.0, path=press), "auto", 1.9)
    assert np.linalg.norm(contact, axis=1).max() > 1.0
    commands = stream(66.0, 0.2, 2.0, path=press)
    device, pressed = wrenches(commands, "auto", 1.9)
    assert largest_change(device) < 2.0 * largest_change(smooth)
    assert np.linalg.norm(pressed, axis=1).max() == pytest.approx(np.linalg.norm(contact, axis=1).max(), rel=0.02)
    assert largest_change(wrenches(commands, "hold", 1.9)[0]) > 10.0 * largest_change(smooth)


@for_each("scene", ["finger_haptic", "finger_coupled"])
def test_a_start_inside_the_plane_is_no_blow(scene: str) -> None:
    """2.2 mm deep: put on the plane, and there in a tenth of a second; then what it is after a slow press."""
    sim = Simulator(small(scene))
    deep = pose((0.0, 0.0, 0.0051), FLAT)
    sim.reset(deep)
    assert sim.set_down_by == pytest.approx(2.24e-3, abs=0.1e-3)
    forces = np.array([sim.step(deep).contact_wrench[:3] for _ in range(1000)])
    assert np.linalg.norm(forces[:2], axis=1).max() < 0.01
    assert largest_change(forces) < 0.06 * forces[-1, 2]
    assert sim.follower.pose == deep
    sim.reset(pose((0.0, 0.0, 0.0080), FLAT))
    assert sim.set_down_by == 0.0
    for height in np.arange(0.0080, 0.0051, -2e-5):
        sim.step(pose((0.0, 0.0, height), FLAT))
    slowly = [sim.step(deep).contact_wrench[2] for _ in range(500)][-1]
    assert forces[-1, 2] == pytest.approx(slowly, rel=0.03)


@for_each("following", ["hold", "predict"])
def test_a_reset_inside_the_plane_goes_on_to_its_command(following: Following) -> None:
    """Without another command, in every mode: there in three tenths of a second at most, and no faster than in one."""
    sim = Simulator(small("finger_coupled").with_values({"coupling.following": following}))
    deep = pose((0.0, 0.0, 0.0051), FLAT)
    sim.reset(deep)
    heights = [deep.position[2] + sim.set_down_by]
    for _ in range(300):
        sim.step()
        heights.append(sim.follower.pose.position[2])
    assert heights[-1] == pytest.approx(deep.position[2], abs=1e-6)
    assert -np.diff(heights).min() < 2.0 * sim.set_down_by / 0.1 * MS


def test_a_clock_that_is_set_ends_no_following() -> None:
    """Back or forth, by an hour or by half a second: some tenths of a second later all is as it was before."""
    for following in ("auto", "predict"):
        for ahead in (-3600.0, -3.0, -0.5, 3.0):
            follower, path = Follower(pose()), []
            for k in range(2000):
                now = k * MS + (ahead if k >= 1000 else 0.0)
                if k % 15 == 0:
                    follower.hear(pose((0.1 * k * MS, 0.0, 0.0)), now)
                path.append(follower.advance(following, now, MS).position[0])  # type: ignore[arg-type]
            assert follower.delay(following) < 0.025, (following, ahead)  # type: ignore[arg-type]
            assert np.abs(np.diff(path)).max() < 3.0 * 0.1 * MS, (following, ahead)
            assert path[1400:] == pytest.approx(0.1 * MS * np.arange(1400, 2000), abs=0.1 * 0.03), (following, ahead)


def test_a_bone_at_rest_is_held_at_rest() -> None:
    """Held, led along a path to its end, and held again: nothing is left of the speed that it had when held first."""
    sim = Simulator(small("finger_coupled").with_values({"coupling.following": "hold"}))
    sim.reset(pose((0.0, 0.0, 0.05), FLAT))
    for _ in range(15):
        sim.step()
    sim.step(pose((0.002, 0.0, 0.05), FLAT))
    for following in ("linear", "hold"):
        sim.apply({"coupling.following": following})
        forces = [np.linalg.norm(sim.step().device_wrench[:3]) for _ in range(500)]
    assert max(forces) < 1e-6


def test_a_time_that_is_none_is_refused() -> None:
    """By name, and as if it had not been tried."""
    sim = Simulator(small("finger_coupled"))
    for bad in (np.nan, np.inf):
        with pytest.raises(SceneError, match=f"received: got {bad}, allowed: a finite time"):
            sim.hear(pose((0.0, 0.0, 0.2), FLAT), bad)
        with pytest.raises(SceneError, match=f"now: got {bad}, allowed: a finite time"):
            sim.step(pose((0.0, 0.0, 0.2), FLAT), now=bad)
    assert sim.time == 0.0
    assert sim.step(now=0.0).pose == Simulator(sim.scene).step(now=0.0).pose


def test_modes_change_in_motion_without_a_jump() -> None:
    """Between path and prediction, at any time: on from where the bone is, as fast as it is."""
    for modes in (("linear", "predict"), ("predict", "auto"), ("hold", "predict"), ("auto", "linear")):
        commands, path = stream(66.0, 0.2, 2.0), []
        follower = Follower(commands[0][1])
        for k in range(1800):
            while commands and commands[0][0] <= k * MS + 1e-12:
                received, command = commands.pop(0)
                follower.hear(command, received)
            path.append(follower.advance(modes[k >= 1000], k * MS, MS).position)  # type: ignore[arg-type]
        begin = 990 if modes[0] != "hold" else 1001
        assert 3.0 * jerk(np.array(path[begin:])) < (0.15 if "predict" in modes else 0.05), modes


def test_whatever_comes_the_bone_stays_between_the_commands_and_comes_to_rest() -> None:
    """Commands at 5 Hz to 5 kHz jump and turn at random, come in bursts, out of order, from the future; clocks jump.

    Finite, within the box of all that was heard, few knots are kept, and at the very last in the end.
    """
    for seed in range(24):
        random = np.random.default_rng(seed)
        dt, following = float(random.choice([1e-4, 1e-3, 4e-3])), ("auto", "linear", "hold", "predict")[seed % 4]
        follower, rate, now = Follower(pose()), 10 ** random.uniform(0.7, 3.7), random.uniform(0.0, 1e6)
        heard, due = [pose()], now
        for k in range(500):
            now += dt + (random.uniform(-0.05, 0.3) if random.random() < 0.01 else 0.0)
            while due <= now and k < 400:
                turn = Rotation.from_rotvec(random.normal(size=3))
                heard.append(pose(random.uniform(-0.1, 0.1, 3), turn) if random.random() < 0.3 else heard[-1])
                follower.hear(heard[-1], due + random.choice([0.0, 0.0, -0.002, 0.001]))
                due += random.choice([0.0, 1.0, 1.0, 1.5]) / rate + (0.4 if random.random() < 0.02 else 0.0)
            out = follower.advance(following, now, dt)  # type: ignore[arg-type]
            assert np.linalg.norm(out.orientation) == pytest.approx(1.0, abs=1e-12)
            box = np.array([command.position for command in heard])
            if following != "predict":
                assert (out.position >= box.min(axis=0) - 1e-12).all()
                assert (out.position <= box.max(axis=0) + 1e-12).all()
            assert 0.0 <= follower.delay(following) < 1.0  # type: ignore[arg-type]
            first, after = follower.course.path.kept
            assert after - first < 3000
        for _ in range(round(3.0 / dt) if following == "predict" else round(1.5 / dt)):
            now += dt
            out = follower.advance(following, now, dt)  # type: ignore[arg-type]
        assert out == heard[-1], (seed, following)


def test_more_commands_than_are_kept_are_followed_all_the_same() -> None:
    """Ten times as many knots in a second as a path holds, and a step that hears more commands than are kept.

    Finite, between the commands, without a jump, and at the very last in the end.
    """
    follower, last = Follower(pose()), pose()
    follower.advance("linear", 0.0, MS)
    path = []
    for k in range(400):
        for i in range(40):
            along = (k + i / 40) * MS
            last = pose((0.1 * along, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, 3.0 * (i % 2)]))
            follower.hear(last, along if k % 100 else along - 0.05)
        path.append(follower.advance("linear", k * MS, MS))
        first, after = follower.course.path.kept
        assert after - first <= KNOTS
    x = np.array([p.position[0] for p in path])
    assert (x >= 0.0).all()
    assert (x <= last.position[0]).all()
    assert np.diff(x).max() < 5e-3
    assert np.isfinite([p.orientation for p in path]).all()
    for k in range(HEARD + 1000):
        last = pose((0.04 + 1e-6 * k, 0.0, 0.0))
        follower.hear(last, 0.4)
    for k in range(400, 1000):
        out = follower.advance("linear", k * MS, MS)
    assert out == last

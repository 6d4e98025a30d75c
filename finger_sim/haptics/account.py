"""The account of a port and its controller (passivity.py), in compiled code."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..physics.compile import kernel, stage
from ..physics.records import side_by_side
from .coupling import finite, part_within

MOST_PERIODS = 1000
"""Periods of delay that are followed; a longer delay counts as this. At 1 kHz that is 1 s, as long as a command's
transport is believed."""
LET_GO = 4.0
"""Leak in allowances from which not even damping is sent. The wrench is scaled to nothing at one; a damper behind a
delay may leak itself, has two more for that in full, and fades out over the last."""
QUIET = 5e-3
"""Speed of a device at rest [m/s]: that of a hand that holds still and trembles by 0.1 mm at 8 Hz."""
QUIET_TIME = 0.02
"""Time beyond a loop delay without any faster speed until a leak is forgiven [s]. A device that swings is so slow too
where it turns round, but shorter: 2.5 ms for 1 mm at 10 Hz."""
FORGIVING = 0.5
"""Time in which the leak, or an allowance if that is more, is forgiven at rest [s]: a press of 5 N comes back by
10 mN a millisecond, which is not felt as a step."""
LETTING = 0.1
"""Time in which an allowance is forgiven of a leak from which nothing is sent [s]: in motion nothing else ends that.
For 10 mJ it is 0.1 W, which 0.8 N s/m of device and hand dissipate at 0.35 m/s."""
BRAKED = 0.25
"""Share of the device's momentum against a wrench that the wrench may take before the next is there: a device of a
quarter of the assumed mass is then stopped, and still not turned round."""
FORGETTING = 0.5
"""Time constant with which energy received is forgotten where no elastic body can hold it [s]: long beside a loop
delay, whose energy is still to come back, and shorter than from one touch to the next."""
DAMPED = math.exp(-1.0)
"""Largest damping · delay / mass with which a delayed damper stops a free mass without swinging: m v'(t) = −b v(t − d)
has a real decay as long as b d / m ≤ 1/e."""
AHEAD = 1.5
"""Intervals of commands from the middle of the motion that was seen last until the next wrench is there."""
_ROWS = MOST_PERIODS + 2


class Account(NamedTuple):
    """A Port, for compiled code: its numbers of these names, (1,) each, and

    now      : number of the next step
    moved    : of the step at which the device was last not at rest
    pushed   : of the step at which it was last not in free air
    interval : steps between the last two commands
    since    : steps since the last one
    velocity : (6,) of the commanded point between the last two commands [m/s, rad/s]
    away     : (6,) how far it has moved since it was last in free air [m, rad]
    damper   : (6,) the damper's part of the last wrench [N, N m]
    sums     : (MOST_PERIODS + 2, 12) sum of all wrenches before a step, and of all dampers' parts, in the row of the
               step's number modulo their count
    until    : step, and part of one, up to which these have met the motion that they caused
    met      : (12,) their sums up to there
    """

    period: Floats
    controlled: Floats
    allowance: Floats
    max_damping: Floats
    mass: Floats
    lever: Floats
    force_limit: Floats
    torque_limit: Floats
    energy: Floats
    leak: Floats
    leaked: Floats
    dissipated: Floats
    forgiven: Floats
    factor: Floats
    damping: Floats
    now: Floats
    moved: Floats
    pushed: Floats
    interval: Floats
    since: Floats
    velocity: Floats
    away: Floats
    damper: Floats
    until: Floats
    met: Floats
    sums: Floats


def build_account() -> Account:
    """As after `reset`, but for the settings, which are 0."""
    fields: dict[str, Any] = {**side_by_side(Account, velocity=6, away=6, damper=6, met=12, sums=0)}
    account = Account(**fields | {"sums": np.zeros((_ROWS, 12))})
    account.factor[0] = account.interval[0] = 1.0
    return account


@kernel
def reset(account: Account) -> None:
    """`Port.reset`."""
    account.energy[0] = account.leak[0] = account.leaked[0] = account.dissipated[0] = account.forgiven[0] = 0.0
    account.damping[0] = account.now[0] = account.moved[0] = account.pushed[0] = account.since[0] = 0.0
    account.factor[0] = account.interval[0] = 1.0
    account.until[0] = 0.0
    for i in range(6):
        account.velocity[i] = account.away[i] = account.damper[i] = 0.0
    for i in range(12):
        account.met[i] = 0.0
        for row in range(_ROWS):
            account.sums[row, i] = 0.0


@kernel
def step(account: Account, wrench: Floats, motion: Floats, delay: float, fresh: bool, out: Floats) -> None:
    """`Port.step` into `out`, which may be `wrench`."""
    delay, sound = max(0.0, delay), finite(wrench)
    lag = min(delay / account.period[0], float(MOST_PERIODS))
    for i in range(6):
        out[i], account.damper[i] = wrench[i] if sound else 0.0, 0.0
    account.since[0] += 1.0
    if fresh and finite(motion):
        _see(account, motion)
        _meet(account, motion, account.now[0] - lag)
    _forget(account, out, lag)
    account.leaked[0] = max(account.leaked[0], account.leak[0])
    if account.controlled[0] != 0.0:
        _control(account, delay, out)
    now = int(account.now[0])
    before, after = account.sums[now % _ROWS], account.sums[(now + 1) % _ROWS]
    for i in range(6):
        after[i] = before[i] + out[i]
        after[6 + i] = before[6 + i] + account.damper[i]
    account.now[0] = now + 1.0


@stage
def _see(account: Account, motion: Floats) -> None:
    """How the device moved since the last command."""
    account.interval[0], account.since[0] = account.since[0], 0.0
    rate = 1.0 / (account.interval[0] * account.period[0])
    square = 0.0
    for i in range(6):
        account.velocity[i] = motion[i] * rate
        account.away[i] += motion[i]
        square += (account.velocity[i] * (1.0 if i < 3 else account.lever[0])) ** 2
    if square > QUIET * QUIET:
        account.moved[0] = account.now[0]


@stage
def _meet(account: Account, motion: Floats, until: float) -> None:
    """The work of the wrenches held during a motion: those since the last call up to step `until`, in equal shares of
    the motion; of one when `until` did not move on."""
    last = math.ceil(until) - 1
    share, span = until - last, until - account.until[0]
    before, after = account.sums[last % _ROWS], account.sums[(last + 1) % _ROWS]
    work = dissipated = 0.0
    for i in range(12):
        mean = after[i] - before[i]
        if span > 0.0:
            there = before[i] + share * mean
            mean = (there - account.met[i]) / span
            account.met[i] = there
        if i < 6:
            work += mean * motion[i]
        else:
            dissipated -= mean * motion[i - 6]
    account.until[0] = max(account.until[0], until)
    account.energy[0] += work
    account.leak[0] += work
    account.dissipated[0] += dissipated


@stage
def _forget(account: Account, wrench: Floats, lag: float) -> None:
    """Of the account what rest, free air and the store of an elastic body leave out."""
    now, leak, allowance = account.now[0], account.leak[0], account.allowance[0]
    period, interval = account.period[0], account.interval[0]
    held = 0.0
    for i in range(6):
        held += wrench[i] * account.away[i]
        if wrench[i] != 0.0:
            account.pushed[0] = now
    if leak > 0.0:
        forgiven = 0.0
        if account.since[0] == 0.0 and now - account.moved[0] > lag + interval + QUIET_TIME / period:
            forgiven = min(leak, max(leak, allowance) * min(1.0, interval * period / FORGIVING))
        elif account.controlled[0] != 0.0 and leak > LET_GO * allowance:
            forgiven = min(leak - LET_GO * allowance, allowance * period / LETTING)
        account.leak[0] -= forgiven
        account.forgiven[0] += forgiven
    elif now - account.pushed[0] > lag + interval + 1.0:
        account.leak[0] = 0.0
        for i in range(6):
            account.away[i] = 0.0
    else:
        account.leak[0] += max(0.0, min(0.0, held) - leak) * period / FORGETTING


@stage
def _control(account: Account, delay: float, out: Floats) -> None:
    """Scales a wrench and damps; the damper's part of it is in the account then."""
    leak, allowance, period, mass = account.leak[0], account.allowance[0], account.period[0], account.mass[0]
    inertia, wait = mass * account.lever[0] ** 2, delay + AHEAD * account.interval[0] * period
    sums, velocity, damper = account.sums[int(account.now[0]) % _ROWS], account.velocity, account.damper
    ahead = braked = turned = 0.0
    for i in range(6):
        flying, weight = sums[i] - account.met[i], mass if i < 3 else inertia
        ahead += 0.5 * flying * flying / weight * period * period + period * flying * velocity[i]
        braked -= BRAKED * out[i] * velocity[i]
        turned += wait * out[i] * out[i] / weight
    factor = min(1.0, max(0.0, 1.0 - (leak + max(ahead, 0.0)) / allowance))
    if factor < 1.0 and braked > 0.0 and leak < 1.001 * LET_GO * allowance:  # 1.001: forgiving ends at LET_GO
        # What only brakes the device is sent: it cannot turn it round before the next wrench is there.
        factor = max(factor, 1.0 if braked >= turned else braked / turned)
    part = min(1.0, leak / allowance, LET_GO - leak / allowance)
    damping = part * min(account.max_damping[0], DAMPED * mass / wait) if part > 0.0 else 0.0
    account.factor[0], account.damping[0] = factor, damping
    if factor == 1.0 and part <= 0.0:
        return
    for i in range(6):
        damper[i] = -damping * velocity[i] * (1.0 if i < 3 else account.lever[0] ** 2)
        out[i] = factor * out[i] + damper[i]
    p = part_within(account.force_limit[0], out[0], out[1], out[2])
    q = part_within(account.torque_limit[0], out[3], out[4], out[5])
    for i in range(6):
        out[i] *= p if i < 3 else q
        damper[i] *= p if i < 3 else q

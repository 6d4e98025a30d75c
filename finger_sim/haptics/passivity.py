"""Energy at the port to a haptic device: an observer of what leaks out, and an optional controller that holds it.

The device holds each wrench until the next one comes, so the energy it is given is known from wrenches and samples of
its motion alone (Ryu, Preusche, Hannaford and Hirzinger 2005): E = Σ f_held · (x_{k+1} − x_k), the wrench being the
one that was held during that motion: a loop delay older than the motion that is seen with it.

A passive simulation gives back at most what it got: E ≤ 0 from a start in free air. What is above leaked.

The controller scales the wrench to nothing as the leak, and what wrenches in flight would do to a mass moving on,
use up an allowance, but for what only brakes the device, and dissipates the leak with a damper as Hannaford and Ryu
(2002) do. A leak is forgiven at rest; in motion only what is above LET_GO allowances, at an allowance in LETTING.
Whatever device and hand do, E at the device, less what was forgiven, stays below

    LET_GO · allowance + force_limit · s + torque_limit · θ

where s [m] and θ [rad] are the longest paths within one loop delay and a period (between commands, if that is
longer): from LET_GO allowances on, nothing is sent, and only what is in flight then still works. That is exact as the
account is: for delays of whole periods and a command each, and else as far as the motion between commands is even.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

Vec6 = tuple[float, float, float, float, float, float]

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
NONE: Vec6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def stable_stiffness(damping: float, period: float, delay: float) -> float:
    """Stiffness of a virtual wall that a device passively renders [N/m]: damping / (period / 2 + delay).

    damping: of the device and the hand [N s/m]; period of the loop and delay in it [s] (Colgate and Schenkel 1997;
    Hulin, Albu-Schäffer and Hirzinger 2014).
    """
    return damping / (period / 2.0 + delay)


@dataclasses.dataclass(frozen=True, slots=True)
class Control:
    """What the controller of a port is set to.

    allowance   : leak at which the simulation's wrench is scaled to nothing [J]
    max_damping : of the damper that dissipates a leak [N s/m]; less where delay and mass demand it
    mass        : least mass of device and hand at the port [kg]; a wrong one costs quality, not the bound
    lever       : a turn of 1 rad counts as a path of this length; mass and damping likewise [m]
    """

    allowance: float = 0.01
    max_damping: float = 5.0
    mass: float = 0.1
    lever: float = 0.05


class Port:
    """The port of a loop: told each step's wrench and motion, it gives the wrench to send.

    period         : of the loop [s]
    controlled     : whether `step` changes the wrench; the account is kept either way
    control        : settings of the controller
    force_limit, torque_limit : of the wrench where the controller changes it [N], [N m]

    energy     : given to the device since the reset; negative: received [J]
    leak       : energy that a passive simulation would not have given; negative: what it may still give back [J]
    leaked     : largest leak since the reset [J]
    dissipated : by the damper since the reset; negative: the damper gave [J]
    forgiven   : of the leak, at rest and where nothing was sent [J]
    factor     : by which the last wrench was scaled, 0 to 1
    damping    : of the damper in the last wrench [N s/m]
    """

    def __init__(
        self,
        period: float,
        controlled: bool = False,
        control: Control = Control(),
        *,
        force_limit: float = math.inf,
        torque_limit: float = math.inf,
    ) -> None:
        self.period, self.controlled = period, controlled
        self.allowance, self.max_damping = control.allowance, control.max_damping
        self.mass, self.lever = control.mass, control.lever
        self.force_limit, self.torque_limit = force_limit, torque_limit
        self.reset()

    def reset(self) -> None:
        """A new account with nothing in flight, as before the first step."""
        self.energy = self.leak = self.leaked = self.dissipated = self.forgiven = self.damping = 0.0
        self.factor = 1.0
        self._now = 0  # number of the next step
        self._sent, self._damper = _Sums(), _Sums()
        self._velocity = self._away = NONE
        self._interval, self._since = 1, 0  # steps between the last two commands, and since the last one
        self._moved = self._pushed = 0  # steps at which the device was last not at rest, and not in free air

    def step(self, wrench: Sequence[float], motion: Sequence[float], delay: float, fresh: bool = True) -> Vec6:
        """The wrench to send for `wrench`, force [N] and torque [N m], world axes, about the commanded point.

        motion: of that point since the last fresh step, translation [m] and rotation vector [rad], world axes.
        delay: from the device's sample of the pose until it holds the wrench of this step [s].
        fresh: whether a command came for this step; without one, `motion` is not read.
        """
        now, lag = self._now, min(delay / self.period, MOST_PERIODS)
        self._since += 1
        if fresh:
            self._account(motion, now - lag)
        self._forget(wrench, lag)
        self.leaked = max(self.leaked, self.leak)
        a, b, c, d, e, f = wrench
        out, damper = (a, b, c, d, e, f), NONE
        if self.controlled:
            out, damper = self._controlled(out, delay)
        self._sent.add(out)
        self._damper.add(damper)
        self._now = now + 1
        return out

    def _account(self, motion: Sequence[float], until: float) -> None:
        """The work of the wrenches held during a motion: those sent up to step `until`, of the share of time."""
        work, dissipated = self._sent.meet(until, motion), self._damper.meet(until, motion)
        self.energy += work
        self.leak += work
        self.dissipated -= dissipated
        a, b, c, d, e, f = motion
        self._interval, self._since = self._since, 0
        rate = 1.0 / (self._interval * self.period)
        self._velocity = (a * rate, b * rate, c * rate, d * rate, e * rate, f * rate)
        u, v, w, x, y, z = self._away
        self._away = (u + a, v + b, w + c, x + d, y + e, z + f)
        square = (a * a + b * b + c * c + self.lever**2 * (d * d + e * e + f * f)) * rate * rate
        if square > QUIET * QUIET:
            self._moved = self._now

    def _forget(self, wrench: Sequence[float], lag: float) -> None:
        """Of the account what rest, free air and the store of an elastic body leave out."""
        if wrench[0] or wrench[1] or wrench[2] or wrench[3] or wrench[4] or wrench[5]:
            self._pushed = self._now
        if self.leak > 0.0:
            if self._since == 0 and self._now - self._moved > lag + self._interval + QUIET_TIME / self.period:
                share = min(1.0, self._interval * self.period / FORGIVING)
                forgiven = min(self.leak, max(self.leak, self.allowance) * share)
                self.leak -= forgiven
                self.forgiven += forgiven
            elif self.controlled and self.leak > LET_GO * self.allowance:
                forgiven = min(self.leak - LET_GO * self.allowance, self.allowance * self.period / LETTING)
                self.leak -= forgiven
                self.forgiven += forgiven
        elif self._now - self._pushed > lag + self._interval + 1.0:
            self.leak, self._away = 0.0, NONE
        elif self.leak < (held := min(0.0, _dot(wrench, self._away))):
            self.leak += (held - self.leak) * self.period / FORGETTING

    def _controlled(self, wrench: Vec6, delay: float) -> tuple[Vec6, Vec6]:
        """The wrench to send, and the damper's part of it."""
        leak, allowance, velocity = self.leak, self.allowance, self._velocity
        u, v, w, x, y, z = self._sent.open()
        inertia = self.mass * self.lever**2
        ahead = (u * u + v * v + w * w) / self.mass + (x * x + y * y + z * z) / inertia
        ahead = 0.5 * ahead * self.period**2 + self.period * _dot((u, v, w, x, y, z), velocity)
        g = self.factor = min(1.0, max(0.0, 1.0 - (leak + max(ahead, 0.0)) / allowance))
        wait = delay + AHEAD * self._interval * self.period
        if g < 1.0 and leak < 1.001 * LET_GO * allowance:  # forgiving ends at LET_GO, but for rounding
            g = self.factor = max(g, self._resisted(wrench, wait))
        part = min(1.0, leak / allowance, LET_GO - leak / allowance)
        if part <= 0.0:
            self.damping = 0.0
            if g == 1.0:
                return wrench, NONE
        else:
            self.damping = part * min(self.max_damping, DAMPED * self.mass / wait)
        b, r = -self.damping, -self.damping * self.lever**2
        a, c, d, e, f, h = velocity
        a, c, d, e, f, h = b * a, b * c, b * d, r * e, r * f, r * h
        u, v, w, x, y, z = wrench
        u, v, w, x, y, z = g * u + a, g * v + c, g * w + d, g * x + e, g * y + f, g * z + h
        force, torque = math.hypot(u, v, w), math.hypot(x, y, z)
        p = self.force_limit / force if force > self.force_limit else 1.0
        q = self.torque_limit / torque if torque > self.torque_limit else 1.0
        return (p * u, p * v, p * w, q * x, q * y, q * z), (p * a, p * c, p * d, q * e, q * f, q * h)

    def _resisted(self, wrench: Vec6, wait: float) -> float:
        """Part of a wrench that only brakes the device: it cannot turn the device round before the next is there."""
        u, v, w, x, y, z = wrench
        braked = -_dot(wrench, self._velocity)
        turned = (u * u + v * v + w * w) / self.mass + (x * x + y * y + z * z) / (self.mass * self.lever**2)
        return min(1.0, BRAKED * braked / (turned * wait)) if braked > 0.0 else 0.0


class _Sums:
    """Sums of one wrench a step, and up to where they met the motion that they caused."""

    def __init__(self) -> None:
        self._before = [NONE] * (MOST_PERIODS + 2)
        """Sum of all before a step, at its number modulo their count."""
        self._count = 0
        self._until, self._met = 0.0, NONE

    def add(self, wrench: Vec6) -> None:
        """The wrench of the next step."""
        count = self._count
        u, v, w, x, y, z = self._before[count % (MOST_PERIODS + 2)]
        a, b, c, d, e, f = wrench
        self._count = count + 1
        self._before[(count + 1) % (MOST_PERIODS + 2)] = (u + a, v + b, w + c, x + d, y + e, z + f)

    def open(self) -> Vec6:
        """Sum of those that have not met a motion."""
        u, v, w, x, y, z = self._before[self._count % (MOST_PERIODS + 2)]
        a, b, c, d, e, f = self._met
        return u - a, v - b, w - c, x - d, y - e, z - f

    def meet(self, until: float, motion: Sequence[float]) -> float:
        """Work [J] of those since the last call up to step `until`, in equal shares of a motion; of one when `until`
        did not move on."""
        before, span = self._before, until - self._until
        step = math.ceil(until) - 1
        share = until - step
        a, b, c, d, e, f = before[step % (MOST_PERIODS + 2)]
        u, v, w, x, y, z = before[(step + 1) % (MOST_PERIODS + 2)]
        u, v, w, x, y, z = u - a, v - b, w - c, x - d, y - e, z - f
        if span <= 0.0:
            return _dot((u, v, w, x, y, z), motion)
        u, v, w, x, y, z = a + share * u, b + share * v, c + share * w, d + share * x, e + share * y, f + share * z
        a, b, c, d, e, f = self._met
        self._until, self._met = until, (u, v, w, x, y, z)
        return _dot((u - a, v - b, w - c, x - d, y - e, z - f), motion) / span


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]

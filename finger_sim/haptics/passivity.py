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
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from numba import types

from ..errors import SceneError
from ..physics.records import VECTOR, Entry, direct, held
from .account import FORGIVING, LET_GO, MOST_PERIODS, build_account, reset, step
from .coupling import six

__all__ = ["FORGIVING", "LET_GO", "MOST_PERIODS", "Control", "Port", "Vec6", "stable_stiffness"]

Vec6 = tuple[float, float, float, float, float, float]


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

    def __post_init__(self) -> None:
        """Raises SceneError for a setting with which nothing can be controlled."""
        for name in ("allowance", "mass", "lever"):
            above_zero(f"control.{name}", getattr(self, name))
        if not 0.0 <= self.max_damping < math.inf:
            raise SceneError("control.max_damping", self.max_damping, "a finite number from 0 on")


def above_zero(name: str, value: float) -> float:
    """The value. Raises SceneError where it is not above 0, or not finite."""
    if not 0.0 < value < math.inf:
        raise SceneError(name, value, "a finite number above 0")
    return value


class Port:
    """The port of a loop: told each step's wrench and motion, it gives the wrench to send.

    period         : of the loop [s]
    controlled     : whether `step` changes the wrench; the account is kept either way
    allowance, max_damping, mass, lever : settings of the controller; see Control
    force_limit, torque_limit : of the wrench where the controller changes it [N], [N m]

    energy     : given to the device since the reset; negative: received [J]
    leak       : energy that a passive simulation would not have given; negative: what it may still give back [J]
    leaked     : largest leak since the reset [J]
    dissipated : by the damper since the reset; negative: the damper gave [J]
    forgiven   : of the leak, at rest and where nothing was sent [J]
    factor     : by which the last wrench was scaled, 0 to 1
    damping    : of the damper in the last wrench [N s/m]
    record     : all of this, as arrays for compiled code

    Raises SceneError where the period is not above 0.
    """

    period, controlled = Entry(float), Entry(bool)
    allowance, max_damping, mass, lever = Entry(float), Entry(float), Entry(float), Entry(float)
    force_limit, torque_limit = Entry(float), Entry(float)
    energy, leak, leaked, dissipated, forgiven = Entry(float), Entry(float), Entry(float), Entry(float), Entry(float)
    factor, damping = Entry(float), Entry(float)

    def __init__(
        self,
        period: float,
        controlled: bool = False,
        control: Control = Control(),
        *,
        force_limit: float = math.inf,
        torque_limit: float = math.inf,
    ) -> None:
        self.record = build_account()
        self.period, self.controlled = above_zero("period", period), controlled
        self.allowance, self.max_damping = control.allowance, control.max_damping
        self.mass, self.lever = control.mass, control.lever
        self.force_limit, self.torque_limit = force_limit, torque_limit
        self._held = held(self.record)

    def reset(self) -> None:
        """A new account with nothing in flight, as before the first step."""
        reset(self._held)

    def step(self, wrench: Sequence[float], motion: Sequence[float], delay: float, fresh: bool = True) -> Vec6:
        """The wrench to send for `wrench`, force [N] and torque [N m], world axes, about the commanded point.

        motion: of that point since the last fresh step, translation [m] and rotation vector [rad], world axes.
        delay: from the device's sample of the pose until it holds the wrench of this step [s].
        fresh: whether a command came for this step; without one, `motion` is not read.

        A wrench that is not finite counts as none, a motion that is not finite as no command.
        """
        out = six(wrench)
        self._step(self._held, out, six(motion) if fresh else out, delay, fresh, out)
        a, b, c, d, e, f = out.tolist()
        return a, b, c, d, e, f

    @cached_property
    def _step(self) -> Callable[..., Any]:
        return direct(step, self._held, VECTOR, VECTOR, types.float64, types.boolean, VECTOR)

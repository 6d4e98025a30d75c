"""What a device is sent of the simulation's wrench: scaled, let in slowly, clamped, and nothing when commands stop."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numba import types

from ..arrays import Floats
from ..physics.compile import kernel
from ..physics.records import VECTOR, Entry, direct, held, side_by_side
from ..scene import Coupling
from .coupling import clamped, finite, six

NO_WRENCH: Floats = np.zeros(6)
NO_WRENCH.setflags(write=False)


class Rendered(NamedTuple):
    """A Rendering, for compiled code: its numbers of these names, (1,) each, and

    part        : of the wrench that is let in, 0 to 1
    force_limit, torque_limit : of the wrench that is sent [N], [N m]
    """

    scale: Floats
    ramp: Floats
    timeout: Floats
    stale: Floats
    clutched: Floats
    part: Floats
    force_limit: Floats
    torque_limit: Floats


class Rendering:
    """The node's and a replay's, with the node's options of these names.

    scale   : factor of the clamped wrench; the clamps hold after it too
    ramp    : time in which the wrench comes in when commands start or resume [s]
    timeout : age from which a command is stale [s]
    stale   : whether the last command is, or the clutch is open
    clutched : whether it is: a device that is moved to another place is not pushed
    record  : all of this, as arrays for compiled code
    """

    scale, ramp, timeout, stale, clutched = Entry(float), Entry(float), Entry(float), Entry(bool), Entry(bool)

    def __init__(self, scale: float = 1.0, ramp: float = 0.2, timeout: float = 0.1) -> None:
        self.record = Rendered(**side_by_side(Rendered))
        self.scale, self.ramp, self.timeout = scale, ramp, timeout
        self._held = held(self.record)

    def silence(self) -> Floats:
        """Nothing (6,); the wrench comes in anew after it."""
        silence(self._held)
        return NO_WRENCH

    def watch(self, age: float) -> bool:
        """Whether a command of an age [s] has a wrench: it is recent, and the clutch closed. Else one comes in anew."""
        return bool(self._watch(self._held, age))

    def render(self, wrench: Floats, coupling: Coupling, dt: float) -> Floats:
        """The wrench (6,) [N, N m] to send of a step's `device_wrench`; nothing where a number is not finite."""
        self.record.force_limit[0], self.record.torque_limit[0] = coupling.force_limit, coupling.torque_limit
        out = six(wrench)
        self._render(self._held, out, dt, out)
        return out

    def unchanged(self, received: int) -> float:
        """Time up to which a constant wrench is sent as it is now, where the last command came at `received` [ns]."""
        if self.stale:
            return math.inf
        return received + 1e9 * self.timeout if self.record.part[0] >= 1.0 else 0.0

    @cached_property
    def _watch(self) -> Callable[..., Any]:
        return direct(watch, self._held, types.float64)

    @cached_property
    def _render(self) -> Callable[..., Any]:
        return direct(render, self._held, VECTOR, types.float64, VECTOR)


@kernel
def silence(rendered: Rendered) -> None:
    """`Rendering.silence`."""
    rendered.part[0] = 0.0


@kernel
def watch(rendered: Rendered, age: float) -> bool:
    """`Rendering.watch`."""
    recent = not age > rendered.timeout[0] and rendered.clutched[0] == 0.0
    rendered.stale[0] = 0.0 if recent else 1.0
    if not recent:
        rendered.part[0] = 0.0
    return recent


@kernel
def render(rendered: Rendered, wrench: Floats, dt: float, out: Floats) -> None:
    """`Rendering.render` into `out`, which may be `wrench`."""
    factor = 0.0
    if rendered.stale[0] == 0.0:
        ramp = rendered.ramp[0]
        rendered.part[0] = min(1.0, rendered.part[0] + dt / ramp) if ramp > 0.0 else 1.0
        factor = rendered.scale[0] * rendered.part[0]
    for i in range(6):
        out[i] = factor * wrench[i]
    clamped(out, rendered.force_limit[0], rendered.torque_limit[0], out)
    if factor == 0.0 or not finite(out):
        for i in range(6):
            out[i] = 0.0

"""From a step's wrench to the one that a device is sent: rendering.py, then passivity.py, in one compiled call."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numba import types

from ..arrays import Floats
from ..physics.compile import kernel
from ..physics.records import VECTOR, Entry, direct, held, side_by_side
from ..scene import Coupling, Pose
from . import account, rendering
from .account import Account
from .coupling import clamped, device_wrench, six, spring_wrench, turned_round, way_and_turn
from .passivity import Port
from .path import numbers, read
from .rendering import NO_WRENCH, Rendered, Rendering

BECAME_STALE, BACK = 1, 2
"""What a step told: the command has become stale; commands are back."""


class Sending(NamedTuple):
    """A Sender, for compiled code.

    delay  : (1,) from the device's sample of its pose until it holds the wrench [s], as of the last command
    motion : (6,) of the commanded point to that command from the one before [m, rad], world axes
    """

    delay: Floats
    motion: Floats
    rendered: Rendered
    account: Account


class Sender:
    """Gives the wrench that a device is sent for each step.

    rendering : of the wrench; it knows whether the command is too old for one
    port      : account of the energy that goes to the device, and its controller
    delay     : from the device's sample of its pose until it holds the wrench [s], as of the last command; the way
                back to the device is taken to be as long as the way here
    record    : all of this, as arrays for compiled code

    period: of the loop [s]
    """

    delay = Entry(float)

    def __init__(self, period: float) -> None:
        self.rendering, self.port = Rendering(), Port(period)
        fields: dict[str, Any] = {**side_by_side(Sending, motion=6, rendered=0, account=0)}
        fields |= {"rendered": self.rendering.record, "account": self.port.record}
        self.record = Sending(**fields)
        self._held = held(self.record)
        self._last, self._first = np.zeros(7), True

    def allow(self, coupling: Coupling) -> None:
        """From now on no more is sent than the coupling allows."""
        for record in (self.record.rendered, self.record.account):
            record.force_limit[0], record.torque_limit[0] = coupling.force_limit, coupling.torque_limit

    def send(
        self,
        wrench: Floats,
        coupling: Coupling,
        command: Pose | None,
        dt: float,
        *,
        transport: float,
        age: float,
        took: float,
    ) -> tuple[Floats, int]:
        """The wrench (6,) [N, N m] to send for a step's `device_wrench`, and what is told, of the bits above.

        command: that came for this step; None: the last one, if there was any, still holds.
        Times in s. dt: of the step. transport: of the command from device to receipt. age: since that receipt, as the
        step began. took: since it began.
        """
        self.allow(coupling)
        out, before, fresh = six(wrench), self._last, command is not None
        if command is not None:
            self._last = np.empty(7)
            self._last[:] = numbers(command)
            before = self._last if self._first else before
            self._first = False
        told: int = self._send(self._held, out, before, self._last, fresh, transport, age, took, dt, out)
        return out, told

    @cached_property
    def _send(self) -> Callable[..., Any]:
        kinds = (VECTOR, VECTOR, VECTOR, types.boolean, *[types.float64] * 4, VECTOR)
        return direct(send, self._held, *kinds)


@kernel
def send(
    sending: Sending,
    wrench: Floats,
    before: Floats,
    command: Floats,
    fresh: bool,
    transport: float,
    age: float,
    took: float,
    dt: float,
    out: Floats,
) -> int:
    """`Sender.send` into `out`, which may be `wrench`; what is told.

    before, command: (7,) numbers of the poses of the command before and of this one; the same where it is the first.
    fresh: whether this one came for this step; without one, neither is read.
    """
    rendered = sending.rendered
    was_stale = rendered.stale[0] != 0.0
    recent = rendering.watch(rendered, age)
    rendering.render(rendered, wrench, dt, out)
    if fresh:
        sending.delay[0] = 2.0 * transport + age + took
        way = way_and_turn(read(before), read(command))
        for i in range(6):
            sending.motion[i] = way[i]
    account.step(sending.account, out, sending.motion, sending.delay[0], fresh, out)
    if was_stale and recent:
        return BACK
    return 0 if was_stale or recent else BECAME_STALE


KERNELS = (
    send, rendering.watch, rendering.silence, rendering.render, account.step, account.reset, clamped, turned_round,
)  # fmt: skip
"""What is called of a Sender, its Rendering and its Port, and of coupling.py for a step's wrench."""


def load() -> None:
    """Compiles or loads these, by calling each."""
    coupling, pose, sender = Coupling(), Pose(), Sender(1.0)
    sender.send(NO_WRENCH, coupling, pose, 1.0, transport=0.0, age=0.0, took=0.0)
    sender.rendering.watch(0.0)
    sender.rendering.silence()
    sender.rendering.render(NO_WRENCH, coupling, 1.0)
    sender.port.step(NO_WRENCH.tolist(), NO_WRENCH.tolist(), 0.0)
    sender.port.reset()
    device_wrench(coupling, spring_wrench(NO_WRENCH, pose, pose))

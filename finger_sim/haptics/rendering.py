"""What a device is sent of the simulation's wrench: scaled, let in slowly, clamped, and nothing when commands stop."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats
from ..scene import Coupling
from .coupling import device_wrench

NO_WRENCH: Floats = np.zeros(6)
NO_WRENCH.setflags(write=False)


class Rendering:
    """The node's and a replay's, with the node's options of these names.

    scale   : factor of the clamped wrench; the clamps hold after it too
    ramp    : time in which the wrench comes in when commands start or resume [s]
    timeout : age from which a command is stale [s]
    stale   : whether the last command is
    """

    def __init__(self, scale: float = 1.0, ramp: float = 0.2, timeout: float = 0.1) -> None:
        self.scale, self.ramp, self.timeout = scale, ramp, timeout
        self.stale = False
        self._part = 0.0

    def silence(self) -> Floats:
        """Nothing (6,); the wrench comes in anew after it."""
        self._part = 0.0
        return NO_WRENCH

    def watch(self, age: float) -> bool:
        """Whether a command of an age [s] is recent; where it is not, the wrench comes in anew after it."""
        self.stale = age > self.timeout
        if self.stale:
            self.silence()
        return not self.stale

    def render(self, wrench: Floats, coupling: Coupling, dt: float) -> Floats:
        """The wrench (6,) [N, N m] to send of a step's `device_wrench`; nothing where a number is not finite."""
        if self.stale:
            return NO_WRENCH
        self._part = min(1.0, self._part + dt / self.ramp) if self.ramp > 0.0 else 1.0
        scaled = device_wrench(coupling, self.scale * self._part * wrench)
        return scaled if math.isfinite(sum(scaled.tolist())) else NO_WRENCH

    def unchanged(self, received: int) -> float:
        """Time up to which a constant wrench is sent as it is now, where the last command came at `received` [ns]."""
        if self.stale:
            return math.inf
        return received + 1e9 * self.timeout if self._part >= 1.0 else 0.0

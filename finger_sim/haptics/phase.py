"""When steps begin: where commands come as often as steps, just after one has come.

A command waits for the next deadline: half a period at the median, and from nothing to a whole one in turn, as the
sender's clock and this one differ by a hair. So deadlines are moved until commands wait no longer than their jitter
asks for: by no more than 1/200 of a period a step while they are far from there, as with a sender that has begun anew,
and by no more than 1/500 afterwards. Steps then follow the sender's clock.

A command that comes too late for its step waits for a whole period more. So all are to come the earlier, the more of
them are late: until one in 400 is (a quantile by stochastic approximation, Robbins and Monro 1951).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..physics.compile import kernel

_OTHER = 0.1  # of a period, by which the interval of commands may differ from it: others move nothing
_SHARE = 1.0 / 16.0  # of what a wait is off, by which deadlines are moved
_MOST = 1.0 / 500.0  # of a period, likewise,
_MOST_FAR = 1.0 / 200.0  # and where the last waits were far off
_FAR = 0.125  # of a period
_LATELY = 16  # steps over which that is judged
_LEAST_WAIT = 5e-5  # that is aimed at [s]
_LATE = 1.0 / 400.0  # of the steps, that have no command as theirs is late
_EARLIER = 1.0 / 64.0  # of a period, by which commands are to come earlier after each of these,
_EARLIEST = 0.2  # and in all


class Phase(NamedTuple):
    """How commands come beside deadlines; (1,) each.

    off     : mean of the last waits beyond what was aimed at [s]
    earlier : by which commands are to come before the latest moment [s]
    """

    off: Floats
    earlier: Floats


def no_phase(period: float) -> Phase:
    """Of a loop that has not begun. period [s]."""
    return Phase(np.zeros(1), np.full(1, 0.1 * period))


@kernel
def moved(phase: Phase, period: float, interval: float, wait: float) -> float:
    """By how much deadlines are to be moved after a step [s].

    interval : of commands, at the mean [s]; steps without a command, and with two, are no other rate: they are what is
               to be cured where commands come just as steps begin
    wait     : of its command from receipt to the step's begin [s]; negative where none has come since the step before
    """
    earlier = phase.earlier
    if abs(interval - period) > _OTHER * period:
        return 0.0
    earlier[0] = max(0.0, min(_EARLIEST * period, earlier[0] + _EARLIER * period * ((wait < 0.0) - _LATE)))
    if wait < 0.0:
        return 0.0
    off = (wait - _LEAST_WAIT - earlier[0] + 0.5 * period) % period - 0.5 * period
    phase.off[0] += (off - phase.off[0]) / _LATELY
    most = (_MOST_FAR if abs(phase.off[0]) > _FAR * period else _MOST) * period
    by: float = -max(-most, min(most, _SHARE * off))
    return by

"""What a device is sent beside device_wrench: the same wrench, in its axes, in messages of its driver's types.

Whenever device_wrench is zero, so is all of this, and the first zero goes out at once, whatever the rate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..arrays import Floats, Ints
from ..bags.template import STAMP_OFFSET
from ..haptics.coupling import part_within
from ..haptics.device_frame import to_device, to_handle
from ..physics.compile import kernel
from .device_bytes import Inlet
from .memory import bytes_at, write_float32, write_float64
from .wire import ADDRESS, LENGTH, Outgoing, write_stamp

DEVICE_AXES, HANDLE_AXES, WORLD_AXES = range(3)
_FORCE, _INTENSITY = 6, 7
"""Places of these in device.WORDS."""


class Outlets(NamedTuple):
    """n messages for a device, which follow those of each step among an Outgoing's, with m numbers in all.

    due     : (n,) 1 where it is to be sent now
    axes    : (n,) of its wrench
    stamped : (n,) 1 where it has a header
    limit   : (n,) of its force [N]
    full    : (n,) force of the intensity 1 [N]
    rate    : (n,) [Hz]; 0: one for each step
    waited  : (n,) parts of a period since it was due
    pushes  : (n,) 1 where the last one that was sent was not zero
    begin   : (n + 1,) its numbers among all
    place   : (m,) where each lies in its message
    width   : (m,) bytes of each
    source  : (m,) which of WORDS it is
    sign    : (m,) 1 or -1
    wrench  : (6,) as it is sent
    words   : (9,) the numbers of WORDS
    """

    due: Ints
    axes: Ints
    stamped: Ints
    limit: Floats
    full: Floats
    rate: Floats
    waited: Floats
    pushes: Ints
    begin: Ints
    place: Ints
    width: Ints
    source: Ints
    sign: Floats
    wrench: Floats
    words: Floats


@kernel
def fill_outlets(
    outlets: Outlets, outgoing: Outgoing, inlet: Inlet, wrench: Floats, limits: Floats, dt: float, stamp: int
) -> None:
    """The messages that are due of a step's wrench (6,) for the device.

    limits: of its force and torque [N], [N m]. dt: of the step [s]. stamp: its time [ns]
    """
    first = outgoing.messages.shape[0] - outlets.due.shape[0]
    for k in range(outlets.due.shape[0]):
        pushes = _express(outlets, k, inlet, wrench, limits)
        waited = outlets.waited[k] + dt * outlets.rate[k]
        due = outlets.rate[k] == 0.0 or waited >= 1.0 or (not pushes and outlets.pushes[k] != 0)
        outlets.waited[k] = waited - math.floor(waited)
        outlets.due[k] = 1 if due else 0
        if not due:
            continue
        outlets.pushes[k] = 1 if pushes else 0
        data = bytes_at(outgoing.messages[first + k, ADDRESS], outgoing.messages[first + k, LENGTH])
        if outlets.stamped[k] != 0:
            write_stamp(data, STAMP_OFFSET, stamp)
        for i in range(outlets.begin[k], outlets.begin[k + 1]):
            value = outlets.sign[i] * outlets.words[outlets.source[i]]
            if outlets.width[i] == 8:
                write_float64(data, outlets.place[i], value)
            else:
                write_float32(data, outlets.place[i], value)


@kernel
def _express(outlets: Outlets, k: int, inlet: Inlet, wrench: Floats, limits: Floats) -> bool:
    """The words of message k; whether any is not zero."""
    out, words = outlets.wrench, outlets.words
    for i in range(6):
        out[i] = wrench[i]
    if outlets.axes[k] != WORLD_AXES:
        to_device(inlet.place, out, out)
    if outlets.axes[k] == HANDLE_AXES:
        to_handle(inlet.grip, out, out)
    p = part_within(min(outlets.limit[k], limits[0]), out[0], out[1], out[2])
    q = part_within(limits[1], out[3], out[4], out[5])
    pushes = False
    for i in range(6):
        words[i] = (p if i < 3 else q) * out[i]
        pushes = pushes or words[i] != 0.0
    size = math.sqrt(words[0] * words[0] + words[1] * words[1] + words[2] * words[2])
    words[_FORCE], words[_INTENSITY] = size, min(1.0, size / outlets.full[k])
    return pushes

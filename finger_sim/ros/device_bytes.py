"""What a device's driver sends, read in compiled code: a PoseStamped is made of it, which goes the way of any command.

A position, an orientation that comes by itself, and a button of the clutch are messages of their own. The command is
judged by pose_bytes.py as any other is. Here is refused what has no pose, and what would spoil the clutch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..arrays import Bytes, Floats, Ints
from ..bags.template import STAMP_OFFSET
from ..haptics import device_frame
from ..haptics.device_frame import Frame
from ..physics.compile import kernel, stage
from ..physics.rotations import LONG_QUATERNION, SHORT_QUATERNION
from ..scene.pose import FARTHEST
from .memory import read_float32, read_float64, read_int32
from .wire import write_numbers, write_stamp

POSITION, ORIENTATION, CLUTCH = range(3)
"""What a message is, and the rows of an Inlet that tell of it."""
HEADER, CHILD, LISTED, ELEMENT, COUNT = range(5)
"""Columns of `Inlet.layout`; see device.Layout. Of a button, LISTED: 1 where it is one of a Joy; COUNT: its number."""
(
    PASSED_OVER, CUT, ENCODING, STAMP, FRAME, FEW, NO_TURN, OLD_TURN, NO_POSE,
) = range(-1, -10, -1)  # fmt: skip
"""Why `take_in` makes no command of a message. The first is no mistake: it is of other frames."""
_NAME, _CHILD_NAME = range(2)
_UNSIGNED = 0xFFFFFFFF
_SECOND = 1_000_000_000


class Inlet(NamedTuple):
    """What is known of a device.

    active  : (1,) 1 where commands are made here
    roles   : (n,) what comes in subscriptions beside those of commands and of the plane
    layout  : (3, 5) of each kind of message
    columns : (2, 7) which number of a message is x y z [units], qx qy qz qw; -1: none
    frame, child : bytes of the names that a header must have; empty: any
    unit    : (1,) [m]
    own     : (1,) 1 where orientations come by themselves
    turned  : (1,) when the last one came, a steady time [ns]; 0: none has
    place   : Frame of the device, which the clutch moves
    grip    : (7,) last pose of the handle, its quaternion of length 1
    raw     : (7,) numbers of the last message as they came [m]
    clutched : (1,) 1 while the clutch is open; the same memory as Rendered.clutched
    opens   : (1,) state of the button that opens it
    anew    : (1,) 1 where the next pose is to go on from `held`
    mapped  : (1,) 1 where there is a `held`
    held    : (7,) last command
    message : the command as PoseStamped, and
    at      : (1,) where its numbers are
    button  : (5,) the clutch as std_msgs/Bool
    why     : (1,) why a message is to be looked at; 0: for what is in `message`
    """

    active: Ints
    roles: Ints
    layout: Ints
    columns: Ints
    frame: Bytes
    child: Bytes
    unit: Floats
    own: Ints
    turned: Ints
    place: Frame
    grip: Floats
    raw: Floats
    clutched: Floats
    opens: Ints
    anew: Ints
    mapped: Ints
    held: Floats
    message: Bytes
    at: Ints
    button: Bytes
    why: Ints


@kernel
def take_in(inlet: Inlet, what: int, data: Bytes, received: int, timeout: float) -> int:
    """Reads a message that came at a steady time [ns]; 1 where `message` is a new command, or `button` has changed.

    0: it was noted. Negative: see PASSED_OVER.
    timeout: age from which an orientation that came by itself is too old [s].
    """
    if data.shape[0] < STAMP_OFFSET:
        return CUT
    if data[0] != 0 or data[1] != 1:
        return ENCODING
    if what == CLUTCH:
        return _take_button(inlet, data)
    stamp = _read(inlet, what, data)
    if stamp < 0:
        return stamp
    raw, handle = inlet.raw, inlet.grip
    if what == ORIENTATION or inlet.columns[POSITION, 6] >= 0:
        norm = math.sqrt(raw[3] * raw[3] + raw[4] * raw[4] + raw[5] * raw[5] + raw[6] * raw[6])
        if not SHORT_QUATERNION <= norm <= LONG_QUATERNION:
            return NO_POSE
        for i in range(3, 7):
            handle[i] = raw[i] / norm
    if what == ORIENTATION:
        inlet.turned[0] = received
        return 0
    if inlet.own[0] != 0:
        if inlet.turned[0] == 0:
            return NO_TURN
        if 1e-9 * (received - inlet.turned[0]) > timeout:
            return OLD_TURN
    for i in range(3):
        if not abs(raw[i]) <= FARTHEST:
            return NO_POSE
    for i in range(3):
        handle[i] = raw[i]
    closed = inlet.clutched[0] == 0.0
    if closed and inlet.anew[0] != 0:
        device_frame.index(inlet.place, handle, inlet.held)
        inlet.anew[0] = 0
    if closed or inlet.mapped[0] == 0:
        device_frame.to_world(inlet.place, handle, inlet.held)
        inlet.mapped[0] = 1
    write_stamp(inlet.message, STAMP_OFFSET, stamp)
    write_numbers(inlet.message, inlet.at[0], inlet.held)
    return 1


@stage
def _take_button(inlet: Inlet, data: Bytes) -> int:
    """The clutch opens, or it closes and the handle goes on from where the finger is."""
    layout, size = inlet.layout[CLUTCH], data.shape[0]
    if layout[LISTED] == 0:
        if size < STAMP_OFFSET + 1:
            return CUT
        pressed = data[STAMP_OFFSET] != 0
    else:
        at = _text_end(data, STAMP_OFFSET + 8)
        if at < 0:
            return CUT
        at += -at % 4
        if size < at + 4:
            return CUT
        at += 4 + 4 * (read_int32(data, at) & _UNSIGNED)
        if size < at + 4:
            return CUT
        count = read_int32(data, at) & _UNSIGNED
        if layout[COUNT] >= count:
            return FEW
        at += 4 + 4 * layout[COUNT]
        if size < at + 4:
            return CUT
        pressed = read_int32(data, at) != 0
    opened = pressed == (inlet.opens[0] != 0)
    if opened == (inlet.clutched[0] != 0.0):
        return 0
    inlet.clutched[0] = 1.0 if opened else 0.0
    if not opened:
        inlet.anew[0] = inlet.mapped[0]
    inlet.button[STAMP_OFFSET] = 1 if opened else 0
    return 1


@stage
def _read(inlet: Inlet, what: int, data: Bytes) -> int:
    """Its numbers into `raw`; its stamp [ns], 0 where it has none, or why there are none."""
    layout, size, at = inlet.layout[what], data.shape[0], STAMP_OFFSET
    stamp, count, element = 0, layout[COUNT], layout[ELEMENT]
    if element != 0:
        at, count = _array(data, element)
        if at < 0:
            return CUT
        return 0 if _numbers(inlet, what, data, at, count, element) else FEW
    entries = 1
    if layout[LISTED] != 0:
        if size < at + 4:
            return CUT
        entries = read_int32(data, at) & _UNSIGNED
        at += 4
    for _ in range(entries):
        fits = True
        if layout[HEADER] != 0:
            at += -at % 4
            if size < at + 12:
                return CUT
            seconds, nanoseconds = read_int32(data, at), read_int32(data, at + 4) & _UNSIGNED
            stamp = seconds * _SECOND + nanoseconds if seconds >= 0 and nanoseconds < _SECOND else STAMP
            name = at + 8
            at = _text_end(data, name)
            if at < 0:
                return CUT
            fits = _is_named(data, name, inlet.frame)
        if layout[CHILD] != 0:
            name = at + -at % 4
            at = _text_end(data, name)
            if at < 0:
                return CUT
            fits = fits and _is_named(data, name, inlet.child)
        at += (STAMP_OFFSET - at) % 8
        if size < at + 8 * count:
            return CUT
        if fits:
            if stamp >= 0:
                _numbers(inlet, what, data, at, count, 8)
            return stamp
        at += 8 * count
    return PASSED_OVER if layout[LISTED] != 0 else FRAME


@stage
def _numbers(inlet: Inlet, what: int, data: Bytes, at: int, count: int, element: int) -> bool:
    """Those that columns name, of `count` from `at` on; False where there are not as many."""
    columns = inlet.columns[what]
    for i in range(7):
        if columns[i] >= count:
            return False
    for i in range(7):
        k = columns[i]
        if k >= 0:
            value = read_float32(data, at + 4 * k) if element == 4 else read_float64(data, at + 8 * k)
            inlet.raw[i] = inlet.unit[0] * value if i < 3 else value
    return True


@stage
def _array(data: Bytes, element: int) -> tuple[int, int]:
    """Where the numbers of an array begin, behind its layout, and how many there are; -1, 0 for one cut short."""
    size, at = data.shape[0], STAMP_OFFSET
    if size < at + 4:
        return -1, 0
    dimensions = read_int32(data, at) & _UNSIGNED
    at += 4
    for _ in range(dimensions):
        at = _text_end(data, at + -at % 4)
        if at < 0:
            return -1, 0
        at += -at % 4 + 8
    if size < at + 8:
        return -1, 0
    skipped, count = read_int32(data, at) & _UNSIGNED, read_int32(data, at + 4) & _UNSIGNED
    at += 8
    if element == 8:
        at += (STAMP_OFFSET - at) % 8
    if size < at + element * count:
        return -1, 0
    return at + element * min(skipped, count), count - min(skipped, count)


@stage
def _text_end(data: Bytes, at: int) -> int:
    """Where a text ends whose length is at `at`; -1 where it is cut short."""
    if at < 0 or data.shape[0] < at + 4:
        return -1
    end = at + 4 + (read_int32(data, at) & _UNSIGNED)
    return end if end <= data.shape[0] else -1


@stage
def _is_named(data: Bytes, at: int, name: Bytes) -> bool:
    """Whether the text at `at` is that name; any is where the name is empty."""
    if name.shape[0] == 0:
        return True
    length = read_int32(data, at) & _UNSIGNED
    if length < name.shape[0] or (length > name.shape[0] and data[at + 4 + name.shape[0]] != 0):
        return False
    same = True
    for i in range(name.shape[0]):
        same = same and data[at + 4 + i] == name[i]
    return same

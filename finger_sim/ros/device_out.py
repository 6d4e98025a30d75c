"""What a device is sent beside device_wrench: the same wrench, in its axes, in messages of its driver's types.

Whenever device_wrench is zero, so is all of this, and the first zero goes out at once, whatever the rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message

from ..arrays import Bytes, Floats, Ints
from ..bags.template import STAMP_OFFSET, Template, marks
from ..errors import SceneError
from ..haptics.coupling import part_within
from ..haptics.device_frame import to_device, to_handle
from ..physics.compile import kernel
from .device import OUTPUTS, WORDS, Device, DeviceOutput
from .device_bytes import Inlet
from .device_in import checked_topic, message_class
from .memory import bytes_at, write_float32, write_float64
from .wire import ADDRESS, LENGTH, Outgoing, write_stamp

DEVICE_AXES, HANDLE_AXES, WORLD_AXES = range(3)
_AXES = {"device": DEVICE_AXES, "handle": HANDLE_AXES, "world": WORLD_AXES}
_FORCE, _INTENSITY = WORDS.index("force"), WORDS.index("intensity")
_FIXED = ("double", "float")
"""Fields that can be set, as rclpy names their types."""


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
        to_handle(inlet.handle, out, out)
    p = part_within(min(outlets.limit[k], limits[0]), out[0], out[1], out[2])
    q = part_within(limits[1], out[3], out[4], out[5])
    pushes = False
    for i in range(6):
        words[i] = (p if i < 3 else q) * out[i]
        pushes = pushes or words[i] != 0.0
    size = math.sqrt(words[0] * words[0] + words[1] * words[1] + words[2] * words[2])
    words[_FORCE], words[_INTENSITY] = size, min(1.0, size / outlets.full[k])
    return pushes


class DeviceOut:
    """Publishers of a device's messages, and the record for compiled code."""

    def __init__(self, node: Any, device: Device | None, frames: dict[str, str], qos: Any) -> None:
        """frames: names of a device's and of the world's axes, for headers. Raises SceneError."""
        outputs = () if device is None else device.device_output
        made = [_Made(f"{OUTPUTS}[{k}]", output, frames) for k, output in enumerate(outputs)]
        self.sent = [(node.create_publisher(each.kind, each.topic, qos), each.template) for each in made]
        n = len(made)
        numbers = [number for each in made for number in each.numbers]
        place, width, source = (np.array([number[i] for number in numbers], np.int64) for i in range(3))
        self.record = Outlets(
            due=np.zeros(n, np.int64),
            axes=np.array([_AXES[output.axes] for output in outputs], np.int64),
            stamped=np.array([each.stamped for each in made], np.int64),
            limit=np.array([math.inf if output.limit is None else output.limit for output in outputs], np.float64),
            full=np.array([output.full_scale for output in outputs], np.float64),
            rate=np.array([output.rate for output in outputs], np.float64),
            waited=np.zeros(n),
            pushes=np.zeros(n, np.int64),
            begin=np.cumsum([0, *(len(each.numbers) for each in made)], dtype=np.int64),
            place=place,
            width=width,
            source=source,
            sign=np.array([number[3] for number in numbers], np.float64),
            wrench=np.zeros(6),
            words=np.zeros(len(WORDS)),
        )


class _Made:
    """A message with nothing in it yet.

    numbers : place, width, source and sign of each that is to be filled in; see Outlets
    """

    def __init__(self, key: str, output: DeviceOutput, frames: dict[str, str]) -> None:
        self.topic = checked_topic(f"{key}.topic", output.topic)
        self.kind = message_class(f"{key}.type", output.type)
        message, names = self.kind(), output.numbers
        self.stamped = message.get_fields_and_field_types().get("header") == "std_msgs/Header"
        if self.stamped:
            message.header.frame_id = output.frame or frames[output.axes]
        if output.columns:
            message.data = [0.0] * len(names)
        values = marks(len(names)).tolist()
        kinds = [_set(key, output, message, name, value) for name, value in zip(names, values, strict=True)]
        blocks = [
            np.array([v], np.float64 if w == 8 else np.float32).tobytes() for v, w in zip(values, kinds, strict=True)
        ]
        filled = Template(serialize_message(message), *blocks, stamps=(STAMP_OFFSET,) if self.stamped else ())
        words = [word.removeprefix("-") for word in names.values()]
        signs = [-1.0 if word.startswith("-") else 1.0 for word in names.values()]
        self.numbers = list(zip(filled.blocks, kinds, map(WORDS.index, words), signs, strict=True))
        self.template = Template(_emptied(filled, kinds), stamps=(STAMP_OFFSET,) if self.stamped else ())


def _set(key: str, output: DeviceOutput, message: Any, name: str, value: float) -> int:
    """Sets a field of a message by its dotted name; bytes that the number has there. Raises SceneError."""
    *way, last = name.split(".")
    try:
        for part in way:
            message = getattr(message, part)
        if last.isdecimal():
            message[int(last)] = value
            return 4 if message.typecode == "f" else 8
        kind = message.get_fields_and_field_types()[last]
        if kind in _FIXED:
            setattr(message, last, value)
            return 4 if kind == "float" else 8
    except (AttributeError, KeyError):
        pass
    given = next((each for each in output.fields.split() if each.startswith(f"{name}=")), name)
    raise SceneError(f"{key}.fields", given, f"a field of {output.type} that is one float32 or float64")


def _emptied(filled: Template, widths: Sequence[int]) -> bytes:
    """The message with zeros in place of its marks."""
    data: Bytes = filled.bytes.copy()
    for at, width in zip(filled.blocks, widths, strict=True):
        data[at : at + width] = 0
    return data.tobytes()

"""Publishers of what a device is sent beside device_wrench, with their messages, which device_fill.py fills."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from ..arrays import Bytes
from ..bags.template import STAMP_OFFSET, Template, marks
from ..errors import SceneError
from .device import OUTPUTS, WORDS, Device, DeviceOutput
from .device_fill import DEVICE_AXES, HANDLE_AXES, WORLD_AXES, Outlets
from .device_in import checked_topic, message_class

_AXES = {"device": DEVICE_AXES, "handle": HANDLE_AXES, "world": WORLD_AXES}
_FIXED = ("double", "float")
"""Fields that can be set, as rclpy names their types."""


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

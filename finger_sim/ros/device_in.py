"""The device's side of what comes in: subscriptions to its topics, and words for what cannot be used."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from numba import types
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from ..bags import cdr, changes
from ..errors import SceneError
from ..haptics.device_frame import build_frame, handle_at
from ..physics.records import direct, held
from . import device_bytes
from .device import COMMANDS, NUMBERS, PACKAGES, POSES, TURNS, Device, Layout
from .device_bytes import (
    CLUTCH,
    COUNT,
    CUT,
    ENCODING,
    FEW,
    FRAME,
    LISTED,
    NO_TURN,
    OLD_TURN,
    ORIENTATION,
    POSITION,
    STAMP,
    Inlet,
)
from .messages import pose_template
from .pose_bytes import frame_bytes
from .recorder import RecordedTopic

_NONE = np.full(7, -1)
_TAKEN = (types.int64, types.Array(types.uint8, 1, "C"), types.int64, types.float64)
"""numba's types of what `device_bytes.take_in` takes beside the Inlet."""


class Source(NamedTuple):
    """A topic of the device: what comes there, the parameter that names it, its name, and its class of messages."""

    what: int
    key: str
    topic: str
    kind: Any


class DeviceIn:
    """Makes commands of what a device's driver sends.

    device : None: command_pose is used as it comes
    record : for compiled code
    sources : what is subscribed to: first the poses, then others
    """

    def __init__(self, device: Device | None, world_frame: str, clutched: Any) -> None:
        """clutched: see Inlet. Raises SceneError for a topic or type of no use."""
        self.device = device
        said = device or Device()
        given, clutch = said.command_input, said.clutch
        self.sources = [_source(POSITION, "command_input.", given.topic, given.type)]
        if given.orientation_topic:
            topic, kind = given.orientation_topic, given.orientation_type
            self.sources.append(_source(ORIENTATION, "command_input.orientation_", topic, kind))
        if clutch is not None:
            self.sources.append(_source(CLUTCH, "clutch.", clutch.topic, clutch.type))
        template = pose_template(world_frame)
        place = said.device_frame
        frame = given.frame or (world_frame if given.topic == COMMANDS and POSES[given.type].header else "")
        self._frame = frame
        record = Inlet(
            active=_ints(device is not None),
            roles=np.array([source.what for source in self.sources[1:]], np.int64),
            layout=np.array([POSES[given.type], TURNS[given.orientation_type], Layout(False)], np.int64),
            columns=np.array([_columns(POSES[given.type], given.columns), _turns(given)]),
            frame=frame_bytes(frame),
            child=frame_bytes(given.child_frame),
            unit=np.array([given.unit]),
            own=_ints(bool(given.orientation_topic)),
            turned=_ints(0),
            place=build_frame(place.turn, place.scale, place.offset, place.tool),
            grip=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            raw=np.zeros(7),
            clutched=clutched,
            opens=_ints(clutch is None or clutch.opens == "pressed"),
            anew=_ints(0),
            mapped=_ints(0),
            held=np.zeros(7),
            message=template.bytes,
            at=_ints(template.blocks[0]),
            button=np.frombuffer(bytearray(cdr.truth(False)), np.uint8),
            why=_ints(0),
        )
        if clutch is not None:
            record.layout[CLUTCH, LISTED], record.layout[CLUTCH, COUNT] = clutch.type == "Joy", clutch.button
        if given.fixed is not None:
            record.columns[POSITION, 3:] = -1
            record.grip[3:] = handle_at(record.place, given.fixed)
        self.record, self._template = record, template
        self._held = held(record)
        self._take_in = direct(device_bytes.take_in, self._held, *_TAKEN)

    @property
    def active(self) -> bool:
        """Whether commands are made here."""
        return self.device is not None

    @property
    def command(self) -> bytes:
        """The command that was made last, as PoseStamped."""
        return self.record.message.tobytes()

    @property
    def button(self) -> bytes:
        """The clutch, as it is recorded."""
        return self.record.button.tobytes()

    def recorded_topics(self, node: Any) -> list[RecordedTopic]:
        """What a recording holds beside commands."""
        if not any(source.what == CLUTCH for source in self.sources):
            return []
        return [RecordedTopic(str(node.resolve_service_name(f"~/{changes.CLUTCH}")), cdr.BOOL, changes.CLUTCH_QOS)]

    def take_in(self, what: int, data: bytes, received: int, timeout: float) -> int:
        """`device_bytes.take_in` of a message in bytes."""
        return int(self._take_in(self._held, what, np.frombuffer(bytearray(data), np.uint8), received, timeout))

    def words(self, what: int, why: int) -> str:
        """Why the last message of a kind makes no command."""
        said = (self.device or Device()).command_input
        topic = next((source.topic for source in self.sources if source.what == what), "")
        fields = zip(NUMBERS, self.record.raw.tolist(), strict=True)
        return {
            CUT: f"message on {topic} cut short",
            ENCODING: f"message on {topic} in an encoding that is not little-endian CDR",
            STAMP: f"message on {topic} with a stamp that is no time",
            FRAME: f"frames of {topic} are others, must be "
            + " to ".join(repr(name) for name in (self._frame, said.child_frame) if name),
            FEW: f"message on {topic} has too few entries for what is said of it",
            NO_TURN: f"no orientation has come on {said.orientation_topic}",
            OLD_TURN: f"the last orientation on {said.orientation_topic} is older than command_timeout",
        }.get(why, f"no pose on {topic}: {', '.join(f'{name} {value:g}' for name, value in fields)}")


def _source(what: int, prefix: str, topic: str, kind: str) -> Source:
    """Raises SceneError."""
    key = f"{prefix}topic"
    return Source(what, key, checked_topic(key, topic), message_class(f"{prefix}type", kind))


def message_class(key: str, name: str) -> Any:
    """The class of a message type by its short or full name. Raises SceneError where it is not installed."""
    package, _, kind = name.rpartition("/msg/")
    package, kind = package or PACKAGES[name], "TFMessage" if name == "tf" else kind
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError, ValueError):
        advice = "; the wheels have no tf2: take a system ROS 2" if name == "tf" else ""
        raise SceneError(key, name, f"a type that is installed here: no {package}/msg/{kind} is{advice}") from None


def checked_topic(key: str, name: str) -> str:
    """The name of a topic. Raises SceneError."""
    try:
        validate_topic_name(name)
    except InvalidTopicNameException as error:
        raise SceneError(key, name, f"the name of a topic: {' '.join(str(error).split())}") from None
    return name


def _columns(layout: Layout, names: str) -> Any:
    """Which number is which of a pose: by name, or in their order."""
    columns = _NONE.copy()
    if layout.element:
        for k, name in enumerate(names.split()):
            if name in NUMBERS:
                columns[NUMBERS.index(name)] = k
    else:
        columns[: layout.size] = range(layout.size)
    return columns


def _turns(given: Any) -> Any:
    """The same of an orientation that comes by itself."""
    columns = _NONE.copy()
    if TURNS[given.orientation_type].element:
        return _columns(TURNS[given.orientation_type], given.orientation_columns)
    columns[3:] = range(4)
    return columns


def _ints(value: int) -> Any:
    return np.array([value], np.int64)

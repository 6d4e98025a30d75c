"""What joins a device: where its poses come from, where forces go, how its frame lies in the world, its clutch.

A YAML file, the node's parameters of the same names, or both say it; config/devices/ has ready ones. It needs no ROS.
"""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple

from ..bags.imports.turns import ALLOWED, parsed_turn
from ..errors import BagError, SceneError
from ..physics.rotations import Quaternion
from ..scene import Parameter, Vec3
from ..scene.fields import UNKNOWN_KEY, field, parse_part, specs, to_dict
from ..scene.pose import FARTHEST
from ..scene.resources import find_device
from ..scene.ros_values import from_ros
from ..scene.yaml_text import YamlText

COMMANDS = "command_pose"
"""Where commands come from unless a device says otherwise, and the name under which they are recorded."""
FLAT: Quaternion = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""Orientation of a finger whose device has none: nail up, tip to the world's x."""


class Layout(NamedTuple):
    """Where a message has its numbers."""

    header: bool
    child: bool = False
    """Whether a child_frame_id comes before them."""
    listed: bool = False
    """Whether it is a list of such, of which one is wanted."""
    element: int = 0
    """Bytes of a number of an array; 0: there are `size` of eight bytes."""
    size: int = 0


ARRAYS = {"Float32MultiArray": Layout(False, element=4), "Float64MultiArray": Layout(False, element=8)}
POSES = {
    "PoseStamped": Layout(True, size=7),
    "Pose": Layout(False, size=7),
    "PointStamped": Layout(True, size=3),
    "Point": Layout(False, size=3),
    "TransformStamped": Layout(True, child=True, size=7),
    **ARRAYS,
    "tf": Layout(True, child=True, listed=True, size=7),
}
"""What poses may come as."""
TURNS = {**ARRAYS, "Quaternion": Layout(False, size=4), "QuaternionStamped": Layout(True, size=4)}
"""What orientations of their own may come as."""
PACKAGES = {
    **dict.fromkeys(ARRAYS, "std_msgs"), "Bool": "std_msgs", "Joy": "sensor_msgs", "tf": "tf2_msgs",
    **dict.fromkeys(("PoseStamped", "Pose", "PointStamped", "Point", "TransformStamped"), "geometry_msgs"),
    **dict.fromkeys(("Quaternion", "QuaternionStamped"), "geometry_msgs"),
    **dict.fromkeys(("Wrench", "WrenchStamped", "Vector3", "Vector3Stamped"), "geometry_msgs"),
}  # fmt: skip
"""Packages of the types that have a short name."""
NUMBERS = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Numbers of a pose, as columns name them."""
UNUSED = "-"
WORDS = ("fx", "fy", "fz", "tx", "ty", "tz", "force", "intensity", "0")
"""What a number of a message to a device may be: of force [N] and torque [N m], the size of the force [N], the same as
a part of full_scale from 0 to 1, and nothing."""
_FORCE = {"x": "fx", "y": "fy", "z": "fz"}
_WRENCH = {f"{name}.{axis}": f"{name[0]}{axis}" for name in ("force", "torque") for axis in "xyz"}
FIELDS = {
    "Wrench": _WRENCH,
    "WrenchStamped": {f"wrench.{name}": word for name, word in _WRENCH.items()},
    "Vector3": _FORCE,
    "Vector3Stamped": {f"vector.{name}": word for name, word in _FORCE.items()},
}
"""What the fields of messages hold unless it is said."""
_FULL_NAME = re.compile(r"[a-z]\w*/msg/[A-Z]\w*")


def _turn(key: str, text: str, of_axes: bool = False) -> Quaternion:
    """Raises SceneError."""
    try:
        return parsed_turn(key, text, of_axes).quaternion
    except BagError:
        raise SceneError(key, text, f"{ALLOWED}, right-handed") from None


@dataclasses.dataclass(frozen=True)
class CommandInput:
    """Where poses of the device's handle come from."""

    topic: str = field("text", "Topic of the poses", default=COMMANDS)
    type: str = field(
        "choice", "Their message type; tf: a pair of frames in a list of transforms", default="PoseStamped",
        choices=tuple(POSES),
    )  # fmt: skip
    frame: str = field("text", "frame_id that a header must have; empty: any", default="")
    child_frame: str = field("text", "child_frame_id that a transform must have; empty: any", default="")
    columns: str = field(
        "text", f"What the numbers of an array are: {' '.join(NUMBERS)}, and {UNUSED} for others", default=""
    )
    unit: float = field(
        "float", "Length of one unit of positions: 0.001 for millimetres", default=1.0, unit="m", low=1e-6, high=1e3
    )
    orientation: Quaternion | None = field(
        "quaternion", "Orientation of the finger in the world instead of the handle's", default=None, optional=True
    )
    orientation_topic: str = field("text", "Topic of orientations, where they come by themselves", default="")
    orientation_type: str = field("choice", "Their message type", default="Float32MultiArray", choices=tuple(TURNS))
    orientation_columns: str = field("text", "What the numbers of their array are", default="qx qy qz qw")

    def check(self, prefix: str) -> None:
        names = self.columns.split()
        array = self.type in ARRAYS
        if array != bool(names):
            words = f"names such as 'x y z', as {self.type} is an array" if array else f"nothing, as of {self.type}"
            raise SceneError(f"{prefix}columns", self.columns, words)
        if array:
            _check_columns(f"{prefix}columns", self.columns, NUMBERS[:3], NUMBERS[3:])
        if self.type == "tf" and not (self.frame and self.child_frame):
            name = "child_frame" if self.frame else "frame"
            raise SceneError(f"{prefix}{name}", "", "the name of a frame, as type is tf")
        if self.orientation_topic:
            if self.orientation is not None:
                raise SceneError(f"{prefix}orientation", self.orientation, "null, as there is an orientation_topic")
            if self.turned_by_message:
                raise SceneError(f"{prefix}orientation_topic", self.orientation_topic, "none: poses have orientations")
            if self.orientation_type in ARRAYS:
                _check_columns(f"{prefix}orientation_columns", self.orientation_columns, NUMBERS[3:], ())

    @property
    def turned_by_message(self) -> bool:
        """Whether messages with positions have orientations too."""
        return "qw" in self.columns.split() if self.type in ARRAYS else POSES[self.type].size == 7

    @property
    def fixed(self) -> Quaternion | None:
        """The finger's orientation, where the device has nothing to say about it."""
        if self.orientation is not None or self.orientation_topic or self.turned_by_message:
            return self.orientation
        return FLAT


@dataclasses.dataclass(frozen=True)
class DeviceFrame:
    """How the device's frame lies in the world; see haptics/device_frame.py."""

    axes: str = field(
        "text", "The world's axes in the device's, as 'x=-y y=x z=z', or a quaternion 'x y z w'", default="x=x y=y z=z"
    )
    scale: float = field(
        "float", "Motion of the finger by that of the handle; forces are scaled alike", default=1.0, low=1e-3, high=1e3
    )
    offset: Vec3 = field(
        "vec3", "Where the device's origin is in the world", default=(0.0, 0.0, 0.0), unit="m", low=-FARTHEST,
        high=FARTHEST,
    )  # fmt: skip
    rotate: str = field(
        "text",
        "How the finger sits on the handle: its axes in the handle's, as 'x=z y=-x z=-y', or a quaternion",
        default="x=x y=y z=z",
    )

    def check(self, prefix: str) -> None:
        _turn(f"{prefix}axes", self.axes)
        _turn(f"{prefix}rotate", self.rotate)

    @property
    def turn(self) -> Quaternion:
        """R: the device's axes to the world's."""
        return _turn("axes", self.axes)

    @property
    def tool(self) -> Quaternion:
        """T: the finger's orientation in the handle's axes."""
        return _turn("rotate", self.rotate, of_axes=True)


@dataclasses.dataclass(frozen=True)
class Clutch:
    """A button that lets the handle be moved to another place: the finger stays, and nothing pushes."""

    topic: str = field("text", "Topic of the button")
    type: Literal["Bool", "Joy"] = field("choice", "Its message type", default="Bool", choices=("Bool", "Joy"))
    button: int = field("int", "Number of the button in Joy, the first is 0", default=0, low=0, high=1000)
    opens: Literal["pressed", "released"] = field(
        "choice", "What opens the clutch", default="pressed", choices=("pressed", "released")
    )


@dataclasses.dataclass(frozen=True)
class DeviceOutput:
    """One thing that is sent to a device, made of each step's device_wrench."""

    topic: str = field("text", "Topic to send on")
    type: str = field("text", "Message type: Wrench, WrenchStamped, Vector3, …, or package/msg/Type")
    rate: float = field("float", "Messages a second; 0: one for each step", default=0.0, unit="Hz", low=0.0, high=1e5)
    axes: Literal["device", "handle", "world"] = field(
        "choice",
        "Axes of force and torque: the device's, those of its handle, or the world's, without scale",
        default="device",
        choices=("device", "handle", "world"),
    )
    columns: str = field("text", f"What the numbers of an array are: {' '.join(WORDS)}, each with a sign", default="")
    fields: str = field("text", "What other fields hold, as 'force.x=fx force.y=-fz'; others stay 0", default="")
    frame: str = field("text", "frame_id of a header; empty: that of command_input, or of the axes", default="")
    limit: float | None = field(
        "float",
        "Force beyond which it is scaled back; coupling.force_limit holds too",
        default=None,
        optional=True,
        unit="N",
        low=0.0,
        high=1e4,
    )
    full_scale: float = field("float", "Force of the intensity 1", default=5.0, unit="N", low=1e-3, high=1e4)

    def check(self, prefix: str) -> None:
        if self.type not in FIELDS and self.type not in ARRAYS and not _FULL_NAME.fullmatch(self.type):
            short = ", ".join([*FIELDS, *ARRAYS])
            raise SceneError(f"{prefix}type", self.type, f"{short}, or a full name such as omni_msgs/msg/OmniFeedback")
        array = self.short_type in ARRAYS
        if array != bool(self.columns.split()):
            words = "words such as 'fx fy fz', as it is an array" if array else f"nothing, as of {self.type}"
            raise SceneError(f"{prefix}columns", self.columns, words)
        if array and self.fields:
            raise SceneError(f"{prefix}fields", self.fields, "nothing, as columns say it")
        for name in ("columns", "fields"):
            for word in getattr(self, name).split():
                value = word.partition("=")[2] if name == "fields" else word
                if value.removeprefix("-") not in WORDS:
                    one = "force.x=fx" if name == "fields" else "fx"
                    raise SceneError(f"{prefix}{name}", word, f"words such as {one}, of {', '.join(WORDS)}")
        if not self.numbers:
            raise SceneError(f"{prefix}fields", self.fields, f"the fields of {self.type} to be set, as 'force.x=fx'")

    @property
    def short_type(self) -> str:
        """The type without its package where that is the usual one."""
        package, _, name = self.type.partition("/msg/")
        return name if PACKAGES.get(name) == package else self.type

    @property
    def numbers(self) -> dict[str, str]:
        """What each field holds, by the field's dotted name; entries of an array are data.0, data.1 and so on."""
        if self.columns:
            return {f"data.{k}": word for k, word in enumerate(self.columns.split())}
        if self.fields:
            return {name: word for name, _, word in (each.partition("=") for each in self.fields.split())}
        return FIELDS.get(self.short_type, {})


@dataclasses.dataclass(frozen=True)
class Device:
    """All that is said of a device."""

    command_input: CommandInput = field("part", "Where poses come from", default=CommandInput(), part=CommandInput)
    device_frame: DeviceFrame = field("part", "The device's frame", default=DeviceFrame(), part=DeviceFrame)
    clutch: Clutch | None = field("part", "The clutch; left out: none", default=None, optional=True, part=Clutch)
    device_output: tuple[DeviceOutput, ...] = ()
    """What is sent; beside `device_wrench`, which always is."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values; `parsed` gives the device back."""
        return to_dict(self) | {OUTPUTS: [to_dict(output) for output in self.device_output]}

    def parameters(self) -> Iterator[Parameter]:
        """Every value under its dotted name, those of the list under device_output_0, device_output_1 and so on."""
        for name, part in (("command_input", self.command_input), ("device_frame", self.device_frame)):
            yield from _parameters(part, f"{name}.")
        if self.clutch is not None:
            yield from _parameters(self.clutch, "clutch.")
        for number, output in enumerate(self.device_output):
            yield from _parameters(output, f"{OUTPUTS}_{number}.")


OUTPUTS = "device_output"
BLOCKS = (*specs(Device), OUTPUTS)
_ENTRY = re.compile(rf"{OUTPUTS}_([0-9]{{1,3}})")
"""How parameters name an entry of the list; rcl takes no name that begins with a number."""


def device_from(name: str, overrides: Mapping[str, Any]) -> Device | None:
    """The device of a file, or a shipped one, with the ROS parameters that begin as its blocks; None without any.

    Raises SceneError, which names the place, the value and what is allowed.
    """
    ours = {key: value for key, value in overrides.items() if _place(key)[0] in BLOCKS}
    data: Any = {}
    if name:
        text = YamlText(find_device(name))
        data = text.data
        try:
            device = parsed(data)
        except SceneError as error:
            raise text.located(error) from None
        if not ours:
            return device
    return parsed(_overridden(data, ours)) if ours else None


def told(name: str, device: Device) -> str:
    """What joins the node to a device, for the log of a node that begins."""
    poses = " and ".join(filter(None, (device.command_input.topic, device.command_input.orientation_topic)))
    sent = ", ".join(f"{output.topic} ({output.type})" for output in device.device_output)
    clutch = f"; clutch on {device.clutch.topic}" if device.clutch is not None else ""
    scale = device.device_frame.scale
    scaled = f"; motion and force are scaled by {scale:g}" if scale != 1.0 else ""
    return f"device {name or 'of parameters'}: poses from {poses}; forces to {sent or 'nothing'}{clutch}{scaled}"


def parsed(data: Any) -> Device:
    """The device of plain values. Raises SceneError."""
    known = ", ".join(BLOCKS)
    if not isinstance(data, Mapping):
        raise SceneError("device", data, f"a block with the keys {known}")
    for name in data:
        if name not in BLOCKS:
            raise SceneError(str(name), data[name], f"{UNKNOWN_KEY}; known here: {known}")
    blocks = dict(data)
    outputs = blocks.pop(OUTPUTS, [])
    if not isinstance(outputs, list | tuple):
        raise SceneError(OUTPUTS, outputs, f"a list of blocks with the keys {', '.join(specs(DeviceOutput))}")
    device = parse_part(Device, blocks)
    made = tuple(parse_part(DeviceOutput, output, f"{OUTPUTS}[{k}]") for k, output in enumerate(outputs))
    for k, output in enumerate(made):
        if output.axes == "handle" and device.command_input.fixed is not None:
            raise SceneError(f"{OUTPUTS}[{k}].axes", "handle", "device or world: the handle tells no orientation")
    return dataclasses.replace(device, device_output=made)


def _check_columns(key: str, text: str, needed: tuple[str, ...], possible: tuple[str, ...]) -> None:
    """Raises SceneError unless all needed numbers are named, all or none of the possible ones, and none twice."""
    names = [name for name in text.split() if name != UNUSED]
    wanted = {*needed, *(possible if set(possible) & set(names) else ())}
    if len(names) != len(set(names)) or set(names) != wanted:
        also = f", with {' '.join(possible)} or without" if possible else ""
        raise SceneError(key, text, f"{' '.join(needed)} in any order, once each{also}; {UNUSED} for other numbers")


def _parameters(part: Any, prefix: str) -> Iterator[Parameter]:
    for name, spec in specs(type(part)).items():
        yield Parameter(prefix + name, getattr(part, name), spec)


def _overridden(data: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values with those of dotted keys in their places. Raises SceneError for a key that has no place."""
    out = copy.deepcopy(dict(data))
    kinds = {"command_input": CommandInput, "device_frame": DeviceFrame, "clutch": Clutch, OUTPUTS: DeviceOutput}
    for key, value in sorted(overrides.items(), key=lambda item: _place(item[0])):
        block, number, name = _place(key)
        known = specs(kinds[block])
        if number >= 0:
            outputs = out[block] = [dict(output) for output in out.get(block) or []]
            if number > len(outputs):
                raise SceneError(key, _short(value), f"{OUTPUTS}_0 to {OUTPUTS}_{len(outputs)}, as the list goes on")
            if number == len(outputs):
                outputs.append({})
            part = outputs[number]
        elif not name or block == OUTPUTS:
            keys = f"{OUTPUTS}_0.topic and others" if block == OUTPUTS else f"{block}.{next(iter(known))} and others"
            raise SceneError(key, _short(value), f"no value: a block, of which the parameters are {keys}")
        else:
            part = out[block] = dict(out.get(block) or {})
        part[name] = from_ros(value, known[name]) if name in known else value
    return out


def _place(key: str) -> tuple[str, int, str]:
    """Block of a parameter, its number in the list of outputs (else -1), and its name there."""
    block, _, name = key.partition(".")
    match = _ENTRY.fullmatch(block)
    return (OUTPUTS, int(match[1]), name) if match else (block, -1, name)


def _short(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value

"""ROS parameters out of the scene's typed fields: names, units, ranges, docs and refusals have one source.

A value that YAML writes as null has no ROS type; a parameter has "" (text) or inf (number, axis of a limit)
there.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter as RosParameter

from ..bags.layout import WRENCH_FRAMES
from ..bags.reader import Compression
from ..errors import SceneError
from ..scene import Parameter, Scene
from ..scene.fields import Field, field, parse_part, specs

ARRAY_KINDS = ("vec3", "quaternion", "limit3")


@dataclasses.dataclass(frozen=True)
class NodeOptions:
    """What the node does around the simulation."""

    scene: str = field("text", "Scene file, or the name of a shipped scene", default="finger")
    world_frame: str = field(
        "text", "Frame of commands and of the mesh; a command in another is refused", default="world"
    )
    finger_frame: str = field("text", "Name of the finger frame", default="finger")
    wrench_frame: Literal["world_aligned", "finger", "world"] = field(
        "choice",
        "Axes and point of reference of contact_wrench",
        default="world_aligned",
        choices=WRENCH_FRAMES,
    )
    command_timeout: float = field(
        "float",
        "A command received longer ago is stale: the pose is held, device_wrench is zero",
        default=0.1,
        unit="s",
        low=1e-3,
        high=3600.0,
        live=True,
    )
    mesh_rate: float = field(
        "float", "Rate of mesh_points; 0: off", default=60.0, unit="Hz", low=0.0, high=1000.0, live=True
    )
    marker_rate: float = field(
        "float", "Rate of mesh_marker; 0: off", default=10.0, unit="Hz", low=0.0, high=60.0, live=True
    )
    marker_color: str = field(
        "choice",
        "What the colour of mesh_marker shows",
        default="strain",
        choices=("strain", "pressure"),
        live=True,
    )
    marker_pressure: float = field(
        "float",
        "Contact pressure shown in the last colour of mesh_marker",
        default=20e3,
        unit="Pa",
        low=1.0,
        high=1e9,
        live=True,
    )
    mode: Literal["free", "triggered"] = field(
        "choice",
        "free: steps at the rate 1/dt follow the newest command; triggered: one step for each command, with its stamp",
        default="free",
        choices=("free", "triggered"),
    )
    cpu_affinity: str = field(
        "text", "Processors that the loop's thread may run on, as in 1 or 0,2-3; empty: any", default=""
    )
    realtime_priority: int = field(
        "int",
        "Priority of the loop's thread under SCHED_FIFO, where the system permits it; 0: as any other thread",
        default=0,
        low=0,
        high=99,
    )
    force_scale: float = field(
        "float",
        "What the clamped device_wrench is multiplied by; the clamps hold after it too",
        default=1.0,
        low=0.0,
        high=100.0,
        live=True,
    )
    force_ramp: float = field(
        "float",
        "Time in which device_wrench comes in when commands start or resume",
        default=0.2,
        unit="s",
        low=0.0,
        high=60.0,
        live=True,
    )
    passivity: Literal["observe", "control"] = field(
        "choice",
        "observe: the energy that leaks to the device is reported; control: and held by scaling device_wrench down",
        default="observe",
        choices=("observe", "control"),
        live=True,
    )
    device_damping: float = field(
        "float",
        "Damping b of the device, for the stable stiffness b / (T/2 + delay) in diagnostics",
        default=0.8,
        unit="N s/m",
        low=0.0,
        high=1e3,
        live=True,
    )
    record: str = field("text", "Bag to record from the start to its end; empty: none", default="")
    record_directory: str = field("text", "Where ~/record makes its bags", default=".", live=True)
    record_compression: Compression = field(
        "choice",
        "Of the chunks of a bag; a change holds from the next recording on, as those of record_split_… do",
        default="zstd",
        choices=get_args(Compression),
        live=True,
    )
    record_split_size: float = field(
        "float",
        "Size at which a recording goes on in a new file; 0: never",
        default=0.0,
        unit="MB",
        low=0.0,
        high=1e6,
        live=True,
    )
    record_split_time: float = field(
        "float",
        "Time after which a recording goes on in a new file; 0: never",
        default=0.0,
        unit="s",
        low=0.0,
        high=1e6,
        live=True,
    )
    record_queue: int = field(
        "int",
        "Messages that may wait to be written; more are dropped and counted",
        default=20_000,
        low=1,
        high=1_000_000,
    )


def node_parameters(options: NodeOptions) -> Iterable[Parameter]:
    """The node's own parameters."""
    for name, spec in specs(NodeOptions).items():
        yield Parameter(name, getattr(options, name), spec)


def to_ros(value: Any, spec: Field) -> Any:
    """The value of a ROS parameter for a field's value."""
    if value is None:
        return "" if spec.kind in ("text", "choice") else [math.inf] * 3 if spec.kind in ARRAY_KINDS else math.inf
    if hasattr(value, "as_plain"):
        return yaml.safe_dump(value.as_plain(), default_flow_style=True).strip()
    if spec.kind in ARRAY_KINDS:
        return [math.inf if item is None else float(item) for item in value]
    return list(value) if isinstance(value, tuple) else value


def from_ros(value: Any, spec: Field) -> Any:
    """The plain value for `Scene` of a ROS parameter's value; `Field.parse` judges it."""
    if spec.optional and value in ("", math.inf):
        return None
    if spec.kind == "limit3" and not isinstance(value, str | bool | int | float):
        return [None if item == math.inf else item for item in value]
    if spec.kind == "text" and type(value) is int:
        return str(value)
    if spec.kind == "text" and isinstance(value, str) and value.lstrip().startswith("{"):
        try:
            return yaml.safe_load(value)
        except yaml.YAMLError:
            return value
    return value


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Description, unit and range of a parameter, as `ros2 param describe` shows them."""
    spec = parameter.spec
    unit = f" [{spec.unit}]" if spec.unit else ""
    null = '; null is written ""' if spec.kind == "text" else "; null is written inf"
    nullable = spec.optional or spec.kind == "limit3"
    out = ParameterDescriptor(
        name=parameter.name,
        description=f"{spec.doc}{unit}",
        additional_constraints=spec.allowed + (null if nullable else ""),
        read_only=not spec.live,
    )
    if spec.kind == "int":
        out.integer_range = [IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=0)]
    elif spec.kind not in ("text", "choice", "bool", "cells") and math.isfinite(spec.low):
        high = math.inf if nullable else float(spec.high)
        out.floating_point_range = [FloatingPointRange(from_value=float(spec.low), to_value=high, step=0.0)]
    return out


def declare(node: Any, parameters: Iterable[Parameter]) -> None:
    """Declares parameters at their present values, overrides already in them."""
    for parameter in parameters:
        node.declare_parameter(
            parameter.name,
            to_ros(parameter.value, parameter.spec),
            descriptor(parameter),
            ignore_override=True,
        )


def options_from(overrides: Mapping[str, Any]) -> NodeOptions:
    """The node's options with ROS overrides applied. Raises SceneError naming the parameter."""
    known = specs(NodeOptions)
    return parse_part(
        NodeOptions,
        {name: from_ros(overrides[name], spec) for name, spec in known.items() if name in overrides},
    )


def scene_from(scene: Scene, overrides: Mapping[str, Any]) -> Scene:
    """The scene with ROS overrides applied. Raises SceneError naming the parameter."""
    changes = {p.name: from_ros(overrides[p.name], p.spec) for p in scene.parameters() if p.name in overrides}
    return scene.with_values(changes) if changes else scene


def processors(text: str) -> set[int]:
    """The processors of `cpu_affinity`; none for an empty one. Raises SceneError for what this process may not use."""
    may = os.sched_getaffinity(0)
    found: set[int] = set()
    for part in filter(None, text.replace(" ", "").split(",")):
        first, _, last = part.partition("-")
        ends = [int(end) if end.isdecimal() else -1 for end in (first, last or first)]
        if not set(ends) <= may or ends[0] > ends[1]:
            these = ",".join(map(str, sorted(may)))
            raise SceneError("cpu_affinity", text, f"numbers and ranges, as in 1 or 0,2-3, of the processors {these}")
        found |= {number for number in may if ends[0] <= number <= ends[1]}
    return found


def unknown(overrides: Iterable[str], known: Iterable[str]) -> dict[str, str]:
    """Overrides that name no parameter, each with the nearest name there is ("" if none is near)."""
    import difflib

    names = list(known)
    return {
        name: next(iter(difflib.get_close_matches(name, names, n=1)), "")
        for name in overrides
        if name not in names and not name.startswith("qos_overrides.")
    }


def widen(parameters: list[Any], declared: Mapping[str, Any]) -> list[Any]:
    """Whole numbers made floating-point where the declared parameter is that (`ros2 param set … 1`)."""
    kind = RosParameter.Type
    out = []
    for given in parameters:
        wanted = declared[given.name].type_ if given.name in declared else None
        if wanted == kind.DOUBLE and given.type_ == kind.INTEGER:
            given = RosParameter(given.name, wanted, float(given.value))
        elif wanted == kind.DOUBLE_ARRAY and given.type_ == kind.INTEGER_ARRAY:
            given = RosParameter(given.name, wanted, [float(item) for item in given.value])
        out.append(given)
    return out


def live_changes(parameters: Iterable[Any], scene: Scene, options: NodeOptions) -> tuple[dict[str, Any], NodeOptions]:
    """What a set request changes: dotted scene keys with plain values, and the node's options after it.

    Raises SceneError naming the parameter, its value and the allowed range.
    """
    values = {p.name: p.value for p in parameters}
    known = {p.name: p.spec for p in scene.parameters()}
    changes = {name: from_ros(value, known[name]) for name, value in values.items() if name in known}
    if changes:
        scene.with_values(changes)
    own = {
        name: from_ros(value, spec)
        for name, spec in specs(NodeOptions).items()
        if (value := values.get(name)) is not None
    }
    options = parse_part(NodeOptions, dataclasses.asdict(options) | own)
    return changes, options

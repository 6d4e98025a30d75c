"""ROS parameters out of the scene's typed fields: names, units, ranges, docs and refusals have one source."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter as RosParameter

from ..bags import cdr
from ..bags.template import Template
from ..errors import SceneError
from ..scene import Parameter, Scene
from ..scene.fields import Field, parse_part, specs
from ..scene.reference import dotted
from ..scene.ros_values import from_ros, plain, to_ros
from .device import Device
from .options import NodeOptions

QOS = "qos_overrides."
"""How the names of ROS's own parameters for qualities of service begin."""


def node_parameters(options: NodeOptions) -> Iterable[Parameter]:
    """The node's own parameters."""
    for name, spec in specs(NodeOptions).items():
        yield Parameter(name, getattr(options, name), spec)


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
    elif spec.kind not in ("text", "choice", "bool", "cells", "parts") and math.isfinite(spec.low):
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


def device_parameters(device: Device | None) -> Iterable[Parameter]:
    """Those of the device; none without one."""
    return () if device is None else device.parameters()


def options_from(overrides: Mapping[str, Any]) -> NodeOptions:
    """The node's options with ROS overrides applied. Raises SceneError naming the parameter."""
    known = specs(NodeOptions)
    given = {name: from_ros(overrides[name], spec) for name, spec in known.items() if name in overrides}
    with _explained(known):
        return parse_part(NodeOptions, given)


def scene_from(scene: Scene, overrides: Mapping[str, Any]) -> Scene:
    """The scene with ROS overrides applied. Raises SceneError naming the parameter."""
    known = {p.name: p.spec for p in scene.parameters()}
    changes = {name: from_ros(overrides[name], spec) for name, spec in known.items() if name in overrides}
    with _explained(known):
        return scene.with_values(changes) if changes else scene


@contextmanager
def _explained(known: Mapping[str, Field]) -> Iterator[None]:
    """A refused value's error also says what the parameter is for: a type alone does not tell what is wanted."""
    try:
        yield
    except SceneError as error:
        spec = known.get(error.key.partition("[")[0])
        if spec is None:
            raise
        raise SceneError(error.key, error.value, f"{error.allowed} ({spec.doc})", source=error.source) from None


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


def require_known(overrides: Mapping[str, Any], node: Any, scene: Scene, file: str) -> None:
    """Raises SceneError naming the first override that no parameter of the node, ROS's own among them, takes.

    It names the nearest parameter, or the block that the scene in `file` does not have.
    """
    possible = {name for part in (NodeOptions, Scene) for name, _, _ in dotted(part)}
    known = {p.name for p in scene.parameters()} | set(specs(NodeOptions))
    for name, value in overrides.items():
        if node.has_parameter(name) or name.startswith(QOS):
            continue
        if name in possible:
            block = name.rpartition(".")[0]
            raise SceneError(name, plain(value), f"no value: the scene {file} has no block {block!r}")
        near = nearest(name, known)
        hint = f"; did you mean {near}?" if near else ""
        raise SceneError(name, plain(value), f"no value: the node has no such parameter{hint}")


def unused_qualities(overrides: Iterable[str], node: Any) -> Iterator[str]:
    """What to say of each override of a quality of service that changes nothing; for a node with its subscriptions."""
    own = [QOS + name for name in node.get_parameters_by_prefix(QOS.rstrip("."))]
    for name in overrides:
        if name.startswith(QOS) and name not in own and not name.startswith(f"{QOS}/clock."):
            near = nearest(name, own)
            yield f"parameter {name} changes nothing here" + (f"; did you mean {near}?" if near else "")


def forces(options: NodeOptions, scene: Scene) -> str:
    """What bounds the forces on a device, for the log of a node that begins."""
    clamps = scene.coupling
    return (
        f"device_wrench: force_scale {options.force_scale:g}, coupling.force_limit {clamps.force_limit:g} N, "
        f"coupling.torque_limit {clamps.torque_limit:g} N m"
    )


def nearest(name: str, names: Iterable[str]) -> str:
    """The one most like `name`; "" if none is near."""
    import difflib

    spelled = {known.lower(): known for known in sorted(names)}
    return next((spelled[near] for near in difflib.get_close_matches(name.lower(), spelled, n=1)), "")


def widen(given: list[Any], node: Any) -> list[Any]:
    """Whole numbers made floating-point where the node's parameter is that (`ros2 param set … 1`)."""
    kind = RosParameter.Type
    out = []
    for parameter in given:
        name, value = parameter.name, parameter.value
        wanted = kind(node.get_parameter_type(name)) if node.has_parameter(name) else None
        if (wanted, parameter.type_) == (kind.DOUBLE, kind.INTEGER):
            parameter = RosParameter(name, kind.DOUBLE, float(value))
        elif (wanted, parameter.type_) == (kind.DOUBLE_ARRAY, kind.INTEGER_ARRAY):
            parameter = RosParameter(name, kind.DOUBLE_ARRAY, [float(item) for item in value])
        out.append(parameter)
    return out


def event(node: str, given: Iterable[Any]) -> Template:
    """What /parameter_events tells of a set request to the node of that name, as rclpy sends it; to be stamped."""
    return Template(cdr.parameter_event(0, node, {parameter.name: plain(parameter.value) for parameter in given}))


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

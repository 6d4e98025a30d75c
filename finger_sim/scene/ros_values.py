"""Values of fields as ROS parameters have them, and back; needs no ROS.

A value that YAML writes as null has no ROS type; a parameter has "" (text) or inf (number, axis of a limit)
there. Nor have blocks, or lists of them: a parameter has their YAML as a text.
"""

from __future__ import annotations

import math
from typing import Any

import yaml

from .fields import Field, to_dict

ARRAY_KINDS = ("vec3", "quaternion", "limit3")


def to_ros(value: Any, spec: Field) -> Any:
    """The value of a ROS parameter for a field's value."""
    if value is None:
        count = {"quaternion": 4}.get(spec.kind, 3)
        return "" if spec.kind in ("text", "choice") else [math.inf] * count if spec.kind in ARRAY_KINDS else math.inf
    if spec.kind == "parts":
        return yaml.safe_dump([to_dict(item) for item in value], default_flow_style=True, sort_keys=False).strip()
    if hasattr(value, "as_plain"):
        return yaml.safe_dump(value.as_plain(), default_flow_style=True).strip()
    if spec.kind in ARRAY_KINDS:
        return [math.inf if item is None else float(item) for item in value]
    return list(value) if isinstance(value, tuple) else value


def from_ros(value: Any, spec: Field) -> Any:
    """The plain value for `Scene` of a ROS parameter's value; `Field.parse` judges it."""
    value = plain(value)
    if spec.optional and (value in ("", math.inf) or (isinstance(value, list) and set(value) == {math.inf})):
        return None
    if spec.kind == "limit3" and isinstance(value, list | tuple):
        return [None if item == math.inf else item for item in value]
    if spec.kind == "text" and type(value) is int:
        return str(value)
    if isinstance(value, str) and (spec.kind == "parts" or (spec.kind == "text" and value.lstrip().startswith("{"))):
        try:
            return yaml.safe_load(value)
        except yaml.YAMLError:
            return value
    return value


def plain(value: Any) -> Any:
    """An array of a parameter as a list; anything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value

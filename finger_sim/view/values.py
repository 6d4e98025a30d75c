"""The parameters of a node, or of a recording, as the page shows them, sets them and writes them as a scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import yaml

from ..bags.origin import block_text, described
from ..errors import FingerSimError, SceneError
from ..ros.options import NodeOptions
from ..scene import Scene
from ..scene.fields import Field, specs
from ..scene.reference import dotted
from ..scene.ros_values import from_ros, to_ros

SCENE_KEYS: Mapping[str, Field] = {name: spec for name, spec, _ in dotted(Scene)}
OWN_KEYS: Mapping[str, Field] = specs(NodeOptions)
NODE_GROUP, TOP_GROUP = "node", "scene"
_KINDS = {"float": "number", "int": "number", "bool": "bool", "text": "text", "choice": "choice", "parts": "text"}
_WIDE = 1e3
"""Range of a parameter, highest by lowest value, from which on its slider is logarithmic."""


class Described(NamedTuple):
    """A parameter as its node describes it."""

    value: Any
    """As ROS has it."""
    doc: str
    live: bool
    low: float = -math.inf
    high: float = math.inf


class Values:
    """Parameters by name. Those that finger_sim does not know, as rclpy's own, are left out."""

    def __init__(self, given: Mapping[str, Described]) -> None:
        self._given = {name: given[name] for name in (*SCENE_KEYS, *OWN_KEYS) if name in given}

    def __contains__(self, name: str) -> bool:
        return name in self._given

    def items(self) -> list[dict[str, Any]]:
        """Descriptions, as the page is told them."""
        return [self._item(name, each) for name, each in self._given.items()]

    def plain(self, name: str) -> Any:
        """The value as a scene has it; None where there is none of that name."""
        return from_ros(self._given[name].value, spec_of(name)) if name in self._given else None

    def take(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Takes new values as ROS has them, from wherever; those that are known, as the page is told them."""
        known = {name: value for name, value in changes.items() if name in self._given}
        for name, value in known.items():
            self._given[name] = self._given[name]._replace(value=value)
        return {name: self._shown(name) for name in known}

    def ros_value(self, name: str, value: Any) -> Any:
        """What to set for a value of the page. Raises SceneError naming the parameter and what is allowed."""
        if name not in self._given:
            raise SceneError(name, value, "no value: there is no such parameter")
        if not self._given[name].live:
            raise SceneError(name, value, "no value: it cannot be changed while the node runs")
        return to_ros(spec_of(name).parse(value, name), spec_of(name))

    def scene(self) -> Scene:
        """The scene with the present values. Raises SceneError where its mesh is not here."""
        data: dict[str, Any] = {}
        for name in self._given:
            if name in SCENE_KEYS:
                *blocks, key = name.split(".")
                block = data
                for part in blocks:
                    block = block.setdefault(part, {})
                block[key] = self.plain(name)
        return Scene.from_dict(data)

    def scene_yaml(self) -> str:
        """The same as a scene file. Raises FingerSimError where it cannot be had."""
        if "dt" not in self._given:
            raise FingerSimError("there are no values yet")
        return block_text(described(self.scene()))

    def _shown(self, name: str) -> Any:
        value = self.plain(name)
        if isinstance(value, dict) or spec_of(name).kind == "parts":
            return yaml.safe_dump(value, default_flow_style=True, sort_keys=False).strip()
        return list(value) if isinstance(value, tuple) else value

    def _item(self, name: str, each: Described) -> dict[str, Any]:
        spec = spec_of(name)
        group = NODE_GROUP if name in OWN_KEYS else name.rpartition(".")[0] or TOP_GROUP
        low, high = max(each.low, spec.low), min(each.high, spec.high)
        number = spec.kind in ("float", "int")
        return {
            "name": name,
            "group": group,
            "value": self._shown(name),
            "kind": _KINDS.get(spec.kind, "vector"),
            "low": low,
            "high": high,
            "unit": spec.unit,
            "choices": list(spec.choices),
            "doc": each.doc,
            "live": each.live,
            "optional": spec.optional,
            "log": number and low > 0.0 and high / low >= _WIDE,
        }


def spec_of(name: str) -> Field:
    """What a parameter may be."""
    return SCENE_KEYS.get(name) or OWN_KEYS[name]


def of_scene(scene: Scene, options: Iterable[tuple[str, Any]] = ()) -> Values:
    """The values of a scene that nobody can change, and of a node's options."""
    found = {p.name: Described(to_ros(p.value, p.spec), p.spec.doc, False) for p in scene.parameters()}
    for name, value in options:
        if name in OWN_KEYS:
            found[name] = Described(value, OWN_KEYS[name].doc, False)
    return Values(found)

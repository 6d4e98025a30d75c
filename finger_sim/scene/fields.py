"""Typed, documented, range-checked fields: one source for YAML keys, ROS parameters, their docs and their refusals."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, TypeVar

from ..errors import SceneError
from ..physics.rotations import ZERO_NORM, normalised

Kind = Literal["float", "int", "bool", "text", "choice", "vec3", "quaternion", "limit3", "cells", "part"]
T = TypeVar("T")

INF = math.inf


@dataclasses.dataclass(frozen=True)
class Field:
    """What one key may hold. `low` and `high` are inclusive; `live` may change while running."""

    kind: Kind
    doc: str
    unit: str = ""
    low: float = -INF
    high: float = INF
    choices: tuple[str, ...] = ()
    optional: bool = False
    live: bool = False
    part: type | None = None

    @property
    def allowed(self) -> str:
        """The allowed values in words, for errors and parameter descriptions."""
        unit = f" {self.unit}" if self.unit else ""
        span = f"in [{self.low:g}, {self.high:g}]{unit}"
        words = {
            "float": f"a number {span}",
            "int": f"a whole number {span}",
            "bool": "true or false",
            "text": "a text",
            "choice": " or ".join(self.choices),
            "vec3": f"three numbers, each {span}",
            "quaternion": "four numbers x y z w, not all zero",
            "limit3": f"a number {span}, or three of them (null on an axis: free)",
            "cells": f"three whole numbers, each {span}",
            "part": "a block of keys",
        }[self.kind]
        return f"{words}, or null" if self.optional else words

    def parse(self, value: Any, key: str) -> Any:
        """The value in its canonical form. Raises SceneError naming `key` when it is not allowed."""
        if value is None and self.optional:
            return None
        parsed = getattr(self, f"_parse_{self.kind}")(value, key)
        if parsed is None:
            raise SceneError(key, value, self.allowed)
        return parsed

    def _number(self, value: Any) -> float | None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return float(value) if math.isfinite(value) and self.low <= value <= self.high else None

    def _numbers(self, value: Any, count: int) -> tuple[float, ...] | None:
        if isinstance(value, str | bytes | Mapping) or not hasattr(value, "__iter__"):
            return None
        numbers = [self._number(item) for item in _plain(value)]
        if len(numbers) != count or any(n is None for n in numbers):
            return None
        return tuple(n for n in numbers if n is not None)

    def _parse_float(self, value: Any, key: str) -> float | None:
        return self._number(_plain(value))

    def _parse_int(self, value: Any, key: str) -> int | None:
        number = self._number(_plain(value))
        return int(number) if number is not None and number == int(number) else None

    def _parse_bool(self, value: Any, key: str) -> bool | None:
        return value if isinstance(value, bool) else None

    def _parse_text(self, value: Any, key: str) -> str | None:
        return value if isinstance(value, str) else None

    def _parse_choice(self, value: Any, key: str) -> str | None:
        return value if isinstance(value, str) and value in self.choices else None

    def _parse_vec3(self, value: Any, key: str) -> tuple[float, ...] | None:
        return self._numbers(value, 3)

    def _parse_cells(self, value: Any, key: str) -> tuple[int, ...] | None:
        numbers = self._numbers(value, 3)
        if numbers is None or any(n != int(n) for n in numbers):
            return None
        return tuple(int(n) for n in numbers)

    def _parse_quaternion(self, value: Any, key: str) -> tuple[float, ...] | None:
        numbers = self._numbers(value, 4)
        if numbers is None or math.hypot(*numbers) < ZERO_NORM:
            return None
        return normalised(numbers)

    def _parse_limit3(self, value: Any, key: str) -> tuple[float | None, ...] | None:
        value = _plain(value)
        items = [value] * 3 if value is None or isinstance(value, int | float) else value
        if not isinstance(items, list | tuple) or len(items) != 3:
            return None
        for axis, item in enumerate(items, 1):
            if item is not None and self._number(item) is None:
                raise SceneError(f"{key}[e{axis}]", item, self.allowed)
        return tuple(None if item is None else float(item) for item in items)

    def _parse_part(self, value: Any, key: str) -> Any:
        assert self.part is not None
        return parse_part(self.part, value, key)


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays as Python numbers and lists; anything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def field(
    kind: Kind,
    doc: str,
    *,
    default: Any = dataclasses.MISSING,
    unit: str = "",
    low: float = -INF,
    high: float = INF,
    choices: tuple[str, ...] = (),
    optional: bool = False,
    live: bool = False,
    part: type | None = None,
) -> Any:
    """A dataclass field that carries its `Field`."""
    spec = Field(kind, doc, unit, low, high, choices, optional, live, part)
    return dataclasses.field(default=default, metadata={"spec": spec})


def specs(cls: type) -> dict[str, Field]:
    """Name → `Field` of every key of a part, in order."""
    return {f.name: f.metadata["spec"] for f in dataclasses.fields(cls) if "spec" in f.metadata}


def parse_part(cls: type[T], data: Any, key: str = "") -> T:
    """Build a part from a mapping. Raises SceneError for an unknown, missing or refused key."""
    known = specs(cls)
    if isinstance(data, cls):
        data = to_dict(data)
    if not isinstance(data, Mapping):
        raise SceneError(key or "scene", data, f"a block with the keys {', '.join(known)}")
    prefix = f"{key}." if key else ""
    for name in data:
        if name not in known:
            raise SceneError(f"{prefix}{name}", data[name], f"no such key; known here: {', '.join(known)}")
    values = {}
    for f in dataclasses.fields(cls):  # type: ignore[arg-type]
        if f.name not in known:
            continue
        if f.name in data:
            values[f.name] = known[f.name].parse(data[f.name], f"{prefix}{f.name}")
        elif f.default is dataclasses.MISSING:
            raise SceneError(f"{prefix}{f.name}", None, f"{known[f.name].allowed} (the key is missing)")
    part = cls(**values)
    check = getattr(part, "check", None)
    if check is not None:
        check(prefix)
    return part


def to_dict(part: Any) -> dict[str, Any]:
    """Plain dict of a part, blocks that are absent left out; `parse_part` gives the part back."""
    out: dict[str, Any] = {}
    for name, spec in specs(type(part)).items():
        value = getattr(part, name)
        if spec.kind == "part":
            if value is not None:
                out[name] = to_dict(value)
        elif hasattr(value, "as_plain"):
            out[name] = value.as_plain()
        elif isinstance(value, tuple):
            out[name] = list(value)
        else:
            out[name] = value
    return out

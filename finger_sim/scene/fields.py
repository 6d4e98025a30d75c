"""Typed, documented, range-checked fields: one source for YAML keys, ROS parameters, their docs and their refusals."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeVar, cast

from ..errors import SceneError
from ..physics.rotations import LONG_QUATERNION, SHORT_QUATERNION, Quaternion, unit

Kind = Literal["float", "int", "bool", "text", "choice", "vec3", "quaternion", "limit3", "cells", "part", "parts"]
T = TypeVar("T")

INF = math.inf
UNKNOWN_KEY = "no such key"
"""How `SceneError.allowed` begins where the key is wrong, not its value."""


@dataclasses.dataclass(frozen=True)
class Field:
    """What one key may hold. `low` and `high` are inclusive; `live` may change while running.

    Of a list of blocks (`parts`), `high` is how many there may be. `quiet`: not written out at its default, so that a
    scene that does not have it is written as it was before there was such a key.
    """

    kind: Kind
    doc: str
    unit: str = ""
    low: float = -INF
    high: float = INF
    choices: tuple[str, ...] = ()
    optional: bool = False
    live: bool = False
    quiet: bool = False
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
            "quaternion": f"four numbers x y z w, of length {SHORT_QUATERNION:g} to {LONG_QUATERNION:g}",
            "limit3": f"a number {span}, or three of them (null on an axis: free)",
            "cells": f"three whole numbers, each {span}",
            "part": "a block of keys",
            "parts": f"a list of at most {self.high:g} blocks with the keys {', '.join(self._keys)}",
        }[self.kind]
        return f"{words}, or null" if self.optional else words

    @property
    def _keys(self) -> Iterable[str]:
        """Of the blocks that it holds, if any."""
        return () if self.part is None else specs(self.part)

    def parse(self, value: Any, key: str) -> Any:
        """The value in its canonical form. Raises SceneError naming `key` when it is not allowed."""
        if value is None and self.optional:
            return None
        parsed = getattr(self, f"_parse_{self.kind}")(value, key)
        if parsed is None:
            raise SceneError(key, value, self.allowed)
        return parsed

    def _number(self, value: Any) -> float | None:
        if isinstance(value, bool) or not isinstance(value, int | float) or not self.low <= value <= self.high:
            return None
        try:
            number = float(value)
        except OverflowError:  # a whole number that no float holds
            return None
        return number if math.isfinite(number) else None

    def _numbers(self, value: Any, count: int) -> tuple[float, ...] | None:
        value = unwrapped(value)
        if not isinstance(value, list | tuple) or len(value) != count:
            return None
        numbers = tuple(n for n in (self._number(unwrapped(item)) for item in value) if n is not None)
        return numbers if len(numbers) == count else None

    def _parse_float(self, value: Any, key: str) -> float | None:
        return self._number(unwrapped(value))

    def _parse_int(self, value: Any, key: str) -> int | None:
        number = self._number(unwrapped(value))
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
        numbers = cast("Quaternion | None", self._numbers(value, 4))
        return None if numbers is None else unit(numbers)

    def _parse_limit3(self, value: Any, key: str) -> tuple[float | None, ...] | None:
        value = unwrapped(value)
        items = [value] * 3 if value is None or isinstance(value, int | float) else value
        if not isinstance(items, list | tuple) or len(items) != 3:
            return None
        numbers = [None if item is None else self._number(unwrapped(item)) for item in items]
        for axis, (item, number) in enumerate(zip(items, numbers, strict=True), 1):
            if item is not None and number is None:
                raise SceneError(f"{key}[e{axis}]", item, self.allowed)
        return tuple(numbers)

    def _parse_part(self, value: Any, key: str) -> Any:
        assert self.part is not None
        return parse_part(self.part, value, key)

    def _parse_parts(self, value: Any, key: str) -> tuple[Any, ...] | None:
        if not isinstance(value, list | tuple) or len(value) > self.high:
            return None
        return tuple(self._parse_part(item, f"{key}[{index}]") for index, item in enumerate(value))


def unwrapped(value: Any) -> Any:
    """NumPy scalars and arrays as Python numbers and lists; anything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def field(kind: Kind, doc: str, *, default: Any = dataclasses.MISSING, **rules: Any) -> Any:
    """A dataclass field that carries its `Field`, made of `kind`, `doc` and the `rules`: unit, low, high and so on."""
    return dataclasses.field(default=default, metadata={"spec": Field(kind, doc, **rules)})


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
            raise SceneError(f"{prefix}{name}", data[name], f"{UNKNOWN_KEY}; known here: {', '.join(known)}")
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
    for f in dataclasses.fields(part):
        if "spec" not in f.metadata:
            continue
        name, spec, value = f.name, f.metadata["spec"], getattr(part, f.name)
        if spec.quiet and value == f.default:
            continue
        if spec.kind == "part":
            if value is not None:
                out[name] = to_dict(value)
        elif spec.kind == "parts":
            out[name] = [to_dict(item) for item in value]
        elif hasattr(value, "as_plain"):
            out[name] = value.as_plain()
        elif isinstance(value, tuple):
            out[name] = list(value)
        else:
            out[name] = value
    return out

"""The facts of each parameter as docs/scenes.md tells them: name, default, allowed values, whether it is live."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import Any

from .fields import Field, specs


def dotted(part: type, prefix: str = "") -> Iterator[tuple[str, Field, Any]]:
    """Dotted name, `Field` and default of every value that a part may hold, those of optional blocks too.

    A value without a default has `dataclasses.MISSING` there.
    """
    for f in dataclasses.fields(part):
        spec: Field | None = f.metadata.get("spec")
        if spec is None:
            continue
        if spec.kind == "part" and spec.part is not None:
            yield from dotted(spec.part, f"{prefix}{f.name}.")
        else:
            yield prefix + f.name, spec, f.default


def rows(part: type) -> Iterator[str]:
    """The beginning of each Markdown row: `| name | default | allowed | live |`; docs/hooks.py adds what it means."""
    for name, spec, default in dotted(part):
        live = "*live*" if spec.live else ""
        yield f"| `{name}` | {default_of(default)} | {allowed_of(spec)} | {live} |"


def default_of(value: Any) -> str:
    """A field's default in words."""
    if value is dataclasses.MISSING:
        return "needed"
    if value is None or value in ("", ()):
        return "none"
    if isinstance(value, tuple):
        return "free" if set(value) == {None} else " ".join(map(_number, value))
    if isinstance(value, bool):
        return str(value).lower()
    return _number(value) if isinstance(value, int | float) else str(value)


def allowed_of(spec: Field) -> str:
    """What a field may hold, in words."""
    if spec.kind == "bool":
        text = "true, false"
    elif spec.kind == "choice":
        text = ", ".join(spec.choices)
    elif spec.kind == "parts" and spec.part is not None:
        keys = ", ".join(f"{name}: {allowed_of(key)}" for name, key in specs(spec.part).items())
        text = f"at most {_number(spec.high)} of {{{keys}}}"
    elif spec.kind in ("text", "quaternion"):
        text = {"text": "text", "quaternion": "x y z w, not all 0"}[spec.kind]
    else:
        span = f"{_number(spec.low)} to {_number(spec.high)}" if math.isfinite(spec.low) else ""
        count = "three numbers" if spec.kind in ("vec3", "limit3", "cells") else ""
        text = ", ".join(filter(None, (count, span))) + (f" {spec.unit}" if spec.unit else "")
    return f"{text}; null" if spec.optional or spec.kind == "limit3" else text


def _number(value: float) -> str:
    """As the tables write numbers: 1e6, −9.81."""
    return re.sub(r"e([+-])0*(\d+)", lambda m: f"e{m[1].strip('+')}{m[2]}", f"{value:g}").replace("-", "−")

"""What a page may say: JSON texts and, as often as it draws, a few bytes; each judged before anything is done."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ..errors import FingerSimError, short

MOST_BYTES = 64 * 1024
"""Of a message; a longer one ends the connection."""
FASTEST = 60.0
"""Frames a second that a page may want."""
_DRAWN, _HELD = struct.Struct("<2I"), struct.Struct("<2I7d")
DRAWN, HELD = 1, 2
"""First word of what a page says in bytes: that it has drawn a frame; the same with a pose of the finger it holds."""


class OrderError(FingerSimError):
    """A message of a page that is not followed."""


class Order(NamedTuple):
    """A message that may be followed: its type and what it says."""

    type: str
    said: Mapping[str, Any]


class Drawn(NamedTuple):
    """What a page says once it has drawn.

    seq  : of the newest frame that it has drawn
    pose : position [m] and x y z w, where it is to send the finger; None: it says nothing of that
    """

    seq: int
    pose: tuple[float, ...] | None


class _Rule(NamedTuple):
    """What a field may hold, in words, and how that is told."""

    allowed: str
    fits: Callable[[Any], bool]
    needed: bool = True


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _number(low: float = -math.inf, high: float = math.inf, needed: bool = True) -> _Rule:
    span = "a number" if math.isinf(high) else f"a number from {low:g} to {high:g}"
    return _Rule(span, lambda value: _is_number(value) and low <= value <= high, needed)


def _text(needed: bool = True) -> _Rule:
    return _Rule("a text of 1 to 200 letters", lambda value: isinstance(value, str) and 0 < len(value) <= 200, needed)


_SWITCH = _Rule("true or false", lambda value: isinstance(value, bool))
_ANYTHING = _Rule("a value", lambda value: True)

RULES: Mapping[str, Mapping[str, _Rule]] = {
    "take": {},
    "release": {},
    "set": {"name": _text(), "value": _ANYTHING},
    "reset": {},
    "record": {"on": _SWITCH},
    "scene": {"name": _text()},
    "yaml": {},
    "seek": {"time": _number(0.0, 1e9)},
    "play": {"on": _SWITCH, "speed": _number(0.01, 100.0, needed=False)},
    "frames": {"hz": _number(1.0, FASTEST)},
}
"""By type: what each message must say."""


def read_order(text: str) -> Order:
    """The order in a text. Raises OrderError naming what was found and what is allowed."""
    try:
        said = _JSON.decode(text)
    except (ValueError, RecursionError) as error:
        raise OrderError(f"a message that is no JSON: {' '.join(str(error).split())}") from None
    if not isinstance(said, dict):
        raise OrderError(f"a message: got {short(said)}, allowed: an object with the key type")
    kind = said.pop("type", None)
    rules = RULES.get(kind) if isinstance(kind, str) else None
    if rules is None:
        raise OrderError(f"type: got {short(kind)}, allowed: {', '.join(RULES)}")
    for name in said:
        if name not in rules:
            raise OrderError(f"{kind}.{short(name)}: no such key; known here: {', '.join(rules) or 'none'}")
    for name, rule in rules.items():
        if name not in said:
            if rule.needed:
                raise OrderError(f"{kind}.{name}: is missing, allowed: {rule.allowed}")
        elif not rule.fits(said[name]):
            raise OrderError(f"{kind}.{name}: got {short(said[name])}, allowed: {rule.allowed}")
    return Order(kind, said)


def read_drawn(data: bytes) -> Drawn:
    """What bytes of a page say, little-endian: kind, seq, and of HELD seven float64. Raises OrderError for others."""
    kind = int.from_bytes(data[:4], "little")
    if kind == DRAWN and len(data) == _DRAWN.size:
        return Drawn(_DRAWN.unpack(data)[1], None)
    if kind == HELD and len(data) == _HELD.size:
        _, seq, *pose = _HELD.unpack(data)
        return Drawn(seq, tuple(pose))
    allowed = f"{_DRAWN.size} that begin with {DRAWN}, or {_HELD.size} that begin with {HELD}"
    raise OrderError(f"a message: got {len(data)} bytes that begin with {kind}, allowed: {allowed}")


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no number of JSON")


_JSON = json.JSONDecoder(parse_constant=_refuse)

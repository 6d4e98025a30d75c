"""What a page may say: JSON texts, each judged before anything is done."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ..errors import FingerSimError, short

MOST_BYTES = 64 * 1024
"""Of a message; a longer one ends the connection."""
FASTEST = 60.0
"""Frames a second that a page may want."""


class OrderError(FingerSimError):
    """A message of a page that is not followed."""


class Order(NamedTuple):
    """A message that may be followed: its type and what it says."""

    type: str
    said: Mapping[str, Any]


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


def _numbers(count: int, words: str) -> _Rule:
    return _Rule(words, lambda value: isinstance(value, list) and len(value) == count and all(map(_is_number, value)))


def _text(needed: bool = True) -> _Rule:
    return _Rule("a text of 1 to 200 letters", lambda value: isinstance(value, str) and 0 < len(value) <= 200, needed)


_SWITCH = _Rule("true or false", lambda value: isinstance(value, bool))
_COUNT = _Rule("a whole number from 0 on", lambda value: type(value) is int and 0 <= value < 2**32)
_ANYTHING = _Rule("a value", lambda value: True)

RULES: Mapping[str, Mapping[str, _Rule]] = {
    "take": {},
    "release": {},
    "pose": {
        "position": _numbers(3, "three numbers [m]"),
        "orientation": _numbers(4, "four numbers x y z w"),
        "t": _number(needed=False),
    },
    "set": {"name": _text(), "value": _ANYTHING},
    "reset": {},
    "record": {"on": _SWITCH},
    "scene": {"name": _text()},
    "yaml": {},
    "seek": {"time": _number(0.0, 1e9)},
    "play": {"on": _SWITCH, "speed": _number(0.01, 100.0, needed=False)},
    "ack": {"seq": _COUNT},
    "frames": {"hz": _number(1.0, FASTEST)},
}
"""By type: what each message must say."""


def read_order(text: str) -> Order:
    """The order in a text. Raises OrderError naming what was found and what is allowed."""
    try:
        said = json.loads(text, parse_constant=_refuse)
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


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no number of JSON")

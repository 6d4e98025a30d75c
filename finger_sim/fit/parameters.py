"""What can be fitted: each unknown, the scene's values that it stands for, its bounds and its prior.

Unknowns are fitted as logarithms: of a value, of the room of a limit, s_max − 1 or 1 − s_min, or of a share over its
rest, g/(1 − g). To have another one, add a line to VALUES (for a number of the scene) or a class beside `Unknown` with
the same methods.

Shares of what relaxes are less than 1 together. Where the fitted ones would leave less than LEFT, they are scaled down
together until they leave that.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from ..arrays import Floats
from ..scene import Scene
from .press import FitError

Kind = Literal["value", "stretch", "compress", "time", "share", "touch"]

TOUCH = 1e-4
"""Scale of the error of the first touch [m]: its prior."""


class Known(NamedTuple):
    """A number of the scene that can be fitted, and between what it is sought."""

    key: str
    low: float
    high: float
    unit: str


VALUES = {
    "young": Known("material.young", 1e2, 1e9, "Pa"),
    "stiffness": Known("limits.stiffness", 0.3, 1e6, ""),
    "damping": Known("material.damping.stiffness", 1e-5, 1.0, "s"),
    "friction": Known("plane.friction", 0.02, 5.0, ""),
}
"""Those that are one number, by their name on the command line."""
TIMED = ("damping",)
"""Those of VALUES that only a simulation in time depends on."""
RELAXATION = ("time", "share")
"""Of each term of `material.relaxation`. They, too, show only in time."""
TERMS = "material.relaxation"
SOUGHT = {"time": (1e-3, 1e4), "share": (1e-3, 0.95)}
"""Between what they are sought [s], [1]."""
LEFT = 0.02
"""What shares leave together at least; less where the scene leaves less."""
LIMITS = ("stretch", "compress")
ROOM = {"stretch": (2e-3, 2.0), "compress": (2e-3, 0.95)}
"""Between what the room of a limit is sought."""
FACTOR = 3.0
"""Prior of everything: the scene's value within such a factor (one standard deviation). It decides what data do not."""


@dataclass(frozen=True)
class Unknown:
    """One unknown θ.

    axes    : of a limit: 0 to 2, all of which have the same
    term    : of what relaxes: its number, from 0 on
    start   : the scene's value, or room
    low     : bound of the same, and `high`
    factor  : standard deviation of the prior, as a factor
    centre  : what the prior is about; None: the scene's value, or the bound that is next to it
    press   : the only press that depends on it; None: all do
    """

    name: str
    kind: Kind
    start: float
    low: float
    high: float
    factor: float = FACTOR
    centre: float | None = None
    axes: tuple[int, ...] = ()
    term: int = -1
    press: int | None = None
    key: str = ""
    unit: str = ""

    @property
    def timed(self) -> bool:
        """Whether only a simulation in time depends on it."""
        return self.name in TIMED or self.kind in RELAXATION

    @property
    def sigma(self) -> float:
        """Standard deviation of θ by the prior."""
        return 1.0 if self.kind == "touch" else math.log(self.factor)

    @property
    def believed(self) -> float:
        """θ that the prior is about."""
        return self.theta(min(max(self.start, self.low), self.high) if self.centre is None else self.centre)

    def theta(self, amount: float) -> float:
        """θ of a value, a room, a share, or a depth [m]."""
        if self.kind == "touch":
            return amount / TOUCH
        return math.log(amount / (1.0 - amount) if self.kind == "share" else amount)

    def amount(self, theta: float) -> float:
        """The value, the room, the share or the depth [m] at θ."""
        if self.kind == "touch":
            return theta * TOUCH
        return 1.0 / (1.0 + math.exp(-theta)) if self.kind == "share" else math.exp(theta)

    def told(self, theta: float) -> float:
        """As the scene has it: a stretch for a limit; of a touch in mm."""
        amount = self.amount(theta)
        return {"stretch": 1.0 + amount, "compress": 1.0 - amount, "touch": 1e3 * amount}.get(self.kind, amount)

    def untold(self, value: float) -> float:
        """The amount of what is told as `value`."""
        return {"stretch": value - 1.0, "compress": 1.0 - value, "touch": 1e-3 * value}.get(self.kind, value)

    def write(self, values: dict[str, Any], scene: Scene, theta: float) -> None:
        """Puts what θ means into changed values of a scene (dotted keys)."""
        if self.kind in LIMITS:
            key = f"limits.{self.kind}"
            row = list(values.get(key, getattr(scene.limits, self.kind)))
            for axis in self.axes:
                row[axis] = self.told(theta)
            values[key] = row
        elif self.kind in RELAXATION:
            terms = values.get(TERMS, [{"time": each.time, "share": each.share} for each in scene.material.relaxation])
            changed = {**terms[self.term], self.kind: self.amount(theta)}
            values[TERMS] = [*terms[: self.term], changed, *terms[self.term + 1 :]]
        elif self.kind == "value":
            values[self.key] = self.amount(theta)

    def words(self, theta: float) -> str:
        """The value with its unit."""
        unit = "mm" if self.kind == "touch" else self.unit
        return f"{self.told(theta):.4g}" + (f" {unit}" if unit else "")


def changes(unknowns: Sequence[Unknown], scene: Scene, theta: Sequence[float] | Floats) -> dict[str, Any]:
    """The scene's values at θ."""
    values: dict[str, Any] = {}
    for unknown, each in zip(unknowns, allowed(unknowns, scene, theta), strict=True):
        unknown.write(values, scene, float(each))
    return values


def allowed(unknowns: Sequence[Unknown], scene: Scene, theta: Sequence[float] | Floats) -> Floats:
    """θ (p,) with fitted shares scaled down together where they leave less than LEFT; it gives the same `changes`."""
    out = np.array(theta, np.float64)
    fitted = [j for j, one in enumerate(unknowns) if one.kind == "share"]
    if not fitted:
        return out
    terms = [unknowns[j].term for j in fitted]
    given = [each.share for each in scene.material.relaxation]
    others = sum(share for term, share in enumerate(given) if term not in terms)
    most = max(1.0 - LEFT, sum(given)) - others
    shares = [unknowns[j].amount(float(out[j])) for j in fitted]
    if sum(shares) > most * (1.0 + 1e-9):
        for j, share in zip(fitted, shares, strict=True):
            out[j] = unknowns[j].theta(share * most / sum(shares))
    return out


def unknowns_of(
    scene: Scene,
    names: Sequence[str],
    presses: Sequence[str],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> list[Unknown]:
    """Unknowns by their names; presses: the names of presses.

    names  : of VALUES; stretch and compress for one limit of all axes, stretch.e1 for that of an axis, stretch.e13 for
             one of two; time.1 and share.1 of the first term of what relaxes; touch, for an error of each press's first
             touch. Also as the scene has them: limits.stretch.e1, material.relaxation.1.share
    bounds : (low, high) by name, as the scene has the value; priors: (value, factor) by name

    Raises FitError naming what cannot be fitted, and why.
    """
    found: list[Unknown] = []
    taken: set[tuple[str, int]] = set()
    for given in names:
        name = _short(given)
        if name == "touch":
            found += [
                Unknown(f"touch:{press}", "touch", 0.0, -10 * TOUCH, 10 * TOUCH, press=k)
                for k, press in enumerate(presses)
            ]
            continue
        first = name.partition(".")[0]
        one = (_limit if first in LIMITS else _term if first in RELAXATION else _value)(scene, name)
        for spot in [(one.kind if one.axes else name, axis) for axis in one.axes or (-1,)]:
            if spot in taken:
                raise FitError(f"--fit: {given}: fitted twice")
            taken.add(spot)
        found.append(one)
    for words, given_ in (("--bound", bounds or {}), ("--prior", priors or {})):
        for name in given_:
            if _short(name) not in {one.name for one in found}:
                raise FitError(f"{words}: {name}: not fitted; fitted are {', '.join(one.name for one in found)}")
    out = []
    for one in found:
        low_high = next((pair for name, pair in (bounds or {}).items() if _short(name) == one.name), None)
        prior = next((pair for name, pair in (priors or {}).items() if _short(name) == one.name), None)
        out.append(_with_prior(_bounded(one, low_high), prior))
    return out


def default_names(scene: Scene) -> list[str]:
    """What is fitted where nobody says: the modulus and each limit that the scene has."""
    names = ["young"]
    if scene.limits is not None:
        for side in LIMITS:
            values = getattr(scene.limits, side)
            if scene.limits.projection == "isotropic":
                names += [side] if values[0] is not None else []
            else:
                names += [f"{side}.e{axis + 1}" for axis in range(3) if values[axis] is not None]
    return names


def _short(name: str) -> str:
    """A name without the scene's blocks."""
    for short, known in VALUES.items():
        if name == known.key:
            return short
    term = re.fullmatch(r"material\.relaxation\.(\d+)\.(time|share)", name)
    return f"{term[2]}.{term[1]}" if term else name.removeprefix("limits.")


def _value(scene: Scene, name: str) -> Unknown:
    if name not in VALUES:
        raise FitError(
            f"--fit: got {name!r}, allowed: {', '.join(VALUES)}, stretch, compress, stretch.e1 …, time.1 …, "
            f"share.1 …, touch"
        )
    known = VALUES[name]
    value = next((p.value for p in scene.parameters() if p.name == known.key), None)
    if value is None:
        raise FitError(f"--fit: {name}: the scene has no {known.key}")
    if value <= 0.0:
        raise FitError(f"--fit: {name}: {known.key} is {value:g} in the scene, allowed: a number > 0 to begin with")
    return Unknown(name, "value", value, min(known.low, value), max(known.high, value), key=known.key, unit=known.unit)


def _limit(scene: Scene, name: str) -> Unknown:
    side, _, axes_text = name.partition(".")
    if scene.limits is None:
        raise FitError(f"--fit: {name}: the scene has no limits")
    digits = axes_text.removeprefix("e") if axes_text else "123"
    if (
        not digits
        or not set(digits) <= set("123")
        or len(set(digits)) != len(digits)
        or (axes_text and axes_text[0] != "e")
    ):
        raise FitError(
            f"--fit: got {name!r}, allowed: {side}, {side}.e1, {side}.e2, {side}.e3, or several as {side}.e13"
        )
    axes = tuple(int(digit) - 1 for digit in digits)
    if scene.limits.projection == "isotropic" and len(axes) < 3:
        raise FitError(f"--fit: {name}: limits.projection is isotropic, allowed: {side}")
    rooms = [getattr(scene.limits, f"{side}_room")[axis] for axis in axes]
    for axis, room in zip(axes, rooms, strict=True):
        if not 0.0 < room < math.inf:
            state = "free" if room == math.inf else "without room"
            raise FitError(f"--fit: {name}: e{axis + 1} is {state} in the scene, allowed: a limit to begin with")
    start = math.exp(sum(map(math.log, rooms)) / len(rooms))
    low, high = ROOM[side]
    kind: Kind = "stretch" if side == "stretch" else "compress"
    return Unknown(name, kind, start, min(low, start), max(high, start), axes=axes)


def _term(scene: Scene, name: str) -> Unknown:
    """A time stays on its side of halfway to the scene's next one, in logarithms: two terms do not change places."""
    kind: Kind = "time" if name.startswith("time") else "share"
    terms = scene.material.relaxation
    if not terms:
        raise FitError(f"--fit: {name}: the scene has no {TERMS}, allowed: a scene with terms to begin with")
    names = [f"{kind}.{term}" for term in range(1, len(terms) + 1)]
    if name not in names:
        count = f"{len(terms)} term{'s' if len(terms) > 1 else ''}"
        raise FitError(f"--fit: got {name!r}, allowed with the {count} of {TERMS}: {', '.join(names)}")
    term = names.index(name)
    value = getattr(terms[term], kind)
    if value <= 0.0:
        raise FitError(f"--fit: {name}: it is {value:g} in the scene, allowed: a number > 0 to begin with")
    low, high = SOUGHT[kind]
    if kind == "time":
        low = max([low, *(math.sqrt(value * each.time) for each in terms if each.time < value)])
        high = min([high, *(math.sqrt(value * each.time) for each in terms if each.time > value)])
    unit = "s" if kind == "time" else ""
    return Unknown(name, kind, value, min(low, value), max(high, value), term=term, unit=unit)


def _bounded(one: Unknown, pair: tuple[float, float] | None) -> Unknown:
    if pair is None:
        return one
    low, high = sorted(one.untold(value) for value in pair)
    if (one.kind != "touch" and low <= 0.0) or not low < high or (one.kind in ("compress", "share") and high >= 1.0):
        raise FitError(
            f"--bound: {one.name}: got {pair[0]:g}:{pair[1]:g}, allowed: LOW:HIGH as the scene has the value"
        )
    return replace(one, low=low, high=high)


def _with_prior(one: Unknown, pair: tuple[float, float] | None) -> Unknown:
    if pair is None:
        return one
    amount = one.untold(pair[0])
    if not one.low <= amount <= one.high or not pair[1] > 1.0:
        raise FitError(
            f"--prior: {one.name}: got {pair[0]:g}:{pair[1]:g}, allowed: VALUE:FACTOR within bounds, FACTOR > 1"
        )
    return replace(one, centre=amount, factor=pair[1])

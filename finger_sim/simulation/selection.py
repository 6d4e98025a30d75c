"""What of a bag a replay simulates, and what of the node's parameters it follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from ..bags.layout import WRENCH_FRAMES
from ..errors import BagError

Mode = Literal["free", "triggered", "recorded"]
MODES: tuple[Mode, ...] = get_args(Mode)


@dataclass(frozen=True)
class Selection:
    """What of a bag is simulated, and how.

    The window of `start` and `duration` counts as a bag of its own that holds what was received in it, ends included.
    Its first command is the newest one received by its beginning, as if it came right then: it places the finger at
    rest. The newest pose of the plane by then holds likewise.
    """

    topic: str | None = None
    """Of the commands; see `bags.reader.read_commands`."""
    plane_topic: str | None = None
    """Of the plane's poses; see `bags.reader.plane_poses_of`."""
    mode: Mode | None = None
    """As the node's: steps on a clock, or one step for each command, stamped with its receipt. "recorded": the steps of
    mode free when the node that recorded the bag made them, so that what it computed comes out, late steps and all.
    None: as the bag was made where its own scene is simulated, else free."""
    start: float = 0.0
    """Beginning of the window, since the first good command [s]."""
    duration: float | None = None
    """Length of the window [s]; None: to the end of the bag."""
    allow_gaps: bool = False
    """In mode free, simulate also what has gaps longer than `bags.gaps.GAP_ALLOWED` between two messages."""


DEFAULTS: Mapping[str, Any] = {
    "mode": "free",
    "world_frame": "world",
    "finger_frame": "finger",
    "wrench_frame": "world_aligned",
    "force_scale": 1.0,
    "force_ramp": 0.2,
    "command_timeout": 0.1,
}
"""The node's parameters that a run follows too, and says that it did; values where no recording gives others."""

RENDERING = {"force_scale": "scale", "force_ramp": "ramp", "command_timeout": "timeout"}
"""Those of the device's wrench, with their names in `Rendering`."""


def unusable(options: Mapping[str, Any]) -> str:
    """What of the parameters that change live no node has; empty where all can be."""
    wrong = (name for name in RENDERING if name in options and not _is_number(options[name]))
    return "; ".join(f"{name}: got {options[name]!r}, allowed: a finite number with a point" for name in wrong)


def _is_number(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)


def options_of(said: Mapping[str, Any], mode: Mode | None, bag: Path) -> dict[str, Any]:
    """The node's parameters, plain values by name, as a bag has said them, or else the DEFAULTS; its mode, or `mode`.

    Raises BagError for one that no node has.
    """
    options = {**DEFAULTS, **said}
    allowed = {"mode": MODES, "wrench_frame": WRENCH_FRAMES}
    wrong = [name for name, known in allowed.items() if options[name] not in known]
    wrong += [name for name in RENDERING if not isinstance(options[name], float)]
    for name in wrong:
        words = ", ".join(allowed[name]) if name in allowed else "a number with a point"
        got = f"{name}: got {options[name]!r}, allowed: {words}"
        raise BagError(f"{bag}: what it says of its making: options: {got}")
    return options if mode is None else {**options, "mode": mode}

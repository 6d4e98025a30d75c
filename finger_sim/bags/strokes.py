"""The shipped bags: commanded poses of minimum-jerk strokes with the tremor of a hand.

`python -m finger_sim.bags.strokes FOLDER` makes the shipped bags anew. World frame: z up, plane z = 0. Finger
frame: e1 = x to the tip, e2 = y to the nail, e3 = z across.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..console import make_files
from ..physics.rotations import matrix, normalised
from ..scene.finger_shape import first_touch
from .reader import START, write_commands

__all__ = [
    "Stroke",
    "make_bags",
    "minimum_jerk",
    "touch_height",
    "trace",
    "tremor",
]

RATE = 500
"""Commands a second of the shipped bags [Hz]."""

FLAT = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""Orientation xyzw with the nail up: maps e2 to world z."""
SIDE_TILT = math.radians(8.0)
SIDE = (0.0, math.sin(0.5 * SIDE_TILT), 0.0, math.cos(0.5 * SIDE_TILT))
"""Orientation xyzw on the side of the finger, e3 up but for a tilt: the tip meets the plane before the knuckle."""

TREMOR = 0.05e-3
"""Largest deflection of the tremor on each axis [m]."""
TREMOR_BAND = (8.0, 12.0)
"""Frequencies of the tremor [Hz]: a resting hand's is about 10 Hz."""


@dataclass(frozen=True)
class Stroke:
    """A minimum-jerk motion that ends at rest at `to`: world x, y and height over first touch [m]."""

    duration: float
    to: tuple[float, float, float]


ABOVE = (0.0, 0.0, 3e-3)
FLAT_DOWN = (0.0, 0.0, -2e-3)
SIDE_DOWN = (0.0, 0.0, -1e-3)

STROKES: dict[str, tuple[tuple[float, float, float, float], tuple[Stroke, ...]]] = {
    "press_flat": (
        FLAT,
        (
            Stroke(0.4, ABOVE),
            Stroke(1.2, FLAT_DOWN),
            Stroke(1.5, FLAT_DOWN),
            Stroke(1.2, ABOVE),
            Stroke(0.4, ABOVE),
        ),
    ),
    "press_side": (
        SIDE,
        (
            Stroke(0.4, ABOVE),
            Stroke(1.2, SIDE_DOWN),
            Stroke(1.5, SIDE_DOWN),
            Stroke(1.2, ABOVE),
            Stroke(0.4, ABOVE),
        ),
    ),
    "press_slide": (
        FLAT,
        (
            Stroke(0.3, ABOVE),
            Stroke(1.0, FLAT_DOWN),
            Stroke(0.4, FLAT_DOWN),
            Stroke(1.0, (0.0, 20e-3, -2e-3)),
            Stroke(1.0, FLAT_DOWN),
            Stroke(1.0, (-20e-3, 0.0, -2e-3)),
            Stroke(1.0, FLAT_DOWN),
            Stroke(0.3, FLAT_DOWN),
            Stroke(1.0, ABOVE),
            Stroke(0.3, ABOVE),
        ),
    ),
}
"""Name of each shipped bag: the finger's orientation and its strokes, from ABOVE to ABOVE."""


def minimum_jerk(s: NDArray[np.float64]) -> NDArray[np.float64]:
    """10 s³ − 15 s⁴ + 6 s⁵: from 0 to 1 over s in [0, 1] with zero velocity and acceleration at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 + s * (-15.0 + 6.0 * s))


def trace(strokes: Sequence[Stroke], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the strokes are at times t (n,) [s]: (n, 3) [m]. They begin at rest at the end of the first."""
    place = np.tile(np.array(strokes[0].to, dtype=np.float64), (len(t), 1))
    begin, here = 0.0, np.array(strokes[0].to)
    for stroke in strokes:
        there = np.array(stroke.to)
        place += minimum_jerk((t - begin) / stroke.duration)[:, None] * (there - here)
        begin, here = begin + stroke.duration, there
    return place


def tremor(t: NDArray[np.float64], seed: int, amplitude: float = TREMOR) -> NDArray[np.float64]:
    """Physiological tremor at times t (n,) [s]: (n, 3) [m], within ±amplitude on each axis.

    A sum of sines in TREMOR_BAND of fixed phases, faded in and out over 0.25 s: zero at both ends.
    """
    phases = random.Random(seed)
    fade = 0.25
    envelope = minimum_jerk((t - t[0]) / fade) * minimum_jerk((t[-1] - t) / fade)
    frequencies = np.linspace(*TREMOR_BAND, 9)
    phase = np.array([[phases.random() for _ in frequencies] for _ in range(3)])
    waves = np.sin(2.0 * np.pi * (t[:, None, None] * frequencies + phase)).sum(axis=2) * envelope[:, None]
    scaled: NDArray[np.float64] = amplitude * waves / np.abs(waves).max(axis=0)
    return scaled


def touch_height(points: NDArray[np.float64], orientation: Sequence[float]) -> float:
    """Height [m] of the finger frame at which the skin just touches z = 0: −min (R X)_z over X (n, 3)."""
    return -float((points @ matrix(normalised(orientation)).T)[:, 2].min())


def make_bags(folder: str | Path) -> list[Path]:
    """Makes the shipped bags in `folder`, for the finger of `scene.finger_shape`; the same files every time.

    Raises BagError when one of the bags is there already.
    """
    made = []
    for seed, (name, (orientation, strokes)) in enumerate(STROKES.items()):
        n = round(sum(stroke.duration for stroke in strokes) * RATE) + 1
        t = np.arange(n) / RATE
        position = trace(strokes, t) + tremor(t, seed)
        position[:, 2] += first_touch(matrix(normalised(orientation)))
        position = np.round(position * 2.0**30) / 2.0**30  # about a nanometre: the same on every machine
        times = [START + k * 1_000_000_000 // RATE for k in range(n)]
        orientations = np.tile(np.array(orientation), (n, 1))
        words = {"scene": "finger", "made_by": "python -m finger_sim.bags.strokes"}
        made.append(write_commands(Path(folder) / name, times, position, orientations, custom_data=words))
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes the shipped bags in a folder."""
    place = "where to put press_flat, press_side and press_slide"
    return make_files("finger_sim.bags.strokes", "Makes the shipped bags in a folder.", place, make_bags, arguments)


if __name__ == "__main__":
    raise SystemExit(main())

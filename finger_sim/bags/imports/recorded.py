"""What readers of recordings are asked for, and what they hand over: poses as they stand there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ...arrays import Floats
from .formats import Clock, Format

POSITION = ("x", "y", "z")
ORIENTATION = ("qx", "qy", "qz", "qw")
DEFAULTS = {"x": 0.0, "y": 0.0, "z": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
"""What stands for a column that is not there: the identity pose."""


@dataclass(frozen=True)
class Reading:
    """What to read of a recording. What is left out is recognised from the content, and said.

    format      : one of FORMATS
    columns     : of text: our column -> its name there, or its number from 1 on
    time_unit   : of text: one of TIME_UNITS
    where       : of text with columns: column -> text; only rows with that cell are read
    concatenate : of text with columns: column that numbers repeats in which t starts anew; they are played one after
                  another
    times       : of KITTI poses: a file with one time a line [s]
    from_topic  : of a bag: the topic to read
    tf          : of a bag: parent and child frame; the child's pose in the parent follows from its transforms
    clock       : of a bag: "header" (when a pose was sampled) or "receipt" (when it was recorded)
    """

    format: Format | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    where: Mapping[str, str] = field(default_factory=dict)
    concatenate: str | None = None
    times: Path | None = None
    from_topic: str | None = None
    tf: tuple[str, str] | None = None
    clock: Clock | None = None


@dataclass(frozen=True)
class Recorded:
    """Poses as a recording has them, in its axes and its unit of length."""

    format: str
    """What was recognised, in words."""
    time: Sequence[int]
    """(n,) [ns], never falling."""
    position: Floats
    """(n, 3)"""
    orientation: Floats | None
    """(n, 4) xyzw; None where the recording has none."""
    places: Sequence[str]
    """(n,) where each pose stands, as errors name it."""
    missing: tuple[str, ...] = ()
    """Columns of a pose that the recording does not have."""
    scale: float = 1.0
    """What makes metres of its lengths, where it says so itself."""
    repeats: int = 1
    """Parts played one after another."""
    notes: tuple[str, ...] = ()
    """What was taken for granted."""
    warnings: tuple[str, ...] = ()
    """What was left out, and why."""

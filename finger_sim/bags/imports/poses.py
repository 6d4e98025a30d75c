"""`import_poses`: a recording is read, brought to our axes and units, judged, and written as a bag of commands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...arrays import Floats
from ...errors import BagError, SceneError
from ...scene import Pose, checked_pose
from ..course import Course, Figures, figures
from ..packing import kind_of_file
from ..reader import START, absolute, require_absent, write_commands
from .formats import FORMATS
from .recorded import DEFAULTS, ORIENTATION, POSITION, Reading, Recorded
from .text import read_text
from .topics import read_bag
from .turns import between, parsed_turn, product

PAD_DOWN = "--set qx=0.7071 --set qw=0.7071"
"""What lays the pad of a finger of the identity orientation on the table."""
MOST_POSES = 10_000_000
"""Poses that resampling makes at most: 2.7 hours at 1 kHz, a gigabyte."""


@dataclass(frozen=True)
class Changes:
    """What is done to the poses of a recording, in this order.

    scale     : lengths are multiplied by it: 0.001 makes metres of millimetres; left out: what a header says of units
    rotate    : the device's axes to ours, as `turns.parsed_turn` reads it: p becomes R p and q becomes R q. An
                orientation that the recording does not have is the identity in our axes; it is not turned
    tool      : how the finger sits on what was tracked: "x=z y=-x z=-y" says that the finger's x is the tool's z and so
                on; a quaternion is the finger's orientation in the tool's frame. q becomes q T; positions stay
    constants : column -> value for every pose [m, 1], in our axes, present in the recording or not
    offset    : column -> value added to every pose [m, 1], in our axes
    resample  : poses a second [Hz]: positions on straight lines, orientations by slerp, from the first pose to the last
    """

    scale: float | None = None
    rotate: str | None = None
    tool: str | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    resample: float | None = None


@dataclass(frozen=True)
class Imported:
    """What came of a recording."""

    path: Path
    topic: str
    frame_id: str
    format: str
    """What was recognised, in words."""
    figures: Figures
    repeats: int
    """Parts played one after another."""
    defaulted: tuple[str, ...]
    """Columns of a pose that neither the recording has nor the user gave."""
    notes: tuple[str, ...]
    """What was taken for granted."""
    warnings: tuple[str, ...]
    """What was left out, and why."""


def import_poses(
    source: str | Path,
    out: str | Path,
    *,
    topic: str = "command_pose",
    frame_id: str = "world",
    reading: Reading | None = None,
    changes: Changes | None = None,
    plane: float = 0.0,
) -> Imported:
    """Makes a bag of commands of a recording, and says what was in it.

    The format is recognised from the content: those of FORMATS. Repeated times, gaps and sign flips are kept, unless
    the poses are resampled. The bag begins at START; commands are stamped with the times that they are received at.

    topic, frame_id : of the commands in the bag
    reading         : what to read of the recording
    changes         : what to do to its poses
    plane           : height of the plane that `figures` measures depth from [m]
    Raises BagError with the place and value of what cannot be used; then there is no bag.
    """
    source, reading, changes = Path(source), reading or Reading(), changes or Changes()
    _check(changes)
    require_absent(out)
    recorded = _read(source, reading)
    course, notes = _changed(recorded, changes)
    for place, p, q in zip(recorded.places, course.position.tolist(), course.orientation.tolist(), strict=True):
        try:
            checked_pose(Pose(tuple(p), tuple(q)))
        except SceneError as error:
            advice = "; --scale or --offset may bring it near" if error.key == "position" else ""
            raise BagError(f"{place}: {error}{advice}") from None
    if changes.resample is not None:
        course = _resampled(course, changes.resample)
    times = [START + int(time) for time in course.time]
    path = write_commands(Path(out), times, course.position, course.orientation, topic=topic, frame_id=frame_id)
    return Imported(
        path=path,
        topic=absolute(topic),
        frame_id=frame_id,
        format=recorded.format,
        figures=figures(course, plane),
        repeats=recorded.repeats,
        defaulted=tuple(name for name in recorded.missing if name not in changes.constants),
        notes=(*recorded.notes, *notes),
        warnings=recorded.warnings,
    )


def _read(source: Path, reading: Reading) -> Recorded:
    """The poses of a recording, by what it is."""
    try:
        is_bag = source.is_dir() or (source.is_file() and kind_of_file(source) is not None)
    except OSError as error:
        raise BagError(f"{source}: cannot be read: {error.strerror}") from None
    if reading.format == "bag" or (is_bag and reading.format is None):
        return read_bag(source, reading)
    if is_bag:
        raise BagError(f"{source}: is a bag, not {FORMATS[reading.format or 'csv']}")
    for option, given in (("--from-topic", reading.from_topic), ("--tf", reading.tf), ("--clock", reading.clock)):
        if given:
            raise BagError(f"{source}: is no bag; {option} is for bags: {FORMATS['bag']}")
    return read_text(source, reading)


def _check(changes: Changes) -> None:
    for option, values in (("constants", changes.constants), ("offset", changes.offset)):
        for name, value in values.items():
            if name not in DEFAULTS:
                raise BagError(f"{option}: got column {name!r}, allowed: {', '.join(DEFAULTS)}")
            if not math.isfinite(value):
                raise BagError(f"{option}: {name}: got {value!r}, allowed: a finite number")
    for option, factor in (("scale", changes.scale), ("resample", changes.resample)):
        if factor is not None and not 0.0 < factor < math.inf:
            raise BagError(f"{option}: got {factor!r}, allowed: a finite number > 0")


def _changed(recorded: Recorded, changes: Changes) -> tuple[Course, list[str]]:
    """The poses in metres, along our axes, with what the user set and added; and what was taken for granted."""
    notes = []
    position, orientation = recorded.position, recorded.orientation
    scale = recorded.scale if changes.scale is None else changes.scale
    if scale != 1.0:
        position = position * scale
    if changes.rotate is not None:
        turn = parsed_turn("--rotate", changes.rotate)
        position = position @ turn.matrix.T
        if orientation is not None:
            orientation = product(turn.quaternion, orientation)
    if orientation is None:
        orientation = np.tile([DEFAULTS[name] for name in ORIENTATION], (len(position), 1))
    if changes.tool is not None:
        orientation = product(orientation, parsed_turn("--tool", changes.tool, of_axes=True).quaternion)
    position, orientation = _set(position, POSITION, changes), _set(orientation, ORIENTATION, changes)
    missing = [name for name in recorded.missing if name not in changes.constants]
    if missing:
        notes.append("not in the file: " + ", ".join(missing) + ", taken as 0" + (", qw as 1" * ("qw" in missing)))
    if set(ORIENTATION) <= set(missing) and changes.tool is None:
        notes.append(f"the finger lies on its side; {PAD_DOWN} lays its pad on the table")
    return Course(np.array(recorded.time, dtype=np.int64), position, orientation), notes


def _set(values: Floats, names: tuple[str, ...], changes: Changes) -> Floats:
    """Columns with constants in their place, and offsets added."""
    columns = [
        np.full(len(values), changes.constants[name]) if name in changes.constants else values[:, i]
        for i, name in enumerate(names)
    ]
    return np.stack([column + changes.offset.get(name, 0.0) for name, column in zip(names, columns, strict=True)], 1)


def _resampled(course: Course, rate: float) -> Course:
    """The same course at a constant rate [Hz]."""
    rising = course.last_of_each_time()
    count = math.floor((rising.time[-1] - rising.time[0]) * 1e-9 * rate * (1.0 + 1e-12)) + 1
    if count > MOST_POSES:
        raise BagError(f"resample: got {rate:g} Hz, which makes {count} poses, allowed: {MOST_POSES}")
    wanted = rising.time[0] + np.round(np.arange(count) * (1e9 / rate)).astype(np.int64)
    position, orientation = between(rising.time, rising.position, rising.orientation, wanted)
    return Course(wanted, position, orientation)

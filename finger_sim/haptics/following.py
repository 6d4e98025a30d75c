"""Commands that come when they come → where the bone is wanted at every step.

Hands and robots send 20 to 1000 poses a second, unevenly. Held until the next one comes, each would be a jump, which
the damper of a coupling turns into a kick. So the bone is led along a path through the poses, late by just so much that
the next one is always there before the path ends:

    commands   ×        ×     ×           ×        ×
    path       ─────────┴─────┴───────────┴────────┴── linear between them (orientation: slerp)
                                    ▲         ▲ newest command
                                    bone, `delay` behind

The delay is the longest that a command lately had to last until the next one was there: one interval for commands that
come evenly, nothing where every step gets a command of its own. Commands that come as often as steps, but unevenly,
`auto` holds instead: see holding.py. The mean of the path over a short window takes its
corners off: from one straight piece to the next the velocity changes evenly over the window (linear segments with
parabolic blends: Craig, Introduction to Robotics, section 7.3).

The path lies on simulated time. Where the loop skips steps, time jumps past it, and it follows in CATCHING_UP: the bone
goes a little faster than the hand, and not in one step where the hand went in twenty.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numba import types

from ..arrays import Floats, Ints
from ..physics.compile import formula, kernel, stage
from ..physics.records import direct, held, side_by_side
from ..scene import Pose
from . import cadence as timing
from . import holding as held_ones
from . import path as through
from . import prediction as ahead
from .cadence import Cadence, Rhythm, build_cadence, rhythm
from .holding import EXACT, REGAIN, Holding, build_holding
from .path import Numbers, Path, build_path, distance, numbers, on_side, pose_of, read, side_near, write
from .prediction import Prediction, build_prediction

Following = Literal["hold", "linear", "predict", "auto"]
HOLD, LINEAR, PREDICT, AUTO = range(4)
MODES: dict[Following, int] = {"hold": HOLD, "linear": LINEAR, "predict": PREDICT, "auto": AUTO}
"""The numbers of the modes in compiled code."""

PAUSE = 0.1
"""Time without a command after which what came before is forgotten [s]."""
RESUME = 0.1
"""Longest time in which the bone goes to the first command after a pause, or from a start beside its command [s]."""
RESUME_SPEED = 0.1
"""At which it goes there where that takes less [m/s]: a coupling with 3 N s/m feels it as 0.3 N."""
LONGEST_WINDOW = 0.025
"""Of the mean [s]: from 0.3 m/s to nothing takes 12 m/s² then; 3 N s/m of a coupling feel 0.036 N of it in 1 ms."""
SLEW = 0.15
"""Of the delay, in s/s: the bone goes so much slower or faster than the hand while the delay changes."""
WINDOW_SLEW = 0.03
"""Of the window, in s/s. Less, as nothing smooths it: the bone goes by half of this slower or faster at once."""
CATCHING_UP = 0.1
"""Time constant with which the path follows a jump of time [s]."""
CLOCK_SET = 1.0
"""From so large a jump on [s] it is no loop that skipped steps, but a clock that was set; back, from PAUSE on."""
STALL, CAUGHT_UP = 2.5, 0.5
"""Steps by which time has to jump to be a loop that skipped some, and up to which it is still behind then."""
HEARD = 4096
"""Most commands that are heard in one step; of more, the last ones count."""
_POSE = types.UniTuple(types.float64, 7)


class Course(NamedTuple):
    """What a follower knows, for compiled code. Times are in s; (1,) each, unless said.

    pose     : (7,) where the bone is wanted at the end of the last step
    before   : (7,) at its start
    last     : (7,) the command heard last, or where it rests
    time     : simulated, at the end of the last step
    offset   : from the commands' clock to simulated time; NaN before the first step
    late     : of the path behind the commands
    window   : of the mean
    stalled  : 1 while the loop is behind after steps that were skipped
    predicts : 1 while the prediction leads, and not the path
    heard    : (HEARD, 8) numbers of the commands since the last step, and the times of their receipt (NaN: as a step
               begins); command k lies in row k % HEARD
    waiting  : how many these are
    """

    pose: Floats
    before: Floats
    last: Floats
    time: Floats
    offset: Floats
    late: Floats
    window: Floats
    stalled: Floats
    predicts: Floats
    heard: Floats
    waiting: Ints
    path: Path
    cadence: Cadence
    holding: Holding
    prediction: Prediction


def build_course() -> Course:
    """One to be put at rest."""
    fields: dict[str, Any] = {
        **side_by_side(Course, pose=7, before=7, last=7, heard=0, waiting=0, path=0, cadence=0, holding=0, prediction=0)
    }
    fields |= {"heard": np.zeros((HEARD, 8)), "waiting": np.zeros(1, np.int64)}
    fields |= {"path": build_path(), "cadence": build_cadence(), "holding": build_holding()}
    return Course(**fields | {"prediction": build_prediction()})


class Follower:
    """Follows commands; see the top of this file. Times are in s, of the clock that commands are received by.

    course, held : what it knows, as arrays and as kernels take it
    """

    def __init__(self, pose: Pose) -> None:
        self.course = build_course()
        self.held = held(self.course)
        self._rest = direct(rest, self.held, _POSE, _POSE)
        self._hear = direct(hear, self.held, _POSE, types.float64)
        self.rest(pose)

    @cached_property
    def _advance(self) -> Any:
        """Compiled when first called: a Simulator's step calls the kernel itself."""
        return direct(advance, self.held, types.int64, types.float64, types.float64)

    @property
    def last(self) -> Pose:
        """The command heard last, or where it rests."""
        return pose_of(self.course.last)

    @property
    def pose(self) -> Pose:
        """Where the bone is wanted at the end of the last step."""
        return pose_of(self.course.pose)

    @property
    def cadence(self) -> Rhythm | None:
        """Of the commands since the last pause; None before the first."""
        return rhythm(self.course.cadence)

    def rest(self, pose: Pose, goal: Pose | None = None) -> None:
        """At rest at `pose`, and on to `goal` in RESUME, if that is given; what was heard is forgotten."""
        self._rest(self.held, numbers(pose), numbers(pose if goal is None else goal))

    def hear(self, pose: Pose, received: float | None = None) -> None:
        """A command that came at a time, by which the next step begins; None: just as that begins."""
        self._hear(self.held, numbers(pose), math.nan if received is None else received)

    def advance(self, following: Following, now: float | None, dt: float) -> Pose:
        """One step of `dt` that begins at a time; None: dt after the last one began. Where the bone is wanted then."""
        self._advance(self.held, MODES[following], math.nan if now is None else now, dt)
        return self.pose

    def delay(self, following: Following) -> float:
        """Of the bone behind the commands [s]; one that is reached by the end of the step that hears it has none."""
        course = self.course
        return float(course.late[0] + 0.5 * course.window[0]) if following in ("linear", "auto") else 0.0

    def mode(self, following: Following) -> Following:
        """What is in use: `auto` holds where commands come as often as steps; see holding.py."""
        if following != "auto":
            return following
        waits = self.course.holding.holds[0] == 0.0 and self.delay(following) > EXACT
        return "linear" if waits else "hold"


@kernel
def rest(course: Course, pose: Numbers, goal: Numbers) -> None:
    """At rest at a pose, and on to a goal in RESUME, where that is another; what was heard is forgotten."""
    write(course.pose, pose)
    write(course.before, pose)
    write(course.last, goal)
    course.time[0] = course.late[0] = course.window[0] = course.stalled[0] = course.predicts[0] = 0.0
    course.offset[0] = math.nan
    course.waiting[0] = 0
    course.cadence.commands[0] = -1.0
    held_ones.begin(course.holding)
    through.set_out(course.path, 0.0, pose)
    ahead.rest(course.prediction, pose)
    if goal != pose:
        course.late[0] = RESUME
        through.append(course.path, RESUME, goal)
        ahead.begin(course.prediction, 0.0, through.last_numbers(course.path), RESUME)


@kernel
def hear(course: Course, pose: Numbers, received: float) -> None:
    """A command for the next step, and the time of its receipt [s]; NaN: just as that step begins."""
    row = course.heard[course.waiting[0] % HEARD]
    write(row, pose)
    write(course.last, pose)
    row[7] = received
    course.waiting[0] += 1


@kernel
def advance(course: Course, following: int, now: float, dt: float) -> None:
    """One step of `dt` that begins at a time [s]; NaN: dt after the last one began.

    Where the bone is wanted then is in course.pose.
    """
    begin, path = course.time[0], course.path
    if following != AUTO:
        course.holding.holds[0] = 0.0
    stalls = _keep_time(course, now, begin, dt)
    if math.isnan(now):
        now = begin - course.offset[0]
    end = begin + dt
    course.time[0] = end
    if (following == PREDICT) != (course.predicts[0] != 0.0):
        _turn_to(course, following, dt)
    _take_all(course, now, dt, following, stalls)
    through.forget(path, end - 2.0 * LONGEST_WINDOW)
    before, last = read(course.pose), through.last_pose(path)
    if following == PREDICT:
        ahead.advance(course.prediction, last, end - course.offset[0], dt)
        write(course.pose, read(course.prediction.pose))
    elif before != last or through.end_of(path) + course.window[0] > begin:
        _widen(course, begin, dt, following)
        if course.window[0] == 0.0 and through.end_of(path) <= end:
            write(course.pose, last)
        else:
            through.mean(path, end - course.window[0], end, course.pose)
    write(course.before, before)


@stage
def _keep_time(course: Course, now: float, begin: float, dt: float) -> bool:
    """Lays the commands' clock on simulated time; whether the loop is behind after steps that were skipped."""
    if math.isnan(now):
        if math.isnan(course.offset[0]):
            course.offset[0] = 0.0
        return False
    offset = begin - now
    behind = course.offset[0] - offset
    if abs(behind) <= EXACT or not -PAUSE < behind < CLOCK_SET:  # or it is the first time
        course.offset[0], course.stalled[0] = offset, 0.0
        return False
    part = dt / CATCHING_UP
    if course.holding.holds[0] != 0.0:
        part = max(part, REGAIN * dt / abs(behind))
    course.offset[0] -= behind * min(1.0, part)
    stalled: bool = behind > (CAUGHT_UP if course.stalled[0] != 0.0 else STALL) * dt
    course.stalled[0] = 1.0 if stalled else 0.0
    return stalled


@formula
def _paused(cadence: Cadence, now: float, dt: float) -> bool:
    """Whether the last command is too long ago at a time; one as far ahead of it came before a clock was set."""
    return not -PAUSE < now - cadence.received[0] <= PAUSE + dt


@stage
def _turn_to(course: Course, following: int, dt: float) -> None:
    """From the path to the prediction, or back: on from where the bone is, and as fast."""
    path, pose, before, time = course.path, read(course.pose), read(course.before), course.time[0]
    course.predicts[0] = 1.0 if following == PREDICT else 0.0
    if following == PREDICT:
        ahead.place(course.prediction, pose, before, dt)
        return
    last = through.last_pose(path)
    course.late[0] = 0.0 if following == HOLD else RESUME
    course.window[0] = 0.0 if following == HOLD else LONGEST_WINDOW
    through.pass_by(path, time - dt, before, pose, dt, LONGEST_WINDOW)
    meant = time
    if course.cadence.commands[0] >= 0.0:
        meant = min(course.cadence.time[0] + course.offset[0] + dt, time)
    through.append(path, max(meant + course.late[0], time), last)


@stage
def _take_all(course: Course, now: float, dt: float, following: int, stalls: bool) -> None:
    """The commands heard since the last step; after a pause, and after as long a stall, only the last one counts."""
    count = course.waiting[0]
    first = max(0, count - HEARD)
    if course.cadence.commands[0] >= 0.0 and _paused(course.cadence, now, dt):
        first = max(0, count - 1)
    for k in range(first, count):
        row = course.heard[k % HEARD]
        received = now if math.isnan(row[7]) else row[7]
        _take(course, read(row), received, now, dt, following, stalls)
    course.waiting[0] = 0


@stage
def _take(course: Course, pose: Numbers, received: float, now: float, dt: float, following: int, stalls: bool) -> None:
    """A command becomes the end of the path."""
    cadence, path, end = course.cadence, course.path, course.time[0]
    begin, last = end - dt, through.last_numbers(path)
    at = on_side(pose, side_near(pose, last))
    if cadence.commands[0] < 0.0 or _paused(cadence, now, dt):
        _begin(course, pose, at, min(received, now), now, dt, following)
        return
    before = cadence.time[0]
    meant = timing.hear(cadence, received, begin - course.offset[0], at)  # a stalled loop does not use up the path
    ahead.hear(course.prediction, meant, at, cadence.interval[0], cadence.waits.largest[0])
    wait = begin - course.offset[0] - before
    held_ones.judge(course.holding, following == AUTO, cadence.interval[0], wait, dt)
    held_ones.keep(course.holding, meant, at, dt)
    stood = through.end_of(path) < begin - EXACT
    if stood:
        course.late[0] = max(0.0, begin - dt - (before + course.offset[0]))
        through.stand(path, begin)
    if following == HOLD:
        course.late[0] = 0.0
        through.append(path, received + course.offset[0] + dt if stalls else end, pose)
        return
    wanted, most, late = max(0.0, cadence.waits.largest[0] - dt), SLEW * (meant - before), course.late[0]
    if course.holding.holds[0] != 0.0:
        wanted, most, meant = course.holding.late[0], REGAIN * (meant - before), min(meant, now)
    if wanted != late:
        late += min(max(wanted - late, -most), most)
        late = late if late > EXACT else 0.0
        course.late[0] = late
    time = meant + course.offset[0] + late + dt
    if course.holding.holds[0] != 0.0 and not stalls:
        time = held_ones.reached(course.holding, through.end_of(path), time, stood, cadence.interval[0], last)
        course.late[0] = max(0.0, time - dt - course.offset[0] - meant)
    through.append(path, end if abs(time - end) < EXACT else max(time, through.end_of(path) + 1e-9), pose)


@stage
def _begin(course: Course, pose: Numbers, at: Numbers, received: float, now: float, dt: float, following: int) -> None:
    """The first command, or the first after a pause."""
    cadence, path, end = course.cadence, course.path, course.time[0]
    takes = course.late[0]
    if cadence.commands[0] >= 0.0:
        way = distance(at, through.last_numbers(path))
        takes = min(RESUME, way / RESUME_SPEED) if way > RESUME_SPEED * dt and following != HOLD else 0.0
        course.late[0] = takes + min(now - received, PAUSE) if takes > 0.0 else 0.0
    timing.begin(cadence, received, at)
    held_ones.begin(course.holding)
    held_ones.keep(course.holding, received, at, dt)
    ahead.begin(course.prediction, received, at, RESUME)
    through.stand(path, end - dt)
    through.append(path, end + takes, pose)


@stage
def _widen(course: Course, begin: float, dt: float, following: int) -> None:
    """The window as long as commands have to be waited for, and come unevenly: at once where the path stands."""
    cadence, window, wanted = course.cadence, course.window[0], 0.0
    if cadence.commands[0] >= 0.0 and following != HOLD:
        wait = max(0.0, cadence.waits.largest[0] - dt) if cadence.interval[0] > 0.0 else course.late[0]
        if wait > EXACT and course.holding.holds[0] == 0.0:
            wanted = min(wait + timing.spread(cadence), LONGEST_WINDOW)
    if wanted != window:
        most = WINDOW_SLEW * dt
        if through.stands(course.path, begin - max(wanted, window), begin):
            most = math.inf
        course.window[0] = window + min(max(wanted - window, -most), most)


KERNELS = (rest, hear)
"""What a Follower calls."""

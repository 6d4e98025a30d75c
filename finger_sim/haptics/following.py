"""Commands that come when they come → where the bone is wanted at every step.

Hands and robots send 20 to 1000 poses a second, unevenly. Held until the next one comes, each would be a jump, which
the damper of a coupling turns into a kick. So the bone is led along a path through the poses, late by just so much that
the next one is always there before the path ends:

    commands   ×        ×     ×           ×        ×
    path       ─────────┴─────┴───────────┴────────┴── linear between them (orientation: slerp)
                                    ▲         ▲ newest command
                                    bone, `delay` behind

The delay is the longest that a command lately had to last until the next one was there: one interval for commands that
come evenly, nothing where every step gets a command of its own. The mean of the path over a short window takes its
corners off: from one straight piece to the next the velocity changes evenly over the window (linear segments with
parabolic blends: Craig, Introduction to Robotics, section 7.3).

The path lies on simulated time. Where the loop skips steps, time jumps past it, and it follows in CATCHING_UP: the bone
goes a little faster than the hand, and not in one step where the hand went in twenty.
"""

from __future__ import annotations

import math
from typing import Literal

from ..scene import Pose
from .cadence import Cadence
from .path import Path, numbers
from .prediction import Prediction

Following = Literal["hold", "linear", "predict", "auto"]

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
EXACT = 1e-6
"""Times nearer to each other than this are one [s]: a log has whole nanoseconds, simulated time none."""
STALL, CAUGHT_UP = 2.5, 0.5
"""Steps by which time has to jump to be a loop that skipped some, and up to which it is still behind then."""


class Follower:
    """Follows commands; see the top of this file. Times are in s, of the clock that commands are received by.

    pose    : where the bone is wanted at the end of the last step
    cadence : of the commands since the last pause; None before the first
    """

    def __init__(self, pose: Pose) -> None:
        self.rest(pose)

    def rest(self, pose: Pose, goal: Pose | None = None) -> None:
        """At rest at `pose`, and on to `goal` in RESUME, if that is given; what was heard is forgotten."""
        self.pose = pose
        self.cadence: Cadence | None = None
        self._heard: list[tuple[Pose, float | None]] = []
        self._time = 0.0  # simulated, at the end of the last step
        self._offset = math.nan  # from the commands' clock to simulated time
        self._stalled = self._predicts = False
        self._before = pose
        self._late = self._window = 0.0
        self._path, self._prediction = Path(0.0, pose), Prediction(pose)
        if goal is not None and goal != pose:
            self._late = RESUME
            self._path.append(RESUME, goal)
            self._prediction.begin(0.0, self._path.last_numbers, RESUME)

    def hear(self, pose: Pose, received: float | None = None) -> None:
        """A command that came at a time, by which the next step begins; None: just as that begins."""
        self._heard.append((pose, received))

    def advance(self, following: Following, now: float | None, dt: float) -> Pose:
        """One step of `dt` that begins at a time; None: dt after the last one began. Where the bone is wanted then."""
        begin, path = self._time, self._path
        stalls = self._keep_time(now, begin, dt)
        now = begin - self._offset if now is None else now
        self._time = end = begin + dt
        if (following == "predict") != self._predicts:
            self._turn_to(following, dt)
            path = self._path
        if self.cadence is not None and self._paused(self.cadence, now, dt):
            del self._heard[:-1]  # after a pause, and after as long a stall, only the last one counts
        for pose, received in self._heard:
            self._take(pose, now if received is None else received, now, dt, following, stalls)
        self._heard.clear()
        path.forget(end - 2.0 * LONGEST_WINDOW)
        before = self.pose
        if following == "predict":
            self.pose = self._prediction.advance(path.last, end - self._offset, dt)
        elif self.pose is not path.last or path.end + self._window > begin:
            self._widen(begin, dt, following)
            at_once = self._window == 0.0 and path.end <= end
            self.pose = path.last if at_once else path.mean(end - self._window, end)
        self._before = before
        return self.pose

    def delay(self, following: Following) -> float:
        """Of the bone behind the commands [s]; one that is reached by the end of the step that hears it has none."""
        return self._late + 0.5 * self._window if following in ("linear", "auto") else 0.0

    def mode(self, following: Following) -> Following:
        """What is in use: `auto` holds where nothing has to be waited for."""
        return following if following != "auto" else "linear" if self.delay(following) > EXACT else "hold"

    def _keep_time(self, now: float | None, begin: float, dt: float) -> bool:
        """Lays the commands' clock on simulated time; whether the loop is behind after steps that were skipped."""
        if now is None:
            self._offset = 0.0 if math.isnan(self._offset) else self._offset
            return False
        offset = begin - now
        behind = self._offset - offset
        if abs(behind) <= EXACT or not -PAUSE < behind < CLOCK_SET:  # or it is the first time
            self._offset, self._stalled = offset, False
            return False
        self._offset -= behind * min(1.0, dt / CATCHING_UP)
        self._stalled = behind > (CAUGHT_UP if self._stalled else STALL) * dt
        return self._stalled

    @staticmethod
    def _paused(cadence: Cadence, now: float, dt: float) -> bool:
        """Whether the last command is too long ago at a time; one as far ahead of it came before a clock was set."""
        return not -PAUSE < now - cadence.received <= PAUSE + dt

    def _turn_to(self, following: Following, dt: float) -> None:
        """From the path to the prediction, or back: on from where the bone is, and as fast."""
        self._predicts = following == "predict"
        if self._predicts:
            self._prediction.place(self.pose, self._before, dt)
            return
        last, self._late = self._path.last, 0.0 if following == "hold" else RESUME
        self._window = 0.0 if following == "hold" else LONGEST_WINDOW
        self._path = Path.passing(self._time - dt, self._before, self.pose, dt, LONGEST_WINDOW)
        meant = self._time if self.cadence is None else min(self.cadence.time + self._offset + dt, self._time)
        self._path.append(max(meant + self._late, self._time), last)

    def _take(self, pose: Pose, received: float, now: float, dt: float, following: Following, stalls: bool) -> None:
        """A command becomes the end of the path."""
        cadence, path, end = self.cadence, self._path, self._time
        begin = end - dt
        at = numbers(pose, path.last_numbers)
        if cadence is None or self._paused(cadence, now, dt):
            received = min(received, now)
            takes = self._late
            if cadence is not None:
                way = math.dist(at, path.last_numbers)
                takes = min(RESUME, way / RESUME_SPEED) if way > RESUME_SPEED * dt and following != "hold" else 0.0
                self._late = takes + min(now - received, PAUSE) if takes > 0.0 else 0.0
            self.cadence = Cadence(received, at)
            self._prediction.begin(received, at, RESUME)
            path.stand(begin)
            path.append(end + takes, pose)
            return
        before = cadence.time
        meant = cadence.hear(received, begin - self._offset, at)  # a stalled loop does not use up the path
        self._prediction.hear(meant, at, cadence)
        if path.end < begin - EXACT:
            self._late = max(0.0, begin - dt - (before + self._offset))
            path.stand(begin)
        if following == "hold":
            self._late = 0.0
            path.append(received + self._offset + dt if stalls else end, pose)
        else:
            wanted, most = max(0.0, cadence.longest_wait - dt), SLEW * (meant - before)
            if wanted != self._late:
                self._late += min(max(wanted - self._late, -most), most)
                self._late = self._late if self._late > EXACT else 0.0
            time = meant + self._offset + self._late + dt
            path.append(end if abs(time - end) < EXACT else max(time, path.end + 1e-9), pose)

    def _widen(self, begin: float, dt: float, following: Following) -> None:
        """The window as long as commands have to be waited for, and come unevenly: at once where the path stands."""
        cadence, wanted = self.cadence, 0.0
        if cadence is not None and following != "hold":
            wait = max(0.0, cadence.longest_wait - dt) if cadence.interval > 0.0 else self._late
            wanted = min(wait + cadence.spread, LONGEST_WINDOW) if wait > EXACT else 0.0
        if wanted != self._window:
            most = math.inf if self._path.standing(begin - max(wanted, self._window), begin) else WINDOW_SLEW * dt
            self._window += min(max(wanted - self._window, -most), most)

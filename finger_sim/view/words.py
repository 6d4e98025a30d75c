"""The node's report on /diagnostics as the page is told it: numbers in SI units, status bits in words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..physics.step import Status

LEVELS = ("info", "warn", "error")
TEXTS: Mapping[Status, tuple[str, str]] = {
    Status.NONFINITE: ("error", "a step gave no finite numbers and was not taken"),
    Status.INVERTED: ("warn", "a tetrahedron is inside out"),
    Status.ITERATION_LIMIT: ("warn", "the solver stopped before its tolerance; its best result was used"),
    Status.STEP_REJECTED: ("error", "a step was not taken; the body moved rigidly with its bone"),
    Status.LOCKED: ("info", "a tetrahedron is held by more limits than it can move in"),
    Status.ROW_LIMIT: ("warn", "more limits were reached than there is room for; some were left out"),
    Status.COMMAND_LIMITED: ("info", "the command moved faster than allowed and is being caught up with"),
    Status.LIMIT_EXCEEDED: ("warn", "a strain is beyond 1.5 times its limit"),
    Status.RESTORED: ("warn", "the body was beyond repair and was put back, undeformed"),
}
"""What each bit means, and how grave it is."""

_SEVERAL = re.compile(r"; (?!send )")
"""Between two problems; within one of them the node writes `; send …`, too."""

_COUNTED = re.compile(r"([A-Z_|]+) in (\d+ of \d+ steps)")
"""A problem that names status bits, and tells in how many steps one of them was set."""


@dataclass
class Report:
    """What one report says.

    values  : by key, as the node words them
    message : the problems, or ok
    level   : 0 well, 1 warning, 2 error
    """

    values: dict[str, str] = field(default_factory=dict)
    message: str = ""
    level: int = 0

    @property
    def runs(self) -> bool:
        """Whether the node makes steps."""
        return "steps" in self.values

    @property
    def status(self) -> Status:
        """The bits that were set in some step since the report before."""
        return read_status(self.values.get("status", ""))

    def number(self, key: str, unit: float = 1.0) -> float | None:
        """A value that is a number, times `unit`; None where there is none."""
        try:
            return unit * float(self.values[key])
        except (KeyError, ValueError):
            return None


def read_status(text: str) -> Status:
    """Status bits by their names, as in LOCKED|ROW_LIMIT; names that are not known are passed over."""
    found = Status.OK
    for name in text.split("|"):
        found |= Status.__members__.get(name, Status.OK)
    return found


def status_of(report: Report, before: Report) -> dict[str, Any]:
    """The numbers of a report, and those that count since the one before it."""
    number = report.number
    steps, late = number("steps"), number("late steps")
    made, were_late = before.number("steps"), before.number("late steps")
    percent = None
    if None not in (steps, late, made, were_late) and steps > made:  # type: ignore[operator]
        percent = 100.0 * (late - were_late) / (steps - made)  # type: ignore[operator]
    accuracy = report.values.get("accuracy")
    return {
        "rate": number("rate [Hz]"),
        "real_time_factor": number("real-time factor"),
        "late": late,
        "late_percent": percent,
        "overruns": number("overruns"),
        "step_ms": {"p50": number("step time p50 [ms]"), "p99": number("step time p99 [ms]")},
        "limited": number("limited tets"),
        "locked": number("locked tets"),
        "contact_nodes": number("contacts"),
        "contact_area": number("contact area [mm^2]", 1e-6),
        "penetration": number("penetration [mm]", 1e-3),
        "words": words_of(report),
        "command": {
            "age": number("command age [s]"),
            "rate": number("command rate [Hz]"),
            "delay": number("following delay [ms]", 1e-3),
            "mode": report.values.get("following"),
        },
        "accuracy": accuracy,
        "recording": recording_of(report),
    }


def words_of(report: Report) -> list[dict[str, str]]:
    """Its status bits in words, and its problems, of which those bits are some."""
    bits = {bit.name or "": said for bit, said in TEXTS.items() if bit & report.status}
    often = dict.fromkeys(bits, "")
    problems = []
    for problem in [] if report.message in ("", "ok") else _SEVERAL.split(report.message):
        counted = _COUNTED.fullmatch(problem)
        if counted is not None and counted[1] in bits:
            often[counted[1]] = f", in {counted[2]}"
        elif counted is not None:
            problems.append(f"one or several of these in {counted[2]}")
        else:
            problems.append(problem)
    found = [{"code": name, "text": text + often[name], "level": level} for name, (level, text) in bits.items()]
    level = LEVELS[min(max(report.level, 0), 2)]
    return found + [{"code": "", "text": problem, "level": level} for problem in problems]


def recording_of(report: Report) -> dict[str, Any]:
    """Whether a recording is made, and how far it is."""
    path = report.values.get("recording", "off")
    on = path != "off"
    return {
        "on": on,
        "name": path.rpartition("/")[2] if on else None,
        "messages": report.number("recorded messages"),
        "dropped": report.number("dropped records"),
    }

"""What a demo reached, what in it failed, and what to change where the machine did not hold it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from ..bags.reader import BagReader
from ..console import say, table
from ..errors import BagError, FingerSimError
from ..scene import Scene
from .loop import StepCounts

if TYPE_CHECKING:
    from ..pictures.report import Health, Recorded
    from .play import Played

FEWEST_HEARD = 0.5
"""Fraction of the commands that the node must hear; it skips those that newer ones overtake."""
REAL_TIME = 0.99
"""Real-time factor from which on a run counts as in real time."""
LATE = 0.005
"""Fraction of its steps by which the node may be late more often than a bare loop."""
LOWEST_RATE = 10.0
"""Least rate that is advised [Hz]: that of the longest dt."""


class DemoError(FingerSimError):
    """A part of the demo did not do its job."""


@dataclass
class Outcome:
    """What a demo left behind, and what went wrong in it."""

    bag: Path
    picture: Path
    log: Path
    played: Played
    heard: int
    """Commands in the recording."""
    messages: int
    """Recorded, all topics."""
    rate: float
    """Steps a second while the commands were played [Hz]."""
    dt: float
    """[s]"""
    tets: int
    recorded: Recorded
    health: Health
    floor: StepCounts
    """Of a bare loop, right before; see `bare_loop`."""
    priority: int
    """Of both loops' threads under SCHED_FIFO; 0: as any other thread."""
    failures: list[str] = field(default_factory=list)
    """Parts that did not do their job."""
    losses: list[str] = field(default_factory=list)
    """Messages that this machine was too slow for: not heard, or not recorded, and counted as such."""

    @property
    def real_time_factor(self) -> float:
        """Simulated time / wall time while the commands were played."""
        return self.rate * self.dt

    @property
    def late(self) -> float:
        """Late steps of the node, of its steps while the commands were played."""
        return self.health.late / max(self.health.steps, 1)

    @property
    def late_above_floor(self) -> float:
        """`late`, less that of the bare loop."""
        return self.late - self.floor.late_fraction

    @property
    def shortfalls(self) -> list[str]:
        """What this machine did not hold, though every part did its job."""
        out = list(self.losses)
        if self.real_time_factor < REAL_TIME:
            out.append(f"slower than real time: {self.rate:.0f} steps a second, of {1.0 / self.dt:g} asked for")
        if self.late_above_floor > LATE:
            out.append(
                f"{100 * self.late_above_floor:.2f} % more steps were late than of a bare loop, "
                f"wanted: at most {100 * LATE:g} %"
            )
        return out

    @property
    def advice(self) -> list[str]:
        """What to change, where something was not held."""
        if not self.shortfalls:
            return []
        out = []
        rate = held_rate(self.health.step_p99)
        if rate < 1.0 / self.dt:
            out.append(f"99 of 100 steps took less than {1e3 * self.health.step_p99:.2f} ms; try --rate {rate:g}")
        if self.priority == 0:
            out.append("let the loop run before other programs: --priority 20, where `ulimit -r` is at least that")
        if not out:
            out.append("steps take less time than they have: other programs delay them; try a quieter machine")
        return out

    def table(self) -> Table:
        """What was reached, and what each number means."""
        played, health, floor = self.played, self.health, self.floor
        peak = int(np.argmax(self.recorded.force))
        force, when = self.recorded.force[peak], self.recorded.wrench_time[peak]
        out = table()
        rows = (
            ("rate reached", f"{self.rate:.1f} Hz", f"steps a second, of {1.0 / self.dt:g} asked for"),
            ("real-time factor", f"{self.real_time_factor:.4f}",
             f"simulated time / wall time; wanted: at least {REAL_TIME:g}"),
            ("late steps", f"{100 * self.late:.2f} %",
             f"{health.late} of {health.steps}, not done when the next was due"),
            ("late steps of a bare loop", f"{100 * floor.late_fraction:.2f} %",
             f"{floor.late} of {floor.steps} that do nothing, right before; real-time factor "
             f"{floor.real_time_factor(self.dt):.4f}"),
            ("late steps above it", f"{100 * self.late_above_floor:.2f} %", f"wanted: at most {100 * LATE:g} %"),
            ("priority of both loops", str(self.priority),
             "SCHED_FIFO" if self.priority else "none: as any other thread"),
            ("step time median", f"{1e3 * health.step_median:.3f} ms",
             f"to simulate and send a step, of {1e3 * self.dt:g} ms"),
            ("step time p99", f"{1e3 * health.step_p99:.3f} ms", "99 of 100 steps took less"),
            ("overruns", str(health.overruns), f"steps skipped, of {health.steps + health.overruns}"),
            ("peak force", f"{force:.3f} N",
             f"of the plane on the finger, at {when:.2f} s" if force > 0.0 else "the finger touched nothing"),
            ("most tetrahedra at a limit", f"{health.limited_tets} of {self.tets}", "in one step"),
            ("max strain/limit", f"{health.max_strain_ratio:.3f}", "1: exactly at the limit"),
            ("max penetration", f"{1e3 * health.max_penetration:.4f} mm", "of the skin into the plane"),
            ("solver status", health.status, f"set in {health.troubled} of {health.steps} steps"
             if health.troubled else "in every step"),
            ("commands", f"{self.heard} of {played.sent}",
             f"heard, sent {1e3 * played.late_p99:.2f} ms late (p99)"),
            ("messages recorded", str(self.messages), "on all topics, numbered"),
            ("bag", str(self.bag), ""),
            ("picture", str(self.picture), ""),
            ("log of the node", str(self.log), ""),
        )  # fmt: skip
        for row in rows:
            out.add_row(*row)
        return out


def held_rate(step_p99: float) -> float:
    """A rate at which 99 of 100 steps are done in time [Hz]: round, with a tenth of the period to spare for waking."""
    rate = 0.9 / max(step_p99, 1e-6)
    grain = 10.0 ** (math.floor(math.log10(rate)) - 1)
    return max(LOWEST_RATE, math.floor(rate / grain) * grain)


def sum_up(
    recording: Path, log: Path, picture: Path, played: Played, scene: Scene, tets: int, floor: StepCounts, priority: int
) -> Outcome:
    """Reads the recording, draws, and checks that nothing is missing."""
    from ..pictures.plots import draw
    from ..pictures.report import read_health, read_recording

    say("reading the recording")
    try:
        reader = BagReader(recording)
        recorded = read_recording(recording, scene.plane)
        health = read_health(recording, recorded.start, recorded.start + round(1e9 * played.duration))
    except BagError as error:
        raise DemoError(f"the recording is of no use: {error}; see {log}") from None
    counts = {topic.name: topic.count for topic in reader.topics}
    during = recorded.wrench_time[(recorded.wrench_time >= 0.0) & (recorded.wrench_time <= played.duration)]
    outcome = Outcome(
        bag=recording,
        picture=picture,
        log=log,
        played=played,
        heard=counts.get("/command_pose", 0),
        messages=reader.message_count,
        rate=_rate(during),
        dt=scene.dt,
        tets=tets,
        recorded=recorded,
        health=health,
        floor=floor,
        priority=priority,
    )
    lost = [f"{t.name}: {t.lost} messages lost in recording" for t in reader.topics if t.lost]
    (outcome.losses if health.dropped else outcome.failures).extend(lost)
    if reader.warning:
        outcome.failures.append(f"the bag is not whole: {reader.warning}")
    if health.dropped:
        outcome.losses.append(f"{health.dropped} messages not recorded: disk or processor too slow")
    if len(during) < 2:
        outcome.failures.append("no contact_wrench was recorded while commands came in")
    if health.refused:
        outcome.failures.append(f"the node refused {health.refused} commands; see {log}")
    if outcome.heard < FEWEST_HEARD * played.sent:
        outcome.losses.append(f"the node heard {outcome.heard} of {played.sent} commands")
    say("drawing")
    draw(recorded, picture)
    if not picture.is_file() or picture.stat().st_size == 0:
        outcome.failures.append(f"{picture} was not written")
    return outcome


def _rate(times: Any) -> float:
    """Events a second of their times (n,) [s]; 0 for fewer than two."""
    return float((len(times) - 1) / (times[-1] - times[0])) if len(times) > 1 else 0.0

"""`finger_sim stress`: directed extremes and a seeded fuzz of whole scenes and motions; none may end as *failed*.

ok        nothing was wrong, and no status bit was set
degraded  nothing was wrong that a status bit did not say
refused   the scene, its mesh or a command was refused by an error that names it; nothing else was wrong
failed    a number that is not finite, an exception, no end, wrong without a word (stress_watch.py), not recovered
          in the time stated, a mesh that stays broken, drift, or a force beyond the one stated
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from ...bags.reader import require_absent
from ...console import say, table
from ...errors import FingerSimError
from ...pictures.surfaces import new_figure, save
from .case import Case, write
from .extremes import LONG_CYCLES, extremes, press_and_slide_for_long
from .fuzz import fuzz_case
from .run import Kind, Outcome, StepClock, run
from .starts import starts

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture
    from rich.table import Table

Meter = Callable[[float, float], None]
"""Told how many cases are done, and how many there are."""

KINDS: tuple[Kind, ...] = get_args(Kind)
COLORS = {"ok": "#2a7f4f", "degraded": "#9cc3e6", "refused": "#c9ced4", "failed": "#b3332e"}
"""Of each end, in pictures."""


@dataclasses.dataclass(frozen=True)
class Options:
    """What to run."""

    cases: int = 200  # of the fuzz, besides the directed ones
    seed: int = 0
    minutes: float | None = None  # after which no further case begins
    long: bool = False  # a million steps of press and slide too
    out: Path = Path("stress_failed")  # folder for cases that failed


@dataclasses.dataclass(frozen=True)
class Report:
    """How every case ended."""

    outcomes: tuple[Outcome, ...]
    left_out: int  # cases that there was no time for
    written: tuple[Path, ...]  # folders of those that failed

    @property
    def failed(self) -> tuple[Outcome, ...]:
        return tuple(outcome for outcome in self.outcomes if outcome.kind == "failed")


def directed(long: bool = False) -> list[Case]:
    """Every directed case."""
    return [*extremes(), *starts(), *([press_and_slide_for_long(LONG_CYCLES)] if long else [])]


def stress(what: Options, progress: Meter = lambda done, all_there_are: None) -> Report:
    """Run the directed cases, then the fuzz; what fails is written to `what.out`.

    Raises FingerSimError when that is there already, or cannot be made.
    """
    require_absent(what.out)
    first = directed(what.long)
    total, began = len(first) + what.cases, time.monotonic()
    fuzz = (fuzz_case(what.seed, index) for index in range(what.cases))
    outcomes: list[Outcome] = []
    written: list[Path] = []
    under_way: list[Case] = []
    with contextlib.closing(StepClock(hung=lambda: _end(under_way[-1], what.out))) as clock:
        for case in itertools.chain(first, fuzz):
            if what.minutes is not None and time.monotonic() - began > 60.0 * what.minutes:
                break
            under_way[:] = [case]
            outcome = run(case, clock=clock)
            outcomes.append(outcome)
            if outcome.kind == "failed":
                written.append(_written(case, outcome, what.out))
            progress(len(outcomes), total)
    return Report(tuple(outcomes), total - len(outcomes), tuple(written))


def digest(outcomes: Iterable[Outcome]) -> str:
    """Of everything but the time it took: equal where all went the same way, to the last bit."""
    same = (repr(dataclasses.replace(outcome, seconds=0.0)) for outcome in outcomes)
    return hashlib.sha256("\n".join(same).encode()).hexdigest()


def by_family(outcomes: Iterable[Outcome]) -> Iterator[tuple[str, list[Outcome]]]:
    """Outcomes of each family, in the order that families come up, then of all."""
    families: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        families.setdefault(outcome.family, []).append(outcome)
        families.setdefault("all", []).append(outcome)
    yield from ((name, some) for name, some in families.items() if name != "all")
    if families:
        yield "all", families["all"]


def summary(report: Report) -> Table:
    """The outcomes counted by family, with the worst of each."""
    rows = table("family", "cases", *KINDS, "strain/limit", "penetration mm", "force N", "recovery s", "drift")
    for family, some in by_family(report.outcomes):
        recovery, drift = _worst(some, "recovery"), _worst(some, "drift")
        rows.add_row(
            family,
            str(len(some)),
            *(str(sum(outcome.kind == kind for outcome in some)) for kind in KINDS),
            f"{_worst(some, 'strain_ratio'):.3g}",
            f"{1e3 * (_worst(some, 'penetration') or 0.0):.3g}",
            f"{_worst(some, 'force'):.3g}",
            "" if recovery is None else f"{recovery:.3g}",
            "" if drift is None else f"{drift:.1g}",
        )
    return rows


def failures(report: Report) -> Table:
    """What failed, and what was wrong."""
    rows = table("failed", "what was wrong")
    for outcome in report.failed:
        rows.add_row(outcome.name, "; ".join(outcome.failures))
    return rows


def draw(report: Report, path: Path) -> Path:
    """Writes the picture. Raises MissingExtraError without matplotlib, FingerSimError when it cannot be written."""
    return save(make_figure(report), path)


def make_figure(report: Report) -> Picture:
    """A bar for each family, as long as it has cases, divided by how they ended."""
    families = list(by_family(report.outcomes))[:-1]
    figure = new_figure(8.6, 0.9 + 0.27 * len(families))
    axes = figure.add_axes((0.2, 0.42 / figure.get_figheight(), 0.78, 1.0 - 0.85 / figure.get_figheight()))
    begun = [0] * len(families)
    for kind in KINDS:
        counts = [sum(outcome.kind == kind for outcome in some) for _, some in families]
        axes.barh(range(len(families)), counts, 0.7, begun, color=COLORS[kind], label=f"{kind} {sum(counts)}")
        begun = [first + count for first, count in zip(begun, counts, strict=True)]
    axes.set_yticks(range(len(families)), [name for name, _ in families])
    axes.invert_yaxis()
    axes.set_xlabel("cases")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, ncols=len(KINDS), loc="lower left", bbox_to_anchor=(0.0, 1.0), borderpad=0.2)
    return figure


def _worst(outcomes: Sequence[Outcome], name: str) -> Any:
    """The largest of a number that not every outcome has; None where none has."""
    return max((value for outcome in outcomes if (value := getattr(outcome, name)) is not None), default=None)


def _end(case: Case, out: Path) -> None:
    """A step that does not return cannot be left but with the process."""
    failure = "hang: a step does not return"
    outcome = Outcome(case.name, case.family, "failed", failures=(failure,))
    say(f"{case.name}: {failure}; written to {_written(case, outcome, out)}")
    os._exit(1)


def _written(case: Case, outcome: Outcome, out: Path) -> Path:
    """The folder of a failed case. Raises FingerSimError when it cannot be made, or is there already."""
    try:
        return write(case, out / case.name, "; ".join(outcome.failures))
    except OSError as error:
        raise FingerSimError(f"--out: {out / case.name} cannot be written: {error.strerror}") from None

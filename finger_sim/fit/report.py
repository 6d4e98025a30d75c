"""What a fit leaves behind: tables on the terminal, the scene, and a CSV and a JSON of its numbers."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.table import Table

from ..console import table
from ..plain import plain, whole_file
from ..studies.tradeoff.run import portable
from ..studies.tradeoff.scene import write_scene
from .fitting import Estimate, Fit
from .press import FitError
from .uncertainty import ENOUGH, LEVEL, Interval

GOOD = 0.03
"""Error of a press's force, a part of its largest, up to which a fit is called good."""


def tables(fit: Fit) -> Iterator[tuple[str, Table]]:
    """Titles and tables."""
    rows = table("unknown", "was", "fitted", f"{LEVEL:.0%} interval", "over presses", "")
    for one in fit.estimates:
        rows.add_row(
            one.unknown.name, one.unknown.words(one.unknown.theta(one.unknown.start)),
            one.unknown.words(one.theta) if one.told else "not told", _interval(one, one.interval),
            "–" if one.resampled is None else _interval(one, Interval(*one.resampled, False, False)), one.why,
        )  # fmt: skip
    yield "", rows
    rows = table(
        "press", "direction", "samples", "to depth", "force", "error before", "fitted", "left out", "as it runs"
    )
    foretold = {each.press: each.foretold for each in fit.foretold}
    for k, press in enumerate(fit.model.presses):
        rows.add_row(
            press.name, press.direction, str(len(fit.curves[k].way.used)), f"{1e3 * press.depth.max():.3g} mm",
            f"{press.normal.max():.3g} N", f"{fit.errors_before[k]:.1%}", f"{fit.errors[k]:.1%}",
            f"{foretold[press.name]:.1%}" if press.name in foretold else "–",
            f"{fit.as_run[k]:.1%}" if fit.as_run else "–",
        )  # fmt: skip
    yield "error: rms of the normal force over the press's largest", rows
    if fit.carried:
        rows = table("mesh", "young", "errors", "forces apart")
        for each in fit.carried:
            errors = ", ".join(f"{error:.1%}" for error in each.errors)
            rows.add_row(each.mesh, f"{each.young:.4g} Pa", errors, f"{each.apart:.1%}")
        yield "on other meshes, the modulus alone fitted again", rows


def sentences(fit: Fit) -> list[str]:
    """What is to be known besides: priors, presses that are few, errors that stay."""
    out = list(fit.notes)
    out += [f"{one.unknown.name}: {one.why}" for one in fit.estimates if not one.told]
    if len(fit.model.presses) == 1:
        out.append("one press: nothing was left out to be foretold")
    if 1 < len(fit.model.presses) < ENOUGH:
        out.append(
            f"{len(fit.model.presses)} presses: too few to draw them anew (from {ENOUGH} on); intervals are of the "
            f"profile"
        )
    poor = [press.name for press, error in zip(fit.model.presses, fit.errors, strict=True) if error > GOOD]
    if poor:
        out.append(
            f"the scene cannot give {', '.join(poor)} within {GOOD:.0%}, whatever the fitted values: intervals do not "
            f"tell of that"
        )
    return out


def _interval(one: Estimate, interval: Interval | None) -> str:
    """As the scene has the value, low end first."""
    if interval is None:
        return "–"
    ends = [(one.unknown.told(interval.low), interval.low_open), (one.unknown.told(interval.high), interval.high_open)]
    (low, low_open), (high, high_open) = sorted(ends)
    return f"{'< ' if low_open else ''}{low:.4g} … {'> ' if high_open else ''}{high:.4g}"


def numbers(fit: Fit) -> dict[str, Any]:
    """Everything, as plain values."""
    estimates = []
    for one in fit.estimates:
        ends = None if one.interval is None else sorted(one.unknown.told(end) for end in one.interval[:2])
        estimates.append(
            {
                "name": one.unknown.name,
                "was": one.unknown.told(one.unknown.theta(one.unknown.start)),
                "fitted": one.unknown.told(one.theta),
                "told": one.told,
                "why": one.why,
                "interval": ends,
                "open": None if one.interval is None else list(one.interval[2:]),
                "over_presses": None if one.resampled is None else sorted(map(one.unknown.told, one.resampled)),
                "bounds": sorted(
                    one.unknown.told(one.unknown.theta(end)) for end in (one.unknown.low, one.unknown.high)
                ),
                "prior_factor": one.unknown.factor,
                "unit": one.unknown.unit,
            }
        )
    presses = [
        {
            "name": press.name, "direction": press.direction,
            "error_before": fit.errors_before[k], "error": fit.errors[k],
            "depth_m": press.depth[fit.curves[k].way.used], "normal_n": press.normal[fit.curves[k].way.used],
            "fitted_normal_n": fit.curves[k].normal,
        }
        for k, press in enumerate(fit.model.presses)
    ]  # fmt: skip
    out = {
        "estimates": estimates, "presses": presses, "left_out": [each._asdict() for each in fit.foretold],
        "carried": [{**each._asdict(), "scene": portable(each.scene)} for each in fit.carried],
        "as_run": fit.as_run, "usual_difference": fit.size, "notes": sentences(fit), "scene": portable(fit.scene),
    }  # fmt: skip
    clean: dict[str, Any] = plain(out)
    return clean


def comments(fit: Fit, command: str) -> list[str]:
    """What the scene says of itself."""
    found = [
        f"{one.unknown.name} {one.unknown.words(one.theta)} ({_interval(one, one.interval)})"
        for one in fit.estimates if one.told
    ]  # fmt: skip
    kept = [one.unknown.name for one in fit.estimates if not one.told]
    errors = ", ".join(f"{press.name} {error:.1%}" for press, error in zip(fit.model.presses, fit.errors, strict=True))
    return [
        f"Fitted by {command}",
        f"Found, with {LEVEL:.0%} intervals: {'; '.join(found) or 'nothing'}.",
        *([f"Not told by the data, and left as it was: {', '.join(kept)}."] if kept else []),
        f"Error of the normal force over each press's largest: {errors}.",
    ]


def write(fit: Fit, out: Path, work: Path, command: str) -> list[Path]:
    """The scene, its table as CSV and everything as JSON. Raises FitError where they cannot be written."""
    write_scene(out, fit.scene, comments(fit, command))
    written = [out]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["unknown", "unit", "was", "fitted", "told", "low", "high", "low_open", "high_open", "why"])
    for one in fit.estimates:
        interval = one.interval or Interval(one.theta, one.theta, True, True)
        ends = [
            (one.unknown.told(interval.low), interval.low_open),
            (one.unknown.told(interval.high), interval.high_open),
        ]
        (low, low_open), (high, high_open) = sorted(ends)
        rows.writerow(
            [
                one.unknown.name,
                one.unknown.unit,
                one.unknown.told(one.unknown.theta(one.unknown.start)),
                one.unknown.told(one.theta),
                one.told,
                low,
                high,
                low_open,
                high_open,
                one.why,
            ]
        )
    for name, content in (
        ("fit.csv", text.getvalue()),
        ("fit.json", json.dumps(numbers(fit), indent=1, ensure_ascii=False, allow_nan=False) + "\n"),
    ):
        try:
            with whole_file(work / name) as file:
                file.write_text(content, encoding="utf-8")
        except OSError as error:
            raise FitError(f"{work / name}: cannot be written: {error.strerror}") from None
        written.append(work / name)
    for each in fit.carried:
        path = out.with_name(f"{out.stem}_on_{Path(each.mesh).stem}.yaml")
        lines = [
            f"As {out.name}, on another mesh: the modulus alone fitted again.",
            f"Its forces are {each.apart:.1%} (rms over the largest) off those of {out.name}.",
        ]
        write_scene(path, each.scene, lines)
        written.append(path)
    return written

"""The picture of a fit: each press, what is left of it, and each unknown with its interval.

Force is drawn against depth; where something relaxes, against time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..pictures.surfaces import new_figure
from .fitting import Fit
from .model import Curve
from .press import TARGET, Press

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED, FITTED, BEFORE, SIDEWAYS = "0.55", "#0b5394", "#d1730f", "#38761d"
WIDEST = 4
"""Presses side by side; more go to further rows."""


def draw(fit: Fit) -> Figure:
    """As a matplotlib figure, without a display. Raises MissingExtraError without matplotlib."""
    count = len(fit.model.presses)
    wide = min(count, WIDEST)
    rows = -(-count // WIDEST)
    tall = 0.32 * len(fit.estimates) + 0.9
    figure = new_figure(max(3.1 * wide, 6.2), 3.7 * rows + tall)
    from matplotlib import rc_context

    style: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        height = figure.get_size_inches()[1]
        low = (tall + 0.35) / height
        grid = figure.add_gridspec(
            2 * rows, wide, height_ratios=[2.4, 1.0] * rows, hspace=0.35, wspace=0.35,
            left=0.11, right=0.97, top=1.0 - 0.3 / height, bottom=low + 0.35 / height,
        )  # fmt: skip
        for k, press in enumerate(fit.model.presses):
            row, column = divmod(k, WIDEST)
            force = figure.add_subplot(grid[2 * row, column])
            rest = figure.add_subplot(grid[2 * row + 1, column], sharex=force)
            title = f"{press.name}: {fit.errors[k]:.1%}"
            _press(force, rest, press, fit.curves[k], fit.before[k], title, bool(fit.scene.material.relaxation))
            if k == 0:
                force.legend(frameon=False, fontsize=8, loc="upper left")
            if column == 0:
                force.set_ylabel("force [N]")
                rest.set_ylabel("fit − data [N]")
        below = figure.add_gridspec(1, 1, left=0.25, right=0.97, top=low - 0.3 / height, bottom=0.45 / height)
        _unknowns(figure.add_subplot(below[0]), fit)
    return figure


def _press(force: Any, rest: Any, press: Press, fitted: Curve, before: Curve, title: str, timed: bool) -> None:
    used = fitted.way.used
    along = press.time - press.time[used[0]] if timed else 1e3 * press.depth
    x = along[used]
    force.plot(
        x, press.normal[used], ".", color=MEASURED, ms=3, label="asked for" if press.name == TARGET else "measured"
    )
    force.plot(along[before.way.used], before.normal, color=BEFORE, lw=0.9, ls="--", label="before")
    force.plot(x, fitted.normal, color=FITTED, lw=1.4, label="fitted")
    if press.tangential is not None and fitted.tangential is not None:
        size = [t if t.ndim == 1 else np.linalg.norm(t, axis=1) for t in (press.tangential[used], fitted.tangential)]
        if size[0].max() > 0.05 * press.normal.max():
            force.plot(x, size[0], ".", color=SIDEWAYS, ms=2, alpha=0.5, label="tangential")
            force.plot(x, size[1], color=SIDEWAYS, lw=1.2)
    force.set_ylim(-0.03 * press.normal.max(), 1.35 * press.normal.max())
    force.set_title(title, fontsize=9)
    force.tick_params(labelbottom=False)
    rest.axhline(0.0, color="0.7", lw=0.8)
    rest.plot(x, fitted.normal - press.normal[used], ".", color=FITTED, ms=2)
    rest.set_xlabel("time [s]" if timed else "depth [mm]")


def _unknowns(axes: Any, fit: Fit) -> None:
    """Each unknown's interval, as factors of what was found; open ends as arrows."""
    for k, one in enumerate(fit.estimates):
        interval = one.interval
        color = FITTED if one.told else MEASURED
        if interval is not None:
            low, high = interval.low - one.theta, interval.high - one.theta
            axes.plot([low, high], [k, k], color=color, lw=2.0)
            for end, is_open, mark in ((low, interval.low_open, "<"), (high, interval.high_open, ">")):
                axes.plot(end, k, mark if is_open else "|", color=color, ms=6)
        axes.plot(0.0, k, "o", color=color, ms=4)
        axes.plot(one.unknown.theta(one.unknown.start) - one.theta, k, "d", color=BEFORE, ms=4, mfc="none")
    axes.set_yticks(range(len(fit.estimates)))
    axes.set_yticklabels(
        [f"{one.unknown.name} {one.unknown.words(one.theta) if one.told else 'not told'}" for one in fit.estimates],
        fontsize=8,
    )
    axes.set_ylim(len(fit.estimates) - 0.5, -0.5)
    low, high = axes.get_xlim()
    axes.set_xlim(max(low, -1.7), min(high, 1.7))
    axes.set_xlabel(
        "ln of value, of a limit's room, of a share over its rest, over what was found; ◇ before", fontsize=8
    )

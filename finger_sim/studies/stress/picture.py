"""The picture of a stress run: how the cases of each family ended."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...pictures.surfaces import new_figure, save
from .stress import KINDS, Report, by_family

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

COLORS = {"ok": "#2a7f4f", "degraded": "#9cc3e6", "refused": "#c9ced4", "failed": "#b3332e"}
"""Of each end."""


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

"""`finger_sim figures`: experiments of the paper, and of fingertips, run, measured and drawn; what differs is said.

Each figure is a module of its own, `<name>` here or one of ELSEWHERE, with `measure`, `numbers`, `findings` and `draw`.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from ...console import gauge, say
from ...errors import FingerSimError
from ...pictures.surfaces import new_figure, save
from ...plain import plain, whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

FIGURES = {
    "beams": "beams of three materials (the paper's Figure 2)",
    "finger": "a finger pressed flat, on its side and on its tip (Figure 3)",
    "standing": "a standing beam at the first violated limit (Figure 4)",
    "isotropy": "strain allowed by direction, and smoothness (Sections 3.3 and 6)",
    "locking": "over-constrained tetrahedra (Section 6)",
    "speed": "steps a second by constrained tetrahedra (Section 5.1)",
    "relaxation": "force that fades while a press is held, and what a tap loses (finger_relaxing)",
    "fingertip": "a fingertip's stiffness, contact area and shear beside what is known of fingertips",
}
"""Name: what it shows."""
ELSEWHERE = {"relaxation": "..relaxation.figure", "fingertip": "..fingertip.figure"}
"""Modules of those that are not of the paper."""
THE_PAPER = "the paper says"
"""Head of the column that measurements are held against, unless a module has another (SAID_BY)."""

Meter = Callable[[float, float], None]
"""Told how much of a study is done, and how much there is."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One statement of the paper, or of another source, beside what was measured."""

    paper: str
    measured: str
    agrees: bool | None  # None: the paper gives nothing to hold it against
    reason: str = ""  # why it does not, where known


class Study(Protocol):
    """What the module of a figure offers; R is a type of its own."""

    @staticmethod
    def measure(progress: Meter) -> Any:
        """Run the experiment: everything that the others need."""

    @staticmethod
    def numbers(result: Any) -> dict[str, Any]:
        """What the figure claims, plain values for JSON; units in the keys' ends (`_m`, `_hz`, `_n_per_m`)."""

    @staticmethod
    def findings(result: Any) -> list[Finding]:
        """The paper's statements that it is about."""

    @staticmethod
    def draw(result: Any) -> Picture:
        """The picture."""


@dataclasses.dataclass(frozen=True)
class Made:
    """One figure as it was written."""

    name: str
    picture: Path
    data: Path
    numbers: dict[str, Any]
    findings: list[Finding]
    said_by: str = THE_PAPER


def figures(names: Sequence[str], out: Path) -> Iterator[Made]:
    """Make the figures of these names in the folder `out`, one after the other: <name>.png and <name>.json.

    Raises FingerSimError when a name is unknown or the folder cannot be written, MissingExtraError without matplotlib.
    """
    for name in names:
        if name not in FIGURES:
            raise FingerSimError(f"--only: got {name!r}, allowed: {', '.join(FIGURES)}")
    new_figure(1.0, 1.0)  # a missing matplotlib shows before anything long
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FingerSimError(f"--out: {out} cannot be made: {error.strerror}") from None
    for name in names:
        study = module_of(name)
        with gauge(f"{name}: {FIGURES[name]}") as meter:
            result = study.measure(meter)
        say(f"{name}: drawing")
        picture = save(study.draw(result), out / f"{name}.png")
        said_by = getattr(study, "SAID_BY", THE_PAPER)
        made = Made(name, picture, out / f"{name}.json", plain(study.numbers(result)), study.findings(result), said_by)
        write(made)
        yield made


def module_of(name: str) -> Study:
    """The module of a figure."""
    return cast(Study, importlib.import_module(ELSEWHERE.get(name, f".{name}"), __package__))


def write(made: Made) -> None:
    """The JSON beside the picture. Raises FingerSimError when it cannot be written."""
    data = {
        "figure": FIGURES[made.name],
        "numbers": made.numbers,
        "findings": [dataclasses.asdict(finding) for finding in made.findings],
    }
    try:
        with whole_file(made.data) as file:
            file.write_text(json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise FingerSimError(f"{made.data}: cannot be written: {error.strerror}") from None

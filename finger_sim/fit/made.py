"""Presses of a scene itself, written as if they had been measured: to try a fit on, and to test it.

`python -m finger_sim.fit.made FOLDER` makes the shipped sample, examples/presses.csv, anew.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Floats
from ..bags.strokes import minimum_jerk
from ..console import make_files
from ..physics.rotations import Quaternion
from ..plain import whole_file
from ..scene import Pose, Scene
from ..simulation.simulator import Simulator
from ..simulation.touch import Imprint
from .press import FitError, orientation_of, touch_height

SAMPLE = "presses.csv"
TRUE = {"material.young": 1.15e4, "limits.stretch": [1.06, 1.2, 1.03], "limits.compress": [0.95, 0.8, 0.97]}
"""What of `finger_haptic` the sample's finger has otherwise."""
RATE = 200.0
"""Samples a second [Hz]."""
ABOVE = 3e-4
"""Height above first touch from which a press begins, and to which it goes back [m]."""
NOISE = 0.02
"""Standard deviation of a force sample, a part of it."""
FLOOR = 2e-3
"""The same where there is no force [N]."""


@dataclass(frozen=True)
class Course:
    """A press: down to `depth` [m] in `seconds`, there for `hold` [s], along by `slide` [m] in `seconds`, and up.

    turn: orientation xyzw where it is no direction that has a name
    """

    direction: str
    depth: float
    seconds: float = 1.0
    slide: float = 0.0
    name: str = ""
    turn: Quaternion | None = None
    hold: float = 0.0

    @property
    def orientation(self) -> Quaternion:
        """Of the finger frame, xyzw."""
        return self.turn or orientation_of(self.direction)


SAMPLES = (
    Course("flat", 1.8e-3, slide=4e-3, name="flat and along"),
    Course("side", 0.9e-3, name="side"),
    Course("tip", 1.2e-3, name="tip"),
)


def measured(scene: Scene, course: Course, noise: float = NOISE, seed: int = 0) -> dict[str, Floats]:
    """Columns of a press of the scene in time, by the step and settings of the scene: SI, names as in CSV files.

    noise: see NOISE; 0: none, and no FLOOR either
    """
    simulator = Simulator(scene.with_values({"plane.point": [0.0, 0.0, 0.0], "plane.normal": [0.0, 0.0, 1.0]}))
    turn = course.orientation
    touch = touch_height(scene, simulator.mesh, turn)
    legs = [(0.1, -ABOVE, 0.0), (course.seconds, course.depth, 0.0)]
    legs += [(course.hold, course.depth, 0.0)] if course.hold else []
    legs += [(course.seconds, course.depth, course.slide)] if course.slide else []
    legs += [(course.seconds, -ABOVE, course.slide)]
    rows, now, every = [], (-ABOVE, 0.0), max(1, round(1.0 / (RATE * scene.dt)))
    simulator.reset(Pose((0.0, 0.0, touch + ABOVE), turn))
    step = 0
    for seconds, *to in legs:
        count = round(seconds / scene.dt)
        for k in range(1, count + 1):
            part = float(minimum_jerk(np.array(k / count)))
            depth, along = (a + (b - a) * part for a, b in zip(now, to, strict=True))
            out = simulator.step(Pose((along, 0.0, touch - depth), turn))
            step += 1
            if step % every == 0:
                area = Imprint.of(simulator).touch().area
                rows.append((step * scene.dt, depth, along, *out.contact_wrench[[2, 0, 1]].tolist(), area))
        now = (to[0], to[1])
    names = ("time", "depth", "along", "normal", "tangential_x", "tangential_y", "area")
    columns = {name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)}
    if noise:
        draw = np.random.default_rng(seed)
        for name in ("normal", "tangential_x", "tangential_y"):
            columns[name] = columns[name] * (1.0 + noise * draw.standard_normal(len(columns[name])))
            columns[name] = columns[name] + FLOOR * draw.standard_normal(len(columns[name]))
    return columns


UNITS = {"time": ("s", 1.0), "depth": ("mm", 1e3), "along": ("mm", 1e3), "area": ("mm^2", 1e6)}


def write(path: Path, presses: Sequence[tuple[Course, dict[str, Floats]]], comments: Sequence[str] = ()) -> Path:
    """A CSV of presses that `csv_data` reads. Raises OSError."""
    names = list(presses[0][1])
    head = [f"{name} [{UNITS.get(name, ('N', 1.0))[0]}]" for name in names]
    turned = any(course.turn for course, _ in presses)
    how = ["qx", "qy", "qz", "qw"] if turned else ["direction"]
    lines = [f"# {comment}" for comment in comments] + [",".join(["press", *how, *head])]
    for course, columns in presses:
        said = [f"{q:.9g}" for q in course.orientation] if turned else [course.direction]
        for values in zip(*columns.values(), strict=True):
            cells = [f"{UNITS.get(n, ('N', 1.0))[1] * v:.6g}" for n, v in zip(names, values, strict=True)]
            lines.append(",".join([course.name or course.direction, *said, *cells]))
    with whole_file(path) as file:
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def make_sample(folder: Path) -> Iterable[Path]:
    """The shipped sample."""
    if not folder.is_dir():
        raise FitError(f"{folder}: no such folder")
    scene = Scene.load("finger_haptic").with_values(TRUE)
    presses = [(course, measured(scene, course, seed=k)) for k, course in enumerate(SAMPLES)]
    comments = (
        "Simulated, not measured: three presses of finger_haptic with these other values, 2 % noise in forces.",
        ", ".join(f"{key} {value}" for key, value in TRUE.items()).replace(": ", " "),
        "Made by python -m finger_sim.fit.made examples",
    )
    yield write(folder / SAMPLE, presses, comments)


if __name__ == "__main__":
    sys.exit(make_files("finger_sim.fit.made", "Makes the sample of presses.", "folder for it", make_sample, None))

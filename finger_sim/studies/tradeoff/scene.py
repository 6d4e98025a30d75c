"""Scenes that a study found, written with what was measured about them."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ...plain import whole_file
from ...scene import Limits, Plane, Scene
from .measures import Errors
from .motion import TradeoffError
from .run import Times, portable

WIDTH = 118
"""Characters in a line of comment."""


@dataclass(frozen=True)
class Meant:
    """What a scene is off the finger that is meant."""

    mesh: str  # of that finger
    by_mesh: Errors  # of the scene's model, converged: mesh and element
    total: Errors  # of the scene as it is


@dataclass(frozen=True)
class Measured:
    """What is claimed about a scene."""

    errors: Errors  # against the same model, converged
    uncertainty: float  # of that: errors' force_rel of it at twice its time step
    peak: float  # force [N]
    times: Times
    meant: Meant | None = None  # None: no finger of which a finer one is shipped

    def sentences(self, motion: str, machine: str) -> list[str]:
        """Errors and times in words."""
        t = self.times
        return [
            *self._solver_and_mesh(motion),
            f"Step time: median {1e3 * t.median:.3f} ms, p99 {1e3 * t.p99:.3f} ms, on one core of {machine}.",
        ]

    def _solver_and_mesh(self, motion: str) -> list[str]:
        error = self.errors
        solver = (
            f"Force error on {motion}, against the same model converged: {error.force_rel:.2%} RMS of the peak force "
            f"({self.peak:.2f} N), {error.force_max_n:.2g} N at most; what it is compared with is good to "
            f"{self.uncertainty:.2%}."
        )
        if self.meant is None:
            return [solver]
        mesh, total = self.meant.by_mesh, self.meant.total
        return [
            solver,
            f"Mesh error, against the finger that is meant ({self.meant.mesh} with patches, converged): "
            f"{mesh.force_rel:.2%} RMS of its peak force, {mesh.force_max_n:.2g} N at most. Both together: "
            f"{total.force_rel:.2%}, {total.force_max_n:.2g} N at most.",
        ]


def short(scene: Scene) -> dict[str, Any]:
    """The scene as plain values without those that a scene has anyway; shipped meshes by name."""
    given, defaults = portable(scene), Scene(scene.mesh, limits=Limits(), plane=Plane()).to_dict()
    out: dict[str, Any] = {}
    for key, value in given.items():
        default: Any = defaults.get(key)
        if key in ("driven", "dt"):
            out[key] = value
        elif key == "mesh":
            out[key] = {name: item for name, item in value.items() if item is not None}
        elif isinstance(value, dict):
            kept = {name: item for name, item in value.items() if name not in default or item != default[name]}
            if kept or key in ("limits", "plane"):
                out[key] = kept
        elif value != default:
            out[key] = value
    return out


def write_scene(path: Path, scene: Scene, comments: Sequence[str]) -> Path:
    """A scene as YAML with comments above, defaults left out. Raises TradeoffError when it cannot be written."""
    lines = [line for comment in comments for line in textwrap.wrap(comment, WIDTH - 2)]
    text = "".join(f"# {line}\n" for line in lines)
    text += yaml.safe_dump(short(scene), sort_keys=False, default_flow_style=None, width=WIDTH)
    try:
        with whole_file(path) as file:
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise TradeoffError(f"{path}: cannot be written: {error.strerror}") from None
    return path

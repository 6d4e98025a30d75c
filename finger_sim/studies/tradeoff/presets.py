"""The presets that the study justifies: finger_haptic, solved in four ways, each with what it was measured to do.

`python -m finger_sim.studies.tradeoff.presets FOLDER` measures and writes them anew: NAME.yaml and claims.yaml,
which tests/studies/tradeoff/test_tradeoff.py holds them to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ...console import make_files
from ...scene import MeshSource, Scene
from ..bench.bench import describe_machine
from .grid import AWAKE, MEANT, changed, meant, reference
from .measures import Errors, errors, peak_force
from .motion import Motion, motion
from .run import Course, course, portable, times
from .scene import Meant, Measured, write_scene
from .store import writable

SCENE = "finger_haptic"
PRESETS: dict[str, tuple[str, Mapping[str, Any]]] = {
    "fastest": (
        "for the least computing time: 250 Hz, a coarse tolerance",
        {"dt": 4e-3, "solver.tolerance": 1e-2, "plane.stiffness": 120.0},
    ),
    "haptic": (
        "for 1 kHz",
        {"plane.stiffness": 250.0},
    ),
    "balanced": (
        "between haptic and reference: two steps in the place of one, a stiffer contact",
        {"plane.stiffness": 400.0, "substeps": 2},
    ),
    "reference": (
        "to compare others with, not for real time: sixteen steps in the place of one, each linearised twice",
        {
            "plane.stiffness": 1000.0,
            "substeps": 16,
            "solver.tolerance": 1e-6,
            "solver.max_iterations": 100,
            "solver.level": "standard",
            "solver.relinearizations": 1,
        },
    ),
}
"""Name: what it is for, and what it changes in SCENE, as a point of a grid does (a mesh brings its modulus)."""


Body = tuple[MeshSource, str]
"""Mesh and element."""


def converged(scene: Scene, path: Motion, coarser: int = 1) -> Course:
    """The run that presets are compared with."""
    return course(portable(reference(scene, scene, len(scene.load_mesh().tets), coarser)), path, False)


def claim(scene: Scene, path: Motion, against: Course) -> tuple[dict[str, float], Errors, Course]:
    """What is claimed of a preset and does not depend on the machine; the errors and the run behind it."""
    own = course(portable(scene.with_values(AWAKE)), path, False)
    error = errors(own, against, None)
    claims = {
        "force_error_rms": error.force_rel,
        "force_error_max_n": error.force_max_n,
        "factorisations": float(own.work[0]),
        "iterations": float(own.work[1]),
    }
    return claims, error, own


def make_presets(folder: Path) -> list[Path]:
    """Measure the presets and write them. Raises TradeoffError when they cannot be written."""
    writable(folder)
    base = Scene.load(SCENE)
    path, machine = motion(base, None), describe_machine()
    scenes = {name: changed(base, values) for name, (_, values) in PRESETS.items()}
    finger = meant(base, MEANT)
    exact = None if finger is None else converged(finger, path)
    against = {body: converged(scene, path) for body, scene in _bodies(scenes.values()).items()}
    doubts = {
        body: errors(converged(scene, path, coarser=2), against[body], None).force_rel
        for body, scene in _bodies(scenes.values()).items()
    }
    claims: dict[str, Any] = {
        "scene": SCENE, "motion": path.name, "machine": machine["cpu"], "date": machine["date"],
        "reference_uncertainty": _short(max(doubts.values())), "meant": MEANT, "presets": {},
    }  # fmt: skip
    made = []
    for name, scene in scenes.items():
        exact_of_body, doubt = against[_body(scene)], doubts[_body(scene)]
        claimed, error, own = claim(scene, path, exact_of_body)
        took = times(portable(scene.with_values(AWAKE)), path)
        off = None
        if exact is not None:
            off = Meant(MEANT, errors(exact_of_body, exact, None), errors(own, exact, None))
            claimed |= {"mesh_error_rms": off.by_mesh.force_rel, "total_error_rms": off.total.force_rel}
        claimed |= {"step_median_s": took.median, "step_p99_s": took.p99}
        claims["presets"][name] = {key: _short(value) for key, value in claimed.items()}
        measured = Measured(error, doubt, peak_force(own), took, off)
        comments = [f"{SCENE}.yaml, {PRESETS[name][0]}.", *measured.sentences(path.name, machine["cpu"])]
        made.append(write_scene(folder / f"{name}.yaml", scene, comments))
    head = (
        "# What the presets were measured to do; a test fails when one does worse by 2 times. Work is for each step.\n"
    )
    file = folder / "claims.yaml"
    file.write_text(head + yaml.safe_dump(claims, sort_keys=False), encoding="utf-8")
    return [*made, file]


def _body(scene: Scene) -> Body:
    """What presets of one converged run have in common."""
    return scene.mesh, scene.material.volumetric


def _bodies(scenes: Iterable[Scene]) -> dict[Body, Scene]:
    """A scene for each mesh and element."""
    return {_body(scene): scene for scene in scenes}


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes the presets in a folder."""
    module, place = "finger_sim.studies.tradeoff.presets", "where to put them: config/presets"
    return make_files(module, "Makes the presets in a folder.", place, make_presets, arguments)


if __name__ == "__main__":
    raise SystemExit(main())

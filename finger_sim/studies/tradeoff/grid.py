"""The points of a trade-off study: what is changed in a scene, and what each point's error is measured against.

A grid file (YAML) changes a scene by dotted keys:

    base: {solver.method: newton}                   # changed in every point, and in what they are compared with
    sweeps:                                         # one value changed at a time
      dt: [0.0005, 0.001, 0.002]
    product:                                        # every combination
      dt: [0.001, 0.002]
      solver.level: [standard, lagged]
    points:                                         # these
      - {solver.method: pgs, solver.max_iterations: 400}

The scene itself, with `base`, is the first point. `finger_sim tradeoff` without a file runs DEFAULT.
A point that changes `mesh.file` from one shipped finger to another has that one's modulus, unless it names its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import SceneError
from ...scene import Scene
from ...scene.calibration import name_of, scene_on
from ...scene.fields import UNKNOWN_KEY
from ...scene.yaml_text import YamlText
from .motion import TradeoffError

HOW = ("dt", "substeps", "limits.viscosity", "limits.inertia", "plane.stiffness")
"""Keys that say how a model is solved, as all of `solver` do. All other keys are the model: what is solved.

The plane's stiffness is one of them: a contact gives only while its force changes, and never by more than the inertia
of a step allows (physics/contact.py). With smaller steps every contact becomes the same rigid one.
"""
AWAKE: dict[str, Any] = {"solver.sleep": False}
"""Steps that are not computed are no measure of anything."""
REFERENCE: dict[str, Any] = {
    "solver.method": "newton",
    "solver.tolerance": 1e-9,
    "solver.max_iterations": 200,
    "solver.relinearizations": 2,
    "solver.level": "standard",
    "solver.settle": True,
    "solver.sleep": False,
    "solver.deadline": None,
}
"""How a reference is solved."""
RIGID: dict[str, Any] = {"solver.method": "pgs", "solver.tolerance": 1e-6, "solver.max_iterations": 5000}
"""Where limits are rigid, which only pgs solves."""
CONTACT = 1e3
"""plane.stiffness of a reference."""
FINE: tuple[tuple[int, float, int], ...] = ((700, 2.5e-4, 8), (1500, 5e-4, 4), (3000, 1e-3, 4), (10**9, 1e-3, 1))
"""Time steps of a reference: up to how many tetrahedra, dt [s], substeps. Finer ones would take longer than a study."""
MESH = ("mesh.file", "material.volumetric")
"""Keys that say which mesh and element stand for the body."""
MEANT = "finger_4000"
"""The finger that is meant: this mesh, with patches, converged."""
BONE = "bone"
"""Node set driven in a finger that others stand for: one held elsewhere is another body on each mesh."""


@dataclass(frozen=True)
class Point:
    """One scene of the study."""

    scene: Scene
    name: str  # of the shipped scene or the file
    changed: Mapping[str, Any]  # dotted keys that differ from the base

    @property
    def knob(self) -> str:
        """The key that was changed; several as `several`, none as `base`. A cap comes with a method."""
        keys = list(self.changed)
        if keys == ["solver.method", "solver.max_iterations"]:
            return "solver.method"
        return keys[0] if len(keys) == 1 else "several" if keys else "base"

    @property
    def value(self) -> str:
        """What it was changed to, in words."""
        if self.knob in self.changed:
            return _word(self.changed[self.knob])
        return ", ".join(f"{key.rpartition('.')[2]} {_word(value)}" for key, value in self.changed.items())


@dataclass(frozen=True)
class Grid:
    """Changes to a scene by dotted keys; see above."""

    base: Mapping[str, Any] = field(default_factory=dict)
    sweeps: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    product: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    points: Sequence[Mapping[str, Any]] = ()
    fits_all: bool = False  # what a scene refuses is left out, and finger meshes where it is no finger on its bone

    def changes(self) -> Iterator[dict[str, Any]]:
        """What each point changes, besides the base."""
        yield {}
        for key, values in self.sweeps.items():
            yield from ({key: value} for value in values)
        if self.product:
            for values in itertools.product(*self.product.values()):
                yield dict(zip(self.product, values, strict=True))
        yield from (dict(point) for point in self.points)

    @staticmethod
    def load(path: Path) -> Grid:
        """Read a grid. Raises TradeoffError naming the file and the key."""
        try:
            text = YamlText(path)
            try:
                return Grid(**_checked(text.data))
            except SceneError as error:
                raise text.located(error) from None
        except SceneError as error:
            raise TradeoffError(f"--grid: {error}") from None


def _checked(data: Any) -> dict[str, Any]:
    """What a grid file holds. Raises SceneError naming the key."""
    allowed: dict[str, type] = {"base": dict, "sweeps": dict, "product": dict, "points": list}
    words: dict[type, str] = {dict: "dotted keys and what they become", list: "a list of blocks of dotted keys"}
    known = ", ".join(allowed)
    if not isinstance(data, dict) or not data:
        raise SceneError("grid", data, f"a block with the keys {known}")
    for key, value in data.items():
        if key not in allowed:
            raise SceneError(key, value, f"{UNKNOWN_KEY}; known here: {known}")
        if not isinstance(value, allowed[key]):
            raise SceneError(key, value, words[allowed[key]])
    for part, name, values in ((p, n, v) for p in ("sweeps", "product") for n, v in data.get(p, {}).items()):
        if not isinstance(values, list) or not values:
            raise SceneError(f"{part}.{name}", values, "a list of values")
    for number, point in enumerate(data.get("points", ())):
        if not isinstance(point, dict):
            raise SceneError(f"points[{number}]", point, "a block of dotted keys")
    return data


FINGERS = tuple(f"meshes/{name}.vtu" for name in ("finger_500", "finger", "finger_2000", "finger_paper"))
"""Meshes of the same body."""
PATCHES: dict[str, Any] = {"material.volumetric": "patch"}
DEFAULT = Grid(
    sweeps={
        "dt": [5e-4, 1e-2],
        "substeps": [2, 4],
        "solver.tolerance": [1e-1, 1e-2, 1e-4],
        "solver.max_iterations": [2, 3],
        "solver.relinearizations": [1],
        "limits.stiffness": [10.0, 30.0],
        "limits.viscosity": [8.0],
        "plane.stiffness": [30.0, 1000.0],
    },
    product={
        "mesh.file": FINGERS,
        "material.volumetric": ["patch", "element"],
        "solver.level": ["standard", "lagged"],
        "dt": [1e-3, 2e-3, 4e-3],
    },
    points=(
        {"solver.method": "newton", "solver.max_iterations": 30},
        {"solver.method": "pgs", "solver.max_iterations": 400},
        {"solver.level": "lagged", "plane.stiffness": 250.0},
        {"solver.level": "lagged", "plane.stiffness": 1000.0, "substeps": 4},
        {"plane.stiffness": 1000.0, "substeps": 4, "solver.level": "standard", "solver.relinearizations": 1},
        {"mesh.file": f"meshes/{MEANT}.vtu", **PATCHES, "dt": 2e-3},
        {"mesh.file": f"meshes/{MEANT}.vtu", **PATCHES, "dt": 4e-3, "solver.level": "lagged"},
    ),
    fits_all=True,
)
"""For the shipped finger scenes; for others what of it fits."""


def points(name: str, grid: Grid) -> list[Point]:
    """The points of a scene, each scene once. Raises SceneError when a key is unknown or a value is refused."""
    base = changed(Scene.load(name), {**AWAKE, **grid.base})
    out: dict[Scene, Point] = {}
    for change in grid.changes():
        if grid.fits_all and "mesh.file" in change and not on_bone(base):
            continue
        try:
            scene = changed(base, change)
        except SceneError:
            if grid.fits_all:
                continue
            raise
        out.setdefault(scene, Point(scene, Path(name).stem, _differing(base, scene, change)))
    return list(out.values())


def _differing(base: Scene, scene: Scene, change: Mapping[str, Any]) -> dict[str, Any]:
    """Of what a point changes, what the base has otherwise: a product names all its keys."""
    had, has = ({one.name: one.value for one in of.parameters()} for of in (base, scene))
    return {key: value for key, value in change.items() if key not in had or had[key] != has.get(key)}


def changed(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with dotted keys changed. A change between shipped fingers changes `material.young` with it, unless
    that is named too. Raises SceneError as `Scene.with_values` does.
    """
    file = values.get("mesh.file")
    if isinstance(file, str) and "material.young" not in values and name_of(scene.mesh.file) and name_of(file):
        scene = scene_on(scene, file)
    return scene.with_values(values)


def on_bone(scene: Scene) -> bool:
    """Whether it is a shipped finger driven by its bone, which every other shipped finger stands for too."""
    return name_of(scene.mesh.file) is not None and scene.driven == BONE


def meant(scene: Scene, mesh: str = MEANT) -> Scene | None:
    """The finger that is meant, in a scene's setting: on the finest mesh, with patches. None where it is no such
    finger, or where its limits are rigid, which nothing solves on that mesh.
    """
    if not on_bone(scene) or not soft(scene):
        return None
    method: dict[str, Any] = {"solver.method": "newton"}
    return scene_on(scene, mesh).with_values(method | PATCHES)


def has_mesh_error(point: Point) -> bool:
    """Whether a point stands for the same finger as its base: only mesh, element and how it is solved were changed."""
    return on_bone(point.scene) and all(is_how(key) or key in MESH for key in point.changed)


def reference(scene: Scene, base: Scene, tets: int, coarser: int = 1) -> Scene:
    """The same model, converged: fine in time, solved exactly; `coarser`: so many times the time step.

    Where `HOW` gives a limit its viscosity or inertia, it has those of `base`.
    """
    dt, substeps = next((dt, substeps) for most, dt, substeps in FINE if tets <= most)
    values = REFERENCE | ({} if soft(scene) else RIGID)
    if scene.plane is not None:
        values |= {"plane.stiffness": CONTACT}
    if substeps % coarser == 0:
        substeps //= coarser
    else:
        dt *= coarser
    values |= {"dt": dt, "substeps": substeps}
    if scene.limits is not None and base.limits is not None:
        values |= {"limits.viscosity": base.limits.viscosity, "limits.inertia": base.limits.inertia}
    return scene.with_values(values)


def soft(scene: Scene) -> bool:
    """Whether limits give way, so that newton solves them."""
    return scene.limits is None or scene.limits.stiffness is not None


def is_how(key: str) -> bool:
    """Whether a key says how a model is solved."""
    return key.startswith("solver.") or key in HOW


def _word(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return Path(value).stem if isinstance(value, str) else str(value)

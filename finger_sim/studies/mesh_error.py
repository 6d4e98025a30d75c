"""How far a finger's answers are from those of the finger that is meant: the error that its mesh leaves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ..scene import Scene
from ..scene.calibration import scene_on
from .at_rest import answers

SCENE = "finger_haptic"
"""Material, limits and table of the finger that is meant."""
YOUNG = 1.4e4
"""Young's modulus that CONVERGED is given at [Pa]; forces and stiffness are proportional to it."""


class Converged(NamedTuple):
    """An answer of the finger that is meant."""

    value: float
    error: float
    """How far off it may be, a part of the value."""


CONVERGED: dict[tuple[bool, float], dict[str, Converged]] = {
    (True, 0.45): {
        "flat 0.5 mm [N]": Converged(0.06333, 0.056),
        "flat 1 mm [N]": Converged(0.3385, 0.033),
        "flat 1.5 mm [N]": Converged(1.461, 0.009),
        "flat 2 mm [N]": Converged(8.099, 0.031),
        "side 0.5 mm [N]": Converged(1.45, 0.006),
        "side 1 mm [N]": Converged(7.224, 0.011),
        "tip 0.5 mm [N]": Converged(0.2068, 0.008),
        "tip 1 mm [N]": Converged(1.912, 0.019),
        "tangential 1 N [N/mm]": Converged(0.7472, 0.019),
        "tangential 4 N [N/mm]": Converged(4.856, 0.001),
        "area 1 N [mm²]": Converged(103.1, 0.019),
        "area 4 N [mm²]": Converged(130.4, 0.047),
    },
    (False, 0.45): {
        "flat 0.5 mm [N]": Converged(0.05037, 0.01),
        "flat 1 mm [N]": Converged(0.1788, 0.012),
        "flat 1.5 mm [N]": Converged(0.3955, 0.027),
        "flat 2 mm [N]": Converged(0.7059, 0.038),
    },
    (True, 0.49): {
        "flat 0.5 mm [N]": Converged(0.1196, 0.099),
        "flat 1 mm [N]": Converged(1.004, 0.029),
        "flat 1.5 mm [N]": Converged(3.654, 0.002),
        "flat 2 mm [N]": Converged(12.57, 0.013),
        "side 0.5 mm [N]": Converged(1.493, 0.005),
        "side 1 mm [N]": Converged(7.475, 0.009),
        "tip 0.5 mm [N]": Converged(0.2143, 0.000),
        "tip 1 mm [N]": Converged(1.967, 0.029),
        "tangential 1 N [N/mm]": Converged(0.2561, 0.084),
        "tangential 4 N [N/mm]": Converged(1.898, 0.045),
        "area 1 N [mm²]": Converged(71.86, 0.051),
        "area 4 N [mm²]": Converged(124.4, 0.030),
    },
    (False, 0.49): {
        "flat 0.5 mm [N]": Converged(0.0539, 0.017),
        "flat 1 mm [N]": Converged(0.1899, 0.032),
        "flat 1.5 mm [N]": Converged(0.425, 0.02),
        "flat 2 mm [N]": Converged(0.7613, 0.013),
    },
}
"""(Whether strain is limited, ν) → the answers by name, see `Answers.values`.

They are those of 8,000 tetrahedra, finest where each press touches, and as far off as those of 4,000 are from
them: `benchmarks/converged.py`.
"""


def finger_on(mesh: str, poisson: float = 0.45, *, limits: bool = True, calibrated: bool = True) -> Scene:
    """The finger that is meant on a mesh, with patches: a shipped mesh by its name ("finger"), or a file.

    calibrated: with the modulus of that mesh, see `scene.calibration`; else with YOUNG on every mesh.
    Raises SceneError when there is no such mesh.
    """
    meant = Scene.load(SCENE)
    scene = scene_on(meant.with_values({"mesh.file": "meshes/finger_16000.vtu", "material.young": YOUNG}), mesh)
    values: dict[str, Any] = {"material.volumetric": "patch", "material.poisson": poisson}
    if not calibrated:
        values["material.young"] = YOUNG
    if not limits:
        values["limits"] = None
    return scene.with_values(values)


def measured(scene: Scene) -> dict[str, float]:
    """The answers of a scene's finger by name: of all presses, or, without limits, of the flat one.

    Raises NotAtRestError when it does not come to rest.
    """
    return (answers(scene) if scene.limits is not None else answers(scene, ("flat",))).values()


def errors(found: Mapping[str, float], scene: Scene) -> dict[str, float]:
    """What is wrong in answers of a scene's finger, as parts of what CONVERGED has; of those that it has.

    A scene's answers are judged by its limits and ν, whatever its modulus: that is what calibrates its mesh.
    """
    truth = CONVERGED.get((scene.limits is not None, scene.material.poisson), {})
    return {name: value / truth[name].value - 1.0 for name, value in found.items() if name in truth}

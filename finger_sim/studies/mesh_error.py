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
        "flat 0.5 mm [N]": Converged(0.06272, 0.029),
        "flat 1 mm [N]": Converged(0.3347, 0.046),
        "flat 1.5 mm [N]": Converged(1.46, 0.004),
        "flat 2 mm [N]": Converged(8.153, 0.02),
        "side 0.5 mm [N]": Converged(1.481, 0.075),
        "side 1 mm [N]": Converged(7.877, 0.003),
        "tip 0.5 mm [N]": Converged(0.2059, 0.017),
        "tip 1 mm [N]": Converged(1.937, 0.007),
        "tangential 1 N [N/mm]": Converged(0.7629, 0.017),
        "tangential 4 N [N/mm]": Converged(4.943, 0.022),
        "area 1 N [mm²]": Converged(105.1, 0.027),
        "area 4 N [mm²]": Converged(129.6, 0.022),
    },
    (False, 0.45): {
        "flat 0.5 mm [N]": Converged(0.05037, 0.01),
        "flat 1 mm [N]": Converged(0.1788, 0.012),
        "flat 1.5 mm [N]": Converged(0.3955, 0.027),
        "flat 2 mm [N]": Converged(0.7059, 0.038),
    },
    (True, 0.49): {
        "flat 0.5 mm [N]": Converged(0.1181, 0.047),
        "flat 1 mm [N]": Converged(0.9869, 0.034),
        "flat 1.5 mm [N]": Converged(3.644, 0.005),
        "flat 2 mm [N]": Converged(12.64, 0.002),
        "side 0.5 mm [N]": Converged(1.53, 0.07),
        "side 1 mm [N]": Converged(8.013, 0.002),
        "tip 0.5 mm [N]": Converged(0.2163, 0.014),
        "tip 1 mm [N]": Converged(1.989, 0.022),
        "tangential 1 N [N/mm]": Converged(0.3201, 0.041),
        "tangential 4 N [N/mm]": Converged(2.027, 0.067),
        "area 1 N [mm²]": Converged(74.89, 0.023),
        "area 4 N [mm²]": Converged(123.0, 0.019),
    },
    (False, 0.49): {
        "flat 0.5 mm [N]": Converged(0.0539, 0.017),
        "flat 1 mm [N]": Converged(0.1899, 0.032),
        "flat 1.5 mm [N]": Converged(0.425, 0.02),
        "flat 2 mm [N]": Converged(0.7613, 0.013),
    },
}
"""(Whether strain is limited, ν) → the answers by name, see `Answers.values`.

They are those of 8,000 tetrahedra, finest where each press touches, and as far off as those of 4,000, or for ν 0.45
flat of 16,000, are from them: `benchmarks/converged.py`.
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

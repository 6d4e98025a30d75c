"""A soft finger for haptic loops: an anisotropic strain-limited FEM finger against a plane with friction."""

from .errors import BagError, FingerSimError, MeshError, MissingExtraError, SceneError
from .scene import Pose, Scene
from .simulator import Simulator, Status, StepResult

__all__ = [
    "BagError",
    "FingerSimError",
    "MeshError",
    "MissingExtraError",
    "Pose",
    "Scene",
    "SceneError",
    "Simulator",
    "Status",
    "StepResult",
]

"""A soft finger for haptic loops: an anisotropic strain-limited FEM finger against a plane with friction."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import BagError, FingerSimError, MeshError, MissingExtraError, SceneError
    from .physics.step import Status
    from .scene import Pose, Scene
    from .simulation.result import StepResult
    from .simulation.simulator import Simulator
    from .simulation.touch import Touch

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
    "Touch",
]

_HOME = {
    "Pose": "scene",
    "Scene": "scene",
    "Simulator": "simulation.simulator",
    "StepResult": "simulation.result",
    "Status": "physics.step",
    "Touch": "simulation.touch",
}


def __getattr__(name: str) -> Any:
    """Public names are imported when first used, so that `finger_sim --help` does not wait for a compiler."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOME.get(name, 'errors')}", __name__), name)


def __dir__() -> list[str]:
    return __all__

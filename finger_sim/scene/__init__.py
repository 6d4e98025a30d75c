"""What is simulated: scenes and their files, poses, meshes, what ships with the package."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .parts import Beam, Box, Coupling, Damping, Limits, Material, MeshSource, Plane, Solver
    from .pose import Pose, Vec3, checked_pose, place
    from .scene import Parameter, Scene

__all__ = [
    "Beam",
    "Box",
    "Coupling",
    "Damping",
    "Limits",
    "Material",
    "MeshSource",
    "Parameter",
    "Plane",
    "Pose",
    "Scene",
    "Solver",
    "Vec3",
    "checked_pose",
    "place",
]

_HOME = dict.fromkeys(("Pose", "Vec3", "checked_pose", "place"), "pose") | {"Parameter": "scene", "Scene": "scene"}


def __getattr__(name: str) -> Any:
    """Names are imported when first used: who reads the poses of a bag does not wait for the libraries of meshes."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOME.get(name, 'parts')}", __name__), name)


def __dir__() -> list[str]:
    return __all__

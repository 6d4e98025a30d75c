"""What is simulated: scenes and their files, meshes, what ships with the package."""

from .scene import (
    Beam,
    Box,
    Coupling,
    Damping,
    Limits,
    Material,
    MeshSource,
    Parameter,
    Plane,
    Pose,
    Scene,
    Solver,
    Vec3,
)

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
]

"""The modulus of each shipped finger mesh: with it all of them press as the finger that is meant does.

What a coarse mesh leaves wrong is nearly one factor of Young's modulus over all depths. Each mesh states that factor:
with it the largest error of the force of a flat press at 0.5, 1, 1.5 and 2 mm is least, at rest, with the limits of
`finger_haptic`, ν 0.45 and patches. What converged is, `studies.mesh_error` tells. Two factors are not measured: the
finest mesh counts as the finger that is meant, and the paper's, which is another finger, keeps 1.
"""

from __future__ import annotations

from pathlib import Path

from .scene import Scene

MODULUS: dict[str, float] = {
    "finger_500": 1.252,
    "finger": 0.977,
    "finger_2000": 0.979,
    "finger_4000": 0.977,
    "finger_16000": 1.0,
    "finger_distal": 0.989,
    "finger_paper": 1.0,
}
"""Of each shipped mesh by its name: its modulus over that of the tissue that is meant."""


def modulus(mesh: str | Path | None) -> float:
    """The factor of a mesh file; 1 for a mesh that is not shipped, or for none."""
    return MODULUS.get(name_of(mesh) or "", 1.0)


def name_of(mesh: str | Path | None) -> str | None:
    """The name in MODULUS of a mesh file; None for any other."""
    from .resources import shipped

    if mesh is None:
        return None
    path = Path(mesh)
    ours = path.parent in (Path(), Path("meshes")) or path.parent == (shipped("config") / "meshes").resolve()
    return path.stem if ours and path.stem in MODULUS and path.suffix in ("", ".vtu") else None


def scene_on(scene: Scene, mesh: str) -> Scene:
    """The same tissue on another mesh: `mesh` changed, `material.young` scaled from its factor to the new one's.

    mesh: a name in MODULUS, or a mesh file. Raises SceneError when there is no such file.
    """
    name = name_of(mesh)
    file = f"meshes/{name}.vtu" if name else mesh
    young = scene.material.young * (modulus(mesh) / modulus(scene.mesh.file))
    return scene.with_values({"mesh": {"file": file}, "material.young": young})

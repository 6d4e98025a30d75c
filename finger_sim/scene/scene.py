"""`Scene`: everything a simulation is made of. Frozen, typed, validated; the one source of names, units and ranges.

What a scene leaves out is not modelled and costs nothing: no `limits`, no strain limits; no `plane`, no contact.
All quantities are SI; frames are right-handed; quaternions are xyzw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError, SceneError
from .fields import Field, field, parse_part, specs, to_dict
from .mesh import TetMesh
from .meshing import beam
from .parts import Box, Coupling, Limits, Material, MeshSource, Plane, Solver
from .pose import FARTHEST, Pose, Vec3
from .resources import find_mesh, find_scene
from .yaml_text import YamlText

BOX = "{box: [[x0, y0, z0], [x1, y1, z1]]}"
"""How a scene selects driven nodes by where they are."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One scene value under its dotted name, with what it may be."""

    name: str
    value: Any
    spec: Field


@dataclasses.dataclass(frozen=True)
class Scene:
    """A soft body, what drives it, what it touches, and how time is stepped."""

    mesh: MeshSource = field("part", "The tetrahedral mesh", part=MeshSource)
    driven: str | Box | None = field(
        "text", "Node set of the mesh that follows the command, or a box; left out: free", default=None, optional=True
    )
    material: Material = field("part", "Elasticity and density", default=Material(), part=Material)
    limits: Limits | None = field("part", "Strain limits; left out: none", default=None, optional=True, part=Limits)
    plane: Plane | None = field("part", "The plane; left out: no contact", default=None, optional=True, part=Plane)
    gravity: Vec3 = field(
        "vec3", "Acceleration of gravity, world", default=(0.0, 0.0, -9.81), unit="m/s^2", low=-1e4, high=1e4
    )
    solver: Solver = field("part", "The step's solver", default=Solver(), part=Solver)
    coupling: Coupling = field("part", "Command to bone", default=Coupling(), part=Coupling)
    dt: float = field("float", "Time step of one Simulator.step", default=0.001, unit="s", low=1e-6, high=0.1)
    substeps: int = field("int", "Steps of dt / substeps inside one Simulator.step", default=1, low=1, high=1000)
    initial_pose: Pose = field("part", "Where the body rests before the first command", default=Pose(), part=Pose)

    def check(self, prefix: str) -> None:
        if self.coupling.type == "virtual" and self.solver.method != "newton":
            raise SceneError(f"{prefix}coupling.type", "virtual", "kinematic, unless solver.method is newton")
        if self.solver.method == "newton":
            for name, part in (("limits", self.limits), ("plane", self.plane)):
                if part is not None and part.stiffness is None:
                    raise SceneError(f"{prefix}{name}.stiffness", None, "a number: only solver.method pgs can be rigid")

    @staticmethod
    def load(path: str | Path) -> Scene:
        """Read a scene from YAML (a file, or the name of a shipped one).

        Raises SceneError naming file, line and column, the key, the value and what is allowed.
        """
        file = find_scene(path)
        text = YamlText(file)
        try:
            return Scene.from_dict(text.data, base=file.parent)
        except SceneError as error:
            raise text.located(error) from None

    @staticmethod
    def from_dict(data: Mapping[str, Any], *, base: str | Path | None = None) -> Scene:
        """A validated scene from plain values; `base` is the folder that mesh.file is relative to (default: here)."""
        return _parsed(data)._with_mesh_found(Path() if base is None else Path(base))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for YAML; `from_dict` gives the scene back. The mesh file's path is absolute."""
        return to_dict(self)

    def with_values(self, values: Mapping[str, Any]) -> Scene:
        """A copy with dotted keys changed, e.g. {"plane.friction": 0.3}. Raises SceneError as loading does."""
        data = self.to_dict()
        for key, value in values.items():
            *blocks, name = key.split(".")
            block = data
            for depth, part in enumerate(blocks):
                if not isinstance(block.get(part), dict):
                    raise SceneError(
                        key, value, f"a key of this scene, which has no block {'.'.join(blocks[: depth + 1])!r}"
                    )
                block = block[part]
            block[name] = value
        scene = _parsed(data)
        # A mesh that stays is not looked for again: its file may be gone, and nothing has to be read for other values.
        return scene if scene.mesh == self.mesh else scene._with_mesh_found(Path())

    def _with_mesh_found(self, base: Path) -> Scene:
        """The same, with the path of the mesh file absolute. Raises SceneError when there is no such file."""
        if self.mesh.file is None:
            return self
        return dataclasses.replace(self, mesh=MeshSource(file=str(find_mesh(self.mesh.file, base))))

    def parameters(self) -> Iterator[Parameter]:
        """Every value of the scene under its dotted name, blocks that are absent left out."""
        yield from _parameters(self, "")

    def load_mesh(self) -> TetMesh:
        """The mesh of the scene. Raises MeshError when it cannot be read or simulated."""
        if self.mesh.beam is not None:
            return beam(self.mesh.beam.size, self.mesh.beam.cells)
        assert self.mesh.file is not None
        return TetMesh.load(self.mesh.file)

    def driven_nodes(self, mesh: TetMesh) -> NDArray[np.int32]:
        """Indices of the nodes that follow the command, sorted. Raises MeshError when the selection is empty."""
        if self.driven is None:
            return np.empty(0, np.int32)
        if isinstance(self.driven, Box):
            inside = np.all((mesh.points >= self.driven.low) & (mesh.points <= self.driven.high), axis=1)
            nodes = np.flatnonzero(inside).astype(np.int32)
        else:
            try:
                nodes = np.asarray(mesh.node_set(self.driven), np.int32)
            except MeshError as error:
                of = f" in {self.mesh.file}" if self.mesh.file else ""
                raise MeshError(f"driven{of}: {error}; or drive the nodes in a box: driven: {BOX}") from None
        if nodes.size == 0:
            raise MeshError(
                f"driven: {to_dict(self)['driven']!r} selects no node of the mesh; leave the key out for a free body"
            )
        if nodes.size == len(mesh.points):
            raise MeshError(
                f"driven: {to_dict(self)['driven']!r} selects all {nodes.size} nodes: nothing would be soft"
            )
        return nodes


def _parameters(part: Any, prefix: str) -> Iterator[Parameter]:
    for name, spec in specs(type(part)).items():
        value = getattr(part, name)
        if spec.kind != "part":
            yield Parameter(prefix + name, value, spec)
        elif value is not None:
            yield from _parameters(value, f"{prefix}{name}.")


def _parsed(data: Any) -> Scene:
    """A validated scene whose mesh file was not looked for."""
    if not isinstance(data, Mapping):
        raise SceneError("scene", data, f"a block with the keys {', '.join(specs(Scene))}")
    data = dict(data)
    driven = _parse_driven(data.pop("driven", None))
    scene = dataclasses.replace(parse_part(Scene, data), driven=driven)
    if scene.coupling.type == "virtual" and driven is None:
        raise SceneError("driven", None, "the nodes that are the bone, since coupling.type is virtual")
    return scene


def _parse_driven(value: Any) -> str | Box | None:
    if value is None or isinstance(value, str | Box):
        return value
    allowed = f"a node set of the mesh, {BOX} in metres, or left out"
    if isinstance(value, Mapping) and set(value) == {"box"}:
        corner = Field("vec3", "corner", low=-FARTHEST, high=FARTHEST)
        corners = value["box"]
        if isinstance(corners, list | tuple) and len(corners) == 2:
            low, high = (corner.parse(c, f"driven.box[{i}]") for i, c in enumerate(corners))
            if all(a <= b for a, b in zip(low, high, strict=True)):
                return Box(low, high)
    raise SceneError("driven", value, allowed)

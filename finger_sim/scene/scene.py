"""`Scene`: everything a simulation is made of. Frozen, typed, validated; the one source of names, units and ranges.

What a scene leaves out is not modelled and costs nothing: no `limits`, no strain limits; no `plane`, no contact.
All quantities are SI; frames are right-handed; quaternions are xyzw.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from ..errors import MeshError, SceneError
from .fields import Field, field, parse_part, specs, to_dict
from .mesh import TetMesh
from .meshing import beam
from .resources import find_scene, shipped

Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Limit3 = tuple[float | None, float | None, float | None]


@dataclasses.dataclass(frozen=True)
class Pose:
    """A rigid placement: a point X of the mesh as read goes to R X + position [m]; orientation is R as x y z w."""

    position: Vec3 = field(
        "vec3", "Origin of the finger frame in the world", default=(0.0, 0.0, 0.0), unit="m", low=-1e4, high=1e4
    )
    orientation: Quaternion = field(
        "quaternion", "Orientation of the finger frame in the world, x y z w", default=(0.0, 0.0, 0.0, 1.0)
    )


@dataclasses.dataclass(frozen=True)
class Beam:
    """A box of cubes, 5 tetrahedra each, one corner at the mesh's origin."""

    size: Vec3 = field("vec3", "Edge lengths along x, y, z", default=(1.0, 0.2, 0.2), unit="m", low=1e-6, high=1e3)
    cells: tuple[int, int, int] = field("cells", "Number of cubes along x, y, z", default=(10, 2, 2), low=1, high=200)


@dataclasses.dataclass(frozen=True)
class MeshSource:
    """Where the mesh comes from: a file that meshio reads, or a generated beam."""

    file: str | None = field("text", "Mesh file, relative to the scene file", default=None, optional=True)
    beam: Beam | None = field("part", "Generated beam", default=None, optional=True, part=Beam)

    def check(self, prefix: str) -> None:
        if (self.file is None) == (self.beam is None):
            raise SceneError(prefix.rstrip("."), to_dict(self), "exactly one of the keys file, beam")


@dataclasses.dataclass(frozen=True)
class Box:
    """Selects the mesh nodes inside an axis-aligned box [m], bounds included."""

    low: Vec3
    high: Vec3

    def as_plain(self) -> dict[str, list[list[float]]]:
        return {"box": [list(self.low), list(self.high)]}


@dataclasses.dataclass(frozen=True)
class Damping:
    """Rayleigh damping D = mass · M + stiffness · K."""

    mass: float = field("float", "Mass-proportional damping", default=0.0, unit="1/s", low=0.0, high=1e6)
    stiffness: float = field("float", "Stiffness-proportional damping", default=0.002, unit="s", low=0.0, high=1e3)


@dataclasses.dataclass(frozen=True)
class Material:
    """Corotational linear elasticity."""

    density: float = field("float", "Mass density", default=1000.0, unit="kg/m^3", low=1.0, high=1e5)
    young: float = field("float", "Young's modulus E", default=2.0e6, unit="Pa", low=1.0, high=1e12)
    poisson: float = field("float", "Poisson's ratio ν", default=0.4, low=-0.9, high=0.4999)
    damping: Damping = field("part", "Rayleigh damping", default=Damping(), part=Damping)


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits on the stretch of every tetrahedron along its material axes e1, e2, e3.

    `stretch` s_max ≥ 1 and `compress` s_min ≤ 1 bound the stretch; null on an axis leaves it free.
    """

    projection: Literal["hyperbolic", "isotropic", "tensor", "orthogonal", "linear"] = field(
        "choice",
        "How limits along the axes bound strain in all directions; hyperbolic: the paper's, tensor: beyond it, "
        "orthogonal and linear: the paper's counterexamples",
        default="hyperbolic",
        choices=("hyperbolic", "isotropic", "tensor", "orthogonal", "linear"),
    )
    stretch: Limit3 = field(
        "limit3", "Largest stretch s_max along e1, e2, e3", default=(None, None, None), low=1.0, high=1e3
    )
    compress: Limit3 = field(
        "limit3", "Smallest stretch s_min along e1, e2, e3", default=(None, None, None), low=0.0, high=1.0
    )
    stiffness: float | None = field(
        "float",
        "Stiffness κ of a violated limit, in units of E·V of its tetrahedron; null: rigid, as in the paper",
        default=30.0,
        low=1e-3,
        high=1e9,
        optional=True,
        live=True,
    )

    inertia: float = field(
        "float",
        "A limit is at least so many times as stiff as the inertia behind it within a step; 0: stiffness alone",
        default=0.0,
        low=0.0,
        high=1e6,
        live=True,
    )

    viscosity: float = field(
        "float",
        "Viscosity of limits that hold, in units of their stress times dt: smooth where not all can hold (tensor only)",
        default=2.0,
        low=0.0,
        high=1e3,
        live=True,
    )

    def check(self, prefix: str) -> None:
        if self.projection == "isotropic":
            for name in ("stretch", "compress"):
                values = getattr(self, name)
                if len(set(values)) != 1:
                    raise SceneError(f"{prefix}{name}", list(values), "one value for all axes when isotropic")

    @property
    def stretch_room(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """a⁺ = s_max − 1 ≥ 0 along e1, e2, e3; ∞ on a free axis. (3,)"""
        return np.array([math.inf if s is None else s - 1.0 for s in self.stretch])

    @property
    def compress_room(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """a⁻ = 1 − s_min ≥ 0 along e1, e2, e3; ∞ on a free axis. (3,)"""
        return np.array([math.inf if s is None else 1.0 - s for s in self.compress])


@dataclasses.dataclass(frozen=True)
class Plane:
    """A rigid half-space below a plane, with Coulomb friction. The normal points out of it, to the finger."""

    point: Vec3 = field(
        "vec3", "A point of the plane, world", default=(0.0, 0.0, 0.0), unit="m", low=-1e4, high=1e4, live=True
    )
    normal: Vec3 = field("vec3", "Outward normal, world; any length but zero", default=(0.0, 0.0, 1.0), live=True)
    friction: float = field("float", "Coulomb friction coefficient μ", default=0.5, low=0.0, high=100.0, live=True)
    stiffness: float | None = field(
        "float",
        "Contact stiffness of a node, in units of E·V^(1/3) (V the mean tetrahedron volume); null: rigid",
        default=1000.0,
        low=1e-3,
        high=1e9,
        optional=True,
        live=True,
    )

    def check(self, prefix: str) -> None:
        if math.hypot(*self.normal) < 1e-9:
            raise SceneError(f"{prefix}normal", list(self.normal), "three numbers, not all zero")

    @property
    def unit_normal(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The normal at length one. (3,)"""
        return np.array(self.normal) / math.hypot(*self.normal)


@dataclasses.dataclass(frozen=True)
class Solver:
    """How the constrained step is solved, and how well."""

    method: Literal["pgs", "newton"] = field(
        "choice",
        "pgs: projected Gauss-Seidel, the paper's; newton: primal, as fast with every tetrahedron at its limit",
        default="pgs",
        choices=("pgs", "newton"),
    )
    tolerance: float = field(
        "float",
        "Stop when no force is off by more than this fraction of the largest row force",
        default=1e-3,
        low=1e-12,
        high=0.5,
        live=True,
    )
    max_iterations: int = field(
        "int",
        "Sweeps or Newton iterations a step at most; reaching it sets a status bit",
        default=400,
        low=1,
        high=1_000_000,
        live=True,
    )
    relinearizations: int = field(
        "int", "Times a step is linearised anew about where it ends (0: as the paper)", default=0, low=0, high=100
    )
    settle: bool = field(
        "bool",
        "Linearise steps of a slow body twice once its command holds: it comes to rest (newton, level standard)",
        default=True,
    )
    sleep: bool = field(
        "bool", "Do not compute steps of a body at rest under a command that does not change", default=True
    )
    level: Literal["standard", "lagged"] = field(
        "choice",
        "standard: all linearised every step; lagged: one stiffness matrix for 4 steps (newton only)",
        default="standard",
        choices=("standard", "lagged"),
        live=True,
    )
    budget_ms: float | None = field(
        "float",
        "Time a step may take; the node gives up accuracy before it misses it (budget.py); null: none",
        default=None,
        unit="ms",
        low=1e-3,
        high=1e4,
        optional=True,
        live=True,
    )
    deadline: float | None = field(
        "float",
        "Time after which a step begins no further Newton iteration; null: none",
        default=None,
        unit="s",
        low=1e-6,
        high=10.0,
        optional=True,
        live=True,
    )


@dataclasses.dataclass(frozen=True)
class Coupling:
    """How a commanded pose drives the bone, and what a device may be asked to render."""

    type: Literal["kinematic", "virtual"] = field(
        "choice",
        "kinematic: driven nodes follow the command exactly; virtual: as a rigid body on a spring to it (newton only)",
        default="kinematic",
        choices=("kinematic", "virtual"),
    )
    stiffness: float = field(
        "float", "Of the virtual coupling", default=1000.0, unit="N/m", low=1e-3, high=1e7, live=True
    )
    damping: float = field("float", "Of the virtual coupling", default=3.0, unit="N s/m", low=0.0, high=1e5, live=True)
    rotational_stiffness: float = field(
        "float", "Of the virtual coupling", default=1.0, unit="N m/rad", low=1e-6, high=1e5, live=True
    )
    rotational_damping: float = field(
        "float", "Of the virtual coupling", default=0.003, unit="N m s/rad", low=0.0, high=1e3, live=True
    )
    max_speed: float = field(
        "float",
        "A command that moves faster is followed at this speed",
        default=2.0,
        unit="m/s",
        low=1e-6,
        high=1e4,
        live=True,
    )
    max_angular_speed: float = field(
        "float",
        "A command that turns faster is followed at this rate",
        default=50.0,
        unit="rad/s",
        low=1e-6,
        high=1e5,
        live=True,
    )
    force_limit: float = field(
        "float",
        "Clamp on the force of device_wrench; a virtual coupling pulls no harder",
        default=10.0,
        unit="N",
        low=0.0,
        high=1e6,
        live=True,
    )
    torque_limit: float = field(
        "float",
        "Clamp on the torque of device_wrench; a virtual coupling turns no harder",
        default=0.5,
        unit="N m",
        low=0.0,
        high=1e6,
        live=True,
    )


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
        if self.solver.level == "lagged" and (self.solver.method == "pgs" or self.solver.relinearizations > 0):
            raise SceneError(f"{prefix}solver.level", "lagged", "standard, unless newton with relinearizations 0")
        if self.coupling.type == "virtual" and self.solver.method != "newton":
            raise SceneError(f"{prefix}coupling.type", "virtual", "kinematic, unless solver.method is newton")
        if self.solver.method == "newton":
            for name, part in (("limits", self.limits), ("plane", self.plane)):
                if part is not None and part.stiffness is None:
                    raise SceneError(f"{prefix}{name}.stiffness", None, "a number: only solver.method pgs can be rigid")

    @staticmethod
    def load(path: str | Path) -> Scene:
        """Read a scene from YAML (a file, or the name of a shipped one). Raises SceneError naming the key."""
        file = find_scene(path)
        if not file.is_file():
            names = ", ".join(sorted(p.stem for p in shipped("config").glob("*.yaml")))
            raise SceneError("scene", str(path), f"an existing YAML file, or a shipped scene: {names}")
        try:
            data = yaml.load(file.read_text(encoding="utf-8"), _Loader)
            return Scene.from_dict(data, base=file.parent)
        except SceneError as error:
            raise SceneError(error.key, error.value, error.allowed, source=str(file)) from None
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise SceneError("scene", " ".join(str(error).split()), "well-formed YAML", source=str(file)) from None

    @staticmethod
    def from_dict(data: Mapping[str, Any], *, base: str | Path | None = None) -> Scene:
        """A validated scene from plain values; `base` is the folder that mesh.file is relative to (default: here)."""
        if not isinstance(data, Mapping):
            raise SceneError("scene", data, f"a block with the keys {', '.join(specs(Scene))}")
        data = dict(data)
        driven = _parse_driven(data.pop("driven", None))
        scene = dataclasses.replace(parse_part(Scene, data), driven=driven)
        if scene.coupling.type == "virtual" and driven is None:
            raise SceneError("driven", None, "the nodes that are the bone, since coupling.type is virtual")
        if scene.mesh.file is not None:
            resolved = _resolve_mesh(scene.mesh.file, Path(base) if base is not None else Path.cwd())
            scene = dataclasses.replace(scene, mesh=MeshSource(file=resolved))
        return scene

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
        return Scene.from_dict(data)

    def parameters(self) -> Iterator[Parameter]:
        """Every value of the scene under its dotted name, blocks that are absent left out."""
        yield from _parameters(self, "")

    def load_mesh(self) -> TetMesh:
        """The mesh of the scene. Raises MeshError when it cannot be read or simulated."""
        if self.mesh.beam is not None:
            return beam(self.mesh.beam.size, self.mesh.beam.cells)
        assert self.mesh.file is not None
        return TetMesh.load(self.mesh.file)

    def driven_nodes(self, mesh: TetMesh) -> np.ndarray[Any, np.dtype[np.int32]]:
        """Indices of the nodes that follow the command, sorted. Raises MeshError when the selection is empty."""
        if self.driven is None:
            return np.empty(0, np.int32)
        if isinstance(self.driven, Box):
            inside = np.all((mesh.points >= self.driven.low) & (mesh.points <= self.driven.high), axis=1)
            nodes = np.flatnonzero(inside).astype(np.int32)
        elif self.driven in mesh.node_sets:
            nodes = np.asarray(mesh.node_sets[self.driven], np.int32)
        else:
            raise MeshError(
                f"driven: the mesh has no node set {self.driven!r}; it has: "
                f"{', '.join(sorted(mesh.node_sets)) or 'none'}"
            )
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


def _parse_driven(value: Any) -> str | Box | None:
    if value is None or isinstance(value, str | Box):
        return value
    allowed = "a node set of the mesh, {box: [[x0, y0, z0], [x1, y1, z1]]} in metres, or left out"
    if isinstance(value, Mapping) and set(value) == {"box"}:
        corner = Field("vec3", "corner", low=-1e4, high=1e4)
        corners = value["box"]
        if isinstance(corners, list | tuple) and len(corners) == 2:
            low, high = (corner.parse(c, f"driven.box[{i}]") for i, c in enumerate(corners))
            if all(a <= b for a, b in zip(low, high, strict=True)):
                return Box(low, high)
    raise SceneError("driven", value, allowed)


def _resolve_mesh(name: str, base: Path) -> str:
    for folder in (base, shipped("config")):
        path = (folder / Path(name).expanduser()).resolve()
        if path.is_file():
            return str(path)
    raise SceneError("mesh.file", name, f"an existing mesh file, relative to {base}")


class _Loader(yaml.SafeLoader):
    """YAML as people mean it: 1e-3 is a number, and a key given twice is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise SceneError(str(key), "given twice", f"one value (line {key_node.start_mark.line + 1})")
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {k: list(v) for k, v in yaml.SafeLoader.yaml_implicit_resolvers.items()}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)

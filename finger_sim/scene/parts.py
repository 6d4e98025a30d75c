"""The blocks of a scene: what the body is made of, what bounds it, what it touches, how it is driven and solved.

Each is a frozen dataclass whose fields carry meaning, unit, range and default. All quantities are SI.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

import numpy as np

from ..arrays import Floats
from ..errors import SceneError
from .fields import field, to_dict
from .pose import Vec3

Limit3 = tuple[float | None, float | None, float | None]
MOST_POISSON = 0.4999


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
class Relaxation:
    """A part of the stress that fades while a strain is held (one term of a Prony series)."""

    time: float = field("float", "Time constant τ, in which it falls to 1/e", unit="s", low=1e-5, high=1e5)
    share: float = field("float", "Its share of the stress of a strain that has just come", low=0.0, high=0.999)


@dataclasses.dataclass(frozen=True)
class Material:
    """Corotational linear elasticity, which may relax."""

    density: float = field("float", "Mass density", default=1000.0, unit="kg/m^3", low=1.0, high=1e5)
    young: float = field("float", "Young's modulus E", default=2.0e6, unit="Pa", low=1.0, high=1e12)
    poisson: float = field("float", "Poisson's ratio ν", default=0.4, low=-0.9, high=MOST_POISSON)
    damping: Damping = field("part", "Rayleigh damping", default=Damping(), part=Damping)
    volumetric: Literal["element", "patch"] = field(
        "choice",
        "what shares one volume strain: each tetrahedron alone, the paper's, which locks near ν = 0.5; patches of them",
        default="element",
        choices=("element", "patch"),
    )
    relaxation: tuple[Relaxation, ...] = field(
        "parts",
        "Parts of the stress that fade while a strain is held, {time, share} each; `young` is that before any has",
        default=(),
        low=0,
        high=8,
        quiet=True,
        part=Relaxation,
    )
    relaxes: Literal["deviator", "stress"] = field(
        "choice",
        "What `relaxation` has shares of: the stress without its pressure, as where volume is kept; or all of it",
        default="deviator",
        choices=("deviator", "stress"),
        quiet=True,
    )

    def check(self, prefix: str) -> None:
        shares = [term.share for term in self.relaxation]
        if sum(shares) >= 1.0:
            where, given = f"{prefix}relaxation", f"shares of {sum(shares):g} together"
            raise SceneError(where, given, "shares of less than 1 together: the rest is what stays")

    @property
    def lasting(self) -> Material:
        """The same once all that relaxes has faded: what a strain that is held for ever feels.

        ν is the largest that a scene may have where it would be larger still.
        """
        if not self.relaxation:
            return self
        left = 1.0 - sum(term.share for term in self.relaxation)
        shear = left * self.young / (2.0 * (1.0 + self.poisson))
        bulk = (left if self.relaxes == "stress" else 1.0) * self.young / (3.0 * (1.0 - 2.0 * self.poisson))
        poisson = min((3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear)), MOST_POISSON)
        young = 2.0 * (1.0 + poisson) * shear
        return dataclasses.replace(self, young=young, poisson=poisson, relaxation=())


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
        "Viscosity of limits that hold, in units of their stress times dt (tensor only)",
        default=0.0,
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
    def stretch_room(self) -> Floats:
        """a⁺ = s_max − 1 ≥ 0 along e1, e2, e3; ∞ on a free axis. (3,)"""
        return np.array([math.inf if s is None else s - 1.0 for s in self.stretch])

    @property
    def compress_room(self) -> Floats:
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
        if not 1e-9 <= math.hypot(*self.normal) < math.inf:
            raise SceneError(f"{prefix}normal", list(self.normal), "three numbers, of length 1e-09 to 1e+308")

    @property
    def unit_normal(self) -> Floats:
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
    least_force: float = field(
        "float",
        "Forces are judged no finer than relative to this one: a first touch is not solved finer than anybody feels",
        default=0.0,
        unit="N",
        low=0.0,
        high=1e3,
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
        "standard: all linearised every step; lagged: newton shares a matrix until a tetrahedron has turned 0.02 rad",
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
    following: Literal["auto", "hold", "linear", "predict"] = field(
        "choice",
        "auto: linear, or held where commands come as often as steps; hold: jumps; linear: a path, one interval late; "
        "predict: where the hand must be by now",
        default="auto",
        choices=("auto", "hold", "linear", "predict"),
        live=True,
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

"""How a body touches its plane: contact area, centre of pressure and how much of it slips, from nodes and their forces.

A step computes none of it unless it is asked to (`Simulator`'s `touch`). Whoever wants to know now and then takes an
`Imprint` between two steps, and computes from it in any thread.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple, Protocol

import numpy as np

from ..arrays import Floats, Ints
from ..physics.rotations import matrix
from ..scene import Pose, Scene, Vec3
from ..scene.mesh import TetMesh

_ROUNDING = 1e-9
"""Part of its largest friction that a node's force may lack by rounding when it is at the cone."""


@dataclasses.dataclass(frozen=True, slots=True)
class Touch:
    """How a body touches its plane at one moment. Contact nodes are those that carry a contact force.

    area     : contact area [m²], 0 when nothing touches. Each triangle of the deformed surface that faces the plane is
               projected on it and gives a third of its area to each corner; the area is that of the contact nodes.
               Exact for a face of the mesh that touches as a whole. Else the rim of contact lies anywhere between
               the last nodes that touch and the next ones, so that the area is off by up to half a triangle's width
               along the rim, and jumps by a node's share as a node comes into contact or leaves it.
    centre   : centre of pressure (3,) [m], world: Σ f x / Σ f over the contact nodes at x, f their normal force [N];
               None when nothing touches.
    slipping : share of the contact nodes whose friction is at its limit, |f_t| ≥ μ f within the solver's tolerance, 0
               to 1. They slip, or did when they last moved. 0 when nothing touches. Without friction (μ = 0) nothing
               holds a node: 1.
    """

    area: float
    centre: Vec3 | None
    slipping: float


NOTHING = Touch(0.0, None, 0.0)
"""Of a body that does not touch a plane, or whose scene has none."""


class Body(Protocol):
    """What an imprint is taken of: a Simulator."""

    @property
    def scene(self) -> Scene: ...
    @property
    def mesh(self) -> TetMesh: ...
    @property
    def positions(self) -> Floats: ...
    @property
    def contact_forces(self) -> Floats: ...
    @property
    def plane_pose(self) -> Pose | None: ...


class Imprint(NamedTuple):
    """What tells of the touch of one moment. The next step does not change it."""

    positions: Floats  # of the nodes (n, 3) [m], world
    forces: Floats  # of the plane on each node (n, 3) [N], world
    surface: Ints  # (k, 3) triangles, counter-clockwise seen from outside
    normal: Floats  # of the plane, unit and outward (3,), world; zeros without a plane
    friction: float  # Coulomb μ
    tolerance: float  # of the solver

    @classmethod
    def of(cls, body: Body) -> Imprint:
        """Of a body after its last step: two arrays are copied."""
        pose, plane = body.plane_pose, body.scene.plane
        normal = np.zeros(3) if pose is None else matrix(pose.orientation)[:, 2]
        friction = 0.0 if plane is None else plane.friction
        positions, forces = body.positions.copy(), body.contact_forces.copy()
        return cls(positions, forces, body.mesh.surface, normal, friction, body.scene.solver.tolerance)

    def touch(self) -> Touch:
        """What it tells."""
        push = self.forces @ self.normal
        touching = push > 0.0
        if not touching.any():
            return NOTHING
        a, b, c = (self.positions[self.surface[:, corner]] for corner in range(3))
        thirds = np.maximum(-np.cross(b - a, c - a) @ self.normal, 0.0) / 6.0
        area = thirds @ touching[self.surface].sum(axis=1)
        push, forces = push[touching], self.forces[touching]
        x, y, z = (push @ self.positions[touching] / push.sum()).tolist()
        friction = np.linalg.norm(forces - np.outer(push, self.normal), axis=1)
        least = (1.0 - max(self.tolerance, _ROUNDING)) * self.friction * push
        return Touch(float(area), (x, y, z), float(np.mean(friction >= least)))

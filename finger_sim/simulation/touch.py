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
_CREEP = 1e-5
"""Speed along the plane up to which a node rests [m/s]. One may come to rest at the cone and stay there, still but for
what the solver's tolerance leaves of its motion."""


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
    slipping : share of the contact nodes that slip, 0 to 1: that move along the plane with their friction at its limit,
               |f_t| ≥ μ f within the solver's tolerance. A node that has come to rest at the limit does not slip.
               Without friction (μ = 0) all that move do. 0 when nothing touches.
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
    def velocities(self) -> Floats: ...
    @property
    def contact_forces(self) -> Floats: ...
    @property
    def plane_pose(self) -> Pose | None: ...
    @property
    def plane_twist(self) -> Floats: ...


class Imprint(NamedTuple):
    """What tells of the touch of one moment. The next step does not change it."""

    positions: Floats  # of the nodes (n, 3) [m], world
    velocities: Floats  # of the nodes (n, 3) [m/s], world
    forces: Floats  # of the plane on each node (n, 3) [N], world
    surface: Ints  # (k, 3) triangles, counter-clockwise seen from outside
    point: Floats  # of the plane (3,) [m], world
    twist: Floats  # (6,) velocity of that point [m/s] and angular velocity [rad/s], world
    normal: Floats  # of the plane, unit and outward (3,), world; zeros without a plane
    friction: float  # Coulomb μ
    tolerance: float  # of the solver

    @classmethod
    def of(cls, body: Body) -> Imprint:
        """Of a body after its last step: three arrays are copied."""
        pose, plane = body.plane_pose, body.scene.plane
        normal = np.zeros(3) if pose is None else matrix(pose.orientation)[:, 2]
        point = np.zeros(3) if pose is None else np.array(pose.position)
        friction = 0.0 if plane is None else plane.friction
        positions, velocities, forces = body.positions.copy(), body.velocities.copy(), body.contact_forces.copy()
        surface, tolerance = body.mesh.surface, body.scene.solver.tolerance
        return cls(positions, velocities, forces, surface, point, body.plane_twist, normal, friction, tolerance)

    def touch(self) -> Touch:
        """What it tells."""
        push = self.forces @ self.normal
        touching = push > 0.0
        if not touching.any():
            return NOTHING
        a, b, c = (self.positions[self.surface[:, corner]] for corner in range(3))
        thirds = np.maximum(-np.cross(b - a, c - a) @ self.normal, 0.0) / 6.0
        area = thirds @ touching[self.surface].sum(axis=1)
        push, forces, at = push[touching], self.forces[touching], self.positions[touching]
        x, y, z = (push @ at / push.sum()).tolist()
        friction = np.linalg.norm(forces - np.outer(push, self.normal), axis=1)
        limited = friction >= (1.0 - max(self.tolerance, _ROUNDING)) * self.friction * push
        motion = self.velocities[touching] - self.twist[:3] - np.cross(self.twist[3:], at - self.point)
        moves = np.linalg.norm(np.cross(motion, self.normal), axis=1) > _CREEP
        return Touch(float(area), (x, y, z), float(np.mean(limited & moves)))

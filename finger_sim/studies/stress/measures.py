"""What `finger_sim stress` measures on a body by itself: plain NumPy and LAPACK, none of the kernels' code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Floats, Ints
from ...physics.patches import partition
from ...scene import Limits, Scene
from ...scene.mesh import TetMesh

KNOWN = ("isotropic", "hyperbolic", "tensor")
"""Projections whose springs `limit_energy` knows."""


class Shape(NamedTuple):
    """The deformation of every tetrahedron: F = R S, S symmetric, det R = 1."""

    F: Floats  # (T, 3, 3), columns along the material axes
    R: Floats  # (T, 3, 3)
    s: Floats  # (T, 3) singular values, the least one with the sign of det F
    V: Floats  # (T, 3, 3) principal axes, by columns


def polar(F: Floats) -> Shape:
    """The decomposition of F (T, 3, 3), by LAPACK."""
    U, s, Vt = np.linalg.svd(F)
    sign = np.sign(np.linalg.det(U @ Vt))
    s[:, 2] *= sign
    U[:, :, 2] *= sign[:, None]
    return Shape(F, U @ Vt, s, np.swapaxes(Vt, 1, 2))


class Body:
    """A mesh with its material at rest, held apart from the simulator's own arrays."""

    def __init__(self, scene: Scene, mesh: TetMesh) -> None:
        corners = mesh.points[mesh.tets]
        D_m = np.swapaxes(corners[:, :3] - corners[:, 3:], 1, 2)
        self.tets: Ints = mesh.tets
        self.volume: Floats = np.linalg.det(D_m) / 6.0
        self.inverse: Floats = np.linalg.inv(D_m) @ np.swapaxes(mesh.axes, 1, 2)
        self.size = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
        self.mass = np.zeros(len(mesh.points))
        np.add.at(self.mass, mesh.tets, scene.material.density * self.volume[:, None] / 4.0)
        young, nu = scene.material.young, scene.material.poisson
        self.shear = young / (2.0 * (1.0 + nu))
        self.lame_lambda = young / (3.0 * (1.0 - 2.0 * nu)) - 2.0 / 3.0 * self.shear
        self.gravity: Floats = np.array(scene.gravity)
        self.free = np.ones(len(mesh.points), np.bool_)
        self.free[scene.driven_nodes(mesh)] = False
        self.patch: Ints = np.arange(len(mesh.tets))
        """Tetrahedra with the same number share their volume strain."""
        if scene.material.volumetric == "patch":
            self.patch = partition(mesh.tets.astype(np.int64), self.free).of_tet

    def gradient(self, x: Floats) -> Floats:
        """F (T, 3, 3) at positions (n, 3)."""
        corners = x[self.tets]
        F: Floats = np.swapaxes(corners[:, :3] - corners[:, 3:], 1, 2) @ self.inverse
        return F

    def shape(self, x: Floats) -> Shape:
        """What `polar` has, at positions (n, 3)."""
        return polar(self.gradient(x))

    def bounded(self, shape: Shape) -> Shape:
        """What limits bound: each tetrahedron's volume strain is that of its patch."""
        change = self._change(shape.s.sum(axis=1) - 3.0)
        return Shape(shape.F + change[:, None, None] * shape.R, shape.R, shape.s + change[:, None], shape.V)

    def _change(self, traces: Floats) -> Floats:
        """What a patch's volume strain is above its tetrahedra's own, a third of it for each axis. (T,)"""
        volume = np.bincount(self.patch, self.volume)
        mean = np.bincount(self.patch, self.volume * traces) / volume
        change: Floats = (mean[self.patch] - traces) / 3.0
        return change

    def elastic(self, strain: Floats) -> Floats:
        """Energy (T,) [J] of principal strains (T, 3).

        That of the deviator and of the patch's volume strain, which is what Hooke's law has for the sum of the two.
        """
        strain = strain + self._change(strain.sum(axis=1))[:, None]
        density = self.shear * (strain**2).sum(axis=1) + 0.5 * self.lame_lambda * strain.sum(axis=1) ** 2
        energy: Floats = self.volume * density
        return energy

    def energy(self, x: Floats, v: Floats, shape: Shape) -> float:
        """Kinetic energy of the free nodes, elastic energy, and that of their height [J]."""
        m = self.mass[self.free]
        kinetic = 0.5 * m @ (v[self.free] ** 2).sum(axis=1)
        return float(kinetic + self.elastic(shape.s - 1.0).sum() - m @ x[self.free] @ self.gravity)

    def linearised_away(self, before: Shape, after: Shape) -> float:
        """Elastic energy that a step from one shape to the other does not see, R being that of its start [J]."""
        seen = np.swapaxes(before.R, 1, 2) @ after.F
        strain = np.linalg.eigvalsh(0.5 * (seen + np.swapaxes(seen, 1, 2)) - np.eye(3)).astype(np.float64)
        return float((self.elastic(after.s - 1.0) - self.elastic(strain)).sum())


def strain_ratio(limits: Limits, shape: Shape) -> float:
    """Largest strain/limit, of the two projections that leave no choice of axes: `isotropic` and `tensor`."""
    if limits.projection == "isotropic":
        strain = shape.s - 1.0
        room = np.where(strain >= 0.0, limits.stretch_room[0], limits.compress_room[0])
        ratio = np.where(np.isinf(room), 0.0, 1.0 + (np.abs(strain) - room) / np.maximum(room, 1e-3))
        return float(ratio.max())
    return max(float(values.max()) for values, _ in _tensor_eigen(limits, shape))


def limit_energy(limits: Limits, young: float, body: Body, shape: Shape) -> float:
    """Energy in the springs of violated limits, one for each row, at κ E V [J]. Not for all projections: see KNOWN."""
    if limits.stiffness is None:
        return 0.0
    shape = body.bounded(shape)
    total = np.zeros(len(shape.s))
    if limits.projection == "tensor":
        for values, y in _tensor_eigen(limits, shape):
            size = np.maximum((y**2).sum(axis=1), 1e-300)
            total += (np.maximum(values - 1.0, 0.0) ** 2 / size**2).sum(axis=1)
    else:
        strain = shape.s[:, None, :] - 1.0
        weight = np.ones_like(shape.V) if limits.projection == "isotropic" else np.abs(shape.V)
        rooms = np.where(strain >= 0.0, limits.stretch_room[:, None], limits.compress_room[:, None])
        excess = np.where(np.isinf(rooms), 0.0, np.maximum(weight * np.abs(strain) - rooms, 0.0)) ** 2
        total += excess[:, 0].sum(axis=1) if limits.projection == "isotropic" else excess.sum(axis=(1, 2))
    return float(0.5 * limits.stiffness * young * body.volume @ total)


def _tensor_eigen(limits: Limits, shape: Shape) -> list[tuple[Floats, Floats]]:
    """Eigenvalues (T, 3) of ± A E A, stretch and compression side, and y = A q by columns (T, 3, 3)."""
    stretch = np.swapaxes(shape.R, 1, 2) @ shape.F - np.eye(3)
    strain, out = 0.5 * (stretch + np.swapaxes(stretch, 1, 2)), []
    for sign, rooms in ((1.0, limits.stretch_room), (-1.0, limits.compress_room)):
        weight = np.where(np.isinf(rooms), 0.0, 1.0 / np.sqrt(np.maximum(rooms, 1e-6)))
        values, q = np.linalg.eigh(sign * weight[:, None] * strain * weight)
        out.append((values, weight[:, None] * q))
    return out

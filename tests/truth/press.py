"""A finger pressed flat on a smooth table with quadratic tetrahedra of scikit-fem: no code of ours but its shape.

Half of the finger, at z >= 0, is solved for. Its tetrahedra are curved: nodes in the middles of edges lie on skin and
bone. At every quadrature point the energy is that of the corotational law, with E = U − I,

    μ |E|² + ½ λ (tr E)²,      P = R (2 μ E + λ tr(E) I),

and at those of the skin ½ k min(0, gap)² per area. The table has no friction, so that the answer depends on no path.
`cd tests && python -m truth.press finger_2000` prints a mesh's answers.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu
from skfem.models.elasticity import lame_parameters
from truth.problems import Floats, Ints
from truth.reference import Answer

from finger_sim.scene.finger_shape import BONE, SKIN
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.resources import shipped

YOUNG = 1.4e4
DEPTHS = (0.5e-3, 1.0e-3, 1.5e-3)
"""How far the bone comes down from where the skin that is meant touches [m]."""
TABLE = 2e10
"""Stiffness of the table [Pa/m]: at 1.5 mm it gives by less than 2 µm."""
PART = 0.25e-3
"""Of a press between two solutions [m]."""
RESIDUAL = 1e-8
"""Of the forces on free nodes, against the force of the table."""
ORDER = 5
"""Of quadrature."""
BY_MESH: dict[tuple[str, float], tuple[float, ...]] = {
    ("finger_500", 0.45): (0.05380, 0.18616, 0.42276),
    ("finger", 0.45): (0.05171, 0.17841, 0.38641),
    ("finger_2000", 0.45): (0.05039, 0.17553, 0.37575),
    ("finger_4000", 0.45): (0.04968, 0.17233, 0.36839),
    ("finger_500", 0.49): (0.06047, 0.21367, 0.50988),
    ("finger", 0.49): (0.05666, 0.19689, 0.42809),
    ("finger_2000", 0.49): (0.05421, 0.18970, 0.40574),
}
"""(Mesh, ν) → force at each of DEPTHS [N]."""
ANSWERS: dict[float, tuple[Answer, ...]] = {
    0.45: (Answer(0.0499, 0.0003), Answer(0.1729, 0.0009), Answer(0.3700, 0.0032)),
    0.49: (Answer(0.0535, 0.0008), Answer(0.1857, 0.0041), Answer(0.4009, 0.0050)),
}
"""ν → force at each of DEPTHS: a little beyond the finest mesh, off by no more than that was from the one before."""

CROSS = np.zeros((3, 3, 3))
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0, -1.0


class HalfFinger:
    """The half of a finger's mesh at z >= 0 in curved quadratic tetrahedra, above a table with normal e2."""

    def __init__(self, mesh: TetMesh, young: float, poisson: float) -> None:
        self.lam, self.mu = lame_parameters(young, poisson)
        half = mesh.tets[mesh.points[mesh.tets].mean(axis=1)[:, 2] > 0.0]
        used, tets = np.unique(half, return_inverse=True)
        straight = skfem.MeshTet(1e3 * mesh.points[used].T, tets.reshape(-1, 4).T)  # mm, as skfem's maps need it
        on_bone = np.isin(used, mesh.node_set("bone"))
        curved, bone, skin = quadratic(straight, on_bone)
        body = skfem.Basis(curved, skfem.ElementTetP2(), intorder=ORDER)
        places = 1e-3 * body.doflocs.T
        self.gradients = 1e3 * np.stack([value[0].grad for value in body.basis])  # (10, 3, T, q)
        self.weights, self.nodes = 1e-9 * body.dx, body.element_dofs.T
        assert self.weights.min() > 0.0, "a tetrahedron is inside out"
        number = dict(zip(map(tuple, straight.edges.T.tolist()), body.edge_dofs[0], strict=True))
        corners = straight.facets[:, skin].T
        middles = [[number[tuple(sorted((c[i], c[j])))] for i, j in ((0, 1), (1, 2), (2, 0))] for c in corners.tolist()]
        self.skin_nodes = np.concatenate([corners, middles], axis=1)
        self.values, self.areas = of_triangles(places[self.skin_nodes])
        self.height = self.at_skin(places)
        held = np.zeros(places.shape, bool)
        held[np.unique(body.get_dofs(bone).all())] = True
        held[np.abs(places[:, 2]) < 1e-9, 2] = True
        self.free = np.flatnonzero(~held)
        self.count = places.size

    def press(self, depths: Sequence[float]) -> list[float]:
        """Force of the whole finger [N] at each depth [m], in rising order."""
        lowest = skin_bottom()
        u, depth, forces = np.zeros(self.count), 0.0, []
        for wanted in depths:
            parts = int(np.ceil((wanted - depth) / PART - 1e-9))
            for part in np.linspace(depth, wanted, parts + 1)[1:]:
                u, force = self.solved(u, lowest + part)
            depth = wanted
            forces.append(force)
        return forces

    def solved(self, u: Floats, table: float) -> tuple[Floats, float]:
        """Displacements [m] at rest with the table at this height [m], and its force on the whole finger [N]."""
        for _ in range(60):
            force, matrix, pressing = self.linearised(u, table)
            if np.linalg.norm(force[self.free]) < RESIDUAL * max(pressing, 1e-6) and pressing > 0.0:
                return u, 2.0 * pressing
            inner = sp.csc_matrix(matrix)[self.free][:, self.free]
            factor = splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            way = np.zeros(self.count)
            way[self.free] = -factor.solve(force[self.free])
            energy, slope, length = self.energy(u, table), float(force @ way), 1.0
            while self.energy(u + length * way, table) > energy + 1e-4 * length * min(slope, 0.0) + 1e-14:
                length *= 0.5
                assert length > 1e-4, "no way down"
            u = u + length * way
        raise AssertionError("no rest")

    def deformation(self, u: Floats) -> Floats:
        """F at quadrature points, (T, q, 3, 3)."""
        F = np.einsum("tai,ajtq->tqij", u.reshape(-1, 3)[self.nodes], self.gradients, optimize=True)
        return np.asarray(F + np.eye(3))

    def at_skin(self, x: Floats) -> Floats:
        """y of (n, 3) at quadrature points of the skin, (f, q)."""
        return np.asarray(x[self.skin_nodes, 1] @ self.values)

    def gap(self, u: Floats, table: float) -> Floats:
        """Height over the table where it is less than nothing [m], at quadrature points of the skin, (f, q)."""
        return np.minimum(0.0, self.height + self.at_skin(u.reshape(-1, 3)) - table)

    def energy(self, u: Floats, table: float) -> float:
        """Of body and table [J]."""
        _, stretch = polar(self.deformation(u))
        strain = stretch - np.eye(3)
        trace = np.trace(strain, axis1=2, axis2=3)
        body = self.mu * (strain**2).sum(axis=(2, 3)) + 0.5 * self.lam * trace**2
        return float((body * self.weights).sum() + 0.5 * TABLE * (self.gap(u, table) ** 2 * self.areas).sum())

    def linearised(self, u: Floats, table: float) -> tuple[Floats, sp.csr_matrix, float]:
        """Gradient of the energy [N], its derivative [N/m], and the force of the table [N]."""
        rotation, stretch = polar(self.deformation(u))
        trace = np.trace(stretch, axis1=2, axis2=3) - 3.0
        stress = 2.0 * self.mu * (rotation @ (stretch - np.eye(3))) + (self.lam * trace)[..., None, None] * rotation
        own = np.einsum("tqij,ajtq,tq->tai", stress, self.gradients, self.weights, optimize=True)
        force = np.bincount(unknowns(self.nodes).ravel(), own.ravel(), self.count)
        tangent = self.tangent(rotation, stretch, trace)
        blocks = np.zeros((len(self.nodes), 30, 30))
        for q in range(self.weights.shape[1]):
            B = np.einsum("ik,ajt->tijak", np.eye(3), self.gradients[..., q]).reshape(-1, 9, 30)
            blocks += np.swapaxes(B, 1, 2) @ ((tangent[:, q] * self.weights[:, q, None, None]) @ B)
        gap = self.gap(u, table)
        press = TABLE * gap * self.areas
        force += np.bincount(3 * self.skin_nodes.ravel() + 1, (press @ self.values.T).ravel(), self.count)
        touching = TABLE * (gap < 0.0) * self.areas
        skin = np.einsum("aq,bq,fq->fab", self.values, self.values, touching, optimize=True)
        matrix = assembled(unknowns(self.nodes), blocks, self.count)
        matrix += assembled(3 * self.skin_nodes + 1, skin, self.count)
        return force, matrix, float(-press.sum())

    def tangent(self, rotation: Floats, stretch: Floats, trace: Floats) -> Floats:
        """dP/dF, (T, q, 9, 9): dP = 2 μ dF + λ (R : dF) R + (λ tr E − 2 μ) dR, dR = R [w]×."""
        flat = rotation.reshape(*rotation.shape[:2], 9)
        out = 2.0 * self.mu * np.eye(9) + self.lam * flat[..., :, None] * flat[..., None, :]
        turning = np.linalg.inv(np.trace(stretch, axis1=2, axis2=3)[..., None, None] * np.eye(3) - stretch)
        # w = (tr(U) I − U)⁻¹ axl(Rᵀ dF − dFᵀ R), and axl(A − Aᵀ)_m = −ε_mkl A_kl
        axial = -np.einsum("mkl,tqik->tqmil", CROSS, rotation, optimize=True)
        w = np.einsum("tqnm,tqmil->tqnil", turning, axial, optimize=True)
        # [w]×_ky = −ε_kyn w_n
        turned = np.einsum("tqxk,kyn->tqxyn", rotation, -CROSS, optimize=True)
        spin = np.einsum("tqxyn,tqnil->tqxyil", turned, w, optimize=True).reshape(out.shape)
        return np.asarray(out + (self.lam * trace - 2.0 * self.mu)[..., None, None] * spin)


def quadratic(straight: skfem.MeshTet, on_bone: np.ndarray) -> tuple[skfem.MeshTet2, Ints, Ints]:
    """A mesh of curved tetrahedra [mm], its facets on what is held, and those of the skin. on_bone (n,): nodes held."""
    facets = straight.boundary_facets()
    corners = straight.facets[:, facets]
    middle = np.all(np.abs(straight.p[2, corners]) < 1e-9, axis=0)
    bone = facets[on_bone[corners].all(axis=0) & ~middle]
    skin = facets[~on_bone[corners].all(axis=0) & ~middle]
    places = skfem.Basis(straight, skfem.ElementTetP2()).doflocs.copy()
    numbers = skfem.Basis(straight, skfem.ElementTetP2())
    cut = straight.p[0].min()
    for part, surface in ((skin, SKIN), (bone, BONE)):
        ends = np.all(np.abs(straight.p[0, straight.facets[:, part]] - cut) < 1e-9, axis=0)
        dofs = np.setdiff1d(numbers.get_dofs(part[~ends]).all(), numbers.nodal_dofs.ravel())
        flat = np.abs(places[2, dofs]) < 1e-9
        placed = surface.nearby(places[:, dofs].T).T
        placed[2, flat] = 0.0
        places[:, dofs] = placed
    return skfem.MeshTet2(places, straight.t), bone, skin


def of_triangles(places: Floats) -> tuple[Floats, Floats]:
    """Values (6, q) of the nodes of curved triangles, corners first, at quadrature points; their areas (f, q) [m²]."""
    (s, t), weights = skfem.quadrature.get_quadrature(skfem.refdom.RefTri, ORDER)
    r, zero = 1.0 - s - t, np.zeros_like(s)
    values = np.stack([r * (2 * r - 1), s * (2 * s - 1), t * (2 * t - 1), 4 * r * s, 4 * s * t, 4 * t * r])
    by_s = np.stack([1 - 4 * r, 4 * s - 1, zero, 4 * (r - s), 4 * t, -4 * t])
    by_t = np.stack([1 - 4 * r, zero, 4 * t - 1, -4 * s, 4 * s, 4 * (r - t)])
    across = np.cross(*(np.einsum("aq,fak->fqk", by, places) for by in (by_s, by_t)))
    return values, np.linalg.norm(across, axis=2) * weights


def skin_bottom() -> float:
    """The lowest y of the skin that is meant [m]."""
    along, across = np.meshgrid(np.linspace(-0.5, 1.0, 3001), np.linspace(-1.0, -0.8, 201), indexing="ij")
    return 1e-3 * float(SKIN.grid(along, across)[..., 1].min())


def unknowns(nodes: Ints) -> Ints:
    """Numbers of the unknowns of nodes (T, k): (T, 3 k)."""
    return (3 * nodes[..., None] + np.arange(3)).reshape(len(nodes), -1)


def assembled(numbers: Ints, blocks: Floats, count: int) -> sp.csr_matrix:
    """The sum of blocks (T, k, k) at numbers (T, k)."""
    size = numbers.shape[1]
    rows, columns = np.repeat(numbers, size, axis=1), np.tile(numbers, (1, size))
    return sp.csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(count, count))


def polar(F: Floats) -> tuple[Floats, Floats]:
    """R and U of F = R U, (…, 3, 3) each."""
    left, s, right = np.linalg.svd(F)
    sign = np.sign(np.linalg.det(left @ right))
    left[..., :, 2] *= sign[..., None]
    s[..., 2] *= sign
    return left @ right, np.swapaxes(right, -1, -2) * s[..., None, :] @ right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="+", help="names of shipped meshes, or files")
    parser.add_argument("--poisson", type=float, nargs="+", default=[0.45, 0.49])
    options = parser.parse_args()
    for name in options.meshes:
        path = Path(name) if name.endswith(".vtu") else shipped("config") / "meshes" / f"{name}.vtu"
        mesh = TetMesh.load(path)
        for poisson in options.poisson:
            forces = HalfFinger(mesh, YOUNG, poisson).press(DEPTHS)
            print(f"{path.stem:14} ν {poisson:g}: " + " ".join(f"{force:.5f}" for force in forces) + " N", flush=True)


if __name__ == "__main__":
    main()

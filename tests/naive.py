"""Slow plain-NumPy twins of the kernels: the same physics from other formulas, sharing no code with finger_sim.

Where the package uses gradients r_n of D_m⁻¹, this file inverts the 4 × 4 matrix of barycentric coordinates; where
it rotates blocks of K, this file multiplies Bᵀ D B in Voigt's notation; where it runs its own Jacobi SVD, LAPACK's;
where it differentiates V by a closed formula, perturbation theory of the eigenvectors of FᵀF; dense throughout.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]


def signed_svd(F: Array) -> tuple[Array, Array, Array]:
    """F = U diag(s) Vᵀ with rotations U, V; signs moved into the singular value of least magnitude (the last)."""
    U, s, Vt = np.linalg.svd(F)
    V = Vt.T.copy()
    if np.linalg.det(U) < 0.0:
        U[:, 2] *= -1.0
        s[2] *= -1.0
    if np.linalg.det(V) < 0.0:
        V[:, 2] *= -1.0
        s[2] *= -1.0
    return U, s, V


def rotation_of(F: Array) -> Array:
    """R = U Vᵀ: the rotation nearest to F."""
    U, _, V = signed_svd(F)
    return U @ V.T


@dataclasses.dataclass
class Body:
    """A mesh with its material, at rest: everything that a step needs, in dense arrays."""

    points: Array  # (n, 3)
    tets: np.ndarray[Any, np.dtype[np.int64]]  # (T, 4)
    gradients: Array  # (T, 4, 3) of the four barycentric coordinates, components along e1, e2, e3
    volume: Array  # (T,)
    mass: Array  # (n,)
    lame_lambda: float
    lame_mu: float
    alpha: float
    beta: float
    gravity: Array

    @classmethod
    def of(cls, scene: Any, mesh: Any) -> Body:
        points, tets = np.array(mesh.points), np.array(mesh.tets, np.int64)
        corners = np.concatenate([points[tets], np.ones((len(tets), 4, 1))], axis=2)  # rows (x, 1)
        coordinates = np.linalg.inv(corners)  # column a: coefficients of barycentric coordinate a
        world = np.swapaxes(coordinates[:, :3, :], 1, 2)
        gradients = np.array([g @ axes.T for g, axes in zip(world, mesh.axes, strict=True)])
        volume = np.abs(np.linalg.det(corners)) / 6.0
        material = scene.material
        mass = np.zeros(len(points))
        for nodes, vol in zip(tets, volume, strict=True):
            mass[nodes] += 0.25 * vol * material.density
        E, nu = material.young, material.poisson
        bulk, shear = E / (3.0 * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))
        return cls(
            points,
            tets,
            gradients,
            volume,
            mass,
            bulk - 2.0 / 3.0 * shear,
            shear,
            material.damping.mass,
            material.damping.stiffness,
            np.array(scene.gravity),
        )

    def deformation(self, x: Array) -> Array:
        """F (T, 3, 3) = Σ_n x_n ⊗ ∇b_n, columns along the material axes."""
        return np.einsum("tni,tnj->tij", x[self.tets], self.gradients)

    def energy(self, x: Array) -> float:
        """Elastic energy Σ vol (μ |S − I|² + λ/2 tr(S − I)²), S = RᵀF [J]."""
        total = 0.0
        for F, vol in zip(self.deformation(x), self.volume, strict=True):
            e = signed_svd(F)[1] - 1.0
            total += vol * (self.lame_mu * (e @ e) + 0.5 * self.lame_lambda * e.sum() ** 2)
        return float(total)

    def hooke(self) -> Array:
        """The 6 × 6 matrix of Hooke's law, Voigt order 11 22 33 23 13 12 with engineering shears."""
        D = np.zeros((6, 6))
        D[:3, :3] = self.lame_lambda
        D[np.arange(3), np.arange(3)] += 2.0 * self.lame_mu
        D[np.arange(3, 6), np.arange(3, 6)] = self.lame_mu
        return D

    def strain_matrix(self, t: int) -> Array:
        """B (6, 12): Voigt strain of a displacement in material axes."""
        B = np.zeros((6, 12))
        for n, (a, b, c) in enumerate(self.gradients[t]):
            B[:, 3 * n : 3 * n + 3] = [[a, 0, 0], [0, b, 0], [0, 0, c], [0, c, b], [c, 0, a], [b, a, 0]]
        return B

    def forces(self, x: Array, rotations: Array | None = None) -> Array:
        """Elastic nodal forces (n, 3) [N] at x; with `rotations` (T, 3, 3) given, R is frozen there."""
        F, out, D = self.deformation(x), np.zeros((len(self.points), 3)), self.hooke()
        for t, nodes in enumerate(self.tets):
            R = rotation_of(F[t]) if rotations is None else rotations[t]
            E = 0.5 * (R.T @ F[t] + F[t].T @ R) - np.eye(3)
            voigt = np.array([E[0, 0], E[1, 1], E[2, 2], 2 * E[1, 2], 2 * E[0, 2], 2 * E[0, 1]])
            f = -self.volume[t] * self.strain_matrix(t).T @ D @ voigt
            out[nodes] += f.reshape(4, 3) @ R.T
        return out

    def stiffness(self, x: Array) -> Array:
        """K (3n, 3n) = Σ vol R Bᵀ D B Rᵀ at x: minus the derivative of the forces with R frozen."""
        n, D = len(self.points), self.hooke()
        K = np.zeros((3 * n, 3 * n))
        for t, (nodes, F) in enumerate(zip(self.tets, self.deformation(x), strict=True)):
            B = self.strain_matrix(t)
            R = np.kron(np.eye(4), rotation_of(F))
            index = (3 * nodes[:, None] + np.arange(3)).ravel()
            K[np.ix_(index, index)] += self.volume[t] * R @ B.T @ D @ B @ R.T
        return K

    def system(self, x: Array, v: Array, h: float, driven: Any = (), v_driven: Array | None = None) -> System:
        """A v = b of backward Euler for the free nodes, the driven ones' velocities on the right."""
        K = self.stiffness(x)
        m = np.repeat(self.mass, 3)
        A = (1.0 + h * self.alpha) * np.diag(m) + h * (h + self.beta) * K
        b = m * v.ravel() + h * (m * np.tile(self.gravity, len(self.points)) + self.forces(x).ravel())
        is_free = np.ones(len(self.points), bool)
        is_free[list(driven)] = False
        free = np.flatnonzero(np.repeat(is_free, 3))
        held = np.flatnonzero(np.repeat(~is_free, 3))
        given = np.zeros(3 * len(self.points))
        if len(held):
            given[held] = np.asarray(v_driven).ravel()
        return System(A[np.ix_(free, free)], b[free] - A[np.ix_(free, held)] @ given[held], free, given)


@dataclasses.dataclass
class System:
    """A v = b over the free unknowns, and the velocities that are given."""

    A: Array
    b: Array
    free: np.ndarray[Any, np.dtype[np.int64]]  # indices into the 3n velocities
    given: Array  # (3n,) driven velocities, zero elsewhere

    def whole(self, v_free: Array) -> Array:
        v = self.given.copy()
        v[self.free] = v_free
        return v.reshape(-1, 3)


def limit_rows(F: Array, limits: Any, gap: float | None = None) -> list[tuple[float, Array, float]]:
    """(C, ∂C/∂F, side) of every row of one tetrahedron (Eq. 9-12); side +1 stretch, −1 compression.

    ∂V from the eigenvectors of FᵀF: dv_i = Σ_k v_k (v_kᵀ d(FᵀF) v_i) / (s_i² − s_k²), |denominator| ≥ gap;
    left at zero, for values alone, when `gap` is None.
    """
    U, s, V = signed_svd(F)
    rows = []
    for i in range(3):
        stretched = s[i] >= 1.0
        side = 1.0 if stretched else -1.0
        dV = np.zeros((3, 3, 3))  # d v_i [component, k, l] for dF = e_k e_lᵀ
        for k, l in itertools.product(range(3), range(3)) if gap is not None else ():
            dF = np.zeros((3, 3))
            dF[k, l] = 1.0
            dC = dF.T @ F + F.T @ dF
            for m in range(3):
                if m != i:
                    difference = s[i] ** 2 - s[m] ** 2
                    if abs(difference) < gap:
                        difference = gap if difference >= 0.0 else -gap
                    dV[:, k, l] += V[:, m] * (V[:, m] @ dC @ V[:, i]) / difference
        ds = np.outer(U[:, i], V[:, i])
        if limits.projection == "isotropic":
            bound = limits.stretch[0] if stretched else limits.compress[0]
            if bound is not None:
                rows.append((float(side * (bound - s[i])), -side * ds, side))
            continue
        for j in range(3):
            bound = limits.stretch[j] if stretched else limits.compress[j]
            if bound is not None:
                C = side * ((bound - 1.0) - abs(V[j, i]) * (s[i] - 1.0))
                dC_dF = -side * (np.sign(V[j, i]) * (s[i] - 1.0) * dV[j] + abs(V[j, i]) * ds)
                rows.append((float(C), dC_dF, side))
    return rows


@dataclasses.dataclass
class Rows:
    """Linearised rows of a step: g = constant + h J v + ε λ over all 3n velocities."""

    C: Array  # (m,)
    J: Array  # (m, 3n)
    compliance: Array  # (m,)
    tet: np.ndarray[Any, np.dtype[np.int64]]  # (m,) −1: contact


def strain_rows(body: Body, x: Array, scene: Any, gap: float, free: Any) -> Rows:
    """The limit rows of all tetrahedra with a free node."""
    limits, C, J, compliance, tet = scene.limits, [], [], [], []
    is_free = np.zeros(len(x), bool)
    is_free[np.unique(np.asarray(free) // 3)] = True
    for t, F in enumerate(body.deformation(x)):
        nodes = body.tets[t]
        if not is_free[nodes].any():
            continue
        for value, dC_dF, _ in limit_rows(F, limits, gap):
            row = np.zeros((len(x), 3))
            row[nodes] = body.gradients[t] @ dC_dF.T
            C.append(value)
            J.append(row.ravel())
            stiffness = limits.stiffness
            compliance.append(0.0 if stiffness is None else 1.0 / (stiffness * scene.material.young * body.volume[t]))
            tet.append(t)
    return Rows(np.array(C), np.array(J).reshape(-1, x.size), np.array(compliance), np.array(tet, np.int64))


def normal_rows(body: Body, x: Array, scene: Any, nodes: Any) -> Rows:
    """One row φ + h n·v ≥ 0 for each of `nodes`."""
    plane = scene.plane
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    J = np.zeros((len(nodes), len(x), 3))
    J[np.arange(len(nodes)), nodes] = normal
    length = np.cbrt(body.volume.mean())
    stiffness = plane.stiffness
    compliance = 0.0 if stiffness is None else 1.0 / (stiffness * scene.material.young * length)
    phi = (x[nodes] - np.array(plane.point)) @ normal
    return Rows(phi, J.reshape(len(nodes), -1), np.full(len(nodes), compliance), np.full(len(nodes), -1))


def joined(*parts: Rows) -> Rows:
    return Rows(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Rows)))


def gauss_seidel(
    W: Array, g: Array, compliance: Array, contacts: int, mu: float, sweeps: int, tolerance: float = 0.0
) -> Array:
    """λ of rows g + W λ ≥ 0 ⊥ λ ≥ 0; the first 3 · contacts rows are (normal, tangent, tangent) in Coulomb's cone.

    Tangents by an exact 2 × 2 step where the contact sticks; where it slips by projecting a step along the
    negative slip, of a length that contracts, many times over.
    """
    W = W + np.diag(compliance)
    lam = np.zeros(len(g))
    for _ in range(sweeps):
        before = lam.copy()
        for c in range(contacts):
            n, t = 3 * c, slice(3 * c + 1, 3 * c + 3)
            lam[n] = max(0.0, lam[n] - (g[n] + W[n] @ lam) / W[n, n])
            block = W[t, t]
            rest = g[t] + W[t] @ lam - block @ lam[t]
            stick = -np.linalg.solve(block, rest)
            bound = mu * lam[n]
            if np.linalg.norm(stick) <= bound:
                lam[t] = stick
            else:
                step = 1.0 / np.linalg.eigvalsh(block)[-1]
                for _ in range(50):
                    lam[t] -= step * (rest + block @ lam[t])
                    size = np.linalg.norm(lam[t])
                    lam[t] *= min(1.0, bound / size) if size > 0.0 else 1.0
        for i in range(3 * contacts, len(g)):
            lam[i] = max(0.0, lam[i] - (g[i] + W[i] @ lam) / W[i, i])
        if np.abs(lam - before).max() <= tolerance * max(np.abs(lam).max(), 1e-300):
            break
    return lam


def energy_of_motion(mass: Array, v: Array) -> float:
    return float(0.5 * mass @ (v * v).sum(axis=1))

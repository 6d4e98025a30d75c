"""Slow plain-NumPy twins of the kernels: the same physics from other formulas, sharing no code with finger_sim.

Where the package uses gradients r_n of D_m⁻¹, this file inverts the 4 × 4 matrix of barycentric coordinates; where
it rotates blocks of K, this file multiplies Bᵀ D B in Voigt's notation; where it runs its own Jacobi SVD, LAPACK's;
where it differentiates V by a closed formula, perturbation theory of the eigenvectors of FᵀF; where it keeps what a
spring of a relaxing term still feels, what the damper has yielded, by a matrix exponential; dense throughout.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from scipy.linalg import expm
from truth import patches

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
    """R = U Vᵀ: the rotation nearest to F.

    LAPACK's factors are good to round-off each, which adds up to as much as a test allows: they are made orthogonal in
    long double, and what is left off the diagonal of Uᵀ F V turned away, to first order (s_i + s_j is its stiffness).
    """
    U, s, V = (factor.astype(np.longdouble) for factor in signed_svd(F))
    U, V = (W @ (3.0 * np.eye(3) - W.T @ W) / 2.0 for W in (U, V))
    left = U.T @ F.astype(np.longdouble) @ V
    pairs = s[:, None] + s[None, :]
    known = np.abs(pairs) > 1e-13 * np.abs(s).max()
    turn = np.where(known, (left - left.T) / np.where(known, pairs, 1.0), 0.0)
    return (U @ (np.eye(3) + turn) @ V.T).astype(np.float64)


@dataclasses.dataclass
class Past:
    """What stress that relaxes depends on beside the strain now."""

    strains: Array  # (T, 3, 3) what relaxes of the strain at the start of a step
    yielded: Array  # (terms, T, 3, 3) strains of the dampers there


@dataclasses.dataclass
class Body:
    """A mesh with its material, at rest: everything that a step needs, in dense arrays."""

    points: Array  # (n, 3)
    tets: np.ndarray[Any, np.dtype[np.int64]]  # (T, 4)
    gradients: Array  # (T, 4, 3) of the four barycentric coordinates, components along e1, e2, e3
    volume: Array  # (T,)
    patch: np.ndarray[Any, np.dtype[np.int64]]  # (T,) tetrahedra with the same number share their volume strain
    mass: Array  # (n,)
    lame_lambda: float
    lame_mu: float
    alpha: float
    beta: float
    gravity: Array
    terms: tuple[tuple[float, float], ...] = ()  # time [s] and share of each
    whole: bool = False  # shares are of all of the stress, else of its deviator

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
        patch = np.arange(len(tets))
        if material.volumetric == "patch":
            held = np.zeros(len(points), bool)
            held[scene.driven_nodes(mesh)] = True
            patch = patches.freedoms(tets, held)
        E, nu = material.young, material.poisson
        bulk, shear = E / (3.0 * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))
        return cls(
            points,
            tets,
            gradients,
            volume,
            patch,
            mass,
            bulk - 2.0 / 3.0 * shear,
            shear,
            material.damping.mass,
            material.damping.stiffness,
            np.array(scene.gravity),
            tuple((term.time, term.share) for term in material.relaxation),
            material.relaxes == "stress",
        )

    def deformation(self, x: Array) -> Array:
        """F (T, 3, 3) = Σ_n x_n ⊗ ∇b_n, columns along the material axes."""
        return np.einsum("tni,tnj->tij", x[self.tets], self.gradients)

    def strains(self, x: Array, rotations: Array | None = None) -> Array:
        """sym(RᵀF) − I (T, 3, 3) at x; with `rotations` (T, 3, 3) given, R is frozen there."""
        F = self.deformation(x)
        if rotations is None:
            rotations = np.array([rotation_of(f) for f in F])
        out: Array = 0.5 * (np.swapaxes(rotations, 1, 2) @ F + np.swapaxes(F, 1, 2) @ rotations) - np.eye(3)
        return out

    def relaxing(self, strains: Array) -> Array:
        """What relaxes of strains (T, 3, 3): all, or the deviator."""
        mean = np.trace(strains, axis1=1, axis2=2) / 3.0
        return strains if self.whole else strains - mean[:, None, None] * np.eye(3)

    def sudden(self, x: Array) -> Past:
        """The past of a body that has just been deformed: no damper has yielded yet."""
        return Past(self.relaxing(self.strains(x)), np.zeros((len(self.terms), len(self.tets), 3, 3)))

    def after(self, past: Past, strains: Array, h: float) -> Past:
        """That of a step of h [s] on, in which strain goes on a straight line to `strains`: τ α̇ = e − α."""
        e, yielded = self.relaxing(strains), past.yielded.copy()
        for k, (time, _) in enumerate(self.terms):
            for t in range(len(e)):
                start = np.stack([past.yielded[k, t], past.strains[t], (e[t] - past.strains[t]) / h]).reshape(3, 9)
                yielded[k, t] = (_course(time, h) @ start)[0].reshape(3, 3)
        return Past(e, yielded)

    def faded(self, past: Past) -> Array:
        """What the stress of a strain lacks by then, as a strain (T, 3, 3)."""
        return np.einsum("k,ktij->tij", [share for _, share in self.terms], past.yielded)

    def within(self, h: float) -> Body:
        """The same with the moduli that stress at the end of a step of h [s] has for the strain there."""
        left = 1.0 - sum(share * float(_course(time, h)[0, 2]) / h for time, share in self.terms)
        bulk = (self.lame_lambda + 2.0 / 3.0 * self.lame_mu) * (left if self.whole else 1.0)
        shear = left * self.lame_mu
        return dataclasses.replace(self, lame_mu=shear, lame_lambda=bulk - 2.0 / 3.0 * shear, terms=())

    def stored(self, x: Array, past: Past) -> float:
        """Elastic energy [J]: of each term's share, that of what its spring still feels of the strain."""
        total = self.energy(x)
        for (_, share), yielded in zip(self.terms, past.yielded, strict=True):
            total += share * (self.energy_of(past.strains - yielded) - self.energy_of(past.strains))
        return total

    def energy_of(self, strains: Array) -> float:
        """Σ vol (μ |dev e|² + K/2 (tr e)²), each tetrahedron with its own volume strain."""
        traces = np.trace(strains, axis1=1, axis2=2)
        bulk = self.lame_lambda + 2.0 / 3.0 * self.lame_mu
        square = (strains**2).sum(axis=(1, 2)) - traces**2 / 3.0
        return float(self.volume @ (self.lame_mu * square + 0.5 * bulk * traces**2))

    def energy(self, x: Array) -> float:
        """Elastic energy Σ vol (μ |dev(S − I)|² + K/2 θ²), S = RᵀF, θ its patch's mean of tr(S − I) [J]."""
        e = np.array([signed_svd(F)[1] for F in self.deformation(x)]) - 1.0
        mean = e.sum(axis=1) / 3.0
        shape = self.lame_mu * ((e - mean[:, None]) ** 2).sum(axis=1)
        bulk = self.lame_lambda + 2.0 / 3.0 * self.lame_mu
        return float(self.volume @ (shape + 0.5 * bulk * self.swelling(3.0 * mean) ** 2))

    def swelling(self, traces: Array) -> Array:
        """The mean by volume of each tetrahedron's patch, (T,) of (T,)."""
        whole = np.bincount(self.patch, self.volume)
        means: Array = (np.bincount(self.patch, self.volume * traces) / whole)[self.patch]
        return means

    def bounded(self, x: Array) -> Array:
        """F with the volume strain of its patch, (T, 3, 3): what limits bound."""
        out = self.deformation(x)
        R, s = np.array([rotation_of(F) for F in out]), np.array([signed_svd(F)[1] for F in out])
        traces = s.sum(axis=1) - 3.0
        wide: Array = out + ((self.swelling(traces) - traces) / 3.0)[:, None, None] * R
        return wide

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

    def forces(self, x: Array, rotations: Array | None = None, past: Past | None = None, h: float = 0.0) -> Array:
        """Elastic nodal forces (n, 3) [N] at x; with `rotations` (T, 3, 3) given, R is frozen there.

        Of stress that relaxes, those at the end of a step of h [s] from `past` to x.
        """
        out, D = np.zeros((len(self.points), 3)), self.hooke()
        if rotations is None:
            rotations = np.array([rotation_of(f) for f in self.deformation(x)])
        strains = self.strains(x, rotations)
        if past is not None:
            strains = strains - self.faded(self.after(past, strains, h))
        traces = np.trace(strains, axis1=1, axis2=2)
        strains += ((self.swelling(traces) - traces) / 3.0)[:, None, None] * np.eye(3)
        for t, (nodes, R, E) in enumerate(zip(self.tets, rotations, strains, strict=True)):
            voigt = np.array([E[0, 0], E[1, 1], E[2, 2], 2 * E[1, 2], 2 * E[0, 2], 2 * E[0, 1]])
            f = -self.volume[t] * self.strain_matrix(t).T @ D @ voigt
            out[nodes] += f.reshape(4, 3) @ R.T
        return out

    def stiffness(self, x: Array) -> Array:
        """K (3n, 3n) = Σ vol R Bᵀ D B Rᵀ at x: minus the derivative of the forces with R frozen.

        D without its bulk part, which is Σ K V_p ∇θ_p ∇θ_pᵀ of patches.
        """
        n, D = len(self.points), self.hooke()
        bulk = self.lame_lambda + 2.0 / 3.0 * self.lame_mu
        D[:3, :3] -= bulk
        K, swells = np.zeros((3 * n, 3 * n)), np.zeros((self.patch.max() + 1, 3 * n))
        for t, (nodes, F) in enumerate(zip(self.tets, self.deformation(x), strict=True)):
            B = self.strain_matrix(t)
            R = np.kron(np.eye(4), rotation_of(F))
            index = (3 * nodes[:, None] + np.arange(3)).ravel()
            K[np.ix_(index, index)] += self.volume[t] * R @ B.T @ D @ B @ R.T
            swells[self.patch[t], index] += self.volume[t] * R @ B[:3].sum(axis=0)
        K += bulk * swells.T @ (swells / np.bincount(self.patch, self.volume)[:, None])
        return K

    def turning(self, limit_force: Array, viscosity: float) -> Array:
        """What limit forces Λ (T,) [N m] that turn with their tetrahedra add to K: viscosity · Λ r_a · r_b (3n, 3n)."""
        K = np.zeros((len(self.points), len(self.points)))
        for nodes, r, force in zip(self.tets, self.gradients, limit_force, strict=True):
            K[np.ix_(nodes, nodes)] += viscosity * force * r @ r.T
        return np.kron(K, np.eye(3))

    def resistance(self, x: Array, limits: Any, young: float) -> Array:
        """What passed `tensor` limits resist the turning of their eigenvectors with, (3n, 3n) [N/m].

        For each two eigenvalues p > q of A⁺EA⁺ and −A⁻EA⁻ of one tetrahedron, with what its patch makes of E:
        2 (f_p − f_q) / (p − q) g gᵀ, f = κ E V |Aq|⁻⁴ (λ − c), 0 below, p − q ≥ 0.1, g = ∂(a_pᵀ E a_q)/∂x, a = Aq.
        c is 0.95, or nearer to 1 where κ E (1 − c) would be more than 15 μ.
        """
        K = np.zeros((3 * len(self.points),) * 2)
        if limits is None or limits.projection != "tensor" or limits.stiffness is None:
            return K
        patched = len(np.unique(self.patch)) < len(self.tets)
        ahead = min(0.05, 15.0 * self.lame_mu / (limits.stiffness * young))
        own, bounded = self.deformation(x), self.bounded(x)
        for t, nodes in enumerate(self.tets):
            E = polar_strain(bounded[t])[0]
            _, V, s = polar_strain(own[t])
            index = (3 * nodes[:, None] + np.arange(3)).ravel()
            for sign, bounds in ((1.0, limits.stretch), (-1.0, limits.compress)):
                if all(bound is None for bound in bounds):
                    continue
                A = np.diag([0.0 if bound is None else abs(bound - 1.0) ** -0.5 for bound in bounds])
                values, vectors = np.linalg.eigh(sign * A @ E @ A)
                for i, j in itertools.combinations(range(3), 2):
                    a, b = A @ vectors[:, i], A @ vectors[:, j]
                    forces = [
                        max(values[k] - 1.0 + ahead, 0.0) / float(y @ y) ** 2 if y @ y > 0.0 else 0.0
                        for k, y in ((i, a), (j, b))
                    ]
                    weight = 2.0 * max(forces[1] - forces[0], 0.0) / max(values[j] - values[i], 0.1)
                    dE = _strain_slopes(own[t], V, s)
                    slope = np.einsum("i,ijkl,j->kl", a, dE, b)
                    if patched:
                        slope -= (a @ b) / 3.0 * np.einsum("iikl->kl", dE)
                    g = (self.gradients[t] @ slope.T).ravel()
                    K[np.ix_(index, index)] += limits.stiffness * young * self.volume[t] * weight * np.outer(g, g)
        return K

    def system(
        self,
        x: Array,
        v: Array,
        h: float,
        driven: Any = (),
        v_driven: Array | None = None,
        limit_force: Array | None = None,
        viscosity: float = 0.0,
        resistance: Array | float = 0.0,
        past: Past | None = None,
    ) -> System:
        """A v = b of backward Euler for the free nodes, the driven ones' velocities on the right."""
        K = self.within(h).stiffness(x)
        m = np.repeat(self.mass, 3)
        A = (1.0 + h * self.alpha) * np.diag(m) + h * (h + self.beta) * K
        if limit_force is not None:
            A += h * h * self.turning(limit_force, viscosity)
        A += h * h * resistance
        b = m * v.ravel() + h * (m * np.tile(self.gravity, len(self.points)) + self.forces(x, None, past, h).ravel())
        is_free = np.ones(len(self.points), bool)
        is_free[list(driven)] = False
        free = np.flatnonzero(np.repeat(is_free, 3))
        held = np.flatnonzero(np.repeat(~is_free, 3))
        given = np.zeros(3 * len(self.points))
        if len(held):
            given[held] = np.asarray(v_driven).ravel()
        return System(A[np.ix_(free, free)], b[free] - A[np.ix_(free, held)] @ given[held], free, given)


def _course(time: float, h: float) -> Array:
    """What h [s] make of (α, e, ė) with τ α̇ = e − α and ė constant: the matrix (3, 3)."""
    step: Array = expm(h * np.array([[-1.0 / time, 1.0 / time, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    return step


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


def limit_rows(
    F: Array, limits: Any, gap: float | None = None, both: bool = False
) -> list[tuple[float, Array, float, float]]:
    """(C, ∂C/∂F, side, room) of every row of one tetrahedron (Eq. 9-12, 19-22); side +1 stretch, −1 compression.

    Of the side that s_i is on, or of `both`. ∂V from the eigenvectors of FᵀF:
    dv_i = Σ_k v_k (v_kᵀ d(FᵀF) v_i) / (s_i² − s_k²), |denominator| ≥ gap; left at zero, for values alone, when `gap`
    is None.
    """
    U, s, V = signed_svd(F)
    rows = []
    for i in range(3):
        here = 1.0 if s[i] >= 1.0 else -1.0
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
        for side in (here, -here) if both else (here,):
            bounds = limits.stretch if side > 0.0 else limits.compress
            rows += [
                (side * C, side * dC, side, room) for C, dC, room in _of_axis(limits, bounds, V[:, i], s[i], dV, ds)
            ]
    return rows


def _of_axis(limits: Any, bounds: Any, v: Array, s: float, dV: Array, ds: Array) -> list[tuple[float, Array, float]]:
    """(limit − s, its ∂/∂F, room) of one principal axis v: of stretch; of compression with the opposite sign."""
    limited = [j for j in range(3) if bounds[j] is not None]
    if not limited:
        return []
    if limits.projection == "isotropic":
        return [(bounds[0] - s, -ds, abs(bounds[0] - 1.0))]
    if limits.projection == "linear":
        if any(bounds[j] is None and v[j] != 0.0 for j in range(3)) and bounds[limited[0]] > 1.0:
            return []
        square = np.array([bounds[j] ** 2 if bounds[j] is not None else 0.0 for j in range(3)])
        reach = np.sqrt(square @ v**2)
        return [(float(reach - s), np.einsum("j,jkl->kl", square * v, dV) / reach - ds, float(abs(reach - 1.0)))]
    rows = []
    for j in limited:
        room, turn = bounds[j] - 1.0, np.sign(v[j]) * dV[j]
        if limits.projection == "orthogonal":
            rows.append((float(room * abs(v[j]) - (s - 1.0)), room * turn - ds, float(abs(room * v[j]))))
        else:
            rows.append((float(room - abs(v[j]) * (s - 1.0)), -(turn * (s - 1.0) + abs(v[j]) * ds), float(abs(room))))
    return rows


def polar_strain(F: Array) -> tuple[Array, Array, Array]:
    """E = U − I, V and s of the right stretch U = V diag(s) Vᵀ, F = R U."""
    _, s, V = signed_svd(F)
    return (V * (s - 1.0)) @ V.T, V, s


def _strain_slopes(F: Array, V: Array, s: Array) -> Array:
    """∂E_ij/∂F_kl: U dU + dU U = d(FᵀF), solved in the eigenvectors V of U."""
    slopes = np.zeros((3, 3, 3, 3))
    for k, l in itertools.product(range(3), range(3)):
        dF = np.zeros((3, 3))
        dF[k, l] = 1.0
        slopes[:, :, k, l] = V @ ((V.T @ (dF.T @ F + F.T @ dF) @ V) / (s[:, None] + s[None, :])) @ V.T
    return slopes


def tensor_rows(
    F: Array, limits: Any, near: float = np.inf, coincide: float = 0.0
) -> list[tuple[float, Array, float, float]]:
    """(1 − λ, its ∂/∂F, |y|², share) of the three eigenvalues of A⁺EA⁺ and of −A⁻EA⁻, y = A q.

    A side without limits has none. Two eigenvalues above `near` and less than `coincide` apart have a row also halfway
    between their eigenvectors, on either side, with a share of the stiffness that fades with their distance.
    dλ = yᵀ dU y, and U dU + dU U = d(FᵀF) is solved in the eigenvectors of U.
    """
    E, V, s = polar_strain(F)
    slopes, rows = _strain_slopes(F, V, s), []
    for sign, bounds in ((1.0, limits.stretch), (-1.0, limits.compress)):
        if all(bound is None for bound in bounds):
            continue
        A = np.diag([0.0 if bound is None else max(abs(bound - 1.0), 1e-6) ** -0.5 for bound in bounds])
        B = sign * A @ E @ A
        values, vectors = np.linalg.eigh(B)
        directions = [(q, 1.0) for q in vectors.T]
        for a, b in itertools.combinations(range(3), 2):
            if min(values[a], values[b]) > near and abs(values[a] - values[b]) < coincide:
                share = 1.0 - abs(values[a] - values[b]) / coincide
                directions += [((vectors[:, a] + side * vectors[:, b]) / np.sqrt(2.0), share) for side in (1.0, -1.0)]
        for q, share in directions:
            y = A @ q
            gradient = -sign * np.einsum("i,ijkl,j->kl", y, slopes, y)
            rows.append((float(1.0 - q @ B @ q), gradient, float(y @ y), share))
    return rows


@dataclasses.dataclass
class Rows:
    """Linearised rows of a step: g = C + shift + h J v + ε λ over all 3n velocities."""

    C: Array  # (m,) room left, or gap
    J: Array  # (m, 3n)
    compliance: Array  # (m,)
    tet: np.ndarray[Any, np.dtype[np.int64]]  # (m,) −1: contact
    room: Array  # (m,) C at rest of a limit; of contact: size of the tetrahedra
    shift: Array  # (m,) −ε λ of the step before for contact, else 0


def rows_of(F: Array, limits: Any, gap: float, near: float, coincide: float) -> list[tuple[float, Array, float, float]]:
    """(C, ∂C/∂F, room, share of the limit's stiffness) of every row of one tetrahedron as a step has it."""
    if limits.projection == "tensor":  # C = (1 − λ) / |y|²: the strain along y that is left
        rows = tensor_rows(F, limits, near, coincide)
        return [(C / size, dC_dF / size, 1.0 / size, share) for C, dC_dF, size, share in rows if size > 0.0]
    both = limits.projection in ("orthogonal", "linear")
    return [(C, dC_dF, room, 1.0) for C, dC_dF, _, room in limit_rows(F, limits, gap, both)]


def strain_rows(
    body: Body, x: Array, scene: Any, free: Any, h: float, gap: float, near: float, coincide: float
) -> Rows:
    """The limit rows of all tetrahedra with a free node.

    A row gives by 1/k, k the larger one of κ E V and of limits.inertia times the inertia h² / (J M⁻¹ Jᵀ) that its free
    nodes have within a step; with stiffness null by nothing.
    """
    limits, parts = scene.limits, []
    moves = np.zeros(x.size)
    moves[np.asarray(free)] = 1.0
    for t, F in enumerate(body.deformation(x)):
        nodes = body.tets[t]
        if not moves.reshape(-1, 3)[nodes].any():
            continue
        for value, dC_dF, room, share in rows_of(F, limits, gap, near, coincide):
            row = np.zeros((len(x), 3))
            row[nodes] = body.gradients[t] @ dC_dF.T
            J = row.ravel()
            if moves @ J**2 < 1e-16 / np.cbrt(body.volume[t]) ** 2:
                continue  # nothing can move it
            soft = 0.0
            if limits.stiffness is not None:
                inertia = 1.0 / (J @ (moves * J / np.repeat(body.mass, 3))) / h**2
                soft = (
                    1.0
                    / max(limits.stiffness * scene.material.young * body.volume[t], limits.inertia * inertia)
                    / share
                )
            parts.append((value, J, soft, t, room, 0.0))
    return _rows(parts, x.size)


def _rows(parts: list[Any], size: int) -> Rows:
    C, J, compliance, tet, room, shift = ([p[k] for p in parts] for k in range(6))
    J = np.array(J).reshape(-1, size)
    return Rows(np.array(C), J, np.array(compliance), np.array(tet, np.int64), np.array(room), np.array(shift))


def contact_compliance(body: Body, scene: Any, node: int, h: float) -> float:
    """ε of a node's contact [m/N]: 1 / (κ E V^⅓), but no more than h² / (30 m)."""
    if scene.plane.stiffness is None:
        return 0.0
    stiffness = scene.plane.stiffness * scene.material.young * np.cbrt(body.volume.mean())
    return float(min(1.0 / stiffness, h**2 / (30.0 * body.mass[node])))


def contact_rows(body: Body, x: Array, scene: Any, nodes: Any, before: Array, h: float, tangents: bool) -> Rows:
    """φ + h n·v + ε (λ_n − λ_n⁰) ≥ 0 for each of `nodes`, and with `tangents` h t·v + ε (λ_t − λ_t⁰) for two of them.

    before (n, 3): the plane's force on each node in the step before [N].
    """
    n = np.array(scene.plane.normal) / np.linalg.norm(scene.plane.normal)
    across = np.linalg.svd(n[None])[2][1:]  # any two will do
    parts = []
    for node in nodes:
        soft = contact_compliance(body, scene, node, h)
        for axis, d in enumerate([n, *(across if tangents else ())]):
            J = np.zeros((len(x), 3))
            J[node] = d
            gap = (x[node] - np.array(scene.plane.point)) @ n if axis == 0 else 0.0
            parts.append((gap, J.ravel(), soft, -1, np.cbrt(body.volume.mean()), -soft * (before[node] @ d)))
    return _rows(parts, x.size)


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

r"""Mean dilatation on patches of tetrahedra: one volume strain for all of a patch, which does not lock.

The energy is that of each tetrahedron's deviator, and of each patch's volume strain (Nagtegaal, Parks & Rice 1974),

    Σ_e vol_e μ |dev E_e|² + Σ_p ½ K V_p θ_p²,    θ_p = Σ_{e ∈ p} vol_e tr E_e / V_p,    K = λ + 2 μ / 3,

V_p the patch's volume. As ∂ tr E/∂F = R, its forces are those of elasticity.py with K θ_p in place of K tr E_e, and its
stiffness has a block K V_p G_a G_bᵀ for each two nodes of a patch, with the gradient of θ_p,

    G_n = Σ_{e ∈ p} vol_e R_e r_{e,n} / V_p.

The matrix stays symmetric and positive definite, and nothing is unknown but the nodes' velocities.

Limits act on Ē = dev E + θ_p I / 3, or they would lock what the patches free. A limit row of a tetrahedron is then a
gradient at its own four nodes, as without patches, and α G at all nodes of its patch: α, in state.row_part, is a third
of what the row has for a change of all three strains.
"""

from __future__ import annotations

from ..arrays import Floats, Ints
from .compile import stage
from .kinematics import edges_times
from .lanes import load4, load8, splat4, store4, store8, sum3
from .model import Model, State
from .polar import load_matrix
from .relaxation import step_moduli


@stage
def patch_pressures(model: Model, state: State, lead: float) -> None:
    """K θ_p of every tetrahedron's patch into state.pressure, driven nodes going on for `lead` [s]."""
    own, pressure, strains, volumes = model.patches, state.pressure, state.felt_strain, model.lane_volume
    bulk = step_moduli(model, state)[2]
    theta, patches = state.theta, own.lane
    r, nodes, driven, w, rotations = (
        model.lane_gradients,
        model.lane_node,
        model.lane_driven,
        state.driven_velocity,
        state.R,
    )
    theta[:] = 0.0
    for b in range(strains.shape[0]):
        trace = load8(strains, b, 0) + load8(strains, b, 1) + load8(strains, b, 2)
        if driven[b]:
            f0, f1, f2, f3, f4, f5, f6, f7, f8 = edges_times(w, nodes, r, b)
            r0, r1, r2, r3, r4, r5, r6, r7, r8 = load_matrix(rotations, b)
            rate = r0 * f0 + r1 * f1 + r2 * f2 + r3 * f3 + r4 * f4 + r5 * f5 + r6 * f6 + r7 * f7 + r8 * f8
            trace = trace + lead * rate
        store8(pressure, b, 0, trace * load8(volumes, b, 0))
        for l in range(8):
            theta[patches[b, l]] += pressure[b, l]
    for p in range(theta.shape[0]):
        theta[p] *= bulk / own.volume[p]
    for b in range(strains.shape[0]):
        for l in range(8):
            pressure[b, l] = theta[patches[b, l]]


@stage
def mean_strains(model: Model, state: State) -> None:
    """Ē of every tetrahedron into state.limit_strain."""
    own, strains, mean, volumes = model.patches, state.E, state.limit_strain, model.lane_volume
    theta, patches = state.patch_rate, own.lane
    theta[:] = 0.0
    for b in range(strains.shape[0]):
        trace = load8(strains, b, 0) + load8(strains, b, 1) + load8(strains, b, 2)
        store8(mean, b, 0, trace * load8(volumes, b, 0))
        for l in range(8):
            theta[patches[b, l]] += mean[b, 0, l]
    for p in range(theta.shape[0]):
        theta[p] /= own.volume[p]
    for b in range(strains.shape[0]):
        e0, e1, e2 = load8(strains, b, 0), load8(strains, b, 1), load8(strains, b, 2)
        for l in range(8):
            mean[b, 0, l] = theta[patches[b, l]]
        change = (load8(mean, b, 0) - (e0 + e1 + e2)) * (1.0 / 3.0)
        store8(mean, b, 0, e0 + change)
        store8(mean, b, 1, e1 + change)
        store8(mean, b, 2, e2 + change)
        for c in range(3, 6):
            store8(mean, b, c, load8(strains, b, c))


@stage
def patch_rates(model: Model, state: State, places: Ints, velocities: Floats) -> None:
    """θ̇_p of velocities into state.patch_rate; places (N,): which of them each entry has."""
    start, rates, G = model.patches.start, state.patch_rate, state.G
    for p in range(rates.shape[0]):
        total = splat4(0.0)
        for k in range(start[p], start[p + 1]):
            total = total + load4(G, k, 0) * load4(velocities, places[k], 0)
        rates[p] = sum3(total)


@stage
def share_out(model: Model, state: State) -> None:
    """Add to state.limit_force each tetrahedron's share of what rows press its patch with, summed in patch_force."""
    own, limit_force, sums = model.patches, state.limit_force, state.patch_force
    for t in range(own.tet_share.shape[0]):
        limit_force[t // 8, t % 8] += own.tet_share[t] * sums[own.lane[t // 8, t % 8]]


@stage
def patch_sizes(model: Model, state: State) -> None:
    """|G|² of each patch over its free nodes, and over their masses, into state.patch_size."""
    start, slots, G, sizes = model.patches.start, model.patches.slot, state.G, state.patch_size
    mobility, nf = model.mobility, model.free.shape[0]
    for p in range(sizes.shape[1]):
        total = moved = 0.0
        for k in range(start[p], start[p + 1]):
            if slots[k] < nf:
                size = sum3(load4(G, k, 0) * load4(G, k, 0))
                total += size
                moved += size * mobility[slots[k]]
        sizes[0, p], sizes[1, p] = total, moved


@stage
def add_patch_forces(model: Model, state: State, h: float, r: Floats) -> None:
    """Add h Σ α λ G, whose sums over the rows of a patch state.patch_force has, to r in slot order."""
    own, force, G = model.patches, state.patch_force, state.G
    start, slots = own.start, own.slot
    for p in range(force.shape[0]):
        if force[p] != 0.0:
            for k in range(start[p], start[p + 1]):
                store4(r, slots[k], 0, load4(r, slots[k], 0) + load4(G, k, 0) * (h * force[p]))


@stage
def add_patch_rows(model: Model, state: State, blocks: Floats) -> None:
    """Add to the Hessian's blocks what limit rows have of their patches' other nodes.

    Of a row with the weight w, J at its own nodes and α: w α (J Gᵀ + G Jᵀ) + w α² G Gᵀ. state.patch_cross has the sums
    of w α J at the nodes of each patch, state.patch_force those of w α².
    """
    own, cross, square, G = model.patches, state.patch_cross, state.patch_force, state.G
    assembly, place = own.assembly, own.place
    for k in range(assembly.shape[0]):
        p, row, column = assembly[k, 0], assembly[k, 1], assembly[k, 2]
        if square[p] == 0.0 or place[k] < 0:
            continue
        half = 0.5 * square[p]
        g, c = load4(G, row, 0), load4(cross, row, 0)
        a = c + g * half
        for j in range(3):
            other = G[column, j]
            mixed = cross[column, j] + half * other
            store4(blocks, place[k], j, load4(blocks, place[k], j) + (a * other + g * mixed))


@stage
def patch_stiffness(model: Model, state: State, A: Floats, weight: float) -> None:
    """Add weight · K V_p G_a G_bᵀ to A."""
    own, G = model.patches, state.G
    assembly, bulk = own.assembly, step_moduli(model, state)[2]
    for k in range(assembly.shape[0]):
        p, row, column, block = assembly[k, 0], assembly[k, 1], assembly[k, 2], assembly[k, 3]
        a = load4(G, row, 0) * (weight * bulk * own.volume[p])
        for j in range(3):
            store4(A, block, j, load4(A, block, j) + a * G[column, j])

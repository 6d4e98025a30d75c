r"""Mean dilatation on patches of tetrahedra: one volume strain for all of a patch, which does not lock.

The energy is that of each tetrahedron's deviator, and of each patch's volume strain (Nagtegaal, Parks & Rice 1974),

    Σ_e vol_e μ |dev E_e|² + Σ_p ½ K V_p θ_p²,    θ_p = Σ_{e ∈ p} vol_e tr E_e / V_p,    K = λ + 2 μ / 3,

V_p the patch's volume. As ∂ tr E/∂F = R, its forces are those of elasticity.py with K θ_p in place of K tr E_e, and its
stiffness has a block K V_p G_a G_bᵀ for each two nodes of a patch, with the gradient of θ_p,

    G_n = Σ_{e ∈ p} vol_e R_e r_{e,n} / V_p.

The matrix stays symmetric and positive definite, and nothing is unknown but the nodes' velocities.
"""

from __future__ import annotations

from .compile import stage
from .kinematics import edges_times
from .lanes import gather3, load4, load8, splat4, store4, store8
from .model import Model, State
from .polar import load_matrix


@stage
def patch_pressures(model: Model, state: State, lead: float) -> None:
    """K θ_p of every tetrahedron's patch into state.pressure, driven nodes going on for `lead` [s]."""
    own, pressure, strains, volumes = model.patches, state.pressure, state.E, model.lane_volume
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
            x4, y4, z4 = gather3(w, nodes, b, 3)
            x1, y1, z1 = gather3(w, nodes, b, 0)
            x2, y2, z2 = gather3(w, nodes, b, 1)
            x3, y3, z3 = gather3(w, nodes, b, 2)
            f0, f1, f2, f3, f4, f5, f6, f7, f8 = edges_times(
                (x1 - x4, y1 - y4, z1 - z4), (x2 - x4, y2 - y4, z2 - z4), (x3 - x4, y3 - y4, z3 - z4), r, b
            )
            r0, r1, r2, r3, r4, r5, r6, r7, r8 = load_matrix(rotations, b)
            rate = r0 * f0 + r1 * f1 + r2 * f2 + r3 * f3 + r4 * f4 + r5 * f5 + r6 * f6 + r7 * f7 + r8 * f8
            trace = trace + lead * rate
        store8(pressure, b, 0, trace * load8(volumes, b, 0))
        for l in range(8):
            theta[patches[b, l]] += pressure[b, l]
    for p in range(theta.shape[0]):
        theta[p] *= own.bulk / own.volume[p]
    for b in range(strains.shape[0]):
        for l in range(8):
            pressure[b, l] = theta[patches[b, l]]


@stage
def patch_gradients(model: Model, state: State) -> None:
    """G_n of every patch at its nodes into state.G, from state.g = R r_n."""
    own, G, g, volume = model.patches, state.G, state.g, model.volume
    place, share = own.tet_place, own.tet_share
    for k in range(G.shape[0]):
        store4(G, k, 0, splat4(0.0))
    for t in range(volume.shape[0]):
        for n in range(4):
            k = place[t, n]
            store4(G, k, 0, load4(G, k, 0) + load4(g, t, n) * share[t])


@stage
def patch_stiffness(model: Model, state: State, weight: float) -> None:
    """Add weight · K V_p G_a G_bᵀ to A."""
    own, A, G = model.patches, state.A, state.G
    assembly = own.assembly
    for k in range(assembly.shape[0]):
        p, row, column, block = assembly[k, 0], assembly[k, 1], assembly[k, 2], assembly[k, 3]
        a = load4(G, row, 0) * (weight * own.bulk * own.volume[p])
        for j in range(3):
            store4(A, block, j, load4(A, block, j) + a * G[column, j])

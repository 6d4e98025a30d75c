"""`Model`: what never changes in a run. `State`: what does, and the step's workspace. Both are plain records."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..scene import Scene
from ..scene.locking import STIFF_BULK, bulk_to_shear, isochoric_strain
from ..scene.mesh import TetMesh
from . import linear_solver, strain_limits
from .kinematics import BATCH
from .lanes import LANES, aligned, padded
from .linear_solver import Pattern, analyse, block_of
from .methods import LEVELS, METHODS, PGS
from .tensor_limit import limit_factors
from .work import WORK

MAX_ROWS = 2048  # limit and contact rows of one step of `pgs`; more are left out, with a status bit
PAIRS = [(a, b) for a in range(4) for b in range(a + 1)]


class Model(NamedTuple):
    """Rest shape, masses, patterns and coefficients.

    n nodes, T tetrahedra, in B batches of 8 lanes (the last one filled up with tetrahedra of no volume); nf free nodes,
    "slots" 0 … nf − 1; slot nf stands for driven nodes and for none. Where the bone yields, slots nf + 1 and nf + 2 are
    its own and the others those of its nodes (bone.py). Node pairs e of a tetrahedron: see PAIRS. A has `nf` diagonal
    blocks and `na` below the diagonal: block k < nf is the diagonal one of slot k, block nf + p the p-th of the others;
    with such a bone, then come its nodes' diagonal blocks. Blocks lie by columns, each padded to four numbers.
    """

    tets: Ints  # (T, 4) nodes of each tetrahedron
    gradients: Floats  # (T, 4, 3) rows r_n of D_m⁻¹ in material axes [1/m]; r_4 = −(r_1 + r_2 + r_3) (Eq. 2)
    volume: Floats  # (T,) rest volume [m³]
    mass: Floats  # (n,) lumped mass [kg]
    mobility: Floats  # (slots,) 1 / mass of each slot [1/kg], 0: driven
    length: float  # cube root of the mean tetrahedron volume [m]
    free: Ints  # (nf,) node of each slot
    slot: Ints  # (n,) slot of each node
    driven: Ints  # (nd,) driven nodes
    tet_slot: Ints  # (T, 4) slots of a tetrahedron's nodes
    tet_place: Ints  # (T, 10) block of the factorisation that each node pair adds to, −1: none (a driven node)
    pair_row: Ints  # (T, 10) node (0 … 3) at the block's row
    pair_column: Ints  # (T, 10) node (0 … 3) at the block's column
    tet_order: Ints  # (T,) tetrahedra by their first slot: neighbouring rows share work in solves
    tet_moves: Ints  # (T,) number of free nodes; 0: cannot deform but by command
    lane_node: Ints  # (B, 4, 8) nodes of the tetrahedra in lanes
    lane_slot: Ints  # (B, 4, 8) their slots
    lane_gradients: Floats  # (B, 12, 8) their r_1 … r_4
    lane_volume: Floats  # (B, 8)
    lane_driven: Ints  # (B,) 1 where a node of a lane is driven and another free
    assembly: Ints  # (k, 4) contributions to A: tetrahedron, its nodes at the row and the column, block of A
    assembly_dot: Floats  # (k,) r_a · r_b of their nodes [1/m²]
    block_row: Ints  # (na,) slot of each block below the diagonal of A
    block_column: Ints  # (na,)
    block_place: Ints  # (…,) where it is in the factorisation; those of a bone's nodes, the last ones, are not in it
    laplace: Floats  # (blocks,) Σ vol r_a · r_b of each block [m]: its part that does not turn
    pattern: Pattern  # of the factorisation of A
    surface_nodes: Ints  # (k,) nodes of the boundary
    contact_nodes: Ints  # (c,) those of them that are free
    lame_lambda: float  # [Pa]
    lame_mu: float  # [Pa]
    least_force: float  # forces are judged relative to the largest row force, and no finer than relative to this [N]
    damping_mass: float  # Rayleigh α [1/s]
    damping_stiffness: float  # Rayleigh β [s]
    gravity: Floats  # (3,) [m/s²], world
    projection: int  # strain_limits.NONE: no limits
    stretch_room: Floats  # (3,) a⁺, ∞: free
    compress_room: Floats  # (3,) a⁻, ∞: free
    limit_factors: Floats  # (2, 9) what `tensor` weighs strain with: see tensor_limit.limit_factors
    isochoric_strain: Floats  # (2, 3) stretch, compression along e_j that volume and the other limits allow, ∞: any
    limit_compliance: float  # 1 / (κ E) [1/Pa]: divided by a volume, a limit row's compliance [1/(N m)]; 0: rigid
    limit_inertia: float  # a limit is at least so many times as stiff as the inertia behind it in one step
    limit_viscosity: float  # of limit forces that turn, in units of themselves: see elasticity.py
    has_plane: bool
    has_bone: bool  # the driven nodes are a rigid body on a spring: see bone.py
    rest_driven: Floats  # (nd, 3) where the mesh has them [m]; empty without has_bone
    bone_lever: float  # rms distance of its nodes from its origin [m]: torques are judged as forces there
    spring: Floats  # (2, 2) stiffness, damping [N/m, N s/m]; the same of rotation [N m/rad, N m s/rad]
    spring_limit: Floats  # (2,) largest force [N] and torque [N m]
    mu_friction: float  # Coulomb μ
    contact_compliance: float  # 1 / k_n [m/N]; 0: rigid
    method: int  # PGS or NEWTON
    tolerance: float  # see Solver.tolerance
    max_iterations: int
    relinearizations: int
    settles: bool  # a step whose driven nodes stay is linearised twice
    hold: int  # steps that share A
    deadline: float  # [s] after which a step begins no further iteration; 0: none


class State(NamedTuple):
    """Positions, velocities and what the last step left; then the workspace of a step (nothing is allocated in it).

    Arrays that a projection or a solver does not use are empty.
    """

    x: Floats  # (n, 4) positions [m], world; as every vector of a node padded to four numbers
    v: Floats  # (n, 4) velocities [m/s], world
    x_start: Floats  # (n, 4) x at the step's start, where a step is linearised more than once
    v_start: Floats  # (n, 4) and v
    v_base: Floats  # (n, 4) v that state.x is linearised with
    moving: Floats  # (n, 4) velocities that state.x has not yet moved by: rows look ahead along them
    age: Ints  # (1,) steps since A was formed
    factored_holds: Ints  # (1,) signature of what held in the last factorisation: see newton.evaluate
    origin: Floats  # (3,) origin of the finger frame at the end of the step, world [m]: wrenches are about it
    driven_velocity: Floats  # (n, 4) velocities of driven nodes in this step [m/s], 0: free
    plane_frame: Floats  # (3, 3) rows: unit normal of the plane at the step's end and two tangents, world
    plane_point: Floats  # (3,) a point of it [m], world
    plane_motion: Floats  # (6,) velocity of that point [m/s] and angular velocity [rad/s] in the step
    moves: Ints  # (1,) 1 where bone or plane move in this step
    target: Floats  # (13,) where a yielding bone is wanted at the end: position, orientation, velocities
    bone: Floats  # (14,) pose of the bone (finger frame) at the step's start, then at x: position, orientation
    twist: Floats  # (6,) its velocity at its origin [m/s] and angular velocity [rad/s], world
    arms: Floats  # (nd, 4) its nodes from its origin, world [m]
    bone_base: Floats  # (6,) wrench of the spring at δ = 0, before its limits [N, N m]
    bone_load: Floats  # (6,) what bears the body's weight [N, N m]
    bone_stop: Floats  # (9,) gradient of the bone's gap to the plane, the gap [m], stiffness [N/m], force [N]
    bone_reach: Floats  # (1,) [m/s] what the spring may add to the bone's speed in a step
    bone_pulls: Floats  # (2, 4) spring at its limit: direction, share of its pull that is left; zeros and 1: not
    bone_holds: Ints  # (2,) which of PULLED, TWISTED, STOPPED hold, and held when factored
    bone_S: Floats  # (6, 6) Cholesky factor of S
    border: Floats  # (nf, 3, 8) B, two lanes empty
    border_solved: Floats  # (nf, 3, 8) H_ff⁻¹ B
    bone_scratch: Floats  # (3, 8)
    coupling: Floats  # (6,) wrench of the spring on the bone in the last step, about its origin, world [N, N m]
    quaternion: Floats  # (B, 4, 8) of R, x y z w
    R: Floats  # (B, 9, 8) rotation of each tetrahedron at x: F = R (I + E), from material axes to the world
    inverted: Ints  # (1,) batches with a tetrahedron that is inside out
    E: Floats  # (B, 6, 8) Biot strain 00 11 22 12 02 01, material axes
    F: Floats  # (T, 3, 3) deformation gradient at x: this and its decomposition for limits on principal stretches only
    U: Floats  # (T, 3, 3) F = U diag(s) Vᵀ
    s: Floats  # (T, 3)
    V: Floats  # (T, 3, 3)
    strain_ratio: Floats  # (T,) strain/limit at x
    contact_force: Floats  # (n, 3) force of the plane on each node [N], world
    wrench: Floats  # (6,) their sum [N] and torque about `origin` [N m]: plane on finger, world axes
    warm_limit: Floats  # (T, keys) `pgs`: last row forces by key, positive: stretch, negative: compression [N m]
    limit_force: Floats  # (B, 8) `tensor`: sum of the forces of a tetrahedron's limit rows in the last step [N m]
    held_tets: Ints  # (1,) tetrahedra that limit rows held in the last step
    active_rows: Ints  # (T,) rows of each tetrahedron that carry a force
    g: Floats  # (8 B, 4, 4) g_n = R r_n of each node of each tetrahedron [1/m], world
    A: Floats  # (nf + na, 3, 4)
    L_diagonal: Floats  # (nf, 3, 4) factorisation: D
    L_lower: Floats  # (nnz, 3, 4) L below its diagonal
    L_inverse: Floats  # (nf, 3, 4) D⁻¹
    rhs: Floats  # (slots, 4)
    slot_velocity: Floats  # (slots, 4) velocities in slot order
    slot_product: Floats  # (slots, 4) scratch
    bound: Floats  # (B, 2, 8) no eigenvalue of A E A is above (stretch) or, for compression, of −A E A
    near: Ints  # (near,) 2 t + side of what may be at a limit: sides 0 stretch, 1 compression
    near_count: Ints  # (1,) how many they are
    eigen: Floats  # (near / 8, 12, 8) their eigenvalues and eigenvectors (by columns), lanes in the order of `near`
    stage: Floats  # (32, 8) scratch: what is gathered for eight of them
    lane_J: Floats  # (8, 4, 4) scratch: a gradient of each of them
    J: Floats  # (rows, 4, 4) gradient of each row at its nodes
    row_slot: Ints  # (rows, 4) slots of these nodes
    row_tet: Ints  # (rows,) tetrahedron of a limit row; −1 − node of a contact row
    row_key: Ints  # (rows,) which of its tetrahedron's limit rows: 3 i + j, or of `tensor` 2 · direction + side
    row_side: Floats  # (rows,) +1 stretch, −1 compression
    constant: Floats  # (rows,) C + h J v at the velocities the rows were formed with
    compliance: Floats  # (rows,)
    scale: Floats  # (rows,) [N] of nodal force per unit of lam
    lam: Floats  # (rows,) row forces
    best: Floats  # (rows,) row forces of the least residual so far
    change: Floats  # (slots, 4) `newton`: change δ of the free nodes' velocities since the rows were formed
    direction: Floats  # (slots, 4) its Newton direction
    tried: Floats  # (slots, 4) δ on trial
    best_change: Floats  # (slots, 4) δ of the least residual so far
    start_residual: Floats  # (slots, 4) b − A v at δ = 0, then what remains at δ
    next_residual: Floats  # (slots, 4) at the δ on trial
    stiffness: Floats  # (rows,) what each row adds to the Hessian [N/m]: 1 / compliance where it carries a force
    factored: Floats  # (rows,) the same, as the factorisation in L has it
    slip: Floats  # (contacts, 4) unit slip direction of a node's contact force (world), and μ; zeros: sticks
    time: Ints  # (2,) scratch of the clock
    laps: Floats  # (7,) seconds spent in each stage of the steps so far (clock.STAGES), or empty: not measured
    diagonal: Floats  # (rows,) `pgs`: diagonal of W
    cross: Floats  # (rows,) W between a contact's two tangents, at the first one's row
    has_column: Ints  # (rows,) 1: the row's column of Z is there
    row_local: Ints  # (rows, 4) where in u the components of each node begin; past the touched ones: driven or none
    local: Ints  # (nf,) touched slots numbered, −1: not touched
    touched: Ints  # (touched,) their slots
    u: Floats  # (3 touched + 3,) h A⁻¹ Jᵀ λ at touched nodes, then zeros
    S: Floats  # (9 touched²,) A⁻¹ between touched nodes, used as (3 touched, 3 touched)
    Z: Floats  # (3 rows touched,) h A⁻¹ Jᵀ, a row's column contiguous
    Y: Floats  # (nf, 3, LANES) right-hand sides
    reached: Ints  # (nf,) 1 where Y is not zero
    columns: Floats  # (3, 3, BATCH) scratch
    turn: Floats  # (3, 3, BATCH) scratch
    P: Floats  # (3, 3) scratch
    D: Floats  # (3, 3) scratch
    turned: Floats  # (B, 4, 8) quaternion when A was formed, where steps share it
    motion: Floats  # (1,) rms speed of the nodes at the end of the last step [m/s]
    held: Floats  # (1,) time since the driven nodes last moved [s]
    clearance: Floats  # (1,) [m] no surface node is nearer to the plane; below 0: not known
    work: Ints  # (9,) what was done so far: see work.py
    result: Floats  # (11,) what a step reports: see step.py


def build_model(scene: Scene, mesh: TetMesh) -> Model:
    """The model of a scene on its mesh. Raises MeshError when the scene's driven nodes cannot be found."""
    tets = mesh.tets.astype(np.int64)
    n = len(mesh.points)
    corners = mesh.points[tets]
    D_m = np.swapaxes(corners[:, :3] - corners[:, 3:], 1, 2)
    material = np.swapaxes(mesh.axes, 1, 2)  # columns e1, e2, e3
    rows = np.linalg.inv(D_m) @ material
    gradients = np.concatenate([rows, -rows.sum(axis=1, keepdims=True)], axis=1)
    volume = np.linalg.det(D_m) / 6.0
    mass = np.zeros(n)
    np.add.at(mass, tets.ravel(), np.repeat(scene.material.density * volume / 4.0, 4))

    driven = scene.driven_nodes(mesh).astype(np.int64)
    is_free = np.ones(n, bool)
    is_free[driven] = False
    graph_nodes = np.flatnonzero(is_free)
    graph_index = np.full(n, -1, np.int64)
    graph_index[graph_nodes] = np.arange(len(graph_nodes))
    pairs = np.concatenate([tets[:, [a, b]] for a, b in PAIRS if a != b])
    edges = graph_index[pairs]
    pattern = analyse(np.unique(np.sort(edges[(edges >= 0).all(axis=1)], axis=1), axis=0), len(graph_nodes))
    free = graph_nodes[pattern.order]
    nf = len(free)
    has_bone = scene.coupling.type == "virtual"
    slot = np.full(n, nf, np.int64)
    slot[free] = np.arange(nf)
    if has_bone:
        slot[driven] = nf + 3 + np.arange(len(driven))
    slots = int(slot.max()) + 1 if has_bone else nf + 1
    tet_slot = slot[tets]
    tet_moves = (tet_slot < nf).sum(axis=1)
    blocks = _blocks(tet_slot, nf, pattern)
    laplace = np.zeros(nf + len(blocks.row) + (len(driven) if has_bone else 0))
    t, row, column, block = blocks.assembly.T
    dot = np.einsum("ki,ki->k", gradients[t, row], gradients[t, column])
    np.add.at(laplace, block, volume[t] * dot)
    surface_nodes = np.unique(mesh.surface).astype(np.int64)

    young, poisson = scene.material.young, scene.material.poisson
    length = float(np.cbrt(volume.mean()))
    limits, plane, solver = scene.limits, scene.plane, scene.solver
    factors, isochoric = np.zeros((2, 9)), np.full((2, 3), np.inf)
    if limits and bulk_to_shear(scene.material) >= STIFF_BULK:
        isochoric = isochoric_strain(limits)
    if limits:
        limit_factors(np.array([limits.stretch_room, limits.compress_room]), factors)
    return Model(
        tets=tets,
        gradients=np.ascontiguousarray(gradients),
        volume=volume,
        mass=mass,
        mobility=np.append(1.0 / mass[free], np.zeros(slots - nf)),
        length=length,
        free=free,
        slot=slot,
        driven=driven,
        tet_slot=tet_slot,
        tet_place=blocks.tet_place,
        pair_row=blocks.pair_row,
        pair_column=blocks.pair_column,
        tet_order=np.argsort(tet_slot.min(axis=1), kind="stable"),
        tet_moves=tet_moves,
        lane_node=np.ascontiguousarray(_in_lanes(tets)),
        lane_slot=np.ascontiguousarray(_in_lanes(tet_slot)),
        lane_gradients=_aligned(_in_lanes(gradients.reshape(-1, 12))),
        lane_volume=_aligned(_in_lanes(np.concatenate([volume, np.zeros(-len(tets) % LANES)]))),
        lane_driven=_in_lanes((tet_moves > 0) & (tet_moves < 4) & (not has_bone)).any(axis=1).astype(np.int64),
        assembly=blocks.assembly,
        assembly_dot=dot,
        block_row=blocks.row,
        block_column=blocks.column,
        block_place=blocks.place,
        laplace=laplace,
        pattern=pattern,
        surface_nodes=surface_nodes,
        contact_nodes=surface_nodes[is_free[surface_nodes]],
        lame_lambda=young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        lame_mu=young / (2.0 * (1.0 + poisson)),
        least_force=_least_force(scene, mass, length),
        damping_mass=scene.material.damping.mass,
        damping_stiffness=scene.material.damping.stiffness,
        gravity=np.array(scene.gravity),
        projection=strain_limits.PROJECTIONS[limits.projection] if limits else strain_limits.NONE,
        stretch_room=limits.stretch_room if limits else np.full(3, np.inf),
        compress_room=limits.compress_room if limits else np.full(3, np.inf),
        limit_factors=factors,
        isochoric_strain=isochoric,
        has_plane=plane is not None,
        has_bone=has_bone,
        rest_driven=mesh.points[driven] if has_bone else np.zeros((0, 3)),
        bone_lever=float(np.sqrt((mesh.points[driven] ** 2).sum(axis=1).mean())) or length if has_bone else length,
        method=METHODS[solver.method],
        relinearizations=solver.relinearizations,
        **_live(scene, length),
    )


def with_live_values(model: Model, scene: Scene) -> Model:
    """The model with those fields that may change while running as the scene now has them."""
    return model._replace(**_live(scene, model.length))


def _live(scene: Scene, length: float) -> dict[str, Any]:
    """Fields that may change while running, of a mesh of that length (Model.length)."""
    limits, plane, solver, coupling = scene.limits, scene.plane, scene.solver, scene.coupling
    young = scene.material.young
    return {
        "limit_compliance": 1.0 / (limits.stiffness * young) if limits and limits.stiffness else 0.0,
        "limit_inertia": limits.inertia if limits else 0.0,
        "limit_viscosity": limits.viscosity if limits else 0.0,
        "mu_friction": plane.friction if plane else 0.0,
        "contact_compliance": 1.0 / (plane.stiffness * young * length) if plane and plane.stiffness else 0.0,
        "spring": np.array(
            [[coupling.stiffness, coupling.damping], [coupling.rotational_stiffness, coupling.rotational_damping]]
        ),
        "spring_limit": np.array([coupling.force_limit, coupling.torque_limit]),
        "tolerance": solver.tolerance,
        "max_iterations": solver.max_iterations,
        "settles": solver.settle and solver.level == "standard",
        "hold": LEVELS[solver.level],
        "deadline": solver.deadline or 0.0,
    }


def plane_frame(normal: Floats) -> Floats:
    """Right-handed rows n, t₁, t₂ for a unit normal; t₁ lies along the world axis most across the normal."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(normal))] = 1.0
    t1 = axis - normal * (normal @ axis)
    t1 /= np.linalg.norm(t1)
    return np.array([normal, t1, np.cross(normal, t1)])


def _least_force(scene: Scene, mass: Floats, length: float) -> float:
    """A thousandth of what shears a tetrahedron by its own length; a tenth of a node's weight where that is less."""
    shear = scene.material.young / (2.0 * (1.0 + scene.material.poisson))
    weight = float(mass.mean() * np.linalg.norm(scene.gravity))
    floor = 1e-3 * shear * length**2
    return min(floor, 0.1 * weight) if weight > 0.0 else floor


class _Blocks(NamedTuple):
    """Where the 3 × 3 blocks of A are, and what adds to them: see Model."""

    tet_place: Ints
    pair_row: Ints
    pair_column: Ints
    assembly: Ints
    row: Ints
    column: Ints
    place: Ints


def _blocks(tet_slot: Ints, nf: int, pattern: Pattern) -> _Blocks:
    """The blocks of A for tetrahedra with these slots, (T, 4)."""
    count = len(tet_slot)
    pairs = np.array(PAIRS)
    slots = tet_slot[:, pairs]  # (T, 10, 2)
    swap = slots[..., 0] < slots[..., 1]
    pair_row = np.ascontiguousarray(np.where(swap, pairs[:, 1], pairs[:, 0]))
    pair_column = np.ascontiguousarray(np.where(swap, pairs[:, 0], pairs[:, 1]))
    rows, columns = slots.max(axis=2), slots.min(axis=2)
    exists = rows < nf
    below = exists & (rows != columns)
    numbers, inverse = np.unique(rows[below] * nf + columns[below], return_inverse=True)
    row, column = numbers // nf, numbers % nf
    place = np.array([block_of(pattern, int(r), int(c)) for r, c in zip(row, column, strict=True)], np.int64)
    block, tet_place = np.full((count, 10), -1, np.int64), np.full((count, 10), -1, np.int64)
    diagonal = exists & (rows == columns)
    block[diagonal] = tet_place[diagonal] = rows[diagonal]
    block[below], tet_place[below] = nf + inverse, place[inverse]
    bone = (rows > nf) & (columns != nf)
    if bone.any():
        beside = bone & (rows != columns)
        slots = rows.max() + 1
        numbers, inverse = np.unique(rows[beside] * slots + columns[beside], return_inverse=True)
        block[beside] = nf + len(row) + inverse
        row, column = np.append(row, numbers // slots), np.append(column, numbers % slots)
        diagonal = bone & (rows == columns)
        block[diagonal] = nf + len(row) + rows[diagonal] - (nf + 3)
    t, e = np.nonzero(block >= 0)
    assembly = np.stack([t, pair_row[t, e], pair_column[t, e], block[t, e]], axis=1)
    return _Blocks(tet_place, pair_row, pair_column, assembly, row, column, place)


def _in_lanes(values: Any) -> Any:
    """(T, …) → (B, …, 8): eight tetrahedra side by side, the last one repeated to fill up."""
    whole = np.concatenate([values, np.repeat(values[-1:], padded(len(values)) - len(values), axis=0)])
    return np.moveaxis(whole.reshape(-1, LANES, *values.shape[1:]), 1, -1)


def _aligned(values: Floats) -> Floats:
    out = aligned(*values.shape)
    out[:] = values
    return out


def build_state(model: Model, positions: Floats, timed: bool = False) -> State:
    """A state at rest at the given positions, (n, 3) [m], with its workspace. timed: its steps measure their stages."""
    count, n, nf = len(model.tets), len(positions), len(model.free)
    batches, nnz = len(model.lane_volume), len(model.pattern.row)
    tensor, limited = model.projection == strain_limits.TENSOR, model.projection != strain_limits.NONE
    spectral = count if limited and not tensor else 0
    contacts = len(model.contact_nodes) * model.has_plane
    both_sides = model.projection in (strain_limits.ORTHOGONAL, strain_limits.LINEAR)
    rows = (12 * count if tensor else (18 if both_sides else 9) * spectral) + 3 * contacts
    pgs = model.method == PGS
    if pgs:
        rows = min(MAX_ROWS, rows)
    touched = min(nf, 4 * rows) if pgs else 0
    slots = len(model.mobility)
    newton = 0 if pgs else slots
    bone = len(model.rest_driven)
    swept = rows if pgs else 0
    near = padded(2 * count) if tensor else 0
    again = n if model.relinearizations or (limited and not pgs) else 0
    x = aligned(n, 4)
    x[:, :3] = positions
    return State(
        x=x,
        v=aligned(n, 4),
        x_start=aligned(again, 4),
        v_start=aligned(again, 4),
        v_base=aligned(again, 4),
        moving=aligned(n, 4),
        age=np.zeros(1, np.int64),
        factored_holds=np.zeros(1, np.int64),
        origin=np.zeros(3),
        driven_velocity=aligned(n, 4),
        plane_frame=np.eye(3),
        plane_point=np.zeros(3),
        plane_motion=np.zeros(6),
        moves=np.zeros(1, np.int64),
        target=np.zeros(13),
        bone=np.zeros(14),
        twist=np.zeros(6),
        arms=aligned(bone, 4),
        bone_base=np.zeros(6),
        bone_load=np.zeros(6),
        bone_stop=np.zeros(9),
        bone_reach=np.zeros(1),
        bone_pulls=np.zeros((2, 4)),
        bone_holds=np.zeros(2, np.int64),
        bone_S=np.zeros((6, 6)),
        border=aligned(nf if bone else 0, 3, LANES),
        border_solved=aligned(nf if bone else 0, 3, LANES),
        bone_scratch=aligned(3, LANES),
        coupling=np.zeros(6),
        quaternion=_aligned(np.broadcast_to(np.array([[0.0], [0.0], [0.0], [1.0]]), (batches, 4, LANES))),
        R=aligned(batches, 9, LANES),
        inverted=np.zeros(1, np.int64),
        E=aligned(batches, 6, LANES),
        F=np.zeros((spectral, 3, 3)),
        U=np.zeros((spectral, 3, 3)),
        s=np.ones((spectral, 3)),
        V=np.zeros((spectral, 3, 3)),
        strain_ratio=np.zeros(count),
        contact_force=np.zeros((n, 3)),
        wrench=np.zeros(6),
        warm_limit=np.zeros((count if limited else 0, 18 if tensor else 9)),
        limit_force=aligned(batches if tensor else 0, LANES),
        held_tets=np.zeros(1, np.int64),
        active_rows=np.zeros(count if limited else 0, np.int64),
        g=aligned(LANES * batches, 4, 4),
        A=aligned(len(model.laplace), 3, 4),
        L_diagonal=aligned(nf, 3, 4),
        L_lower=aligned(nnz, 3, 4),
        L_inverse=aligned(nf, 3, 4),
        rhs=aligned(slots, 4),
        slot_velocity=aligned(slots, 4),
        slot_product=aligned(slots, 4),
        bound=aligned(batches if tensor else 0, 2, LANES),
        near=np.zeros(near, np.int64),
        near_count=np.zeros(1, np.int64),
        eigen=aligned(near // LANES, 12, LANES),
        stage=aligned(32, LANES),
        lane_J=aligned(LANES, 4, 4),
        J=aligned(rows, 4, 4),
        row_slot=np.zeros((rows, 4), np.int64),
        row_tet=np.zeros(rows, np.int64),
        row_key=np.zeros(rows, np.int64),
        row_side=np.zeros(rows),
        constant=np.zeros(rows),
        compliance=np.zeros(rows),
        scale=np.zeros(rows),
        lam=np.zeros(rows),
        best=np.zeros(rows),
        change=aligned(newton, 4),
        direction=aligned(newton, 4),
        tried=aligned(newton, 4),
        best_change=aligned(newton, 4),
        start_residual=aligned(newton, 4),
        next_residual=aligned(newton, 4),
        stiffness=np.zeros(rows - swept),
        factored=np.zeros(rows - swept),
        slip=aligned(0 if pgs else contacts, 4),
        time=np.zeros(2, np.int64),
        laps=np.zeros(7 if timed else 0),
        diagonal=np.zeros(swept),
        cross=np.zeros(swept),
        has_column=np.zeros(swept, np.int64),
        row_local=np.zeros((swept, 4), np.int64),
        local=np.zeros(nf if pgs else 0, np.int64),
        touched=np.zeros(touched, np.int64),
        u=np.zeros(3 * touched + 3 if touched else 0),
        S=np.zeros(9 * touched * touched),
        Z=np.zeros(3 * swept * touched),
        Y=np.zeros((nf if pgs else 0, 3, linear_solver.LANES)),
        reached=np.zeros(nf if pgs else 0, np.int64),
        columns=np.zeros((3, 3, BATCH)),
        turn=np.zeros((3, 3, BATCH)),
        P=np.zeros((3, 3)),
        D=np.zeros((3, 3)),
        turned=aligned(batches if model.method != PGS else 0, 4, LANES),
        motion=np.zeros(1),
        held=np.zeros(1),
        clearance=np.full(1, -1.0),
        work=np.zeros(len(WORK), np.int64),
        result=np.zeros(11),
    )

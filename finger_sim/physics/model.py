"""`Model`: what never changes in a run. `State`: what does, and the step's workspace. Plain records of arrays.

Built by prepare.py and workspace.py.
"""

from __future__ import annotations

from typing import NamedTuple

from ..arrays import Floats, Ints, Singles


class Pattern(NamedTuple):
    """Where the blocks of A and L are. `nf` block rows; `nnz` blocks of L below its diagonal."""

    order: Ints  # (nf,) graph node of each slot
    slot: Ints  # (nf,) slot of each graph node
    start: Ints  # (nf + 1,) first block of each column of L
    row: Ints  # (nnz,) slot of each block's row, ascending in a column
    panel: Ints  # (panels + 1,) first column of each panel
    target: Ints  # (4 k,) the blocks that `factor` subtracts from, in its order and numbers
    work: Floats  # (most blocks in a panel, 3, 4) L D of the panel that `factor` is at
    pairs: Floats  # (half as many, 3, 8) its L, two rows side by side
    worth: int  # about how many iterations of Newton's method take as long as new factors


class Patches(NamedTuple):
    """Patches of tetrahedra with one volume strain each (dilatation.py); no patch where each has its own.

    P patches; N entries for their nodes, those of patch 0 first: a node has one in each patch it belongs to.
    """

    bulk: float  # K [Pa]
    volume: Floats  # (P,) V_p [m³]
    lane: Ints  # (B, 8) patch of the tetrahedra in lanes
    tet_place: Ints  # (T, 4) entries of a tetrahedron's nodes in its patch
    lane_entry: Ints  # (B, 4, 8) the same in lanes
    tet_share: Floats  # (T,) vol / V_p
    lane_share: Floats  # (B, 8) the same in lanes; 0 where they are filled up
    start: Ints  # (P + 1,) first entry of each patch
    node: Ints  # (N,) nodes
    slot: Ints  # (N,) their slots
    assembly: Ints  # (k, 4) contributions to A: patch, entries at the row and the column, block of A
    place: Ints  # (k,) where that block is in the factorisation, −1: nowhere (see Model.tet_place)


class Model(NamedTuple):
    """Rest shape, masses, patterns and coefficients.

    n nodes, T tetrahedra, in B batches of 8 lanes (the last one filled up with tetrahedra of no volume); nf free nodes,
    "slots" 0 … nf − 1; slot nf stands for driven nodes and for none. Where the bone yields, slots nf + 1 and nf + 2 are
    its own and the others those of its nodes (bone.py). Node pairs e of a tetrahedron: see blocks.PAIR_ROW. A has `nf`
    diagonal blocks and `na` below the diagonal: block k < nf is the diagonal one of slot k, block nf + p the p-th of
    the others; with such a bone, then come its nodes' diagonal blocks. Blocks lie by columns, each padded to four
    numbers.
    """

    tets: Ints  # (T, 4) nodes of each tetrahedron
    tet_number: Ints  # (T,) its number in the mesh: see neighbours.py
    gradients: Floats  # (T, 4, 3) rows r_n of D_m⁻¹ in material axes [1/m]; r_4 = −(r_1 + r_2 + r_3) (Eq. 2)
    volume: Floats  # (T,) rest volume [m³]
    mass: Floats  # (n,) lumped mass [kg]
    mobility: Floats  # (slots,) 1 / mass of each slot [1/kg], 0: driven
    length: float  # cube root of the mean tetrahedron volume [m]
    free: Ints  # (nf,) node of each slot
    slot: Ints  # (n,) slot of each node
    driven: Ints  # (nd,) driven nodes
    tet_slot: Ints  # (T, 4) slots of a tetrahedron's nodes
    tet_place: Ints  # (T, 10) block of State.L_blocks that each node pair adds to, −1: none (a driven node)
    tet_block: Ints  # (T, 10) block of A that it adds to, −1: none
    tet_order: Ints  # (T,) tetrahedra by their first slot: neighbouring rows share work in solves
    tet_moves: Ints  # (T,) number of free nodes; 0: cannot deform but by command
    lane_node: Ints  # (B, 4, 8) nodes of the tetrahedra in lanes
    lane_slot: Ints  # (B, 4, 8) their slots
    lane_gradients: Floats  # (B, 12, 8) their r_1 … r_4
    lane_volume: Floats  # (B, 8)
    lane_mobility: Floats  # (B, 4, 8) 1 / mass of their nodes, 0: driven
    lane_metric: Floats  # (B, 12, 8) Σ r_n r_nᵀ over their free nodes, 00 11 22 12 02 01; and over these nodes' masses
    lane_driven: Ints  # (B,) 1 where a node of a lane is driven and another free
    assembly: Ints  # (k, 3) contributions to A, block after block: tetrahedron, its nodes at the row and the column
    assembly_start: Ints  # (blocks + 1,) first one of each block of A
    assembly_dot: Floats  # (k,) r_a · r_b of their nodes [1/m²]
    block_row: Ints  # (na,) slot of each block below the diagonal of A, column after column
    block_column: Ints  # (na,)
    block_place: Ints  # (…,) where it is in State.L_blocks, ascending; those of a bone's nodes, the last, are not in it
    laplace: Floats  # (blocks,) Σ vol r_a · r_b of each block [m]: its part that does not turn
    pattern: Pattern  # of the factorisation of A
    patches: Patches
    surface_nodes: Ints  # (k,) nodes of the boundary
    contact_nodes: Ints  # (c,) those of them that are free
    lame_lambda: float  # [Pa]; where there are patches −2 μ / 3: what a tetrahedron's deviator has of it
    lame_mu: float  # [Pa]
    relaxation: Floats  # (terms, 2) time τ [s] and share g of each term of relaxation.py; none: stress does not fade
    relaxes_pressure: bool  # shares are of all of the stress, else of its deviator
    least_force: float  # forces are judged relative to the largest row force, and no finer than relative to this [N]
    felt_force: float  # nor than to this [N]: Solver.least_force
    damping_mass: float  # Rayleigh α [1/s]
    damping_stiffness: float  # Rayleigh β [s]
    gravity: Floats  # (3,) [m/s²], world
    projection: int  # one of methods.py; NONE: no limits
    stretch_room: Floats  # (3,) a⁺, ∞: free
    compress_room: Floats  # (3,) a⁻, ∞: free
    limit_factors: Floats  # (2, 9) what `tensor` weighs strain with: see tensor_limit.limit_factors
    mirrored: bool  # both sides have the same rooms: −A E A is decomposed with A E A
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
    turn: float  # cos² of half the angle that a tetrahedron may turn by while steps share A; 1: none do
    deadline: float  # [s] after which a step begins no further iteration; 0: none
    sweeps_at: int  # addresses of kernels (apart.py); 0: not needed, or nothing is compiled
    decompose_at: int
    limit_rows_at: int
    relax_at: int


class Newton(NamedTuple):
    """`newton`'s own: the search for δ, the change of the velocities since the rows were formed (newton.py)."""

    change: Floats  # (slots, 4) δ
    direction: Floats  # (slots, 4) Newton's direction from there
    tried: Floats  # (slots, 4) δ on trial
    best_change: Floats  # (slots, 4) δ of the least residual so far
    remainder: Floats  # (slots, 4) b − A (v + δ)
    along: Floats  # (slots, 4) what it changes by along `direction`
    next_residual: Floats  # (slots, 4) at the δ on trial
    gap: Floats  # (rows,) g of each row at δ (along.py)
    rate: Floats  # (rows,) and what it changes by along `direction`
    stiffness: Floats  # (rows,) what each row adds to the Hessian [N/m]: 1 / compliance where it carries a force
    factors: Ints  # (1,) what the factors in L are of: hessian.NONE …
    spent: Ints  # (1,) iterations of the last step along factors of an earlier one; 0 where it made its own
    poor: Ints  # (1,) 1 where it found these too poor to go on with
    slip: Floats  # (contacts, 4) unit slip direction of a node's contact force (world), and μ; zeros: sticks
    holds: Ints  # (1,) 1 while friction is bounded by `bound` and not by μ times the normal forces
    bound: Floats  # (contacts,) largest friction of each contact [N]


class Secants(NamedTuple):
    """What is known of H beyond its factors (secants.py), in a ring of places of which one is being filled."""

    pairs: Floats  # (2 places, slots, 4) a change of the velocities, then what the residual fell by along it
    weight: Floats  # (places,) 1 / their product
    part: Floats  # (places,) scratch
    ring: Ints  # (2,) how many there are; the place that is being filled


class Pgs(NamedTuple):
    """`pgs`'s own: what its sweeps read and write (pgs.py)."""

    diagonal: Floats  # (rows,) of W
    cross: Floats  # (rows,) W between a contact's two tangents, at the first one's row
    has_column: Ints  # (rows,) 1: the row's column of Z is there
    row_local: Ints  # (rows, 4) where in u the components of each node begin; past the touched ones: driven or none
    row_rate: Ints  # (rows,) where in u its patch is; past them: none
    local: Ints  # (nf,) touched slots numbered, −1: not touched
    touched: Ints  # (touched,) their slots
    local_patch: Ints  # (P,) touched patches numbered, −1: not touched
    touched_patch: Ints  # (patches,) which they are
    u: Floats  # (unknowns + 3,) h A⁻¹ Jᵀ λ at touched nodes, h θ̇ of it of touched patches, then zeros
    S: Floats  # (unknowns²,) A⁻¹ between touched nodes and patches, as a matrix: see touched.py
    Z: Floats  # (rows unknowns,) h A⁻¹ Jᵀ, a row's column contiguous
    Y: Floats  # (nf, 3, linear_solver.SIDES_AT_ONCE) right-hand sides
    reached: Ints  # (nf,) 1 where Y is not zero


class Yielding(NamedTuple):
    """What a bone that yields is solved for with (bone.py); its pose, velocity and command are in State."""

    arms: Floats  # (nd, 4) its nodes from its origin, world [m]
    base: Floats  # (6,) wrench of the spring at δ = 0, before its limits [N, N m]
    load: Floats  # (6,) what bears the body's weight [N, N m]
    stop: Floats  # (9,) gradient of the bone's gap to the plane, the gap [m], stiffness [N/m], force [N]
    reach: Floats  # (1,) [m/s] what the spring may add to the bone's speed in a step
    pulls: Floats  # (2, 4) spring at its limit: direction, share of its pull that is left; zeros and 1: not
    S: Floats  # (6, 6) Cholesky factor of S
    border: Floats  # (nf, 3, 8) B, two lanes empty
    border_solved: Floats  # (nf, 3, 8) H_ff⁻¹ B
    scratch: Floats  # (3, 8)


class Principal(NamedTuple):
    """F and its decomposition, for limits on principal stretches (svd.py, strain_limits.py)."""

    F: Floats  # (T, 3, 3) deformation gradient at x
    U: Floats  # (T, 3, 3) F = U diag(s) Vᵀ
    s: Floats  # (T, 3)
    bounded: Floats  # (T, 3) what limits bound: s, or with the volume strain of the patch
    V: Floats  # (T, 3, 3)
    columns: Floats  # (3, 3, BATCH) scratch
    turn: Floats  # (3, 3, BATCH) scratch
    P: Floats  # (3, 3) scratch
    D: Floats  # (3, 3) scratch


class Tensor(NamedTuple):
    """What the `tensor` limit looks at (tensor_limit.py)."""

    bound: Floats  # (B, 2, 8) no eigenvalue of A E A is above (stretch) or, for compression, of −A E A
    near: Floats  # (B, 2, 8) 1 where a tetrahedron may be at a limit of that side: 0 stretch, 1 compression
    frames: Floats  # (2 B, 12, 8) eigenvalues and eigenvectors (by columns) at a batch and side: see pairs_of
    top: Floats  # (1,) the largest strain/limit of what was decomposed
    first: Ints  # (2 B + 1,) first group of rows of each four tetrahedra (tensor_rows.py)
    key: Ints  # (groups,) 2 · direction + side
    slope: Floats  # (groups, 9, 4) ∂C/∂F, world by material axes; with patches without its own volume strain
    row: Floats  # (groups, 3, 4) what else a row is: see tensor_rows.CONSTANT …
    gap: Floats  # (groups, 4) g at δ, as Newton.gap
    rate: Floats  # (groups, 4)
    lam: Floats  # (groups, 4) row forces; 0 where there is no row
    best: Floats  # (groups, 4) those of the least residual so far
    lane_J: Floats  # (8, 4 k, 4) scratch: k gradients of each of eight or four tetrahedra, by nodes
    lane_root: Floats  # (k, 8) scratch: roots of their weights
    turning_count: Ints  # (1,) how many squares g gᵀ A has at driven nodes (turning.py):
    turning_tet: Ints  # (k,) whose
    turning_J: Floats  # (k, 4, 4) g


class Relaxing(NamedTuple):
    """What stress that relaxes has of the past (relaxation.py); empty where it does not."""

    overstrain: Floats  # (B, 6 terms, 8) y of each term, as State.E; within a step z
    memory: Floats  # (B, 6, 8) Σ g z / γ of this step
    factors: Floats  # (terms, 2) a, c of each term in this step
    moduli: Floats  # (3,) λ and μ of tetrahedra, K of patches in this step [Pa]
    rate: Floats  # (1,) the largest |y| / τ, component by component, at the end of the last step [1/s]


class State(NamedTuple):
    """Positions, velocities and what the last step left; then the workspace of a step (nothing is allocated in it).

    Arrays that a projection or a solver does not use are empty.
    """

    # The body: what one step hands to the next.
    x: Floats  # (n, 4) positions [m], world; as every vector of a node padded to four numbers
    v: Floats  # (n, 4) velocities [m/s], world
    quaternion: Floats  # (B, 4, 8) of R, x y z w
    contact_force: Floats  # (n, 3) force of the plane on each node [N], world
    warm_limit: Floats  # (T, keys) `pgs`: last row forces by key, positive: stretch, negative: compression [N m]
    limit_force: Floats  # (B, 8) `tensor`: sum of the forces of a tetrahedron's limit rows in the last step [N m]
    turning_force: Floats  # (B, 8) the same as A has it
    held_tets: Ints  # (1,) tetrahedra that limit rows held in the last step

    # What a step is told.
    plane_frame: Floats  # (3, 3) rows: unit normal of the plane at the step's end and two tangents, world
    plane_point: Floats  # (3,) a point of it [m], world
    plane_motion: Floats  # (6,) velocity of that point [m/s] and angular velocity [rad/s] in the step
    moves: Ints  # (1,) 1 where bone or plane move in this step
    target: Floats  # (13,) where a yielding bone is wanted at the end: position, orientation, velocities

    # A bone that yields.
    bone: Floats  # (14,) pose of the bone (finger frame) at the step's start, then at x: position, orientation
    twist: Floats  # (6,) its velocity at its origin [m/s] and angular velocity [rad/s], world
    twist_start: Floats  # (6,) and at the start of a step that shares A
    coupling: Floats  # (6,) wrench of the spring on the bone in the last step, about its origin, world [N, N m]

    # What a step reports, beside x, v and contact_force.
    result: Floats  # (11,) what a step reports: see step.py
    origin: Floats  # (3,) origin of the finger frame at the end of the step, world [m]: wrenches are about it
    wrench: Floats  # (6,) sum of contact_force [N] and torque about `origin` [N m]: plane on finger, world axes
    R: Floats  # (B, 9, 8) rotation of each tetrahedron at x: F = R (I + E), from material axes to the world
    E: Floats  # (B, 6, 8) Biot strain 00 11 22 12 02 01, material axes
    felt_strain: Floats  # (B, 6, 8) what stress is of: E, or with what is left of the past (relaxation.py)
    limit_strain: Floats  # (B, 6, 8) what limits bound: E, or its deviator with the volume strain of the patch
    inverted: Ints  # (1,) batches with a tetrahedron that is inside out
    strain_ratio: Floats  # (T,) strain/limit at x
    active_rows: Ints  # (T,) rows of each tetrahedron that carry a force

    # When a step may take less work: see step.py.
    stale: Ints  # (2,) parts of A that the next step forms, and that one after it does: elasticity.ELASTIC, TURNING
    turned: Floats  # (B, 4, 8) quaternion when A was formed, where steps share it
    motion: Floats  # (1,) rms speed of the nodes at the end of the last step [m/s]
    held: Floats  # (1,) time since the driven nodes last moved [s]
    clearance: Floats  # (1,) [m] no surface node is nearer to the plane; below 0: not known

    # What steps cost so far.
    work: Ints  # (9,) counters: see work.py
    laps: Floats  # (7,) seconds spent in each stage of the steps so far (clock.STAGES), or empty: not measured
    time: Ints  # (2,) scratch of the clock

    # Linearisation: where, and along which velocities.
    x_start: Floats  # (n, 4) x at the step's start, where a step may be taken back or is linearised more than once
    v_start: Floats  # (n, 4) and v
    v_base: Floats  # (n, 4) v that state.x is linearised with
    moving: Floats  # (n, 4) velocities that state.x has not yet moved by: rows look ahead along them
    driven_velocity: Floats  # (n, 4) velocities of driven nodes in this step [m/s], 0: free

    # A v = b, and the factors of A or of what a solver makes of it.
    g: Floats  # (8 B, 4, 4) g_n = R r_n of each node of each tetrahedron [1/m], world
    turning_A: Floats  # as A: what `add_turning` has in it, where steps share it
    elastic_A: Floats  # as A: the rest of it there
    A: Floats  # (nf + na, 3, 4)
    theta: Floats  # (P,) K θ_p [Pa]
    pressure: Floats  # (B, 8) the same of the patch of each tetrahedron
    G: Floats  # (N, 4) gradient of θ_p at each node of each patch [1/m], world
    patch_rate: Floats  # (P,) θ̇_p of velocities [1/s]
    patch_size: Floats  # (2, P) Σ |G_n|² over the free nodes of each patch [1/m²], and over their masses [1/(m² kg)]
    patch_force: Floats  # (P,) sums over the limit rows of each patch
    patch_cross: Floats  # (N, 4) the same at its nodes
    rhs: Floats  # (slots, 4)
    slot_velocity: Floats  # (slots, 4) velocities in slot order
    slot_product: Floats  # (slots, 4) scratch
    L_blocks: Floats  # (nf + nnz + 1, 3, 4) factorisation: see linear_solver.factor
    L_lower: Floats  # (nnz, 3, 4) of it: L below its diagonal
    L_single: Singles  # (nnz, 3, 4) L_lower of a large body once more, for Newton's directions: see hessian.keep_single
    L_inverse: Floats  # (nf, 3, 4) D⁻¹

    # The rows of contact, then those of limits.
    J: Floats  # (rows, 4, 4) gradient of each row at its nodes
    row_slot: Ints  # (rows, 4) slots of these nodes
    row_tet: Ints  # (rows,) tetrahedron of a limit row; −1 − node of a contact row
    row_key: Ints  # (rows,) which of its tetrahedron's limit rows: 3 i + j, or of `tensor` 2 · direction + side
    row_side: Floats  # (rows,) +1 stretch, −1 compression
    row_part: Floats  # (rows,) α: the row has α G at the nodes of its patch, beside J (dilatation.py); contact: 0
    constant: Floats  # (rows,) C + h J v at the velocities the rows were formed with
    compliance: Floats  # (rows,)
    scale: Floats  # (rows,) [N] of nodal force per unit of lam
    lam: Floats  # (rows,) row forces
    best: Floats  # (rows,) row forces of the least residual so far

    # By owner.
    relaxing: Relaxing
    newton: Newton
    secants: Secants
    pgs: Pgs
    yielding: Yielding
    principal: Principal
    tensor: Tensor

"""`Model`: what never changes in a run. `State`: what does, and the step's workspace. Both are plain records."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..mesh import TetMesh
from ..scene import Scene
from . import strain_limits
from .kinematics import BATCH
from .linear_solver import LANES, Pattern, analyse, block_of

MAX_ROWS = 2048  # limit and contact rows of one step; more are left out, with a status bit
PAIRS = [(a, b) for a in range(4) for b in range(a + 1)]


class Model(NamedTuple):
    """Rest shape, masses, patterns and coefficients. n nodes, T tetrahedra, nf free nodes ("slots" 0 … nf − 1)."""

    tets: Ints  # (T, 4) nodes of each tetrahedron
    gradients: Floats  # (T, 4, 3) rows r_n of D_m⁻¹ in material axes [1/m]; r_4 = −(r_1 + r_2 + r_3) (Eq. 2)
    volume: Floats  # (T,) rest volume [m³]
    mass: Floats  # (n,) lumped mass [kg]
    length: float  # cube root of the mean tetrahedron volume [m]
    free: Ints  # (nf,) node of each slot
    slot: Ints  # (n,) slot of each node, −1: driven
    driven: Ints  # (nd,) driven nodes
    tet_slot: Ints  # (T, 4) slots of a tetrahedron's nodes, −1: driven
    tet_block: Ints  # (T, 10) block of A for each node pair, −1: none (a driven node)
    pair_row: Ints  # (T, 10) node (0 … 3) at the block's row
    pair_column: Ints  # (T, 10) node (0 … 3) at the block's column
    tet_order: Ints  # (T,) tetrahedra by their first slot: neighbouring rows share work in solves
    tet_moves: Ints  # (T,) number of free nodes; 0: cannot deform but by command
    touches_driven: Ints  # (T,) 1 where a node is driven and another free
    pattern: Pattern  # of the factorisation of A
    surface_nodes: Ints  # (k,) nodes of the boundary
    contact_nodes: Ints  # (c,) those of them that are free
    lame_lambda: float  # [Pa]
    lame_mu: float  # [Pa]
    damping_mass: float  # Rayleigh α [1/s]
    damping_stiffness: float  # Rayleigh β [s]
    gravity: Floats  # (3,) [m/s²], world
    projection: int  # strain_limits.NONE: no limits
    stretch_room: Floats  # (3,) a⁺, ∞: free
    compress_room: Floats  # (3,) a⁻, ∞: free
    limit_compliance: float  # 1 / (κ E) [1/Pa]: divided by a volume, a limit row's compliance [1/(N m)]; 0: rigid
    has_plane: bool
    plane_frame: Floats  # (3, 3) rows: unit normal and two tangents, world
    plane_point: Floats  # (3,) [m], world
    mu_friction: float  # Coulomb μ
    contact_compliance: float  # 1 / k_n [m/N]; 0: rigid
    tolerance: float  # see Solver.tolerance
    max_iterations: int


class State(NamedTuple):
    """Positions, velocities and what the last step left; then the workspace of a step (nothing is allocated in it)."""

    x: Floats  # (n, 3) positions [m], world
    v: Floats  # (n, 3) velocities [m/s], world
    origin: Floats  # (3,) origin of the finger frame at the end of the step, world [m]: wrenches are about it
    F: Floats  # (T, 3, 3) deformation gradient at x
    U: Floats  # (T, 3, 3) F = U diag(s) Vᵀ
    s: Floats  # (T, 3)
    V: Floats  # (T, 3, 3)
    strain_ratio: Floats  # (T,) strain/limit at x
    contact_force: Floats  # (n, 3) force of the plane on each node [N], world
    wrench: Floats  # (6,) their sum [N] and torque about `origin` [N m]: plane on finger, world axes
    warm_limit: Floats  # (T, 3, 3) last row forces by key (i, j), positive: stretch, negative: compression [N m]
    active_rows: Ints  # (T,) rows of each tetrahedron that carry a force
    A_diagonal: Floats  # (nf, 3, 3)
    A_lower: Floats  # (nnz, 3, 3)
    A_inverse: Floats  # (nf, 3, 3) D⁻¹ of the factorisation
    rhs: Floats  # (nf, 3)
    J: Floats  # (rows, 4, 3) gradient of each row at its nodes
    row_slot: Ints  # (rows, 4) slots of these nodes, −1: driven or none
    row_tet: Ints  # (rows,) tetrahedron of a limit row; −1 − node of a contact row
    row_key: Ints  # (rows,) 3 i + j of a limit row
    row_side: Floats  # (rows,) +1 stretch, −1 compression
    constant: Floats  # (rows,) C + h J v_free
    compliance: Floats  # (rows,)
    scale: Floats  # (rows,) [N] of nodal force per unit of lam
    lam: Floats  # (rows,) row forces
    best: Floats  # (rows,) row forces of the least residual so far
    diagonal: Floats  # (rows,) diagonal of W
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
    D: Floats  # (3, 3) scratch
    P: Floats  # (3, 3) scratch
    G: Floats  # (4, 3) scratch
    result: Floats  # (8,) what a step reports: see step.py


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
    slot = np.full(n, -1, np.int64)
    slot[free] = np.arange(len(free))
    tet_slot = slot[tets]
    tet_block, pair_row, pair_column = _block_maps(tet_slot, pattern)
    free_corners = (tet_slot >= 0).sum(axis=1)
    first_slot = np.where(tet_slot >= 0, tet_slot, n).min(axis=1)
    surface_nodes = np.unique(mesh.surface).astype(np.int64)

    young, poisson = scene.material.young, scene.material.poisson
    length = float(np.cbrt(volume.mean()))
    limits, plane = scene.limits, scene.plane
    return Model(
        tets=tets,
        gradients=np.ascontiguousarray(gradients),
        volume=volume,
        mass=mass,
        length=length,
        free=free,
        slot=slot,
        driven=driven,
        tet_slot=tet_slot,
        tet_block=tet_block,
        pair_row=pair_row,
        pair_column=pair_column,
        tet_order=np.argsort(first_slot, kind="stable"),
        tet_moves=free_corners,
        touches_driven=((free_corners > 0) & (free_corners < 4)).astype(np.int64),
        pattern=pattern,
        surface_nodes=surface_nodes,
        contact_nodes=surface_nodes[is_free[surface_nodes]],
        lame_lambda=young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        lame_mu=young / (2.0 * (1.0 + poisson)),
        damping_mass=scene.material.damping.mass,
        damping_stiffness=scene.material.damping.stiffness,
        gravity=np.array(scene.gravity),
        projection=strain_limits.PROJECTIONS[limits.projection] if limits else strain_limits.NONE,
        stretch_room=limits.stretch_room if limits else np.full(3, np.inf),
        compress_room=limits.compress_room if limits else np.full(3, np.inf),
        limit_compliance=1.0 / (limits.stiffness * young) if limits and limits.stiffness else 0.0,
        has_plane=plane is not None,
        plane_frame=plane_frame(plane.unit_normal) if plane else np.eye(3),
        plane_point=np.array(plane.point) if plane else np.zeros(3),
        mu_friction=plane.friction if plane else 0.0,
        contact_compliance=1.0 / (plane.stiffness * young * length) if plane and plane.stiffness else 0.0,
        tolerance=scene.solver.tolerance,
        max_iterations=scene.solver.max_iterations,
    )


def with_live_values(model: Model, scene: Scene) -> Model:
    """The model with those fields that may change while running as the scene now has them."""
    model = model._replace(tolerance=scene.solver.tolerance, max_iterations=scene.solver.max_iterations)
    if scene.plane is None:
        return model
    return model._replace(
        plane_frame=plane_frame(scene.plane.unit_normal),
        plane_point=np.array(scene.plane.point),
        mu_friction=scene.plane.friction,
    )


def plane_frame(normal: Floats) -> Floats:
    """Right-handed rows n, t₁, t₂ for a unit normal; t₁ lies along the world axis most across the normal."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(normal))] = 1.0
    t1 = axis - normal * (normal @ axis)
    t1 /= np.linalg.norm(t1)
    return np.array([normal, t1, np.cross(normal, t1)])


def _block_maps(tet_slot: Ints, pattern: Pattern) -> tuple[Ints, Ints, Ints]:
    """For each tetrahedron and node pair: the block of A it adds to, and which node is its row and its column."""
    count = len(tet_slot)
    block = np.full((count, 10), -1, np.int64)
    row, column = np.zeros((count, 10), np.int64), np.zeros((count, 10), np.int64)
    for t, slots in enumerate(tet_slot):
        for e, (a, b) in enumerate(PAIRS):
            if slots[a] < 0 or slots[b] < 0:
                continue
            if slots[a] < slots[b]:
                a, b = b, a
            row[t, e], column[t, e] = a, b
            block[t, e] = slots[a] if a == b else block_of(pattern, slots[a], slots[b])
    return block, row, column


def build_state(model: Model, positions: Floats) -> State:
    """A state at rest at the given positions, (n, 3) [m], with its workspace."""
    count, n, nf = len(model.tets), len(positions), len(model.free)
    nnz = len(model.pattern.row)
    wanted = (9 * count if model.projection != strain_limits.NONE else 0) + 3 * len(
        model.contact_nodes
    ) * model.has_plane
    rows = min(MAX_ROWS, wanted)
    touched = min(nf, 4 * rows)
    return State(
        x=positions.copy(),
        v=np.zeros((n, 3)),
        origin=np.zeros(3),
        F=np.zeros((count, 3, 3)),
        U=np.zeros((count, 3, 3)),
        s=np.ones((count, 3)),
        V=np.zeros((count, 3, 3)),
        strain_ratio=np.zeros(count),
        contact_force=np.zeros((n, 3)),
        wrench=np.zeros(6),
        warm_limit=np.zeros((count, 3, 3)),
        active_rows=np.zeros(count, np.int64),
        A_diagonal=np.zeros((nf, 3, 3)),
        A_lower=np.zeros((nnz, 3, 3)),
        A_inverse=np.zeros((nf, 3, 3)),
        rhs=np.zeros((nf, 3)),
        J=np.zeros((rows, 4, 3)),
        row_slot=np.zeros((rows, 4), np.int64),
        row_tet=np.zeros(rows, np.int64),
        row_key=np.zeros(rows, np.int64),
        row_side=np.zeros(rows),
        constant=np.zeros(rows),
        compliance=np.zeros(rows),
        scale=np.zeros(rows),
        lam=np.zeros(rows),
        best=np.zeros(rows),
        diagonal=np.zeros(rows),
        cross=np.zeros(rows),
        has_column=np.zeros(rows, np.int64),
        row_local=np.zeros((rows, 4), np.int64),
        local=np.zeros(nf, np.int64),
        touched=np.zeros(touched, np.int64),
        u=np.zeros(3 * touched + 3 if touched else 0),
        S=np.zeros(9 * touched * touched),
        Z=np.zeros(3 * rows * touched),
        Y=np.zeros((nf, 3, LANES)),
        reached=np.zeros(nf, np.int64),
        columns=np.zeros((3, 3, BATCH)),
        turn=np.zeros((3, 3, BATCH)),
        D=np.zeros((3, 3)),
        P=np.zeros((3, 3)),
        G=np.zeros((4, 3)),
        result=np.zeros(8),
    )

"""From a body's mesh and its coefficients, as arrays and plain numbers, to the Model that steps work on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from .blocks import PAIR_COLUMN, PAIR_ROW, Blocks, blocks_of
from .elimination import analyse
from .lanes import LANES, aligned_copy, padded
from .locking import STIFF_BULK, bulk_to_shear, isochoric_strain
from .methods import NONE
from .model import Model, Patches, Pattern
from .neighbours import side_by_side
from .patches import Partition, each_alone, partition, shares
from .tensor_limit import limit_factors


class Body(NamedTuple):
    """A mesh at rest, and the nodes of it that are driven."""

    points: Floats  # (n, 3) [m]
    tets: Ints  # (T, 4)
    axes: Floats  # (T, 3, 3) rows e1, e2, e3: material axes
    surface: Ints  # (k, 3) triangles of the boundary
    driven: Ints  # (nd,) driven nodes
    yields: bool  # they are a rigid body on a spring, else they go where they are told


class Rest(NamedTuple):
    """The rest shape of a body's tetrahedra: see Model."""

    gradients: Floats
    volume: Floats
    length: float


class Tissue(NamedTuple):
    """What the body is made of."""

    density: float  # [kg/m³]
    young: float  # [Pa]
    poisson: float
    damping_mass: float  # Rayleigh α [1/s]
    damping_stiffness: float  # Rayleigh β [s]
    patched: bool = False  # volume strain is that of patches of tetrahedra, not each one's own
    relaxation: tuple[tuple[float, float], ...] = ()  # time [s] and share of the stress of each term that fades
    relaxes_pressure: bool = False  # shares are of all of the stress, else of its deviator

    @property
    def bulk(self) -> float:
        """K [Pa]."""
        return self.young / (3.0 * (1.0 - 2.0 * self.poisson))

    @property
    def shear(self) -> float:
        """μ [Pa]."""
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def lasting_poisson(self) -> float:
        """ν once all that relaxes has faded."""
        if not self.relaxation or self.relaxes_pressure:
            return self.poisson
        bulk, shear = 3.0 * self.bulk, self.shear * (1.0 - sum(share for _, share in self.relaxation))
        return (bulk - 2.0 * shear) / (2.0 * (bulk + shear))


class Strains(NamedTuple):
    """Limits on strain along the material axes."""

    projection: int  # one of methods.py
    stretch_room: Floats  # (3,) s_max − 1, ∞: free
    compress_room: Floats  # (3,) 1 − s_min, ∞: free
    shortest: Floats  # (3,) s_min, 0: free
    longest: Floats  # (3,) s_max, ∞: free


UNLIMITED = Strains(NONE, np.full(3, np.inf), np.full(3, np.inf), np.zeros(3), np.full(3, np.inf))


class Setting(NamedTuple):
    """What is around the body, and how its steps are solved: see Model."""

    gravity: Floats
    has_plane: bool
    method: int
    relinearizations: int


class Live(NamedTuple):
    """The coefficients of a Model that may change while it runs: see there."""

    limit_compliance: float
    limit_inertia: float
    limit_viscosity: float
    mu_friction: float
    contact_compliance: float
    spring: Floats
    spring_limit: Floats
    tolerance: float
    felt_force: float
    max_iterations: int
    settles: bool
    turn: float
    deadline: float


def rest_of(points: Floats, tets: Ints, axes: Floats) -> Rest:
    """points (n, 3) [m], tets (T, 4), axes (T, 3, 3): see Body."""
    corners = points[tets]
    D_m = np.swapaxes(corners[:, :3] - corners[:, 3:], 1, 2)
    material = np.swapaxes(axes, 1, 2)  # columns e1, e2, e3
    rows = np.linalg.inv(D_m) @ material
    gradients = np.concatenate([rows, -rows.sum(axis=1, keepdims=True)], axis=1)
    volume = np.linalg.det(D_m) / 6.0
    return Rest(gradients, volume, float(np.cbrt(volume.mean())))


def prepare_model(body: Body, rest: Rest, tissue: Tissue, strains: Strains, setting: Setting, live: Live) -> Model:
    """The model of a body; `rest`: what `rest_of` gives for it. Its tetrahedra lie in an order of its own."""
    is_free = np.ones(len(body.points), bool)
    is_free[body.driven] = False
    patches = partition(body.tets, is_free) if tissue.patched else each_alone()
    order = side_by_side(body.points, body.tets)
    body, rest, patches = _in_order(order, body, rest, patches)
    slots = _slots(body, is_free, patches)
    body, rest, patches, slots = _nodes_by_slot(body, rest, patches, slots)
    nf = len(slots.free)
    tets, driven, has_bone = body.tets, body.driven, body.yields
    gradients, volume, length = rest
    mass = np.zeros(len(body.points))
    np.add.at(mass, tets.ravel(), np.repeat(tissue.density * volume / 4.0, 4))
    blocks = blocks_of(slots.of_tet, patches.pairs, slots.of_node[patches.node], nf, slots.pattern)
    laplace = np.zeros(nf + len(blocks.row) + (len(driven) if has_bone else 0))
    t, row, column = blocks.assembly.T
    dot = np.einsum("ki,ki->k", gradients[t, row], gradients[t, column])
    np.add.at(laplace, np.repeat(np.arange(len(laplace)), np.diff(blocks.assembly_start)), volume[t] * dot)
    surface_nodes = np.unique(body.surface).astype(np.int64)
    mobility = np.append(1.0 / mass[slots.free], np.zeros(slots.total - nf))
    poisson = tissue.poisson
    return Model(
        tets=tets,
        tet_number=order,
        gradients=np.ascontiguousarray(gradients),
        volume=volume,
        mass=mass,
        mobility=mobility,
        length=length,
        free=slots.free,
        slot=slots.of_node,
        driven=driven,
        tet_slot=slots.of_tet,
        tet_place=blocks.tet_place,
        tet_block=blocks.tet_block,
        tet_order=np.argsort(slots.of_tet.min(axis=1), kind="stable"),
        tet_moves=(slots.of_tet < nf).sum(axis=1),
        **_in_lanes(body, rest, slots, mobility),
        assembly=blocks.assembly,
        assembly_start=blocks.assembly_start,
        assembly_dot=dot,
        block_row=blocks.row,
        block_column=blocks.column,
        block_place=blocks.place,
        laplace=laplace,
        pattern=slots.pattern,
        patches=_patches(patches, volume, tissue, slots, blocks),
        surface_nodes=surface_nodes,
        contact_nodes=surface_nodes[is_free[surface_nodes]],
        lame_lambda=-2.0 / 3.0 * tissue.shear
        if tissue.patched
        else tissue.young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        lame_mu=tissue.shear,
        relaxation=np.array(tissue.relaxation, np.float64).reshape(-1, 2),
        relaxes_pressure=tissue.relaxes_pressure,
        least_force=_least_force(tissue.shear, setting.gravity, mass, length),
        damping_mass=tissue.damping_mass,
        damping_stiffness=tissue.damping_stiffness,
        **_limits(strains, tissue.lasting_poisson),
        **setting._asdict(),
        has_bone=has_bone,
        rest_driven=body.points[driven] if has_bone else np.zeros((0, 3)),
        bone_lever=_lever(body.points[driven], length) if has_bone else length,
        sweeps_at=0,
        decompose_at=0,
        limit_rows_at=0,
        relax_at=0,
        **live._asdict(),
    )


def _in_order(order: Ints, body: Body, rest: Rest, patches: Partition) -> tuple[Body, Rest, Partition]:
    """The same of tetrahedra in that order."""
    if len(patches.of_tet):
        patches = patches._replace(of_tet=patches.of_tet[order], tet_place=patches.tet_place[order])
    body = body._replace(tets=body.tets[order], axes=body.axes[order])
    return body, rest._replace(gradients=rest.gradients[order], volume=rest.volume[order]), patches


class _Slots(NamedTuple):
    """The places of nodes in vectors and in A: see Model."""

    pattern: Pattern
    free: Ints  # node of each slot
    of_node: Ints
    of_tet: Ints
    total: int


def _nodes_by_slot(body: Body, rest: Rest, patches: Partition, slots: _Slots) -> tuple[Body, Rest, Partition, _Slots]:
    """The same with the nodes of each tetrahedron in the order of their slots, as blocks.PAIR_ROW takes them."""
    order = np.argsort(slots.of_tet, axis=1, kind="stable")
    if len(patches.of_tet):
        patches = patches._replace(tet_place=np.take_along_axis(patches.tet_place, order, 1))
    body = body._replace(tets=np.take_along_axis(body.tets, order, 1))
    rest = rest._replace(gradients=np.take_along_axis(rest.gradients, order[:, :, None], 1))
    return body, rest, patches, slots._replace(of_tet=np.take_along_axis(slots.of_tet, order, 1))


def _patches(found: Partition, volume: Floats, tissue: Tissue, slots: _Slots, blocks: Blocks) -> Patches:
    """What a Model has of patches."""
    whole, share = shares(found, volume)
    lanes = _side_by_side(found.of_tet) if len(whole) else np.empty((0, LANES), np.int64)
    entries = _side_by_side(found.tet_place) if len(whole) else np.empty((0, 4, LANES), np.int64)
    return Patches(
        bulk=tissue.bulk,
        volume=whole,
        lane=np.ascontiguousarray(lanes),
        tet_place=found.tet_place,
        lane_entry=np.ascontiguousarray(entries),
        tet_share=share,
        lane_share=aligned_copy(_side_by_side(np.append(share, np.zeros(-len(share) % LANES)))),
        start=found.start,
        node=found.node,
        slot=slots.of_node[found.node],
        assembly=np.ascontiguousarray(blocks.patch_assembly),
        place=blocks.patch_place,
    )


def _slots(body: Body, is_free: Any, patches: Partition) -> _Slots:
    """Free nodes in the order of elimination, the empty slot, then a yielding bone and its nodes."""
    n, nodes = len(is_free), np.flatnonzero(is_free)
    number = np.full(n, -1, np.int64)
    number[nodes] = np.arange(len(nodes))
    apart = patches.pairs[patches.pairs[:, 1] != patches.pairs[:, 2], 1:]
    beside = [[a, b] for a, b in zip(PAIR_ROW, PAIR_COLUMN, strict=True) if a != b]
    pairs = np.concatenate([*(body.tets[:, pair] for pair in beside), patches.node[apart]])
    edges = number[pairs]
    pattern = analyse(np.unique(np.sort(edges[(edges >= 0).all(axis=1)], axis=1), axis=0), len(nodes))
    free = nodes[pattern.order]
    nf = len(free)
    slot = np.full(n, nf, np.int64)
    slot[free] = np.arange(nf)
    if body.yields:
        slot[body.driven] = nf + 3 + np.arange(len(body.driven))
    return _Slots(pattern, free, slot, slot[body.tets], int(slot.max()) + 1 if body.yields else nf + 1)


def _in_lanes(body: Body, rest: Rest, slots: _Slots, mobility: Floats) -> dict[str, Any]:
    """What a Model has of its tetrahedra in lanes."""
    moves = (slots.of_tet < len(slots.free)).sum(axis=1)
    mobile = mobility[slots.of_tet]
    filled = np.concatenate([rest.volume, np.zeros(-len(body.tets) % LANES)])
    return {
        "lane_node": np.ascontiguousarray(_side_by_side(body.tets)),
        "lane_slot": np.ascontiguousarray(_side_by_side(slots.of_tet)),
        "lane_gradients": aligned_copy(_side_by_side(rest.gradients.reshape(-1, 12))),
        "lane_volume": aligned_copy(_side_by_side(filled)),
        "lane_mobility": aligned_copy(_side_by_side(mobile)),
        "lane_metric": aligned_copy(
            _side_by_side(np.concatenate([_metric(rest, mobile > 0.0), _metric(rest, mobile)], 1))
        ),
        "lane_driven": _side_by_side((moves > 0) & (moves < 4) & (not body.yields)).any(axis=1).astype(np.int64),
    }


def _metric(rest: Rest, weight: Any) -> Floats:
    """Σ w_n r_n r_nᵀ of each tetrahedron, (T, 6) in the order 00 11 22 12 02 01; weight (T, 4)."""
    whole = np.einsum("tn,tni,tnj->tij", weight.astype(float), rest.gradients, rest.gradients)
    return np.asarray(whole[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]])


def _side_by_side(values: Any) -> Any:
    """(T, …) → (B, …, 8): eight tetrahedra side by side, the last one repeated to fill up."""
    whole = np.concatenate([values, np.repeat(values[-1:], padded(len(values)) - len(values), axis=0)])
    return np.moveaxis(whole.reshape(-1, LANES, *values.shape[1:]), 1, -1)


def _limits(strains: Strains, poisson: float) -> dict[str, Any]:
    """What a Model has of limits, but for what may change while it runs."""
    factors, isochoric = np.zeros((2, 9)), np.full((2, 3), np.inf)
    limited = strains.projection != NONE
    if limited and bulk_to_shear(poisson) >= STIFF_BULK:
        isochoric = isochoric_strain(strains.shortest, strains.longest)
    if limited:
        limit_factors(np.array([strains.stretch_room, strains.compress_room]), factors)
    return {
        "projection": strains.projection,
        "stretch_room": strains.stretch_room,
        "compress_room": strains.compress_room,
        "limit_factors": factors,
        "mirrored": bool(np.allclose(factors[0, :6], -factors[1, :6], rtol=1e-9, atol=0.0)),
        "isochoric_strain": isochoric,
    }


def _least_force(shear: float, gravity: Floats, mass: Floats, length: float) -> float:
    """A thousandth of what shears a tetrahedron by its own length; a tenth of a node's weight where that is less."""
    weight = float(mass.mean() * np.linalg.norm(gravity))
    floor = 1e-3 * shear * length**2
    return min(floor, 0.1 * weight) if weight > 0.0 else floor


def _lever(points: Floats, length: float) -> float:
    """Rms distance of the points from the origin [m], `length` if that is 0."""
    return float(np.sqrt((points**2).sum(axis=1).mean())) or length

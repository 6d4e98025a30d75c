"""A State at rest: every array of it, made before the first step and never again."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from .elasticity import ALL_OF_A
from .lanes import BATCH, LANES, aligned, aligned_copy
from .linear_solver import MANY_BLOCKS, SIDES_AT_ONCE
from .methods import LINEAR, NONE, ORTHOGONAL, PGS, TENSOR
from .model import Model, Newton, Pgs, Principal, Relaxing, Secants, State, Tensor, Yielding
from .secants import MOST
from .tensor_rows import MOST_DIRECTIONS
from .work import WORK

MAX_ROWS = 2048  # limit and contact rows of one step of `pgs`; more are left out, with a status bit


class _Sizes(NamedTuple):
    """How long the arrays of a model's State are; 0 where it has no use for one."""

    tets: int
    nodes: int
    free: int
    slots: int
    batches: int
    contacts: int  # rows of contact
    rows: int
    spectral: int  # tetrahedra with a singular value decomposition
    tensor: int  # batches under the `tensor` limit
    patches: int
    limited_patches: int  # the same, where limits act on them
    turning: int  # squares at driven nodes that A may have where limits turn: three a side of each tetrahedron there
    pgs: bool


def _sizes(model: Model, nodes: int) -> _Sizes:
    count, batches = len(model.tets), len(model.lane_volume)
    tensor, pgs = model.projection == TENSOR, model.method == PGS
    spectral, patches = count if model.projection not in (NONE, TENSOR) else 0, len(model.patches.volume)
    contacts = len(model.contact_nodes) * model.has_plane
    both_sides = model.projection in (ORTHOGONAL, LINEAR)
    rows = (18 * count if tensor else (18 if both_sides else 9) * spectral) + 3 * contacts
    if pgs:
        rows = min(MAX_ROWS, rows)
    return _Sizes(
        count, nodes, len(model.free), len(model.mobility), batches, contacts, rows, spectral,
        batches if tensor else 0, patches, patches if spectral or tensor else 0,
        6 * int(np.count_nonzero(model.tet_moves < 4)) if tensor else 0, pgs,
    )  # fmt: skip


def build_state(model: Model, positions: Floats, timed: bool = False) -> State:
    """A state at rest at the given positions, (n, 3) [m], with its workspace. timed: its steps measure their stages."""
    size = _sizes(model, len(positions))
    return State(
        **_body(model, size, positions),
        **_told_and_reported(model, size),
        **_saved(model, size),
        work=np.zeros(len(WORK), np.int64),
        laps=np.zeros(7 if timed else 0),
        time=np.zeros(2, np.int64),
        **_linearisation(model, size),
        **_rows(size),
        relaxing=_relaxing(model, size),
        newton=_newton(size),
        secants=_secants(size),
        pgs=_pgs(size),
        yielding=_yielding(model),
        principal=_principal(size),
        tensor=_tensor(size),
    )


def _body(model: Model, size: _Sizes, positions: Floats) -> dict[str, Any]:
    limited, keys = model.projection != NONE, 18 if size.tensor else 9
    x = aligned(size.nodes, 4)
    x[:, :3] = positions
    at_rest = np.array([[0.0], [0.0], [0.0], [1.0]])
    return {
        "x": x,
        "v": aligned(size.nodes, 4),
        "quaternion": aligned_copy(np.broadcast_to(at_rest, (size.batches, 4, LANES))),
        "contact_force": np.zeros((size.nodes, 3)),
        "warm_limit": np.zeros((size.tets if limited else 0, keys)),
        "limit_force": aligned(size.tensor, LANES),
        "turning_force": aligned(size.tensor, LANES),
        "held_tets": np.zeros(1, np.int64),
        "active_rows": np.zeros(size.tets if limited else 0, np.int64),
    }


def _told_and_reported(model: Model, size: _Sizes) -> dict[str, Any]:
    strain = aligned(size.batches, 6, LANES)
    return {
        "plane_frame": np.eye(3),
        "plane_point": np.zeros(3),
        "plane_motion": np.zeros(6),
        "moves": np.zeros(1, np.int64),
        "target": np.zeros(13),
        "bone": np.zeros(14),
        "twist": np.zeros(6),
        "twist_start": np.zeros(6),
        "coupling": np.zeros(6),
        "result": np.zeros(11),
        "origin": np.zeros(3),
        "wrench": np.zeros(6),
        "R": aligned(size.batches, 9, LANES),
        "E": strain,
        "felt_strain": aligned(*strain.shape) if len(model.relaxation) else strain,
        "limit_strain": np.zeros_like(strain) if size.limited_patches else strain,
        "inverted": np.zeros(1, np.int64),
        "strain_ratio": np.zeros(size.tets),
    }


def _saved(model: Model, size: _Sizes) -> dict[str, Any]:
    """What lets a step take less work."""
    return {
        "stale": np.array([ALL_OF_A, 0]),
        "turned": aligned(0 if size.pgs else size.batches, 4, LANES),
        "motion": np.zeros(1),
        "held": np.zeros(1),
        "clearance": np.full(1, -1.0),
    }


def _linearisation(model: Model, size: _Sizes) -> dict[str, Any]:
    again = size.nodes if model.relinearizations or not size.pgs else 0
    below = len(model.pattern.row)
    parts = len(model.laplace) if size.tensor and not size.pgs else 0
    blocks = aligned(size.free + below + 1, 3, 4)
    return {
        "x_start": aligned(again, 4),
        "v_start": aligned(again, 4),
        "v_base": aligned(again, 4),
        "moving": aligned(size.nodes, 4),
        "driven_velocity": aligned(size.nodes, 4),
        "g": aligned(LANES * size.batches, 4, 4),
        "turning_A": aligned(parts, 3, 4),
        "elastic_A": aligned(parts, 3, 4),
        "A": aligned(len(model.laplace), 3, 4),
        "theta": np.zeros(size.patches),
        "pressure": aligned(size.batches if size.patches else 0, LANES),
        "G": aligned(len(model.patches.node), 4),
        "patch_rate": np.zeros(size.patches),
        "patch_size": np.zeros((2, size.patches)),
        "patch_force": np.zeros(size.patches),
        "patch_cross": aligned(len(model.patches.node), 4),
        "rhs": aligned(size.slots, 4),
        "slot_velocity": aligned(size.slots, 4),
        "slot_product": aligned(size.slots, 4),
        "L_blocks": blocks,
        "L_lower": blocks[size.free : size.free + below],
        "L_single": np.zeros((below if below >= MANY_BLOCKS and not size.pgs else 0, 3, 4), np.float32),
        "L_inverse": aligned(size.free, 3, 4),
    }


def _rows(size: _Sizes) -> dict[str, Any]:
    rows = size.rows
    return {
        "J": aligned(rows, 4, 4),
        "row_slot": np.zeros((rows, 4), np.int64),
        "row_tet": np.zeros(rows, np.int64),
        "row_key": np.zeros(rows, np.int64),
        "row_side": np.zeros(rows),
        "row_part": np.zeros(rows if size.limited_patches else 0),
        "constant": np.zeros(rows),
        "compliance": np.zeros(rows),
        "scale": np.zeros(rows),
        "lam": np.zeros(rows),
        "best": np.zeros(rows),
    }


def _relaxing(model: Model, size: _Sizes) -> Relaxing:
    terms = len(model.relaxation)
    batches, one = (size.batches, 1) if terms else (0, 0)
    return Relaxing(
        overstrain=aligned(batches, 6 * terms, LANES),
        memory=aligned(batches, 6, LANES),
        factors=np.zeros((terms, 2)),
        moduli=np.zeros(3 * one),
        rate=np.zeros(one),
    )


def _newton(size: _Sizes) -> Newton:
    slots, rows, contacts = (0, 0, 0) if size.pgs else (size.slots, size.rows, size.contacts)
    return Newton(
        change=aligned(slots, 4),
        direction=aligned(slots, 4),
        tried=aligned(slots, 4),
        best_change=aligned(slots, 4),
        remainder=aligned(slots, 4),
        along=aligned(slots, 4),
        next_residual=aligned(slots, 4),
        gap=np.zeros(rows),
        rate=np.zeros(rows),
        stiffness=np.zeros(rows),
        factors=np.zeros(1, np.int64),
        spent=np.zeros(1, np.int64),
        poor=np.zeros(1, np.int64),
        slip=aligned(contacts, 4),
        holds=np.zeros(1, np.int64),
        bound=np.zeros(contacts),
    )


def _secants(size: _Sizes) -> Secants:
    places = 0 if size.pgs else MOST + 1
    return Secants(
        pairs=aligned(2 * places, size.slots, 4),
        weight=np.zeros(places),
        part=np.zeros(places),
        ring=np.zeros(2, np.int64),
    )


def _pgs(size: _Sizes) -> Pgs:
    rows, free = (size.rows, size.free) if size.pgs else (0, 0)
    touched = min(free, 4 * rows)
    patches = min(size.limited_patches, rows)
    unknowns = 3 * touched + patches
    return Pgs(
        diagonal=np.zeros(rows),
        cross=np.zeros(rows),
        has_column=np.zeros(rows, np.int64),
        row_local=np.zeros((rows, 4), np.int64),
        row_rate=np.zeros(rows if patches else 0, np.int64),
        local=np.zeros(free, np.int64),
        touched=np.zeros(touched, np.int64),
        local_patch=np.zeros(size.limited_patches if patches else 0, np.int64),
        touched_patch=np.zeros(patches, np.int64),
        u=np.zeros(unknowns + 3 if unknowns else 0),
        S=np.zeros(unknowns * unknowns),
        Z=np.zeros(rows * unknowns),
        Y=np.zeros((free, 3, SIDES_AT_ONCE)),
        reached=np.zeros(free, np.int64),
    )


def _yielding(model: Model) -> Yielding:
    nodes = len(model.rest_driven)
    free = len(model.free) if nodes else 0
    return Yielding(
        arms=aligned(nodes, 4),
        base=np.zeros(6),
        load=np.zeros(6),
        stop=np.zeros(9),
        reach=np.zeros(1),
        pulls=np.zeros((2, 4)),
        S=np.zeros((6, 6)),
        border=aligned(free, 3, LANES),
        border_solved=aligned(free, 3, LANES),
        scratch=aligned(3, LANES),
    )


def _principal(size: _Sizes) -> Principal:
    tets = size.spectral
    s = np.ones((tets, 3))
    return Principal(
        F=np.zeros((tets, 3, 3)),
        U=np.zeros((tets, 3, 3)),
        s=s,
        bounded=s.copy() if size.limited_patches else s,
        V=np.zeros((tets, 3, 3)),
        columns=np.zeros((3, 3, BATCH)),
        turn=np.zeros((3, 3, BATCH)),
        P=np.zeros((3, 3)),
        D=np.zeros((3, 3)),
    )


def _tensor(size: _Sizes) -> Tensor:
    groups = 4 * MOST_DIRECTIONS * size.tensor
    frames = aligned(2 * size.tensor, 12, LANES)
    frames[:, 3:] = np.eye(3).reshape(9, 1)
    return Tensor(
        bound=aligned(size.tensor, 2, LANES),
        near=aligned(size.tensor, 2, LANES),
        frames=frames,
        top=np.zeros(1),
        first=np.zeros(2 * size.tensor + 1, np.int64),
        key=np.zeros(groups, np.int64),
        slope=aligned(groups, 9, 4),
        row=aligned(groups, 3, 4),
        gap=aligned(groups, 4),
        rate=aligned(groups, 4),
        lam=aligned(groups, 4),
        best=aligned(groups, 4),
        lane_J=aligned(LANES, 4 * 2 * MOST_DIRECTIONS, 4),
        lane_root=aligned(6, LANES),
        turning_count=np.zeros(1, np.int64),
        turning_tet=np.zeros(size.turning, np.int64),
        turning_J=aligned(size.turning, 4, 4),
    )

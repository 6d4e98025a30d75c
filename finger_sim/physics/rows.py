"""What all limit rows on principal stretches have in common: how far they give, their scale, their warm start."""

from __future__ import annotations

import math

from .compile import stage
from .dilatation import patch_sizes
from .lanes import load4, sum3
from .model import Model, State


@stage
def finish_rows(model: Model, state: State, h: float, first: int, rows: int) -> None:
    """compliance, scale and lam of the rows from `first` on; the rest of them is there (J, row_slot, row_tet, …).

    state.compliance holds the share of its limit's stiffness that a row has.

    A limit gives by λ / k, k = max(κ E V, k_m / (h² J M⁻¹ Jᵀ)): what is soft against the inertia that the step sees is
    no limit. κ = ∞ (model.limit_compliance 0): rigid. J: all of the row, also what it has at its patch.
    """
    J, row_slot, row_tet, row_key, row_side = state.J, state.row_slot, state.row_tet, state.row_key, state.row_side
    compliances, scale, lam, warm_limit = state.compliance, state.scale, state.lam, state.warm_limit
    mobility, volume, nf = model.mobility, model.volume, model.free.shape[0]
    patched, patches, entries = model.patches.volume.shape[0] > 0, model.patches.lane, model.patches.tet_place
    parts, G, sizes = state.row_part, state.G, state.patch_size
    if patched and rows > first:
        patch_sizes(model, state)
    for row in range(first, rows):
        tet = row_tet[row]
        force = moved = 0.0
        for n in range(4):
            j, slot = load4(J, row, n), row_slot[row, n]
            size = sum3(j * j)
            moved += size * mobility[slot]
            force += size if slot < nf else 0.0
        if patched:
            p, part = patches[tet // 8, tet % 8], parts[row]
            force += part * part * sizes[0, p]
            moved += part * part * sizes[1, p]
            for n in range(4):
                slot = row_slot[row, n]
                if slot < nf:
                    both = 2.0 * part * sum3(load4(J, row, n) * load4(G, entries[tet, n], 0))
                    force += both
                    moved += both * mobility[slot]
        share = compliances[row]
        compliance = model.limit_compliance / volume[tet]
        if model.limit_inertia > 0.0:
            compliance = min(compliance, h * h * moved / model.limit_inertia)
        compliances[row] = compliance / share
        scale[row] = math.sqrt(0.5 * force)
        warm = warm_limit[tet, row_key[row]]
        lam[row] = abs(warm) if (warm > 0.0) == (row_side[row] > 0.0) else 0.0

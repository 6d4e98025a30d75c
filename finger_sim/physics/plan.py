"""What a step forms, decided as it begins: a part of A, or factors of H.

A step that forms a part of A takes one and a half times as long as one that does neither, one that makes factors more
than twice. None does both where that can be helped: a part of A waits for a step when new factors are due.
"""

from __future__ import annotations

from .compile import stage
from .elasticity import ALL_OF_A, ELASTIC, TURNING, limits_changed, turns
from .hessian import NONE
from .kinematics import turned_far
from .methods import NEWTON
from .model import Model, State
from .turning import AHEAD, ahead_of

# Of the iterations that new factors are worth (Pattern.worth), what a step takes along old ones until the next begins
# with new ones; and where A is to change, which old ones would serve even less. With fewer, slow motion at 4 kHz, where
# old factors serve long, makes new ones for nothing.
_MANY, _SOME = 0.6, 0.5


@stage
def plan(model: Model, state: State, again: bool) -> None:
    """state.stale: what of A the step forms, and what a later one. Poor factors go: it begins with new ones.

    again: it is linearised more than once, with an A of its own each time.
    """
    own, stale = state.newton, state.stale
    poor = own.poor[0] != 0
    if poor:
        own.factors[0] = NONE
    if model.turn == 1.0 or model.method != NEWTON or again:
        stale[0] = ALL_OF_A
    if stale[0] == ALL_OF_A:
        stale[1] = 0
        return
    changed = turned_far(state, model.turn) or limits_changed(state)
    most = int((_SOME if changed or stale[1] != 0 else _MANY) * model.pattern.worth)
    if poor or own.spent[0] >= most:
        own.factors[0] = NONE
    elif changed:
        # What turns is left to a later step, so that none forms all of A; but all but rigid limits would tremble, and
        # where A changes in every step it is all of one.
        by_parts = stale[1] == 0 and turns(model) and ahead_of(model) == AHEAD
        stale[0], stale[1] = (ELASTIC, TURNING) if by_parts else (ALL_OF_A, 0)
    else:
        stale[0], stale[1] = stale[1], 0

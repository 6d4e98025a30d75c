"""Records as compiled code holds them: one that is made of another is what it would be made of nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from small_fingers import small

from finger_sim.arrays import Floats
from finger_sim.physics.records import Pointed
from finger_sim.simulation.build import build_model, with_live_values


class Inner(NamedTuple):
    numbers: Floats


class Outer(NamedTuple):
    count: int
    size: float
    on: bool
    array: Floats
    inner: Inner


FIRST = Outer(3, 0.5, True, np.arange(6.0).reshape(2, 3), Inner(np.ones(4)))


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"count": -7, "size": 2.5, "on": False},
        {"array": np.zeros((4, 5))},
        {"inner": Inner(np.arange(9.0))},
        {"array": np.zeros(7)},  # of another kind
        {"size": 2},
    ],
)
def test_a_changed_record_is_the_one_it_would_be_anew(change: dict[str, object]) -> None:
    """Of the same words, but for where the parts within lie; the one before stays as it is."""
    before = Pointed(FIRST)
    words = before._memory.copy()
    record = FIRST._replace(**change)  # type: ignore[arg-type]
    made, anew = before.changed(record), Pointed(record)
    assert made.record is record
    assert made.kind == anew.kind
    assert made.address == made._memory.ctypes.data
    place = anew.kind.places["inner"]
    np.testing.assert_array_equal(np.delete(made._memory, place), np.delete(anew._memory, place))
    inside = made._within["inner"]
    np.testing.assert_array_equal(inside._memory, anew._within["inner"]._memory)
    assert made._memory[place] == inside.address
    np.testing.assert_array_equal(before._memory, words)


def test_live_values_of_a_model_change_no_kind() -> None:
    """So that what is compiled for the first model steps the changed ones."""
    scene = small("finger_coupled")
    model = build_model(scene, scene.load_mesh())
    live = {"plane.friction": 0.11, "solver.tolerance": 2e-3, "coupling.stiffness": 333.0}
    changed = with_live_values(model, scene.with_values(live))
    before = Pointed(model)
    made, anew = before.changed(changed), Pointed(changed)
    assert made.kind == anew.kind == before.kind
    assert made._memory.tolist() != before._memory.tolist()
    within = [anew.kind.places[name] for name in anew._within]
    np.testing.assert_array_equal(np.delete(made._memory, within), np.delete(anew._memory, within))

"""A time budget: when the ladder is walked down and up, and what its rungs are."""

from __future__ import annotations

import numpy as np
from cases import for_each

from finger_sim import Scene, Simulator
from finger_sim.haptics.budget import LADDER, MOST_PATIENCE, PATIENCE, WINDOW, Budget, on_rung
from finger_sim.scene import Solver


def fed(budget: Budget, seconds: float, steps: int) -> list[int]:
    """The rung after each of so many steps of one length."""
    rungs = []
    for _ in range(steps):
        budget.spent(seconds)
        rungs.append(budget.rung)
    return rungs


def test_within_the_budget_nothing_changes() -> None:
    """Nor does a step in twenty that is late: those are the machine's."""
    budget = Budget(1e-3)
    for k in range(10_000):
        assert not budget.spent(3e-3 if k % 20 == 0 else 0.9e-3)
    assert (budget.rung, budget.moves) == (0, 0)


def test_too_long_leads_down_a_rung_a_window_to_the_last() -> None:
    """One rung for each full window of steps beyond the budget; at the end of the ladder it stays."""
    budget = Budget(1e-3)
    rungs = fed(budget, 1.1e-3, 10 * WINDOW)
    assert rungs[WINDOW - 2] == 0
    assert [rungs[k * WINDOW - 1] for k in range(1, len(LADDER))] == list(range(1, len(LADDER)))
    assert rungs[-1] == len(LADDER) - 1
    assert budget.moves == len(LADDER) - 1


def test_ease_leads_up_after_patience() -> None:
    """Well below the budget for PATIENCE steps: up a rung. Near it: not."""
    budget = Budget(1e-3)
    fed(budget, 1.1e-3, WINDOW)
    assert budget.rung == 1
    assert set(fed(budget, 0.9e-3, 5 * PATIENCE)) == {1}
    rungs = fed(budget, 0.3e-3, PATIENCE)
    assert rungs[-1] == 0
    budget = Budget(1e-3)
    fed(budget, 1.1e-3, WINDOW)
    assert set(fed(budget, 0.3e-3, PATIENCE - 1)) == {1}


def test_a_rung_that_is_too_dear_is_tried_ever_more_seldom() -> None:
    """A load that the rung above cannot carry: the first tries are PATIENCE apart, then twice that, to an end."""
    budget, ups, rung = Budget(1e-3), [], 0
    for k in range(40 * PATIENCE):
        budget.spent(1.2e-3 if budget.rung == 0 else 0.3e-3)
        if budget.rung < rung:
            ups.append(k)
        rung = budget.rung
    apart = np.diff(ups)
    assert len(ups) < 8
    assert (apart[1:] > 1.5 * apart[:-1]).all()
    for _ in range(20 * MOST_PATIENCE):
        budget.spent(1.2e-3 if budget.rung == 0 else 0.3e-3)
    assert budget._patience <= MOST_PATIENCE


def test_patience_comes_back_after_a_calm_time() -> None:
    """A rung that held for its patience was not too dear."""
    budget = Budget(1e-3)
    fed(budget, 1.1e-3, WINDOW)
    fed(budget, 0.3e-3, PATIENCE)
    fed(budget, 1.1e-3, WINDOW)
    assert budget._patience == 2 * PATIENCE
    fed(budget, 0.3e-3, 2 * PATIENCE)
    assert budget.rung == 0
    fed(budget, 0.3e-3, 2 * PATIENCE)
    assert budget._patience == PATIENCE


@for_each("rung", range(len(LADDER)))
def test_rungs_never_ask_for_more_than_the_scene(rung: int) -> None:
    """Coarser, fewer iterations; `pgs` and a relinearised `newton` keep their level."""
    for method in ("pgs", "newton"):
        solver = Solver(method=method, tolerance=2e-2, max_iterations=3)
        on = on_rung(solver, rung)
        assert on.tolerance >= solver.tolerance
        assert on.max_iterations <= solver.max_iterations
        assert on.level == ("lagged" if method == "newton" and LADDER[rung].lagged else "standard")
    assert on_rung(Solver(method="newton", relinearizations=1), rung).level == "standard"
    assert on_rung(Solver(), 0) == Solver()


def test_a_simulator_walks_the_ladder_and_back() -> None:
    """solve_with changes how a step is solved, not the scene; rungs cost fewer factorisations."""
    sim = Simulator(Scene.load("finger_haptic").with_values({"solver.sleep": False}))
    for rung in (0, 2, 0):
        sim.solve_with(on_rung(sim.scene.solver, rung))
        sim.step(None)
        before = sim.work["matrices"]
        for _ in range(40):
            out = sim.step(None)
        assert np.isfinite(sim.positions).all()
        assert sim.work["matrices"] - before == (10 if LADDER[rung].lagged else 40)
        assert not out.status
    assert sim.scene.solver.level == "standard"
    sim.solve_with(on_rung(sim.scene.solver, 3))
    sim.apply({"plane.friction": 0.4})
    before = sim.work["matrices"]
    sim.step(None)
    sim.step(None)
    assert sim.work["matrices"] - before == 2

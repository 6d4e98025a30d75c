"""A time budget: when the ladder is walked down and up, and what its rungs are."""

from __future__ import annotations

import numpy as np
import pytest
from small_fingers import small

from finger_sim import Scene, Simulator
from finger_sim.haptics import budget as budgets
from finger_sim.haptics.budget import MOST_PATIENCE, PATIENCE, WINDOW, Budget, claimed, ladder, usable
from finger_sim.scene import Solver
from finger_sim.studies.shared import poses
from finger_sim.studies.tradeoff.rungs import CONVERGED, forces

RUNGS = 4


def fed(budget: Budget, seconds: float, steps: int) -> list[int]:
    """The rung after each of so many steps of one length."""
    rungs = []
    for _ in range(steps):
        budget.spent(seconds)
        rungs.append(budget.rung)
    return rungs


def test_within_the_budget_nothing_changes() -> None:
    """Nor does a step in twenty that is late: those are the machine's."""
    budget = Budget(1e-3, RUNGS)
    for k in range(10_000):
        assert not budget.spent(3e-3 if k % 20 == 0 else 0.9e-3)
    assert (budget.rung, budget.moves) == (0, 0)


def test_too_long_leads_down_a_rung_a_window_to_the_last() -> None:
    """One rung for each full window of steps beyond the budget; at the end of the ladder it stays."""
    budget = Budget(1e-3, RUNGS)
    rungs = fed(budget, 1.1e-3, 10 * WINDOW)
    assert rungs[WINDOW - 2] == 0
    assert [rungs[k * WINDOW - 1] for k in range(1, RUNGS)] == list(range(1, RUNGS))
    assert rungs[-1] == RUNGS - 1
    assert budget.moves == RUNGS - 1


def test_ease_leads_up_after_patience() -> None:
    """Well below the budget for PATIENCE steps: up a rung. Near it: not."""
    budget = Budget(1e-3, RUNGS)
    fed(budget, 1.1e-3, WINDOW)
    assert budget.rung == 1
    assert set(fed(budget, 0.9e-3, 5 * PATIENCE)) == {1}
    rungs = fed(budget, 0.3e-3, PATIENCE)
    assert rungs[-1] == 0
    budget = Budget(1e-3, RUNGS)
    fed(budget, 1.1e-3, WINDOW)
    assert set(fed(budget, 0.3e-3, PATIENCE - 1)) == {1}


def test_a_rung_that_is_too_dear_is_tried_ever_more_seldom() -> None:
    """A load that the rung above cannot carry: the first tries are PATIENCE apart, then twice that, to an end."""
    budget, ups, rung = Budget(1e-3, RUNGS), [], 0
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
    assert budget.purse.patience[0] <= MOST_PATIENCE


def test_patience_comes_back_after_a_calm_time() -> None:
    """A rung that held for its patience was not too dear."""
    budget = Budget(1e-3, RUNGS)
    fed(budget, 1.1e-3, WINDOW)
    fed(budget, 0.3e-3, PATIENCE)
    fed(budget, 1.1e-3, WINDOW)
    assert budget.purse.patience[0] == 2 * PATIENCE
    fed(budget, 0.3e-3, 2 * PATIENCE)
    assert budget.rung == 0
    fed(budget, 0.3e-3, 2 * PATIENCE)
    assert budget.purse.patience[0] == PATIENCE


def test_rungs_never_ask_for_more_than_the_scene_and_each_changes_something() -> None:
    """Coarser, fewer iterations; what changes nothing is left out: `lagged` where matrices cannot be kept."""
    for method in ("pgs", "newton"):
        solver = Solver(method=method, tolerance=2e-2, max_iterations=3)
        for rung in ladder(solver):
            assert rung.solver.tolerance >= solver.tolerance
            assert rung.solver.max_iterations <= solver.max_iterations
    names = {
        "newton": Solver(method="newton", tolerance=1e-3, max_iterations=30),
        "twice": Solver(method="newton", tolerance=1e-3, max_iterations=30, relinearizations=1),
        "pgs": Solver(method="pgs", tolerance=1e-3, max_iterations=400),
        "loose": Solver(method="pgs", tolerance=0.1, max_iterations=2),
    }
    assert {key: [rung.name for rung in ladder(solver)] for key, solver in names.items()} == {
        "newton": ["scene", "coarse", "lagged", "capped"],
        "twice": ["scene", "coarse", "capped"],
        "pgs": ["scene", "coarse", "capped"],
        "loose": ["scene"],
    }
    for solver in names.values():
        assert ladder(solver)[0].solver == solver


def test_a_rung_that_blows_a_body_up_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where its error was measured to be half of the peak force."""
    scene = Scene.load("finger_coupled")
    for error, rungs in ((0.49, 3), (0.5, 2)):
        monkeypatch.setattr(budgets, "claimed", lambda *_, error=error: {"capped": error})
        assert len(usable(scene, scene.load_mesh())) == rungs


def test_errors_are_claimed_only_of_what_was_measured() -> None:
    """For each shipped scene its own; none once a value that decides about them is another."""
    haptic, other = Scene.load("finger_haptic"), Scene.load("finger")
    mesh = haptic.load_mesh()
    mine, its = claimed(haptic, mesh), claimed(other, mesh)
    assert list(mine) == list(its) == ["scene", "coarse", "capped"]
    assert mine != its
    assert claimed(haptic.with_values({"solver.budget_ms": 0.5, "solver.sleep": False}), mesh) == mine
    for changes in ({"plane.friction": 0.6}, {"material.young": 1.5e4}, {"dt": 2e-3}, {"solver.tolerance": 2e-3}):
        assert claimed(haptic.with_values(changes), mesh) == {}
    assert claimed(haptic, Scene.load("presets/haptic").load_mesh()) == mine
    coupled = Scene.load("finger_coupled")
    assert [rung.name for rung in usable(coupled, mesh)] == ["scene", "coarse", "capped"]
    assert usable(haptic, mesh) == ladder(haptic.solver)
    beam = Scene.from_dict({"mesh": {"beam": {"size": [1.0, 1.0, 1.0], "cells": [1, 1, 1]}}})
    assert claimed(beam, beam.load_mesh()) == {}


@pytest.mark.slow
def test_the_largest_claim_of_the_scene_for_haptics_holds() -> None:
    """Measured anew, the quickest rung does no worse by 2 times, nor better by 2 times."""
    scene = Scene.load("finger_haptic").with_values({"solver.sleep": False})
    commands = poses(scene, "press_slide")
    exact = forces(Simulator(scene.with_values(CONVERGED)), commands)
    simulator = Simulator(scene)
    simulator.solve_with(ladder(scene.solver)[-1].solver)
    error = np.linalg.norm(forces(simulator, commands) - exact, axis=1) / np.linalg.norm(exact, axis=1).max()
    claim = claimed(scene, simulator.mesh)["capped"]
    assert 0.5 * claim < np.sqrt((error**2).mean()) < 2.0 * claim


def test_a_simulator_walks_the_ladder_and_back() -> None:
    """solve_with changes how a step is solved, not the scene; rungs cost fewer factorisations."""
    sim = Simulator(small("finger_haptic").with_values({"solver.sleep": False}))
    rungs = {rung.name: rung.solver for rung in ladder(sim.scene.solver)}
    for name in ("scene", "lagged", "scene"):
        sim.solve_with(rungs[name])
        sim.step(None)
        before = sim.work["matrices"]
        for _ in range(40):
            out = sim.step(None)
        assert np.isfinite(sim.positions).all()
        assert sim.work["matrices"] - before == (0 if name == "lagged" else 40)
        assert not out.status
    assert sim.scene.solver.level == "standard"
    sim.solve_with(rungs["capped"])
    sim.apply({"plane.friction": 0.4})
    before = sim.work["matrices"]
    sim.step(None)
    sim.step(None)
    assert sim.work["matrices"] - before == 2

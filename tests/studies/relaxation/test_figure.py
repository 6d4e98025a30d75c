"""What fades of a held force and what a tap loses: fits and loops against closed forms, verdicts, the finger itself."""

from __future__ import annotations

import json

import numpy as np
import pytest

from finger_sim import Scene
from finger_sim.plain import plain
from finger_sim.studies.at_rest import at_rest
from finger_sim.studies.relaxation import figure
from finger_sim.studies.relaxation.figure import DEPTHS, FREE, LOST, STILL, TAP, TAPS, WHOLE, Held, Result, Tap, _fitted

TERMS = ((0.004, 0.35), (0.07, 0.25), (1.4, 0.15))


def ignore(done: float, total: float) -> None:
    """Told of progress."""


def test_parts_of_a_force_are_found() -> None:
    """Of 2.5 N that fade with the three times, to parts in 1e4; a force that fades otherwise is missed."""
    time = 1e-3 * np.arange(6000)
    parts = np.array([0.1, 0.2, 0.3, 0.4])
    force = 2.5 * (parts[3] + sum(p * np.exp(-time / t) for p, (t, _) in zip(parts[:3], TERMS, strict=True)))
    found, missed = _fitted(time, force, [t for t, _ in TERMS])
    np.testing.assert_allclose(found, parts, rtol=0, atol=1e-4)
    assert missed < 1e-9
    assert _fitted(time, 1.0 + np.sin(3.0 * time), [t for t, _ in TERMS])[1] > 0.05


def test_what_a_tap_loses() -> None:
    """A spring nothing; one that pushes back with a third of its force two thirds; clay all."""
    depth = 1e-3 * np.sin(np.linspace(0.0, np.pi, 101))
    force = 500.0 * depth
    back = np.arange(101) > 50
    assert Tap(depth, force).lost == pytest.approx(0.0, abs=1e-12)
    assert Tap(depth, np.where(back, force / 3.0, force)).lost == pytest.approx(2.0 / 3.0, abs=0.02)
    assert Tap(depth, np.where(back, 0.0, force)).lost == pytest.approx(1.0, abs=0.02)


def made(lost: float, missed: float) -> Result:
    """A result in which all taps lose so much, and fits miss so much of the force."""
    time = 1e-3 * np.arange(6000)
    held = [Held(depth, time, np.exp(-time), np.array([0.1, 0.2, 0.3, 0.4]), missed) for depth in DEPTHS]
    depth = 1e-3 * np.sin(np.linspace(0.0, np.pi, 2001))
    tap = Tap(depth, depth * np.where(np.arange(2001) > 1000, 1.0 - lost, 1.0))
    return Result(TERMS, held, {name: dict.fromkeys(TAPS, tap) for name in (WHOLE, FREE, STILL)}, 0)


def test_verdicts() -> None:
    """A finger that does as fingertips do agrees, one that does not differs; JSON and a picture take all of it."""
    pytest.importorskip("matplotlib")
    assert [finding.agrees for finding in figure.findings(made(LOST, 1e-3))] == [True, True]
    assert [finding.agrees for finding in figure.findings(made(0.3, 0.1))] == [False, False]
    json.dumps(plain(figure.numbers(made(0.3, 0.1))), allow_nan=False)
    assert len(figure.draw(made(0.3, 0.1)).axes) == 3


def test_at_rest_it_is_the_everyday_finger() -> None:
    """What studies press at rest has no terms, but the moduli, limits and contact that are left of them."""
    soft, everyday = at_rest(Scene.load("finger_relaxing")), at_rest(Scene.load("finger_haptic"))
    assert soft.material.relaxation == ()
    for name in ("material.young", "material.poisson", "limits.stiffness", "plane.stiffness"):
        block, key = name.split(".")
        wanted = getattr(getattr(everyday, block), key)
        assert getattr(getattr(soft, block), key) == pytest.approx(wanted, rel=1e-3), name


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_finger_is_measured() -> None:
    """Force fades less the deeper the press; a tap loses more with terms than by damping alone; nothing turns over."""
    found = figure.measure(ignore, hold=6.0, taps=(TAP, 0.5))
    left = [held.force[-1] / held.force[0] for held in found.held]
    assert 0.45 < left[0] < left[1] < left[2] < 0.9
    assert max(held.missed for held in found.held) < 0.01
    assert found.taps[WHOLE][TAP].lost == pytest.approx(0.26, abs=0.03)
    assert found.taps[WHOLE][0.5].lost > 2.0 * found.taps[STILL][0.5].lost
    assert found.taps[FREE][TAP].lost > found.taps[WHOLE][TAP].lost

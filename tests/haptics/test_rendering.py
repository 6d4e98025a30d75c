"""What a device gets, step by step: scaled, ramped in, clamped, nothing when the command is stale."""

from __future__ import annotations

import numpy as np
import pytest

from finger_sim.haptics.rendering import Rendering
from finger_sim.scene import Coupling

FORCE = np.array([0.0, 0.0, 4.0, 0.0, 0.1, 0.0])
MS = 0.001


def test_it_comes_in_on_a_ramp_and_anew_after_a_pause() -> None:
    device = Rendering(ramp=0.1, timeout=0.1)
    for _ in range(2):
        assert device.watch(age=0.1)
        first = [device.render(FORCE, Coupling(), MS)[2] for _ in range(150)]
        assert first[:100] == pytest.approx(0.04 * np.arange(1, 101))
        assert first[100:] == pytest.approx([4.0] * 50)
        assert not device.watch(age=0.1001)
        assert not device.render(FORCE, Coupling(), MS).any()


def test_an_open_clutch_takes_it_and_it_comes_in_anew() -> None:
    """At once, however recent the command is."""
    device = Rendering(ramp=0.1, timeout=0.1)
    device.clutched = False
    device.watch(age=0.0)
    full = [device.render(FORCE, Coupling(), MS)[2] for _ in range(150)][-1]
    device.clutched = True
    assert not device.watch(age=0.0)
    assert not device.render(FORCE, Coupling(), MS).any()
    device.clutched = False
    assert device.watch(age=0.0)
    assert full == pytest.approx(4.0)
    assert device.render(FORCE, Coupling(), MS)[2] == pytest.approx(0.04)


def test_the_clamps_hold_after_the_scale_too() -> None:
    device = Rendering(scale=5.0, ramp=0.0)
    assert device.render(FORCE, Coupling(), MS) == pytest.approx([0.0, 0.0, 10.0, 0.0, 0.5, 0.0])
    assert not Rendering(scale=0.0, ramp=0.0).render(FORCE, Coupling(), MS).any()


def test_what_is_not_finite_is_not_sent() -> None:
    assert not Rendering().render(np.array([np.nan, 0.0, 1.0, 0.0, 0.0, 0.0]), Coupling(), MS).any()

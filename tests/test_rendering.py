"""What a device gets, step by step: scaled, ramped in, clamped, nothing when the command is stale."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from finger_sim import Scene
from finger_sim.ros.parameters import NodeOptions
from finger_sim.ros.stepper import Stepper


def stepper(**options: Any) -> Stepper:
    outputs: Any = SimpleNamespace(options=NodeOptions(**options))
    return Stepper(Scene.load("finger_coupled"), outputs, None, None)


FORCE = np.array([0.0, 0.0, 4.0, 0.0, 0.1, 0.0])


def test_it_comes_in_on_a_ramp_and_anew_after_a_pause() -> None:
    node = stepper(force_ramp=0.1)
    for _ in range(2):
        first = [node._rendered(FORCE)[2] for _ in range(150)]
        assert first[:100] == pytest.approx(0.04 * np.arange(1, 101))
        assert first[100:] == pytest.approx([4.0] * 50)
        assert not node._silenced().any()


def test_the_scale_acts_before_the_clamps() -> None:
    node = stepper(force_ramp=0.0, force_scale=5.0)
    assert node._rendered(FORCE) == pytest.approx([0.0, 0.0, 10.0, 0.0, 0.5, 0.0])
    assert stepper(force_ramp=0.0, force_scale=0.0)._rendered(FORCE) == pytest.approx(np.zeros(6))


def test_what_is_not_finite_is_not_sent() -> None:
    assert not stepper()._rendered(np.array([np.nan, 0.0, 1.0, 0.0, 0.0, 0.0])).any()

"""The finger scenes on the paper's 350 tetrahedra: for tests of what does not depend on which finger is stepped."""

from __future__ import annotations

from pathlib import Path

from finger_sim import Scene

SMALL_COUPLED = Path(__file__).parent / "scenes" / "finger_coupled.yaml"
"""For programs that are given a scene by its path."""


def small(name: str) -> Scene:
    """`finger`, `finger_haptic` or `finger_coupled`, on that mesh, with elements."""
    return Scene.load(SMALL_COUPLED.with_name(f"{name}.yaml"))

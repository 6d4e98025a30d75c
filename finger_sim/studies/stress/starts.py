"""Directed cases that start broken: bodies inside out, flat, or collapsed, let go in air without gravity."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...arrays import Floats
from ...scene import Scene
from .case import Case
from .extremes import LIMITS, block
from .motions import STILL

STEPS = 550
"""That a body is given to come to rest, of 1 ms."""
AIR = 20.0
"""Damping of a free body's motion [1/s]: nothing else ends a rotation that it came out with."""
RECOVERS = 0.5
"""Time in which it has to be as if it had never been broken [s]."""
BODIES: dict[str, dict[str, Any]] = {
    "elastic": {"solver": "newton", "limits": None},
    "newton": {"solver": "newton"},
    "isotropic": {"solver": "newton", "limits": LIMITS | {"projection": "isotropic", "stretch": 1.1, "compress": 0.9}},
    "pgs": {"solver": "pgs"},
}
"""How limits hold the block, if any do."""


def starts() -> Iterator[Case]:
    """Every broken start of every body: its soft nodes alone, held by their bone, and all nodes of a free body."""
    for held in (True, False):
        for body, values in BODIES.items():
            changed = {"plane": None, "gravity": [0.0, 0.0, 0.0], **values}
            if not held:
                changed |= {"driven": None, "material": {"damping": {"mass": AIR, "stiffness": 0.002}}}
            scene = block(**changed)
            for state, positions in broken(Scene.from_dict(scene)).items():
                yield Case(
                    f"start_{state}_{'held' if held else 'free'}_{body}", f"start {'held' if held else 'free'}",
                    scene, (STILL,) * STEPS, start=positions, disturbed=0, recovers=RECOVERS,
                )  # fmt: skip


def broken(scene: Scene) -> dict[str, Floats]:
    """Positions (n, 3) [m] of a body at rest with its free nodes put where they cannot be."""
    mesh = scene.load_mesh()
    X = mesh.points
    centre = X.mean(axis=0)
    maps = {
        "inverted": np.diag([1.0, 1.0, -1.0]),  # s₂ = −s₃ of every tetrahedron, |s| equal
        "opposite": np.diag([1.4, 0.7, -0.7]),  # s₂ = −s₃
        "inside_out": -np.eye(3),
        "flat": np.diag([1.0, 1.0, 0.0]),
        "line": np.diag([1.0, 0.0, 0.0]),
        "point": np.zeros((3, 3)),
        "half": 0.5 * np.eye(3),  # equal singular values everywhere
        "double": 2.0 * np.eye(3),
    }
    free = np.setdiff1d(np.arange(len(X)), scene.driven_nodes(mesh))
    out = {}
    for name, F in maps.items():
        out[name] = np.array(X)
        out[name][free] = (centre + (X - centre) @ F.T)[free]
    return out

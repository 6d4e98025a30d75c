"""A soft block on a plane, and presses of it: a fit's tests in seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from finger_sim import Scene
from finger_sim.fit.made import Course

LEVEL = (0.0, 0.0, 0.0, 1.0)
DOWN = Course("pose", 1.5e-3, 0.5, name="down", turn=LEVEL)
ALONG = Course("pose", 1.0e-3, 0.5, slide=2e-3, name="along", turn=LEVEL)


def block(**values: Any) -> Scene:
    """20 × 20 × 10 mm, held at its top, with other values (dotted keys, __ for a dot)."""
    scene = Scene.from_dict(
        {
            "mesh": {"beam": {"size": [0.02, 0.02, 0.01], "cells": [3, 3, 2]}},
            "driven": {"box": [[-1.0, -1.0, 0.0099], [1.0, 1.0, 0.0101]]},
            "material": {"young": 2e4, "poisson": 0.4, "volumetric": "patch"},
            "limits": {
                "projection": "tensor",
                "stretch": [1.3, 1.3, 1.3],
                "compress": [0.95, 0.95, 0.95],
                "stiffness": 50.0,
                "viscosity": 2.0,
            },
            "plane": {"friction": 0.4, "stiffness": 250.0},
            "gravity": [0.0, 0.0, 0.0],
            "solver": {"method": "newton", "tolerance": 1e-4, "max_iterations": 60},
            "coupling": {"following": "hold"},
            "dt": 2e-3,
        }
    )
    return scene.with_values({key.replace("__", "."): value for key, value in values.items()})


def scene_file(folder: Path, scene: Scene, name: str = "block.yaml") -> Path:
    path = folder / name
    path.write_text(yaml.safe_dump(scene.to_dict()))
    return path

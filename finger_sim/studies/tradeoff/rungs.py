"""What the rungs of a time budget cost in accuracy, scene by scene: what the node claims on /diagnostics.

`python -m finger_sim.studies.tradeoff.rungs FILE` measures the scenes in SCENES and writes FILE, a claim for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from ...arrays import Floats
from ...console import make_files, say
from ...haptics.budget import fingerprint, ladder
from ...scene import Pose, Scene
from ...simulation.simulator import Simulator
from ..bench.bench import describe_machine
from ..shared import poses

SCENES = (
    "finger", "finger_haptic", "finger_coupled", "presets/fastest", "presets/haptic", "presets/balanced",
)  # fmt: skip
BAG = "press_slide"
CONVERGED = {"solver.tolerance": 1e-9, "solver.max_iterations": 500}
"""What rungs are compared with: the same model, solved to the end."""


class Cost(NamedTuple):
    """Error of contact force on a rung against the converged run, as a part of that one's peak."""

    name: str
    rms: float
    most: float


def costs(scene: Scene, commands: Sequence[Pose]) -> list[Cost]:
    """Of every rung of a scene's ladder, its own settings first."""
    awake = scene.with_values({"solver.sleep": False})
    exact = forces(Simulator(awake.with_values(CONVERGED)), commands)
    peak = np.linalg.norm(exact, axis=1).max()
    found = []
    for rung in ladder(awake.solver):
        simulator = Simulator(awake)
        simulator.solve_with(rung.solver)
        error = np.linalg.norm(forces(simulator, commands) - exact, axis=1) / peak
        found.append(Cost(rung.name, float(np.sqrt((error**2).mean())), float(error.max())))
    return found


def forces(simulator: Simulator, commands: Sequence[Pose]) -> Floats:
    """Contact force of every step (k, 3) [N]."""
    simulator.reset(commands[0])
    return np.array([simulator.step(pose).contact_wrench[:3] for pose in commands])


def claims(names: Sequence[str] = SCENES) -> dict[str, Any]:
    """Of scenes by name, plain values."""
    scenes: dict[str, Any] = {}
    for name in names:
        scene = Scene.load(name)
        found = costs(scene, poses(scene, BAG))
        say(f"{name}: " + ", ".join(f"{cost.name} {cost.rms:.3%}, at most {cost.most:.2%}" for cost in found))
        scenes[name] = {
            "fingerprint": fingerprint(scene, scene.load_mesh()),
            "rms": {cost.name: float(f"{cost.rms:.2g}") for cost in found},
            "most": {cost.name: float(f"{cost.most:.2g}") for cost in found},
        }
    return {"motion": BAG, "date": describe_machine()["date"], "scenes": scenes}


def make_claims(file: Path) -> list[Path]:
    """Measures what the rungs of a time budget cost, and writes it to a file."""
    head = "# Errors of contact force on each rung of solver.budget_ms, as a part of the peak force of the motion.\n"
    file.write_text(head + yaml.safe_dump(claims(), sort_keys=False), encoding="utf-8")
    return [file]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures what the rungs of a time budget cost, and writes it to a file."""
    module, place = "finger_sim.studies.tradeoff.rungs", "where to write: config/presets/rungs.yaml"
    what = "Measures what the rungs of a time budget cost, and writes it to a file."
    return make_files(module, what, place, make_claims, arguments)


if __name__ == "__main__":
    raise SystemExit(main())

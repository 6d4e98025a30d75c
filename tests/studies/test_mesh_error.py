"""What each shipped finger mesh answers at rest, pinned, and how far that is from the finger that is meant."""

from __future__ import annotations

import pytest
from truth.press import ANSWERS
from truth.press import DEPTHS as SMOOTH_DEPTHS

from finger_sim.scene.calibration import MODULUS
from finger_sim.scene.resources import shipped
from finger_sim.studies.at_rest import ORIENTATIONS, SETTING, Press
from finger_sim.studies.mesh_error import errors, finger_on, measured

NAMES = (
    "flat 0.5 mm [N]",
    "flat 1 mm [N]",
    "flat 1.5 mm [N]",
    "flat 2 mm [N]",
    "side 0.5 mm [N]",
    "side 1 mm [N]",
    "tip 0.5 mm [N]",
    "tip 1 mm [N]",
    "tangential 1 N [N/mm]",
    "area 1 N [mm²]",
    "tangential 4 N [N/mm]",
    "area 4 N [mm²]",
)
"""Of the numbers below; without limits, the first four."""
LIMITED = {
    "finger_500": (0.0505, 0.3664, 1.492, 5.288, 0.8373, 4.379, 0.087, 1.276, 0.8788, 88.34, 4.353, 136.7),
    "finger": (0.0672, 0.3711, 1.5, 7.438, 1.184, 6.13, 0.1446, 1.99, 0.7543, 103.6, 5.163, 104.3),
    "finger_2000": (0.0682, 0.3677, 1.497, 8.13, 1.462, 7.529, 0.1358, 1.755, 0.772, 97.16, 4.804, 107.5),
}
FREE = {
    "finger_500": (0.0420, 0.1681, 0.3872, 0.7200),
    "finger": (0.0528, 0.1922, 0.4512, 0.7957),
    "finger_2000": (0.0512, 0.1855, 0.4215, 0.7494),
    "finger_4000": (0.0512, 0.1806, 0.4029, 0.7342),
}
"""Mesh → its answers at YOUNG with limits and without, ν 0.45, as they were when they were judged."""
WORST = {"finger_500": (0.27, 0.14), "finger": (0.115, 0.105), "finger_2000": (0.055, 0.045)}
"""Mesh → how far the calibrated forces of a flat press are from the finger that is meant, with limits and without."""
PINNED = 0.01
"""Part by which an answer may leave its pin: a solver's tolerance, and limits that come and go."""


def require_pinned(mesh: str, *, limits: bool) -> None:
    """Answers are those that are pinned, and calibrated forces as near the meant ones as is stated."""
    found = measured(finger_on(mesh, limits=limits, calibrated=False))
    pinned = dict(zip(NAMES, (LIMITED if limits else FREE)[mesh], strict=False))
    for name, value in found.items():
        assert value == pytest.approx(pinned[name], rel=3.0 * PINNED if "tangential" in name else PINNED), name
    scene = finger_on(mesh, limits=limits)
    forces = {name: MODULUS[mesh] * value for name, value in found.items() if name.startswith("flat")}
    wrong = max(map(abs, errors(forces, scene).values()))
    assert wrong <= WORST[mesh][0 if limits else 1]


def test_the_smallest_meshes_press_as_they_did() -> None:
    """The default mesh without limits, the smallest one with them: forces at rest, stiffness along, contact area."""
    require_pinned("finger", limits=False)
    require_pinned("finger_500", limits=True)


@pytest.mark.slow
def test_the_other_meshes_press_as_they_did() -> None:
    """The default mesh with limits, all three presses; the next one without."""
    require_pinned("finger", limits=True)
    require_pinned("finger_500", limits=False)
    require_pinned("finger_2000", limits=False)


def test_patches_meet_quadratic_tetrahedra_on_a_smooth_table() -> None:
    """2,000 tetrahedra without friction and limits: within 4 % of the independent solution at every depth."""
    scene = finger_on("finger_2000", limits=False, calibrated=False)
    press = Press(scene.with_values(SETTING | {"plane.friction": 0.0}), ORIENTATIONS["flat"])
    for depth, answer in zip(SMOOTH_DEPTHS, ANSWERS[0.45], strict=True):
        assert press.to(depth) == pytest.approx(answer.force, rel=0.04)


def test_every_shipped_finger_has_a_modulus() -> None:
    """A mesh that is added is calibrated too; what is stated for it is a factor near one."""
    meshes = {path.stem for path in (shipped("config") / "meshes").glob("finger*.vtu")}
    assert meshes == set(MODULUS)
    assert all(0.8 < factor <= 1.25 for factor in MODULUS.values())

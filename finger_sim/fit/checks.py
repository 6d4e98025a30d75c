"""What is wrong with measured presses: refused where nothing can be fitted, told where a part of it is doubtful."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import Floats
from ..physics.rotations import Quaternion, matrix, normalised
from ..scene import Scene
from ..scene.mesh import TetMesh
from .press import FitError, Press

FEWEST = 8
"""Samples that a press takes while the finger touches."""
FORCES = (5e-3, 200.0)
"""Largest normal force of a press that is believed [N]."""
LONGEST = 3600.0
"""Longest press that is believed [s]."""
FIRM = 0.03
"""Part of the largest force that is one: less may be noise."""
SLIGHT = 0.005
"""Part of the largest force that is contact: force grows exponentially, and half of the way gives little of it."""
HELD = 5
"""So many equal samples in a row at the largest force, while the finger goes on, are a sensor at its end."""


def checked(presses: Sequence[Press], scene: Scene, mesh: TetMesh) -> tuple[list[Press], list[str]]:
    """The presses without what cannot be used, and what there is to tell.

    Raises FitError where a press cannot be fitted, with what was found and what may be the reason.
    """
    good, told = [], []
    for press in presses:
        _require_times(press)
        _require_units(press, scene, mesh)
        notes: list[str] = []
        press = _without_saturation(press, notes)
        _require_enough(press)
        _note_offsets(press, notes)
        good.append(press)
        told += [f"{press.name}: {note}" for note in notes]
    names = [press.name for press in good]
    for name in names:
        if names.count(name) > 1:
            raise FitError(f"{name}: two presses of this name, allowed: each its own")
    return good, told


def _require_times(press: Press) -> None:
    steps = np.diff(press.time)
    if (steps <= 0.0).any():
        at = int(np.argmax(steps <= 0.0)) + 1
        raise FitError(
            f"{press.name}: time: got {press.time[at]:g} s after {press.time[at - 1]:g} s, allowed: rising times"
        )
    if press.time[-1] - press.time[0] > LONGEST:
        raise FitError(
            f"{press.name}: time: got {press.time[-1] - press.time[0]:g} s for a press, "
            f"allowed: at most {LONGEST:g} s; is time in ms?"
        )


def _require_units(press: Press, scene: Scene, mesh: TetMesh) -> None:
    """Depths and forces that a finger can have."""
    depth, peak = press.depth, float(press.normal.max())
    deepest, thick = float(depth.max()), thickness(scene, mesh, press)
    rising = (
        float(np.corrcoef(depth, press.normal)[0, 1]) if np.ptp(depth) > 0.0 and np.ptp(press.normal) > 0.0 else 0.0
    )
    if deepest <= 0.0:
        found = f"{press.name}: depth: got {1e3 * depth.min():.4g} to {1e3 * deepest:.4g} mm"
        if rising < -0.3:
            raise FitError(f"{found}, negative while force rises, allowed: depth that grows downwards; turn its sign")
        raise FitError(f"{found}, never below first touch, allowed: some above 0; where is first touch?")
    if deepest > thick:
        guess = _guess(deepest, thick)
        raise FitError(
            f"{press.name}: depth: got {1e3 * deepest:.4g} mm, allowed: less than the {1e3 * thick:.3g} mm from skin "
            f"to bone of this mesh{guess}"
        )
    if deepest < 2e-5:
        raise FitError(
            f"{press.name}: depth: got {1e3 * deepest:.4g} mm at most, allowed: from 0.02 mm on; is it in m, not mm?"
        )
    if peak <= 0.0 or -float(press.normal.min()) > 2.0 * peak:
        raise FitError(
            f"{press.name}: normal: got {press.normal.min():.4g} to {peak:.4g} N, allowed: positive where the plane "
            f"pushes; is it the force of the finger on the plane?"
        )
    if not FORCES[0] <= peak <= FORCES[1]:
        why = "is it in mN, or in grams (gf)?" if peak > FORCES[1] else "is it in kN, or not scaled?"
        raise FitError(
            f"{press.name}: normal: got {peak:.4g} N at most, allowed: {FORCES[0]:g} to {FORCES[1]:g} N; {why}"
        )
    if rising < 0.2:
        raise FitError(
            f"{press.name}: normal: does not grow with depth (correlation {rising:.2f}), allowed: a press; "
            f"are the columns or the clocks mixed up?"
        )
    if press.tangential is not None and _size(press.tangential).max() > 5.0 * peak:
        raise FitError(
            f"{press.name}: tangential: got {_size(press.tangential).max():.4g} N where the normal force is at most "
            f"{peak:.4g} N, allowed: 5 times as much; is one of them in another unit?"
        )
    if press.area is not None and press.area.max() > 4.0 * thick**2 * 100.0:
        raise FitError(
            f"{press.name}: area: got {1e6 * press.area.max():.4g} mm² at most, allowed: {400e6 * thick**2:.3g} mm²; "
            f"is it in another unit?"
        )


def _guess(found: float, allowed: float) -> str:
    """Another unit that would do."""
    for factor, words in ((1e-3, "µm"), (1e-1, "tenths of a mm")):
        if 0.02 * allowed < found * factor < allowed:
            return f"; is it in {words}?"
    return "; where is first touch?"


def thickness(scene: Scene, mesh: TetMesh, press: Press) -> float:
    """As thickness_along, where a press is deepest."""
    return thickness_along(scene, mesh, normalised(press.orientation[int(np.argmax(press.depth))].tolist()))


def thickness_along(scene: Scene, mesh: TetMesh, orientation: Quaternion) -> float:
    """From where the skin first touches up to the lowest driven node [m]; without driven nodes the mesh's size."""
    heights = mesh.points @ matrix(orientation)[2]
    driven = scene.driven_nodes(mesh)
    if len(driven) == 0:
        return float(np.ptp(heights))
    return float(heights[driven].min() - heights[np.unique(mesh.surface)].min())


def _without_saturation(press: Press, notes: list[str]) -> Press:
    """Samples of a sensor that is at its end are left out."""
    peak = float(press.normal.max())
    at_end = press.normal >= peak * (1.0 - 1e-6)
    runs = np.flatnonzero(np.diff(np.concatenate([[0], at_end.astype(int), [0]])))
    flat = np.zeros(len(at_end), bool)
    for begin, end in zip(runs[::2], runs[1::2], strict=True):
        moves = float(np.ptp(press.depth[begin:end])) if end > begin else 0.0
        if end - begin >= HELD and moves > 0.01 * float(press.depth.max()):
            flat[begin:end] = True
    if not flat.any():
        return press
    span = press.depth[flat]
    notes.append(
        f"normal: {int(flat.sum())} samples at {peak:.4g} N while depth goes from {1e3 * span.min():.3g} to "
        f"{1e3 * span.max():.3g} mm: the sensor is at its end; they are left out"
    )
    return _kept(press, ~flat)


def _kept(press: Press, keep: Floats) -> Press:
    def of(values: Floats | None) -> Floats | None:
        return None if values is None else values[keep]

    return replace(
        press, time=press.time[keep], position=press.position[keep], orientation=press.orientation[keep],
        normal=press.normal[keep], tangential=of(press.tangential), area=of(press.area),
    )  # fmt: skip


def _require_enough(press: Press) -> None:
    count = int((press.depth > 0.0).sum())
    if count < FEWEST:
        raise FitError(f"{press.name}: got {count} samples while the finger touches, allowed: from {FEWEST} on")


def _note_offsets(press: Press, notes: list[str]) -> None:
    """Forces where there is no contact, and contact where there is no force."""
    depth, force, peak = press.depth, press.normal, float(press.normal.max())
    deepest = int(np.argmax(depth))
    clear = depth < -1e-4
    before, after = clear.copy(), clear.copy()
    before[deepest:], after[:deepest] = False, False
    noise = max(FIRM * peak, 5e-3)
    start = float(np.median(force[before])) if before.sum() >= 3 else math.nan
    end = float(np.median(force[after])) if after.sum() >= 3 else math.nan
    if abs(end - start) > 0.5 * noise and not math.isnan(end - start):
        notes.append(
            f"normal: drifts from {start:.3g} N before to {end:.3g} N after the press; the fit takes it for force: "
            f"take it out"
        )
    elif abs(start) > 0.5 * noise:
        notes.append(f"normal: {start:.3g} N before contact; zero the sensor")
    offset = 0.0 if math.isnan(start) else start
    early = np.flatnonzero((depth[:deepest] < -2e-5) & (force[:deepest] - offset > 0.5 * noise))
    if len(early) >= 2:
        at = int(early[0])
        notes.append(
            f"depth: force before contact: {force[at]:.3g} N at {1e3 * depth[at]:.3g} mm; first touch is earlier than "
            f"depth says: --fit touch, or depth from there"
        )
    late = np.flatnonzero(force[: deepest + 1] > max(SLIGHT * peak, 5e-3))
    if len(late) and depth[late[0]] > 0.5 * depth[deepest]:
        notes.append(
            f"depth: no force up to {1e3 * depth[late[0]]:.3g} of {1e3 * depth[deepest]:.3g} mm; first touch is later "
            f"than depth says: --fit touch"
        )
    if depth.min() < -5e-3:
        notes.append(f"depth: {1e3 * depth.min():.3g} mm: from far above; only what touches is used")


def _size(tangential: Floats) -> Floats:
    return np.abs(tangential) if tangential.ndim == 1 else np.asarray(np.linalg.norm(tangential, axis=1))

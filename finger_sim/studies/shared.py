"""What several studies use: a bag as one pose a step, strains apart from a step, a process on one processor."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ..arrays import Floats
from ..bags.reader import read_commands
from ..errors import FingerSimError
from ..scene import Pose, Scene
from ..scene.mesh import TetMesh
from ..scene.resources import find_bag


def poses(scene: Scene, bag: str) -> list[Pose]:
    """The newest command received by the start of each step of `scene.dt`, from the bag's first to its last."""
    commands = read_commands(find_bag(bag))
    starts = np.arange(0.0, commands.duration, scene.dt) + 1e-9
    newest = np.searchsorted(commands.receipt, starts, side="right") - 1
    position, orientation = commands.position[newest].tolist(), commands.orientation[newest].tolist()
    return [Pose((*p,), (*q,)) for p, q in zip(position, orientation, strict=True)]


def deformation(mesh: TetMesh, points: Floats) -> Floats:
    """F of each tetrahedron at node positions (n, 3) [m], columns along its material axes e1, e2, e3. (T, 3, 3)"""
    rest, now = (np.moveaxis(x[mesh.tets[:, :3]] - x[mesh.tets[:, 3:]], 1, 2) for x in (mesh.points, points))
    return np.asarray(now @ np.linalg.inv(rest) @ np.swapaxes(mesh.axes, 1, 2))


def stretches(F: Floats) -> tuple[Floats, Floats]:
    """Signed principal stretches s (T, 3) and axes V (T, 3, 3), in columns, of F (T, 3, 3)."""
    _, s, Vt = np.linalg.svd(F)
    s[:, 2] *= np.sign(np.linalg.det(F))
    return s, np.swapaxes(Vt, 1, 2)


def biot_strain(mesh: TetMesh, points: Floats) -> Floats:
    """E = U − I of each tetrahedron in its material axes, U = V diag(s) Vᵀ. (T, 3, 3)"""
    s, V = stretches(deformation(mesh, points))
    return np.asarray(V * s[:, None, :] @ np.swapaxes(V, 1, 2) - np.eye(3))


@contextmanager
def pinned(cpu: int | None) -> Iterator[int | None]:
    """This process on one processor (None: the last allowed one) inside a `with` block; gives which.

    Where processors cannot be chosen it gives None, unless one was asked for. Raises FingerSimError.
    """
    if not hasattr(os, "sched_setaffinity"):
        if cpu is not None:
            raise FingerSimError(f"--cpu: got {cpu}, allowed: nothing, this system pins no process")
        yield None
        return
    allowed = os.sched_getaffinity(0)
    chosen = max(allowed) if cpu is None else cpu
    if chosen not in allowed:
        raise FingerSimError(f"--cpu: got {cpu}, allowed: {', '.join(map(str, sorted(allowed)))}")
    os.sched_setaffinity(0, {chosen})
    try:
        yield chosen
    finally:
        os.sched_setaffinity(0, allowed)

"""`Case`: one scene and motion of `finger_sim stress`, and what is expected of it; written out so that it can be rerun.

A case is data alone: the same case gives the same bits, in this process or from the folder that `write` makes.
"""

from __future__ import annotations

import dataclasses
import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np
import yaml

from ...arrays import Floats, Ints
from ...bags.reader import START, write_commands
from ...plain import plain
from ...scene import Pose, Scene

MESH_FILE, SCENE_FILE, BAG, START_FILE, README = "mesh.vtu", "scene.yaml", "commands", "start.npy", "README.txt"
"""What a written case consists of."""


class RawMesh(NamedTuple):
    """A mesh that no one has checked yet."""

    points: Floats  # (n, 3) [m]
    tets: Ints  # (T, 4), nodes in VTK's order


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A scene, the commands of its steps, and what is expected.

    Rest at `motion[0]` is where it starts, unless `start` says otherwise. After `disturbed` steps it is left alone,
    and has to be where a twin is that was never disturbed: the same scene that holds `motion[0]` from the beginning.
    """

    name: str
    family: str
    scene: dict[str, Any]
    motion: tuple[Pose | None, ...]  # one a step; None: the last command holds
    cycles: int = 1  # times that the motion is gone through; more than once: without drift
    mesh: RawMesh | None = None  # written to MESH_FILE, which the scene names
    start: Floats | None = None  # (n, 3) positions at rest to start from, world [m]
    disturbed: int | None = None  # steps until the disturbance is over; None: it never is
    recovers: float = math.inf  # time within which the twin is met again, after that [s]
    force_limit: float = math.inf  # what the contact force must not exceed [N]

    @property
    def steps(self) -> int:
        return len(self.motion) * self.cycles


@contextmanager
def opened(case: Case) -> Iterator[Scene]:
    """The validated scene, as long as its mesh file is there. Raises SceneError."""
    with tempfile.TemporaryDirectory() as folder:
        if case.mesh is not None:
            write_mesh(case.mesh, Path(folder))
        yield Scene.from_dict(case.scene, base=folder)


def write_mesh(mesh: RawMesh, folder: Path) -> None:
    """The mesh as it is, sound or not."""
    meshio.write(folder / MESH_FILE, meshio.Mesh(mesh.points, [("tetra", mesh.tets)]), file_format="vtu")


def write(case: Case, folder: Path, why: str) -> Path:
    """Everything that `finger_sim run` needs to go through the case again, and why it was written.

    What a bag cannot hold is said in the README: a start that is not at rest, and many cycles.
    Whatever ends it before its end leaves no folder that was not there before.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        _fill(folder, case, why)
    except BaseException:
        if new:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def _fill(folder: Path, case: Case, why: str) -> None:
    (folder / SCENE_FILE).write_text(
        yaml.safe_dump(plain(case.scene), sort_keys=False, allow_unicode=True), encoding="utf-8"
    )
    if case.mesh is not None:
        write_mesh(case.mesh, folder)
    dt = float(case.scene.get("dt", 1e-3))
    sent = [(k, pose) for k, pose in enumerate(case.motion) if pose is not None]
    last = case.motion[-1] or sent[-1][1]
    sent += [(len(case.motion) - 1, last)] if case.motion[-1] is None else []
    write_commands(
        folder / BAG,
        [START + round(k * dt * 1e9) for k, _ in sent],
        np.array([pose.position for _, pose in sent], np.float64),
        np.array([pose.orientation for _, pose in sent], np.float64),
    )
    lines = [f"{case.name}: {why}", "", f"finger_sim run {SCENE_FILE} --bag {BAG} -o again"]
    if case.cycles > 1:
        lines.append(f"The bag holds one cycle of {case.cycles}.")
    if case.start is not None:
        np.save(folder / START_FILE, case.start)
        lines.append(f"It does not start at rest: Simulator.set_state(positions, 0) with positions from {START_FILE}.")
    (folder / README).write_text("\n".join(lines) + "\n", encoding="utf-8")

"""Finished runs on disk, so that a study that was interrupted goes on: one file each, named by what it depends on."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ...physics.sources import digest, imported
from ...scene import Scene
from ..bench.bench import describe_machine
from .motion import Motion, TradeoffError
from .run import NAMES, Course, Times, portable

Kind = Literal["course", "times"]
_PACKAGE = Path(__file__).parents[2]


class Job(NamedTuple):
    """One run to make: of its answers, or of its times."""

    kind: Kind
    scene: Scene
    motion: Motion
    drift: bool  # of energy, too; for its answers only
    cost: float  # about how long it takes, in units of its own
    key: str  # names its file


def job(kind: Kind, scene: Scene, motion: Motion, tets: int, drift: bool = False) -> Job:
    """A job and its key: a hash over scene, mesh, motion, sources, and for times the processor."""
    solver = scene.solver
    sweeps = scene.substeps * (1 + solver.relinearizations) * (3.0 if solver.tolerance < 1e-7 else 1.0)
    cost = (20.0 + motion.steps(scene.dt) * sweeps) * tets**1.5 * (2.0 if kind == "times" else 1.0)
    depends: dict[str, Any] = {"scene": portable(scene), "motion": motion.digest, "code": code_digest()}
    if scene.mesh.file is not None:
        depends["mesh"] = _file_digest(scene.mesh.file)
    depends |= {"drift": drift} if kind == "course" else {"cpu": describe_machine()["cpu"]}
    text = json.dumps(depends | {"kind": kind}, sort_keys=True)
    return Job(kind, scene, motion, drift, cost, hashlib.sha256(text.encode()).hexdigest()[:20])


@cache
def code_digest() -> str:
    """Hash of the sources that a run depends on."""
    return digest(_PACKAGE, sources())[:16]


def sources() -> list[Path]:
    """All that run.py imports, directly or not."""
    return imported(_PACKAGE, [_PACKAGE / "studies" / "tradeoff" / "run.py"])


def writable(folder: Path) -> Path:
    """The folder, made where it is missing. Raises TradeoffError when nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise TradeoffError(f"--out: {folder}: cannot be written: {error.strerror}") from None
    return folder


class Store:
    """A folder of finished runs: answers as .npz, times as .json. Raises TradeoffError when it cannot be written."""

    def __init__(self, folder: Path) -> None:
        self._folder = writable(folder)

    def load(self, job: Job) -> Course | Times | None:
        """What a job gave before; None when it is not there, or not whole."""
        try:
            if job.kind == "times":
                return Times(**json.loads(self._path(job).read_text(encoding="utf-8"))["times"])
            with np.load(self._path(job)) as data:
                return Course(**{name: data[name] for name in NAMES})
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
            return None

    def save(self, job: Job, result: Course | Times) -> None:
        """Write what a job gave, whole or not at all."""
        path = self._path(job)
        part = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            with part.open("wb") as file:
                if isinstance(result, Course):
                    values: Mapping[str, Any] = {name: getattr(result, name) for name in NAMES}
                    np.savez(file, allow_pickle=False, **values)
                else:
                    whole = {"times": dataclasses.asdict(result), "scene": portable(job.scene)}
                    file.write(json.dumps(whole, indent=1).encode())
            part.replace(path)
        except OSError as error:
            raise TradeoffError(f"--out: {path}: cannot be written: {error.strerror}") from None

    def _path(self, job: Job) -> Path:
        return self._folder / f"{job.key}.{'json' if job.kind == 'times' else 'npz'}"


@cache
def _file_digest(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]

"""Simulated presses, made in parallel on Dask and kept on disk: a fit that was interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..console import say
from ..errors import FingerSimError
from ..physics.sources import digest, imported
from ..studies.tradeoff import pool
from .press import FitError
from .press import Path as Way
from .simulate import Run, pressed

Meter = Callable[[float, float], None]
_PACKAGE = Path(__file__).parents[1]


class Job(NamedTuple):
    """A press to simulate; key: names what it gives."""

    scene: dict[str, Any]
    way: Way
    area: bool
    key: str


def job(scene: Mapping[str, Any], way: Way, area: bool) -> Job:
    """A job and its key: a hash over scene, mesh, way and sources."""
    text = json.dumps([scene, _mesh_digest(scene["mesh"].get("file")), area, code_digest()], sort_keys=True)
    key = hashlib.sha256(text.encode() + way.poses.tobytes() + way.steps.tobytes()).hexdigest()[:24]
    return Job(dict(scene), way, area, key)


@cache
def code_digest() -> str:
    """Hash of the sources that a run depends on."""
    return digest(_PACKAGE, imported(_PACKAGE, [_PACKAGE / "fit" / "simulate.py"]))[:16]


@cache
def _mesh_digest(file: str | None) -> str:
    from ..scene.resources import find_mesh

    return "" if file is None else hashlib.sha256(find_mesh(file, Path()).read_bytes()).hexdigest()[:16]


class Runner:
    """Makes jobs, each once.

    folder : where finished runs are kept; None: only in memory
    client : of Dask; None: in this process
    meter  : told how many runs are made of how many that are foreseen
    """

    def __init__(self, folder: Path | None = None, client: Any = None, meter: Meter | None = None) -> None:
        self._folder, self._client, self._meter = folder, client, meter
        self._known: dict[str, Run] = {}
        self.made = self.found = 0
        """Runs that were simulated, and those that were there before."""
        self.foreseen = 1
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                (folder / ".writable").touch()
                (folder / ".writable").unlink()
            except OSError as error:
                raise FitError(f"--work: {folder}: cannot be written: {error.strerror}") from None

    def __call__(self, jobs: Sequence[Job]) -> list[Run]:
        """What each gives, in order. Raises FitError where a scene was refused."""
        missing = {}
        for each in jobs:
            if each.key not in self._known and (run := self._load(each.key)) is not None:
                self._known[each.key], self.found = run, self.found + 1
            if each.key not in self._known:
                missing[each.key] = each
        for key, run in self._make(list(missing.values())):
            self._known[key], self.made = run, self.made + 1
            self._save(key, run)
            if self._meter is not None:
                self.foreseen = max(self.foreseen, self.made + self.found)
                self._meter(self.made + self.found, self.foreseen)
        return [self._known[each.key] for each in jobs]

    def _make(self, jobs: Sequence[Job]) -> Iterator[tuple[str, Run]]:
        if self._client is None or len(jobs) < 2:
            for each in jobs:
                yield each.key, _good(attempt(each.scene, each.way.poses, each.way.steps, each.area))
            return
        from distributed import as_completed

        waiting = {
            self._client.submit(attempt, each.scene, each.way.poses, each.way.steps, each.area, pure=False): each.key
            for each in jobs
        }
        for future in as_completed(list(waiting), loop=self._client.loop):
            yield waiting.pop(future), _good(future.result())

    def _load(self, key: str) -> Run | None:
        if self._folder is None:
            return None
        try:
            with np.load(self._folder / f"{key}.npz") as data:
                return Run(*(data[name] for name in Run._fields))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def _save(self, key: str, run: Run) -> None:
        """Whole or not at all."""
        if self._folder is None:
            return
        part = self._folder / f".{key}.{os.getpid()}"
        values: dict[str, Floats] = run._asdict()
        try:
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **values)
            part.replace(self._folder / f"{key}.npz")
        except OSError as error:
            raise FitError(f"--work: {self._folder}: cannot be written: {error.strerror}") from None


def attempt(*arguments: Any) -> Run | str:
    """A run, or why its scene was refused: errors of this package do not travel between processes."""
    try:
        return pressed(*arguments)
    except FingerSimError as error:
        return str(error)


def _good(run: Run | str) -> Run:
    if isinstance(run, str):
        raise FitError(run)
    return run


@contextmanager
def runner(folder: Path | None, workers: int | None, scheduler: str | None, meter: Meter | None) -> Iterator[Runner]:
    """A Runner for a `with` block: on a Dask scheduler, on so many own processes, or, without Dask, in this one.

    workers: None: one for each processor; 1: this process
    """
    if workers == 1 and scheduler is None:
        yield Runner(folder, None, meter)
        return
    try:
        import distributed  # noqa: F401
    except ImportError:
        if scheduler is not None or workers is not None:
            pool.require_dask()
        say("one process: more at once need the extra [tradeoff]: pip install 'finger_sim[tradeoff]'")
        yield Runner(folder, None, meter)
        return
    with pool.connected(scheduler, workers) as client:
        yield Runner(folder, client, meter)

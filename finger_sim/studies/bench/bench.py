"""`finger_sim bench`: how long a step takes, always beside how well it was solved; the finger, and peers on it.

Whole steps are timed in one process on one processor: each contender runs its whole motion, one after the other, over
and over. Peers run without limits, which they do not have; their errors are against our own converged run without.
"""

from __future__ import annotations

import datetime
import math
import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Ints
from ...console import gauge
from ...errors import MissingExtraError
from ...scene import Scene
from ..shared import pinned
from . import passes, peers
from .figures import (
    DEFAULT_SIZE,
    LEVEL,
    MUJOCO,
    PATCHED,
    UNIT_SIZE,
    Figure,
    Key,
    Records,
    Row,
    by_repetition,
    figures,
    median_and_p99,
    ratio,
    row,
    unsteadiness,
)
from .scenes import (
    CANTILEVER,
    CANTILEVER_FINER,
    CANTILEVER_STEPS,
    LOOSER,
    MESHES,
    PATCHES,
    PHASES,
    SCALES,
    TIGHT,
    BenchError,
    Motion,
    Ours,
    Record,
    Runner,
    Theirs,
    converged,
    fall,
    finger_scene,
    press_and_slide,
    touch_height,
)

Makers = Mapping[str, Callable[[peers.PeerCase], peers.Peer]]

CONTENDERS = {
    350: [("limits", "newton"), ("limits", "lagged"), ("limits", "pgs"), ("limited", "newton"),
          ("limited", "lagged"), ("limited", "pgs"), ("no limits", "newton")],
    900: [("limits", "newton"), ("limits", "lagged"), ("limits", "patch"), ("limits", "patch lagged"),
           ("limited", "newton"), ("limited", "patch")],
    2000: [("limits", "newton"), ("limits", "lagged"), ("limits", "patch"), ("limited", "newton")],
    4000: [("limits", "newton"), ("limits", "lagged"), ("limited", "newton")],
    16000: [("limits", "lagged")],
}  # fmt: skip
"""Our own at each size: (scene, solver)."""
STAGED = [("limits", "newton"), ("limits", "lagged"), ("limited", "newton")]
"""Of which the stages are timed."""
STEADY = 2.0
"""p99/median of fixed work beyond which a machine is too noisy to judge that of a step."""
NEO_HOOKEAN = "MuJoCo nH"
"""Name of MuJoCo with its other material."""
START_SCENE = "finger_haptic"
"""Shipped scene that `starts` builds."""


@dataclass(frozen=True)
class Options:
    """What to run."""

    sizes: tuple[int, ...] = (350, 900, 2000, 4000)
    repeats: int = 3
    scale: float = 1.0  # of the steps that SCALES leaves
    cpu: int | None = None  # None: the last allowed one
    peers: bool = True
    startup: bool = True

    def check(self) -> None:
        """Raises BenchError naming the option."""
        for size in self.sizes:
            if size not in MESHES:
                raise BenchError(f"--sizes: got {size}, allowed: {', '.join(map(str, MESHES))}")
        if not self.sizes:
            raise BenchError(f"--sizes: got nothing, allowed: {', '.join(map(str, MESHES))}")
        if self.repeats < 1:
            raise BenchError(f"--repeats: got {self.repeats}, allowed: a whole number ≥ 1")
        if not 0.0 < self.scale <= 100.0:
            raise BenchError(f"--steps: got {self.scale}, allowed: above 0, to 100")


QUICK = Options(sizes=(350,), repeats=1, startup=False)
"""Half a minute."""


@dataclass(frozen=True)
class Report:
    """All that was measured."""

    machine: dict[str, Any]
    rows: list[Row]
    cantilever: list[Row]
    stages: list[dict[str, Any]]  # size, scene, contender, phase, and microseconds of each stage a step: <stage>_us
    figures: list[Figure]
    peers: dict[str, str]  # name: what it is, or why it is missing


def bench(options: Options) -> Report:
    """Run it all. Raises BenchError when an option cannot be met."""
    options.check()
    with pinned(options.cpu):
        pass  # a mistake shows before anything long
    machine, extras, stages = describe_machine(), dict[str, tuple[float, str]](), list[dict[str, Any]]()
    if options.startup:
        extras |= _starts()
    records = Records()
    found = peers.available() if options.peers else {}
    said = peers.missing() if options.peers else dict.fromkeys(peers.missing() | peers.available(), "not asked for")
    said = {name: f"missing: {reason}" if options.peers else reason for name, reason in said.items()}
    with pinned(options.cpu) as cpu:
        machine["cpu_index"] = cpu
        for size in sorted(set(options.sizes)):
            said |= _finger(size, options, _peers_at(size, found), records)
            stages += _stages(size, options)
        cantilever = _cantilever(options, found)
        if UNIT_SIZE in options.sizes:
            extras["allocations"] = _allocations(options)
        if DEFAULT_SIZE in options.sizes:
            extras |= {"p99": _steadiness(options), "patch": _patch_to_element(options)}
    return Report(machine, records.rows(), cantilever, stages, figures(records, extras), said)


def describe_machine() -> dict[str, Any]:
    """Date, processor and versions."""
    cpu = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).is_file():
        models = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = models[0].partition(":")[2].strip() if models else cpu
    versions = {"python": platform.python_version()}
    for name in ("finger_sim", "numpy", "numba", "mujoco", "drake"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "cpu": cpu,
        "cpus_allowed": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load_average": list(os.getloadavg()),
        "system": platform.platform(),
        "versions": versions,
    }


def _motion(size: int, options: Options) -> Motion:
    scene = finger_scene(size, "limits")
    return press_and_slide(touch_height(scene), scene.dt, options.scale * SCALES.get(size, 1.0))


def _finger(size: int, options: Options, found: Makers, records: Records) -> dict[str, str]:
    """The contenders of one size into `records`; gives the full names of the peers."""
    motion = _motion(size, options)
    keys = [Key(size, limits, solver) for limits, solver in CONTENDERS[size]]
    with gauge(f"{size} tetrahedra: converged runs to compare with"):
        solved = {_body(key) for key in [*keys, *(Key(size, "no limits", name) for name in found)]}
        reference = {body: _reference(finger_scene(size, *body), motion) for body in sorted(solved)}
    with gauge(f"{size} tetrahedra: {options.repeats} repetitions of {len(motion.poses)} steps") as meter:
        runners: dict[Key, Runner] = {key: Ours(finger_scene(size, key.scene, key.contender), motion) for key in keys}
        bare, names = finger_scene(size, "no limits"), {}
        for name, make in found.items():
            try:
                peer = Theirs(bare, motion, make)
            except MissingExtraError as error:
                names[name] = f"missing: {error}"
                continue
            runners[Key(size, "no limits", name)], names[name] = peer, peer.name
        came = passes.interleaved(runners, options.repeats, meter)
    if size == DEFAULT_SIZE:
        key, body = Key(size, "limits", PATCHED), ("limits", PATCHES)
        with gauge(f"{size} tetrahedra: further converged runs"):
            records.others[key] = [_reference(finger_scene(size, *body), motion, tolerance=t) for t in LOOSER]
    records.of |= came
    records.reference |= {key: reference[_body(key)] for key in came}
    records.phase[size] = motion.phase
    return names


def _body(key: Key) -> tuple[str, str]:
    """What is solved: limits, and `patch` or, with single tetrahedra, `newton`."""
    return key.scene, PATCHES if key.contender.startswith(PATCHES) else "newton"


def _patch_to_element(options: Options) -> tuple[float, str]:
    """Patches to elements on the default mesh, `lagged` as our scenes have it; the two take turns."""
    motion = _motion(DEFAULT_SIZE, options)
    keys = [Key(DEFAULT_SIZE, "limits", contender) for contender in (PATCHED, LEVEL)]
    runners: dict[Key, Runner] = {key: Ours(finger_scene(*key), motion) for key in keys}
    with gauge("patches beside elements") as meter:
        came = passes.interleaved(runners, options.repeats, meter)
    patch, element = (came[key].seconds[:, motion.phase > PHASES.index("air")] for key in keys)
    ours, theirs = (1e6 * median_and_p99(seconds)[0] for seconds in (patch, element))
    return ratio(patch, element), f"{ours:.0f} µs to {theirs:.0f} µs{by_repetition(patch, element)}"


def _peers_at(size: int, found: Makers) -> Makers:
    """All at UNIT_SIZE, with MuJoCo's other material too, as the two bracket ours; MuJoCo on the default mesh."""
    if size == UNIT_SIZE and MUJOCO in found:
        return {**found, NEO_HOOKEAN: partial(peers.mujoco_peer, neo_hookean=True)}
    return {name: make for name, make in found.items() if size == UNIT_SIZE or (size, name) == (DEFAULT_SIZE, MUJOCO)}


def _reference(scene: Scene, motion: Motion, tip: Ints | None = None, tolerance: float = TIGHT) -> Record:
    return passes.once(Ours(scene=converged(scene, tolerance), motion=motion, tip=tip), lambda done, total: None)


def _stages(size: int, options: Options) -> list[dict[str, Any]]:
    motion, out = _motion(size, options), []
    for limits, solver in STAGED:
        with gauge(f"{size} tetrahedra: stages of {solver}, {limits}") as meter:
            runner = Ours(finger_scene(size, limits, solver), motion, timed=True)
            for phase, spent in passes.stages(runner, meter).items():
                row = {"size": size, "phase": phase, "scene": limits, "contender": solver}
                out.append(row | {f"{stage}_us": 1e6 * seconds for stage, seconds in spent.items()})
    return out


def _cantilever(options: Options, found: Makers) -> list[Row]:
    """The beam falling from rest, ours and the peers; errors of the tip are against ours at a finer time step."""
    steps = max(1, round(CANTILEVER_STEPS * min(1.0, options.scale)))
    scene = Scene.load(CANTILEVER).with_values({"solver.method": "newton"})
    points = scene.load_mesh().points
    tip, motion = np.flatnonzero(points[:, 0] >= points[:, 0].max() - 1e-9), fall(steps)
    with gauge(f"cantilever: {options.repeats} repetitions of {steps} steps") as meter:
        reference = _reference(scene.with_values({"substeps": CANTILEVER_FINER}), motion, tip)
        runners: dict[str, Runner] = {"newton": Ours(scene, motion, tip)}
        runners |= {name: Theirs(scene, motion, make, tip) for name, make in found.items()}
        records = passes.interleaved(runners, options.repeats, meter)
    theirs = records[MUJOCO].seconds if MUJOCO in records else np.empty((0, 0))
    everything = np.ones(steps, np.bool_)
    tets = len(scene.load_mesh().tets)
    return [
        row(Key(tets, "cantilever", name), "fall", record, reference, everything, theirs)
        for name, record in records.items()
    ]


def _steadiness(options: Options) -> tuple[float, str]:
    """p99 over median of steps of the default mesh with patches, to that of fixed work."""
    runner = Ours(finger_scene(DEFAULT_SIZE, "limits", PATCHED), _motion(DEFAULT_SIZE, options))
    with gauge("p99 beside fixed work") as meter:
        ours, work = passes.steadiness(runner, options.repeats, meter)
    both = unsteadiness(ours), unsteadiness(work)
    p50, p99, p999, most = (1e6 * np.percentile(ours, (50.0, 99.0, 99.9, 100.0))).round()
    note = f"{len(ours)} steps, p50 {p50:.0f}, p99 {p99:.0f}, p99.9 {p999:.0f}, max {most:.0f} µs; work: {both[1]:.2f}"
    if both[1] <= STEADY:
        return both[0] / both[1], note
    return math.nan, f"{note}: {both[0] / both[1]:.2f}, but too noisy to tell"


def _allocations(options: Options) -> tuple[float, str]:
    """Of compiled code, at UNIT_SIZE."""
    counted = passes.allocations(Ours(finger_scene(UNIT_SIZE, "limits"), _motion(UNIT_SIZE, options)))
    return math.nan if counted is None else counted, "numba's count, whole motion but 10 steps"


def _starts() -> dict[str, tuple[float, str]]:
    with gauge("start of a process with nothing compiled, then compiled before") as meter:
        cold, cached = passes.starts(START_SCENE, 3, meter)
    spread = f"{min(cached):.2f} to {max(cached):.2f} s"
    return {
        "cold": (cold, f"Simulator(Scene.load({START_SCENE!r})), import included; once"),
        "cached": (float(np.median(cached)), f"the same, median of {len(cached)}, {spread}"),
    }

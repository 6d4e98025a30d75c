"""What `finger_sim bench` runs: its scenes, its motion, and the contenders that run them. All numbers are here."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ...arrays import Floats, Ints
from ...errors import FingerSimError
from ...physics.step import Status
from ...scene import Pose, Scene, place
from ...scene.resources import shipped
from ...simulation.simulator import Simulator
from .peers import Peer, PeerCase

MESHES = {
    350: "meshes/finger_paper.vtu",
    900: "meshes/finger.vtu",
    2000: "meshes/finger_2000.vtu",
    4000: "meshes/finger_4000.vtu",
    16000: "meshes/finger_16000.vtu",
}
"""Shipped meshes, by about how many tetrahedra they have."""
FLAT = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""Orientation of the finger with its pad on the table."""
BASE: dict[str, Any] = {
    "driven": "bone",
    "material": {"density": 1000.0, "young": 2.0e6, "poisson": 0.4, "damping": {"mass": 0.0, "stiffness": 0.002}},
    "plane": {"friction": 0.5, "stiffness": 10.0},
    "solver": {"method": "newton", "tolerance": 1e-3, "max_iterations": 30, "settle": False, "sleep": False},
    "dt": 1e-3,
}
"""What the scenes share."""
LIMITS: dict[str, dict[str, Any] | None] = {
    "limits": {
        "projection": "tensor",
        "stretch": [1.05, 1.25, 1.02],
        "compress": [0.95, 0.75, 0.98],
        "stiffness": 10.0,
    },
    "limited": {
        "projection": "tensor",
        "stretch": [1.004, 1.02, 1.002],
        "compress": [0.996, 0.98, 0.998],
        "stiffness": 3.0,
    },
    "no limits": None,
}
"""The scenes: the paper's limits; such that four tetrahedra in five are at one; none, as peers have none."""
SOLVERS: dict[str, dict[str, Any]] = {
    "newton": {},
    "lagged": {"level": "lagged"},
    "pgs": {"method": "pgs", "max_iterations": 400},
    "patch": {},
    "patch lagged": {"level": "lagged"},
}
"""What each solver changes in `solver`."""
PATCHES = "patch"
"""Solvers whose names begin so solve a body whose patches share a volume strain, the others one of single tets."""
TIGHT = 1e-9
CONVERGED: dict[str, Any] = {"method": "newton", "tolerance": TIGHT, "max_iterations": 200}
"""`solver` of the runs that errors are measured against."""
LOOSER = (1e-5, 1e-6, 1e-7, 1e-8)
"""Tolerances of further converged runs: what these differ by is not known any better."""

SPEED = 0.02
"""Of the bone, in every phase [m/s]."""
GAP, DEPTH = 0.2e-3, 2e-3
"""Height over the table in free air, depth the undeformed pad is pressed to [m]."""
PHASES = ("air", "press", "slide")
"""Sideways in free air; straight down, then held; along the table."""
AIR, HOLD, SLIDE = 100, 100, 250
"""Steps of the phases at full length, without those of the way down."""
SCALES = {4000: 0.2}
"""Share of AIR, HOLD and SLIDE run at a size; 1 where not named."""

CANTILEVER = "beam_stiff"
"""The shipped scene that falls from rest under gravity."""
CANTILEVER_STEPS, CANTILEVER_FINER = 300, 8
"""Steps of its fall; the reference has so many steps in the place of one."""


class BenchError(FingerSimError):
    """A benchmark that cannot be run as asked: the option, the value and what is allowed."""


@dataclass(frozen=True)
class Motion:
    """Poses of the bone at the end of each step, and the phase each step belongs to."""

    start: Pose
    poses: tuple[Pose, ...]
    phase: Ints  # (steps,) index into PHASES


def press_and_slide(touch: float, dt: float, scale: float = 1.0) -> Motion:
    """The motion of every finger scene. touch: height of the bone where the undeformed pad touches the table [m].

    scale shortens what is steady, not the way down. At least one step is left of each phase.
    """
    step = SPEED * dt
    air, hold, slide = (max(1, round(scale * steps)) for steps in (AIR, HOLD, SLIDE))
    down = round((GAP + DEPTH) / step)
    x = step * np.concatenate([np.arange(1 - air, 1), np.zeros(down + hold), np.arange(1, slide + 1)])
    z = touch + GAP - step * np.concatenate([np.zeros(air), np.arange(1, down + 1), np.full(hold + slide, down)])
    phase = np.repeat(np.arange(3), [air, down + hold, slide])
    poses = tuple(Pose((float(a), 0.0, float(b)), FLAT) for a, b in zip(x, z, strict=True))
    return Motion(Pose((-step * air, 0.0, touch + GAP), FLAT), poses, phase)


def fall(steps: int) -> Motion:
    """A bone that does not move."""
    return Motion(Pose(), (Pose(),) * steps, np.zeros(steps, np.int64))


def finger_scene(size: int, limits: str, solver: str = "newton") -> Scene:
    """A finger scene of `MESHES`, `LIMITS` and `SOLVERS`. Raises BenchError when its mesh is not there."""
    if not (shipped("config") / MESHES[size]).is_file():
        raise BenchError(f"{MESHES[size]}: this mesh is not in {shipped('config')}")
    data = BASE | {"mesh": {"file": MESHES[size]}, "solver": BASE["solver"] | SOLVERS[solver]}
    if solver.startswith(PATCHES):
        data["material"] = BASE["material"] | {"volumetric": "patch"}
    if LIMITS[limits] is not None:
        data["limits"] = LIMITS[limits]
    return Scene.from_dict(data, base=shipped("config"))


def converged(scene: Scene, tolerance: float = TIGHT) -> Scene:
    """The scene for the run that errors are measured against."""
    solver = dataclasses.replace(scene.solver, level="standard", **CONVERGED | {"tolerance": tolerance})
    return dataclasses.replace(scene, solver=solver)


def touch_height(scene: Scene) -> float:
    """Height of the bone at which the lowest node that is not driven is at z = 0 [m]."""
    mesh = scene.load_mesh()
    soft = np.setdiff1d(np.arange(len(mesh.points)), scene.driven_nodes(mesh))
    return -float(place(mesh.points[soft], Pose((0.0, 0.0, 0.0), FLAT))[:, 2].min())


@dataclass(frozen=True, eq=False)
class Record:
    """What one contender did, step by step: one column for each step of the motion."""

    seconds: Floats  # (repeats, steps) [s]
    answer: Floats  # (steps, 3) contact force [N]; of the cantilever: displacement of the tip [m]
    iterations: Floats  # (steps,); this and all below: NaN when not known
    residual: Floats  # (steps,)
    converged: Floats  # (steps,) 1 where the solver met its tolerance, else 0
    limit_rows: Floats  # (steps,)
    limited_tets: Floats  # (steps,)
    status: Ints  # (steps,)

    @staticmethod
    def empty(repeats: int, steps: int) -> Record:
        def unknown(*shape: int) -> Floats:
            return np.full(shape, np.nan)

        return Record(
            seconds=unknown(repeats, steps),
            answer=unknown(steps, 3),
            iterations=unknown(steps),
            residual=unknown(steps),
            converged=unknown(steps),
            limit_rows=unknown(steps),
            limited_tets=unknown(steps),
            status=np.zeros(steps, np.int64),
        )


class Runner(Protocol):
    """A contender, ready to run its motion."""

    @property
    def given(self) -> Sequence[Any]:
        """What each step is called with."""

    def begin(self) -> Callable[[Any], Any]:
        """Back to the start of the motion; returns the step, all that is timed."""

    def observe(self, k: int, came: Any, record: Record) -> None:
        """Note what step k gave, which returned `came`."""


class Ours:
    """`Simulator` as a contender. tip: nodes whose mean displacement is the answer; without, it is contact force."""

    def __init__(self, scene: Scene, motion: Motion, tip: Ints | None = None, timed: bool = False) -> None:
        self.simulator = Simulator(scene, timed=timed)
        self.motion, self.given, self._tip = motion, motion.poses, tip

    def begin(self) -> Callable[[Any], Any]:
        self.simulator.reset(self.motion.start)
        return self.simulator.step

    def observe(self, k: int, came: Any, record: Record) -> None:
        record.answer[k] = came.contact_wrench[:3]
        if self._tip is not None:
            record.answer[k] = (self.simulator.positions - self.simulator.mesh.points)[self._tip].mean(axis=0)
        record.iterations[k], record.residual[k] = came.iterations, came.residual
        record.converged[k] = not came.status & (Status.ITERATION_LIMIT | Status.STEP_REJECTED)
        record.limit_rows[k], record.limited_tets[k] = came.limit_rows, came.limited_tets
        record.status[k] = int(came.status)


class Theirs:
    """A peer as a contender, on the mesh, motion and plane of a scene without limits."""

    def __init__(self, scene: Scene, motion: Motion, make: Callable[[PeerCase], Peer], tip: Ints | None = None) -> None:
        mesh, material = scene.load_mesh(), scene.material
        driven = scene.driven_nodes(mesh)
        self._case = PeerCase(
            points=place(mesh.points, motion.start),
            tets=mesh.tets,
            surface=mesh.surface,
            driven=driven,
            density=material.density,
            young=material.young,
            poisson=material.poisson,
            damping_stiffness=material.damping.stiffness,
            dt=scene.dt,
            gravity=np.array(scene.gravity),
            friction=scene.plane.friction if scene.plane else None,
        )
        self.given = [place(mesh.points[driven], pose) for pose in motion.poses]
        self._make, self._tip = make, tip
        self._peer = make(self._case)
        self.name = self._peer.name

    def begin(self) -> Callable[[Any], Any]:
        self._peer = self._make(self._case)
        return self._peer.step

    def observe(self, k: int, came: Any, record: Record) -> None:
        if self._tip is None:
            record.answer[k] = self._peer.force()
        else:
            record.answer[k] = (self._peer.positions() - self._case.points)[self._tip].mean(axis=0)

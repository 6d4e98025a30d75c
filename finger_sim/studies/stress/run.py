"""One case from its first step to a verdict: ok, degraded, refused or failed."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import math
import threading
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from ...arrays import Floats
from ...errors import FingerSimError, SceneError
from ...physics.rotations import normalised
from ...physics.step import Status
from ...scene import Pose, Scene
from ...simulation.simulator import Simulator
from .case import Case, opened
from .measures import Body
from .watch import Watch

Kind = Literal["ok", "degraded", "refused", "failed"]
MakeSimulator = Callable[[Scene], Simulator]

STEP_LIMIT = 20.0
"""Processor time after which a step counts as one that never returns [s]; the slowest of the cases takes 0.01 s."""
NEAR = 1e-3
"""Of the body's size: so near to the undisturbed twin is recovered."""
DRIFT = 1e-3
"""Of the largest force: what a wrench may differ by from that of the second cycle at the same place."""
GLANCES = 97
"""From the fourth cycle on, only every so many steps get more than a glance."""
LET_GO = 10_000
"""Steps in which a body that ended broken has to be whole again when nothing but its bone holds it: most are in 400;
one that has rigid limits without room took 8000."""
BROKEN = 0.9
"""Largest |stretch − 1| of a body that is seen to heal by itself: one that is inside out has more."""
WHOLE = 0.02
"""Largest |stretch − 1| of a body that is whole."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How a case ended, and the worst on the way."""

    name: str
    family: str
    kind: Kind
    status: Status = Status.OK  # bits that any step had
    said: str = ""  # of a refusal: the error
    failures: tuple[str, ...] = ()  # check: what was wrong
    strain_ratio: float = 0.0
    penetration: float = 0.0  # [m]
    force: float = 0.0  # [N]
    energy_excess: float = 0.0  # of the energies at play
    recovery: float | None = None  # time until the undisturbed twin was met again [s]
    drift: float | None = None  # of the largest force
    steps: int = 0
    digest: str = ""  # of all positions and wrenches
    seconds: float = dataclasses.field(default=0.0, compare=False)


class StepClock:
    """Processor time of a step [s], of the thread that makes this: waiting for a processor does not count.

    A step of more than `limit` is a hang. `hung` is called from another thread when such a step has not returned; until
    `close`.
    """

    def __init__(self, limit: float = STEP_LIMIT, hung: Callable[[], None] | None = None) -> None:
        self.limit = limit
        self._began = math.inf
        self._closed = threading.Event()
        if hung is not None and hasattr(time, "pthread_getcpuclockid"):
            clock = time.pthread_getcpuclockid(threading.get_ident())
            threading.Thread(target=self._look, args=(clock, hung), daemon=True).start()

    def begin(self) -> None:
        """A step begins."""
        self._began = time.thread_time()

    def end(self) -> float:
        """It ended: what it took [s]."""
        spent, self._began = time.thread_time() - self._began, math.inf
        return spent

    def close(self) -> None:
        """No step is looked at any more, not even one that was begun and raised."""
        self._closed.set()

    def _look(self, clock: int, hung: Callable[[], None]) -> None:
        with contextlib.suppress(OSError):  # the thread that is looked at has ended
            while not self._closed.wait(min(1.0, 0.5 * self.limit)):
                if time.clock_gettime(clock) - self._began > self.limit:
                    hung()
                    return


def run(case: Case, make: MakeSimulator = Simulator, clock: StepClock | None = None) -> Outcome:
    """Go through the case. Nothing that goes wrong in it is raised, but KeyboardInterrupt."""
    began = time.monotonic()
    try:
        with opened(case) as scene, np.errstate(all="ignore"):
            outcome = _Run(case, scene, make, clock or StepClock()).outcome()
    except FingerSimError as error:
        outcome = Outcome(case.name, case.family, "refused", said=str(error))
    except Exception as error:
        outcome = Outcome(case.name, case.family, "failed", failures=(f"crash: {type(error).__name__}: {error}",))
    return dataclasses.replace(outcome, seconds=time.monotonic() - began)


def verdict(failures: tuple[str, ...], refused: str, status: Status) -> Kind:
    """The worst that can be said of a case."""
    if failures:
        return "failed"
    if refused:
        return "refused"
    return "degraded" if status else "ok"


class _Run:
    """A case under way."""

    def __init__(self, case: Case, scene: Scene, make: MakeSimulator, clock: StepClock) -> None:
        self.case, self.scene, self.make = case, scene, make
        first = case.motion[0] or scene.initial_pose
        self.sim = make(scene)
        self.sim.reset(first)
        if case.start is not None:
            self.sim.set_state(case.start, np.zeros_like(case.start))
        self.twin = make(scene) if case.disturbed is not None else None
        if self.twin is not None:
            self.twin.reset(first)
        orientations = {pose.orientation for pose in case.motion if pose is not None}
        self.watch = Watch(scene, self.sim, len(orientations) == 1)
        self.command = first
        self.refused = ""
        self.digest = hashlib.sha256()
        self.steps = self.apart = 0
        self.cycle = np.zeros((len(case.motion), 6))
        self.drift = np.zeros(len(case.motion))
        self.clock = clock

    def outcome(self) -> Outcome:
        """Every step, then what can only be judged at the end."""
        case, watch = self.case, self.watch
        while self.steps < case.steps and self._step():
            pass
        if self.steps == case.steps:
            self._judge_end()
        failures = tuple(f"{check}: {text}" for check, text in watch.failures.items())
        return Outcome(
            case.name,
            case.family,
            verdict(failures, self.refused, watch.status),
            status=watch.status,
            said=self.refused,
            failures=failures,
            strain_ratio=watch.strain,
            penetration=watch.penetration,
            force=watch.force,
            energy_excess=watch.excess,
            recovery=None if case.disturbed is None else self.apart * self.scene.dt,
            drift=float(self.drift.max()) if case.cycles > 1 else None,
            steps=self.steps,
            digest=self.digest.hexdigest(),
        )

    def _step(self) -> bool:
        """One step; a command that is refused has to leave everything as it is."""
        case, sim, place_in_cycle = self.case, self.sim, self.steps % len(self.case.motion)
        command = case.motion[place_in_cycle]
        before = sim.positions.copy()
        self.clock.begin()
        try:
            out = sim.step(command)
            if command is not None:
                self.command = Pose(command.position, normalised(command.orientation))
        except SceneError as error:
            self.refused = str(error)
            if not np.array_equal(before, sim.positions):
                self.watch.fail("refusal", f"step {self.steps}: a refused command changed the state")
            out = sim.step(None)
        if (spent := self.clock.end()) > self.clock.limit:
            self.watch.fail("hang", f"step {self.steps} of {case.steps}: {spent:.3g} s of processor time")
            return False
        looked_at = self.steps < 3 * len(case.motion) or self.steps % GLANCES == 0
        if not (self.watch.step if looked_at else self.watch.glance)(self.steps, out, self.command):
            return False
        self.digest.update(sim.positions.tobytes() + out.contact_wrench.tobytes())
        if case.cycles > 1:
            self._compare(place_in_cycle, out.contact_wrench)
        if self.twin is not None and case.disturbed is not None:
            self.twin.step(None)
            away = apart(sim.positions, self.twin.positions, len(self.watch.driven) == 0)
            if self.steps >= case.disturbed and away > NEAR * self.watch.body.size:
                self.apart = self.steps + 1 - case.disturbed
        self.steps += 1
        return True

    def _compare(self, place_in_cycle: int, wrench: Floats) -> None:
        """The second cycle is what later ones have to repeat: the first begins at rest."""
        cycle = self.steps // len(self.case.motion)
        if cycle == 1:
            self.cycle[place_in_cycle] = wrench
        elif cycle > 1:
            peak = np.abs(self.cycle).max(axis=0).reshape(2, 3).max(axis=1).repeat(3) + 1e-300
            off = float((np.abs(wrench - self.cycle[place_in_cycle]) / peak).max())
            self.drift[place_in_cycle] = max(self.drift[place_in_cycle], off)

    def _judge_end(self) -> None:
        case, watch = self.case, self.watch
        if case.disturbed is not None and self.apart * self.scene.dt > case.recovers:
            watch.fail("recovery", f"not met its twin again {case.recovers:.3g} s after the disturbance")
        if watch.force > case.force_limit:
            watch.fail("force", f"{watch.force:.4g} N, allowed: {case.force_limit:.4g} N")
        if (most := float(self.drift.max())) > DRIFT:
            watch.fail("drift", f"wrench {most:.2g} of its peak off the second cycle at the same place")
        if _misshapen(watch.body, self.sim.positions) > BROKEN:
            left = let_go(self.scene, self.sim, self.make)
            if not left <= WHOLE:
                watch.fail("broken", f"let go, a stretch is still {left:.3g} off 1 after {LET_GO} steps")


def apart(x: Floats, y: Floats, free: bool) -> float:
    """Largest distance of a node in x from the same in y, (n, 3) [m]; of a free body, after the best rigid motion."""
    if free:
        x, y = x - x.mean(axis=0), y - y.mean(axis=0)
        U, _, Vt = np.linalg.svd(x.T @ y)
        U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
        x = x @ U @ Vt
    return float(np.linalg.norm(x - y, axis=1).max())


def let_go(scene: Scene, sim: Simulator, make: MakeSimulator) -> float:
    """Largest |stretch − 1| left once the body is whole, or after LET_GO steps.

    A step is one fifth of the time sound takes across the body, 0.1 s at most. The body is as it is now, with gravity,
    plane and motion gone, and damped; its stress does not relax. 0 where sound takes more than 5 s.
    """
    material = scene.material
    crossing = Body(scene, sim.mesh).size * (material.density / material.young) ** 0.5
    if crossing > 5.0:
        return 0.0
    calm = scene.to_dict() | {"gravity": [0.0, 0.0, 0.0], "plane": None, "dt": min(max(1e-6, 0.2 * crossing), 0.1)}
    calm["material"] = {
        **calm["material"],
        "relaxation": [],
        "damping": {"mass": min(1e6, 1.0 / crossing), "stiffness": 0.0},
    }
    free = make(Scene.from_dict(calm))
    free.reset(sim.pose)
    free.set_state(sim.positions, np.zeros_like(sim.positions))
    body = Body(scene, sim.mesh)
    for step in range(LET_GO):
        free.step(None)
        if step % GLANCES == 0 and _misshapen(body, free.positions) <= WHOLE:
            break
    return _misshapen(body, free.positions)


def _misshapen(body: Body, x: Floats) -> float:
    """Largest |stretch − 1|."""
    return float(np.abs(body.shape(x).s - 1.0).max())

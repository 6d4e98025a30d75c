"""`Watch`: looks at every step of a case from outside, and notes what was wrong without the status saying so.

    finite       every number of the result, positions, velocities, contact forces
    driven       driven nodes are where the pose says
    speed        the bone goes no faster than the coupling allows, and COMMAND_LIMITED says when that holds it back
    wrench       force and torque are the sum of the nodes' contact forces
    inverted     INVERTED says when det F < 0 of a tetrahedron, by LAPACK                         not REJECTED
    strain       max_strain_ratio is LAPACK's (`isotropic`, `tensor`), LIMIT_EXCEEDED its word    not REJECTED
    cone         contact forces push, friction is within μ of them, to the solver's tolerance     not EXCUSED
    penetration  a free node is no deeper than its contact's spring gives by the force gained in  not EXCUSED, OVERCOME
                 the step; one that has just arrived may be a step of the bone late
    momentum     a free body changes its momentum by gravity and contact alone, to MOMENTUM       not EXCUSED, OVERCOME
    energy       none comes from nowhere: stress_energy.py; known where the bone does not turn    not EXCUSED, OVERCOME

EXCUSED is a step whose status says that it was not solved, REJECTED one that was not taken, OVERCOME one whose status
says that the body is beyond its limits or inside out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Floats
from ...physics.rotations import angle
from ...physics.step import Status
from ...scene import Pose, Scene, place
from ...simulation.result import StepResult
from ...simulation.simulator import Simulator
from .energy import Ledger, Moment
from .measures import Body, Shape, polar, strain_ratio

LEAST = 1e-3
"""Part of G · length² that a solver judges forces by, at most."""
REJECTED = Status.NONFINITE | Status.STEP_REJECTED | Status.RESTORED
EXCUSED = REJECTED | Status.ITERATION_LIMIT | Status.ROW_LIMIT
OVERCOME = Status.LIMIT_EXCEEDED | Status.INVERTED
INERTIA = 30.0
"""A contact is at least so many times as stiff as its node's inertia in one step: see physics/contact.py."""
LOOK = 5
"""Strain is looked at by LAPACK once in so many steps."""
MOMENTUM = 1e-3
"""Of the forces and momenta at play: more than that is no round-off of the solver."""


class Watch:
    """Everything noted about one run; `failures` has the first of each check."""

    def __init__(self, scene: Scene, sim: Simulator, one_orientation: bool) -> None:
        self.scene, self.sim, self.body = scene, sim, Body(scene, sim.mesh)
        self.failures: dict[str, str] = {}
        self.status = Status.OK
        self.strain = self.penetration = self.force = self.excess = 0.0
        solver = scene.solver
        self._exact = solver.relinearizations == 0 and solver.level == "standard" and scene.substeps == 1
        settles = solver.settle and solver.method == "newton" and scene.limits is not None
        self._length = float(np.cbrt(self.body.volume.mean()))
        self.driven = np.flatnonzero(~self.body.free)
        surface = np.unique(sim.mesh.surface)
        self._contacts = surface[self.body.free[surface]]
        self._stale = False  # whether what is kept is older than the step before
        self._keep()
        fades = bool(scene.material.relaxation)  # what is stored then is not to be seen in where the nodes are
        known = self._exact and one_orientation and not settles and not fades
        self._ledger = Ledger(scene, self.body, self._moment()) if known else None

    def _begin_again(self) -> None:
        """The state that was kept is where energy counts from."""
        self._stale = False
        if self._ledger is not None:
            self._ledger.begin(self._moment())

    def _keep(self) -> None:
        sim = self.sim
        self._x, self._v, self._f = sim.positions.copy(), sim.velocities.copy(), sim.contact_forces.copy()
        self._pose = sim.pose
        self._F = self.body.gradient(self._x)
        self._polar: Shape | None = None

    def _shape(self) -> Shape:
        """The decomposition of F at what was kept, once it is asked for."""
        if self._polar is None:
            self._polar = polar(self._F)
        return self._polar

    def _moment(self) -> Moment:
        return Moment(self._x, self._v, self._shape())

    def fail(self, check: str, text: str) -> None:
        """Note what was wrong, if it is the first time."""
        self.failures.setdefault(check, text)

    def step(self, number: int, out: StepResult, command: Pose) -> bool:
        """Look at what step `number` gave. False: not finite, there is no sense in going on."""
        self.status |= out.status
        where = f"step {number}"
        if not self._finite(out):
            self.fail("finite", f"{where}: a number that is not finite, status {out.status!r}")
            return False
        self._bone(out, command, where)
        self._wrench(out, where)
        self._peaks(out)
        moment = self._moment() if self._ledger is not None else None
        x, v, f, pose = self._x, self._v, self._f, self._pose
        excused = bool(out.status & EXCUSED) or self._stale
        self._keep()
        if not out.status & REJECTED:
            self._mesh(out, where)
            if number % LOOK == 0:
                self._strain(out, where)
        if not excused and self.scene.plane is not None:
            self._cone(where)
        if excused or out.status & OVERCOME:
            self._begin_again()
            return True
        if self.scene.plane is not None:
            self._sunk(pose, f, out, where)
        if self._exact:
            self._balance(x, v, pose, moment, out, where)
        return True

    def _balance(self, x: Floats, v: Floats, pose: Pose, before: Moment | None, out: StepResult, where: str) -> None:
        """Momentum and energy of a step from x, v and the bone at `pose`."""
        force, held = self._external(v), out.limit_rows > 0 or out.contacts > 0
        if not len(self.driven):
            self._momentum(force, v, out, where)
        if self._ledger is None or before is None:
            return
        moved = np.array(self._pose.position) - np.array(pose.position) if len(self.driven) else np.zeros(3)
        work = float(force @ moved + (self._f * (self._x - x)).sum())
        unseen = abs(self.body.linearised_away(before.shape, self._shape()))
        if held:
            unseen += self._unsolved() * float(np.abs(self._x - x).max())
        self._ledger.add(work, unseen, not held)
        if out.limit_rows > 0 and not self._ledger.springs_known:
            self._ledger.begin(self._moment())
        excess, part, too_much = self._ledger.from_nowhere(self._moment())
        self.excess = max(self.excess, part)
        if too_much:
            self.fail("energy", f"{where}: {excess:.3g} J from nowhere, {part:.2g} of all")

    def glance(self, number: int, out: StepResult, command: Pose) -> bool:
        """`step` for a few of its checks: whether all is finite, the bone, and the worst of everything."""
        self.status |= out.status
        if not self._finite(out):
            self.fail("finite", f"step {number}: a number that is not finite, status {out.status!r}")
            return False
        self._bone(out, command, f"step {number}")
        self._peaks(out)
        self._stale, self._pose = True, self.sim.pose
        return True

    def _peaks(self, out: StepResult) -> None:
        self.force = max(self.force, float(np.linalg.norm(out.contact_wrench[:3])))
        self.penetration = max(self.penetration, out.max_penetration)
        self.strain = max(self.strain, out.max_strain_ratio)

    def _finite(self, out: StepResult) -> bool:
        numbers: tuple[float, ...] = (out.time, out.residual, out.max_strain_ratio, out.max_penetration)
        if out.status & EXCUSED:
            numbers = numbers[:1] + numbers[2:]
        arrays: tuple[ArrayLike, ...] = (
            out.contact_wrench, out.device_wrench, out.pose.position, out.pose.orientation,
            self.sim.positions, self.sim.velocities, self.sim.contact_forces, self.sim.strain_ratio,
        )  # fmt: skip
        return all(map(math.isfinite, numbers)) and all(np.isfinite(a).all() for a in arrays)

    def _bone(self, out: StepResult, command: Pose, where: str) -> None:
        if not len(self.driven):
            return
        coupling, dt, was = self.scene.coupling, self.scene.dt, self._pose
        reach = self.body.size + math.hypot(*out.pose.position)
        target = place(self.sim.mesh.points[self.driven], out.pose)
        off = float(np.abs(self.sim.positions[self.driven] - target).max())
        if off > 1e-12 * reach:
            self.fail("driven", f"{where}: a driven node is {off:.3g} m from where the pose has it")
        went, turned = math.dist(was.position, out.pose.position), angle(was.orientation, out.pose.orientation)
        if went > coupling.max_speed * dt * (1 + 1e-9) + 1e-12 * reach:
            self.fail("speed", f"{where}: the bone moved at {went / dt:.3g} m/s")
        if turned > coupling.max_angular_speed * dt * (1 + 1e-9) + 1e-12:
            self.fail("speed", f"{where}: the bone turned at {turned / dt:.3g} rad/s")
        there = math.dist(out.pose.position, command.position) <= 1e-12 * reach
        there &= angle(out.pose.orientation, command.orientation) < 1e-12
        late = self.sim.follower.delay(coupling.following) > 0.0  # after a step whose command was refused
        if not there and not late and not out.status & Status.COMMAND_LIMITED:
            self.fail("speed", f"{where}: the bone is not at the command, and COMMAND_LIMITED is not set")

    def _wrench(self, out: StepResult, where: str) -> None:
        forces, arms = self.sim.contact_forces, self.sim.positions - np.array(out.pose.position)
        torque = np.cross(arms, forces)
        off = np.abs(out.contact_wrench - np.concatenate([forces.sum(axis=0), torque.sum(axis=0)]))
        reach = self.body.size + math.hypot(*out.pose.position) + float(np.abs(self.sim.positions).max())
        allowed = 1e-9 * np.repeat([np.abs(forces).sum(), reach * np.abs(forces).sum()], 3)
        if (off > allowed + 1e-300).any():
            self.fail("wrench", f"{where}: off the sum of contact forces by {off.max():.3g}")

    def _mesh(self, out: StepResult, where: str) -> None:
        det = float(np.linalg.det(self._F).min())
        size = float(np.abs(self._F).max()) ** 3
        sure = abs(det) > (1e-9 + 30.0 * self._noise()) * max(size, 1.0)
        if sure and (det < 0.0) != bool(out.status & Status.INVERTED):
            self.fail("inverted", f"{where}: least det F {det:.3g}, status {out.status!r}")
        said = bool(out.status & Status.LIMIT_EXCEEDED)
        if said != (out.max_strain_ratio > 1.5):
            self.fail("strain", f"{where}: strain/limit {out.max_strain_ratio:.3g}, status {out.status!r}")

    def _strain(self, out: StepResult, where: str) -> None:
        """The result's strain/limit beside LAPACK's, for the projections and shapes that leave no choice of axes."""
        limits = self.scene.limits
        if limits is None or limits.projection not in ("isotropic", "tensor"):
            return
        shape = self._shape()
        pair = (shape.s[:, 1] + shape.s[:, 2]).min()  # where it vanishes R is not unique, nor the Biot strain
        if limits.projection == "tensor" and pair <= 1e-6 * shape.s.max():
            return
        rooms = np.concatenate([limits.stretch_room, limits.compress_room])
        least = float(rooms.min())
        blur = 30.0 * self._noise() * shape.s.max() / max(least, 1e-6)
        blur += least < 1e-9  # without room, 0 is as good as 1
        ratio = max(strain_ratio(limits, self.body.bounded(shape)), 0.0)
        if abs(out.max_strain_ratio - ratio) > 1e-3 * max(ratio, 1e-3) + blur:
            self.fail("strain", f"{where}: strain/limit {out.max_strain_ratio:.6g}, by LAPACK {ratio:.6g}")

    def _noise(self) -> float:
        """What round-off of positions that are far away, and of slivers, does to F."""
        return 1e-14 * float(np.abs(self._x).max()) * float(np.abs(self.body.inverse).max())

    def _normals(self) -> tuple[Floats, Floats]:
        """Normal parts (n,) of contact forces [N], and gaps [m]."""
        assert self.scene.plane is not None
        normal = self.scene.plane.unit_normal
        return self._f @ normal, (self._x - np.array(self.scene.plane.point)) @ normal

    def _cone(self, where: str) -> None:
        assert self.scene.plane is not None
        pressed, _ = self._normals()
        along = np.linalg.norm(self._f - np.outer(pressed, self.scene.plane.unit_normal), axis=1)
        mu, largest = self.scene.plane.friction, float(np.abs(self._f).max())
        slack = (4.0 * (1.0 + mu) * self.scene.solver.tolerance + 1e-9) * largest
        if pressed.min() < -slack or (along - mu * pressed).max() > slack:
            self.fail("cone", f"{where}: a contact force outside Coulomb's cone, μ {mu:.3g}")

    def _sunk(self, was: Pose, before: Floats, out: StepResult, where: str) -> None:
        """Gap of each free node + (gain of its force) / stiffness ≥ 0, to the solver's tolerance."""
        assert self.scene.plane is not None
        plane, h = self.scene.plane, self.scene.dt / self.scene.substeps
        pressed, gap = self._normals()
        nodes = self._contacts
        spring = plane.stiffness * self.scene.material.young * self._length if plane.stiffness else math.inf
        yields = h * h / self.body.mass[nodes]
        compliance = np.minimum(1.0 / spring, yields / INERTIA)
        gain = np.maximum(pressed - before @ plane.unit_normal, 0.0)[nodes]
        largest = max(float(pressed.max()), LEAST * self.body.shear * self._length**2)
        slack = 4.0 * self.scene.solver.tolerance * largest * (compliance + 8.0 * yields)
        slack = slack + (pressed[nodes] <= 0.0) * math.dist(self._pose.position, was.position)
        slack += 1e-9 * self.body.size + 1e-12 * float(np.abs(self._x).max())
        deep = -gap[nodes] - compliance * gain - slack
        if self.scene.substeps == 1 and out.limit_rows == 0 and deep.max() > 0.0:
            node = int(nodes[deep.argmax()])
            self.fail("penetration", f"{where}: node {node} is {-gap[node]:.3g} m deep, {deep.max():.3g} m unexplained")

    def _external(self, v: Floats) -> Floats:
        """Force of the bone on the free nodes, by their momentum (3,) [N]: all but gravity and contact. v: before."""
        h, m = self.scene.dt, self.body.mass[self.body.free, None]
        now, then = self._v[self.body.free], v[self.body.free]
        rate = ((1.0 + h * self.scene.material.damping.mass) * now - then) / h
        force: Floats = (m * (rate - self.body.gravity)).sum(axis=0) - self._f.sum(axis=0)
        return force

    def _unsolved(self) -> float:
        """Force that the solver may leave at all nodes together [N], limit forces not counted."""
        largest = max(float(np.abs(self._f).max()), LEAST * self.body.shear * self._length**2)
        return 2.0 * self.scene.solver.tolerance * len(self._f) * largest

    def _momentum(self, external: Floats, v: Floats, out: StepResult, where: str) -> None:
        scene, m = self.scene, self.body.mass
        if scene.solver.method == "newton" and out.limit_rows > 0:
            return  # it may leave `tolerance` of the limits' own forces
        carried = m @ (np.abs(v) + np.abs(self._v)).max(axis=1) / scene.dt + m.sum() * np.abs(self.body.gravity).max()
        pushed = float(np.abs(self._f).sum())
        roundoff = 1e-13 * scene.material.young * self.body.size * float(np.abs(self._x).max())
        allowed = MOMENTUM * (carried + pushed) + roundoff
        if out.limit_rows or out.contacts:
            allowed += self._unsolved()
        if not self._v.any():  # it was as good as at rest, and fell asleep
            allowed += carried
        if np.abs(external).max() > allowed:
            self.fail("momentum", f"{where}: {np.abs(external).max():.3g} N from nowhere, {allowed:.3g} allowed")

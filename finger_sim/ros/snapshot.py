"""A body as other threads see it: the loop copies it between two steps, without the interpreter, when it is asked to.

Who asks sleeps until the copy is there. The loop looks at one word a step, and copies some ten kilobytes when asked.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import time
import weakref
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..haptics.path import pose_of
from ..physics.atomics import load_acquire, store_release
from ..physics.compile import stage
from ..physics.lanes import aligned
from ..physics.model import State
from ..physics.rotations import matrix
from ..scene import Pose
from ..simulation.ground import frame_of
from ..simulation.simulator import Simulator
from ..simulation.touch import Imprint
from ..simulation.whole import Body
from .accounts import Counted, Window, nothing_counted
from .memory import call


class Copied(NamedTuple):
    """A copy, for compiled code; arrays are flat.

    asked   : (1,) 1 where one is wanted; 0 when it is there
    write   : address of write(2), and
    event   : an eventfd, to which is written then
    one     : (1,) 1, which is written
    steps   : (1,) since the last reset
    stamp   : (1,) of the last step, and
    at      : (1,) the steady time at which it began [ns]
    positions, velocities, forces, strains, ratios : State.x, v, contact_force, limit_strain, strain_ratio
    pose    : (7,) of the finger frame
    device  : (6,) wrench that a device was sent
    placed, plane, normal, point, twist : of the Table of the plane; plane: its `pose`
    counted : of the steps since the last copy, if they are counted here
    """

    asked: Ints
    write: int
    event: int
    one: Ints
    steps: Ints
    stamp: Ints
    at: Ints
    positions: Floats
    velocities: Floats
    forces: Floats
    strains: Floats
    ratios: Floats
    pose: Floats
    device: Floats
    placed: Floats
    plane: Floats
    normal: Floats
    point: Floats
    twist: Floats
    counted: Counted


@stage
def hand_over(copied: Copied, state: State, body: Body, device: Floats, stamp: int, at: int) -> None:
    """Makes the copy that is asked for. device, stamp, at: of the last step."""
    table = body.table
    copied.steps[0], copied.stamp[0], copied.at[0] = body.steps[0], stamp, at
    _copy(copied.positions, state.x.reshape(-1))
    _copy(copied.velocities, state.v.reshape(-1))
    _copy(copied.forces, state.contact_force.reshape(-1))
    _copy(copied.strains, state.limit_strain.reshape(-1))
    _copy(copied.ratios, state.strain_ratio)
    _copy(copied.pose, body.pose)
    _copy(copied.device, device)
    _copy(copied.placed, table.placed)
    _copy(copied.plane, table.pose)
    _copy(copied.normal, table.normal)
    _copy(copied.point, table.point)
    _copy(copied.twist, table.twist)


@stage
def take_counted(copied: Copied, counted: Counted) -> None:
    """What was counted goes into the copy, and begins anew."""
    _take(copied.counted.steps, counted.steps)
    _take(copied.counted.asleep, counted.asleep)
    _take(copied.counted.status, counted.status)
    _take(copied.counted.troubled, counted.troubled)
    _take(copied.counted.doubtful, counted.doubtful)
    _take(copied.counted.iterations, counted.iterations)
    _take(copied.counted.residual, counted.residual)
    _take(copied.counted.most, counted.most)


@stage
def is_there(copied: Copied) -> None:
    """Who asked is woken."""
    store_release(copied.asked, 0, 0)
    call(copied.write, (copied.event, copied.one.ctypes.data, 8))


@stage
def _copy(out: Floats, values: Floats) -> None:
    for k in range(out.shape[0]):
        out[k] = values[k]


@stage
def _take(out: Any, values: Any) -> None:
    for k in range(out.shape[0]):
        out[k] = values[k]
        values[k] = 0


class Shown(NamedTuple):
    """A body at the end of a step, until the next copy is asked for."""

    pose: Pose
    plane: Pose | None
    stamp: int  # of the step [ns]
    at: int  # steady time at which the step began [ns]
    positions: Floats  # of the nodes (n, 3) [m], world
    forces: Floats  # of the plane on each node (n, 3) [N], world
    strain: Floats  # strain/limit of each tetrahedron (T,)
    device: Floats  # force and torque that a device was sent (6,) [N, N m]


class Snapshot:
    """Asks the loop for copies; of one thread. record: for compiled code."""

    def __init__(self, state: State) -> None:
        """state: of the body, for its sizes."""
        write = ctypes.cast(ctypes.CDLL(None).write, ctypes.c_void_p).value
        assert write is not None
        event = os.eventfd(0, os.EFD_CLOEXEC)
        asked, steps, stamp, at = np.zeros((4, 1), np.int64)
        x, v, forces = (np.zeros(part.size) for part in (state.x, state.v, state.contact_force))
        strains = aligned(state.limit_strain.size)
        self.record = Copied(
            asked, write, event, np.ones(1, np.int64), steps, stamp, at, x, v, forces, strains,
            np.zeros(state.strain_ratio.size), np.zeros(7), np.zeros(6), np.zeros(1), np.zeros(7), np.zeros(3),
            np.zeros(3), np.zeros(6), nothing_counted(),
        )  # fmt: skip
        self.close = weakref.finalize(self, os.close, event)
        """To be called when no compiled code uses the record any more."""

    def take(self, timeout: float) -> bool:
        """Waits for a copy of the present; False: the loop has made none within `timeout` [s]."""
        asked, event, end = self.record.asked, self.record.event, time.monotonic() + timeout
        store_release(asked, 0, 1)
        while load_acquire(asked, 0) != 0:
            left = max(end - time.monotonic(), 0.0)
            with contextlib.suppress(OSError):
                if select.select([event], [], [], left)[0]:
                    os.read(event, 8)
                    continue
            asked[0] = 0
            return False
        return True

    def shown(self, sim: Simulator, whole: bool) -> Shown | None:
        """What the last copy shows; None: of no step. whole: with the strain of a mesh."""
        own = self.record
        if own.steps[0] == 0:
            return None
        strain = sim.strains_of(own.strains, own.ratios) if whole else np.zeros(0)
        return Shown(
            pose_of(own.pose), self._plane(sim), int(own.stamp[0]), int(own.at[0]),
            own.positions.reshape(-1, 4)[:, :3], own.forces.reshape(-1, 3), strain, own.device,
        )  # fmt: skip

    def imprint(self, sim: Simulator) -> Imprint:
        """What the last copy tells of the touch."""
        own, pose, plane = self.record, self._plane(sim), sim.scene.plane
        return Imprint(
            own.positions.reshape(-1, 4)[:, :3], own.velocities.reshape(-1, 4)[:, :3], own.forces.reshape(-1, 3),
            sim.mesh.surface, np.zeros(3) if pose is None else np.array(pose.position), own.twist,
            np.zeros(3) if pose is None else matrix(pose.orientation)[:, 2], 0.0 if plane is None else plane.friction,
            sim.scene.solver.tolerance,
        )  # fmt: skip

    def window(self) -> Window:
        """The steps that were counted until the last copy, since the one before."""
        return Window.of(self.record.counted)

    def _plane(self, sim: Simulator) -> Pose | None:
        own = self.record
        return None if sim.scene.plane is None else frame_of(own.placed, own.plane, own.normal, own.point)

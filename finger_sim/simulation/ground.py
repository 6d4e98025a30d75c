"""The plane under the body: where it is, and how it follows targets that come less often than steps."""

from __future__ import annotations

from numba import types

from ..arrays import Floats
from ..errors import SceneError
from ..haptics import carrying
from ..haptics.carrying import build_table, nearest, turned
from ..haptics.coupling import LONGEST_GAP
from ..haptics.path import numbers, pose_of
from ..physics.contact import plane_frame
from ..physics.model import State
from ..physics.records import direct, held
from ..scene import Coupling, Plane, Pose, Vec3, checked_pose

_POSE = types.UniTuple(types.float64, 7)

KERNELS = (*carrying.KERNELS, plane_frame)
"""What a Ground calls."""


def frame_of(placed: Floats, pose: Floats, normal: Floats, point: Floats) -> Pose:
    """Ground.frame of the arrays of a Table."""
    if placed[0] != 0.0:
        return pose_of(pose)
    (a, b, c), (x, y, z) = normal.tolist(), point.tolist()
    return Pose((x, y, z), turned((a, b, c), (0.0, 0.0, 1.0)))


class Ground:
    """Where a plane is, and how fast; compiled code moves it (haptics/carrying.py).

    table : what it knows, for compiled code

    plane: of the scene; None: there is none.
    """

    def __init__(self, plane: Plane | None) -> None:
        self.table = build_table()
        self._held = held(self.table)
        self._begin = direct(carrying.begin, self._held, _POSE)
        self._lay = direct(carrying.lay, self._held)
        if plane is not None:
            self.table.exists[0] = 1.0
            self.table.normal[:], self.table.point[:] = plane.unit_normal, plane.point

    def __bool__(self) -> bool:
        """Whether there is a plane."""
        return bool(self.table.exists[0] != 0.0)

    @property
    def surface(self) -> tuple[Vec3, Vec3]:
        """Unit outward normal and a point [m] at the end of the last step, world."""
        (a, b, c), (x, y, z) = self.table.normal.tolist(), self.table.point.tolist()
        return (a, b, c), (x, y, z)

    @property
    def frame(self) -> Pose:
        """The plane is the x-y plane of this pose now, its z the outward normal, world; before any target too."""
        table = self.table
        return frame_of(table.placed, table.pose, table.normal, table.point)

    @property
    def twist(self) -> Floats:
        """(6,) velocity of that pose's origin [m/s] and angular velocity [rad/s] in the last step, world."""
        return self.table.twist.copy()

    def allow(self, coupling: Coupling) -> None:
        """How fast it goes from now on: as the coupling allows."""
        self.table.fastest[:] = coupling.max_speed, coupling.max_angular_speed

    def aim(self, target: Pose) -> None:
        """Where it is to go from the next step on, as the x-y plane of a pose."""
        self.table.target[:], self.table.given[0] = numbers(target), 1.0

    def move(self, plane: Plane) -> None:
        """Go to another plane of the scene, from the next step on."""
        table = self.table
        if table.placed[0] == 0.0:
            self._begin(self._held, numbers(self.frame))
        x, y, z = plane.unit_normal.tolist()
        table.goal[:] = nearest(numbers(pose_of(table.pose)), (x, y, z), plane.point)
        table.left[0] = LONGEST_GAP

    def arrive(self, target: Pose | None = None) -> None:
        """At rest where it is to go: at `target`, or at the last one."""
        table = self.table
        if target is not None:
            table.goal[:] = numbers(target)
            table.placed[0] = table.anchored[0] = 1.0
        table.given[0] = 0.0
        if table.placed[0] != 0.0:
            table.pose[:] = table.before[:] = table.goal
            self._lay(self._held)
        table.twist[:] = 0.0

    def write(self, state: State) -> None:
        """The plane as it is, at rest, into the state of a body."""
        if self:
            plane_frame(self.table.normal, state.plane_frame)
            state.plane_point[:], state.plane_motion[:] = self.table.point, 0.0
            state.clearance[0] = -1.0


def checked_target(ground: Ground, target: Pose | None) -> Pose | None:
    """A target with a unit quaternion; None where there is none. Raises SceneError, also where there is no plane."""
    if target is not None and not ground:
        raise SceneError("plane", None, "a scene with a plane, to move it")
    return None if target is None else checked_pose(target, "plane")

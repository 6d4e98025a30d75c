"""Where finger and plane are, as /tf and /tf_static tell it to viewers.

Three frames stand in the world's: the finger frame, its twin with the world's axes (frame_id of wrenches), and the
plane, z its outward normal. A plane that stands is on /tf_static; from where it has moved on, it is on /tf.
"""

from __future__ import annotations

import re

from ..scene import Pose
from . import cdr
from .layout import wrench_frame_id
from .metadata import Qos
from .template import Template, doubles, marks, stamp_bytes

MOVING, STANDING = "/tf", "/tf_static"
MOVING_QOS, STANDING_QOS = Qos(depth=100), Qos(depth=1, transient_local=True)
"""As tf2's broadcasters offer them."""
PLANE = "plane"
"""Name of the plane's frame."""

_LEVEL = (0.0, 0.0, 0.0, 1.0)
_MARK = 1_234_567_891_123_456_789
"""A time that no other field of a message of transforms looks like [ns]."""


class Frames:
    """The frames of one recording, as TFMessage.

    world  : frame in which they stand
    finger : name of the finger frame
    """

    def __init__(self, world: str, finger: str) -> None:
        self._world = world
        self._names = (finger, wrench_frame_id("world_aligned", finger, world), PLANE)
        self._stands: Pose | None = None
        self._moves = False
        self._without_plane, self._with_plane = self._template(2), self._template(3)

    def standing(self, stamp: int, plane: Pose | None) -> bytes | None:
        """What /tf_static tells from `stamp` [ns] on: where the plane is; None where there is none."""
        self._stands = plane
        return None if plane is None else cdr.transforms(stamp, self._world, {PLANE: plane})

    def moving(self, stamp: int, finger: Pose, plane: Pose | None) -> bytes:
        """What /tf tells at `stamp` [ns]: the finger frame, its twin, and the plane once it has moved."""
        self._moves = self._moves or plane != self._stands
        numbers = [*finger.position, *finger.orientation, *finger.position, *_LEVEL]
        if not self._moves or plane is None:
            return self._without_plane.fill(stamp, *_blocks(numbers))
        return self._with_plane.fill(stamp, *_blocks([*numbers, *plane.position, *plane.orientation]))

    def _template(self, count: int) -> Template:
        """The message of the first so many frames; blocks: position [m] and orientation of each."""
        numbers = marks(7 * count).reshape(count, 7).tolist()
        poses = {name: _pose(n) for name, n in zip(self._names, numbers, strict=False)}
        data = cdr.transforms(_MARK, self._world, poses)
        stamps = [found.start() for found in re.finditer(re.escape(stamp_bytes(_MARK)), data)]
        return Template(data, *(doubles(n) for n in numbers), stamps=stamps)


def _pose(numbers: list[float]) -> Pose:
    x, y, z, qx, qy, qz, qw = numbers
    return Pose((x, y, z), (qx, qy, qz, qw))


def _blocks(numbers: list[float]) -> list[bytes]:
    return [doubles(numbers[i : i + 7]) for i in range(0, len(numbers), 7)]

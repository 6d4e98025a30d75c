"""Poses of whoever holds the finger: judged, and not sent faster than a node can use them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from ..errors import SceneError
from ..scene import Pose, checked_pose
from .orders import OrderError

SHORTEST = 1.0 / 250.0
"""Time between two poses that are sent [s]; of those that come between them the newest is."""


class Poses:
    """Hands on the newest pose."""

    def __init__(self, send: Callable[[Pose], None]) -> None:
        self._send = send
        self._sent = 0.0
        self._newest: Pose | None = None

    def submit(self, numbers: Sequence[float]) -> None:
        """A pose came: position [m] and x y z w. Raises OrderError for one that is refused."""
        x, y, z, a, b, c, d = numbers
        try:
            pose = checked_pose(Pose((x, y, z), (a, b, c, d)), "pose")
        except SceneError as error:
            raise OrderError(str(error)) from None
        loop = asyncio.get_running_loop()
        wait = self._sent + SHORTEST - loop.time()
        if wait <= 0.0:
            self._hand_on(pose)
        else:
            if self._newest is None:
                loop.call_later(wait, self._flush)
            self._newest = pose

    def _flush(self) -> None:
        pose, self._newest = self._newest, None
        if pose is not None:
            self._hand_on(pose)

    def _hand_on(self, pose: Pose) -> None:
        self._sent = asyncio.get_running_loop().time()
        self._send(pose)

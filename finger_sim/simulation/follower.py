"""What recorded poses have a simulator do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..bags.excerpt import Received
from ..errors import SceneError
from ..scene import Pose
from .summary import Summary

if TYPE_CHECKING:
    from .result import StepResult
    from .simulator import Simulator


class Newest:
    """Poses in the order of their receipt, asked for the newest."""

    def __init__(self, poses: Iterator[Received]) -> None:
        self._poses = poses
        self._next = next(poses, None)

    def received_by(self, log_time: int) -> Received | None:
        """The newest of those received by then [ns] that were not asked for before; None if none was."""
        newest = None
        while self._next is not None and self._next.log_time <= log_time:
            newest, self._next = self._next, next(self._poses, None)
        return newest


class Follower:
    """A simulator under poses that it may refuse: then the command before holds, and the plane stays where it is."""

    def __init__(self, simulator: Simulator, first: Pose, summary: Summary) -> None:
        self._simulator, self._summary, self._held = simulator, summary, first
        simulator.reset(first)

    def step(self, command: Received | None, plane: Received | None, answers: bool) -> StepResult | None:
        """A step with what came for it; None where it `answers` a command that is refused."""
        pose, place = command and command.pose, plane and plane.pose
        refusal: SceneError | None = None
        for wanted in (pose, None if answers else self._held):
            for where in (place, None) if place is not None else (None,):
                if wanted is None:
                    continue
                try:
                    result = self._simulator.step(wanted, where)
                except SceneError as error:
                    refusal = error
                    continue
                self._refuse(command if wanted is not pose else None, plane if where is None else None)
                self._held = wanted
                return result
        if not answers and refusal is not None:
            raise refusal
        self._refuse(command, plane)
        return None

    def _refuse(self, command: Received | None, plane: Received | None) -> None:
        """Counts poses that were taken for good ones."""
        counts = self._summary
        counts.commands, counts.refused = counts.commands - bool(command), counts.refused + bool(command)
        counts.plane_poses, counts.plane_refused = counts.plane_poses - bool(plane), counts.plane_refused + bool(plane)

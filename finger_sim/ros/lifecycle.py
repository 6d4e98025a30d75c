"""A managed node, where `lifecycle` asks for one: the states and services of ROS 2's nodes with a life cycle.

| state | what the node does |
|---|---|
| unconfigured | it answers; nothing is loaded |
| inactive | mesh and kernels are loaded; no step is made, the device gets no force, commands are passed over |
| active | as a node without a life cycle |

rclpy's own class of such nodes would decide before the parameters are read; here its services join a node that is
there. The loop is the same in both: it rests between two steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleNodeMixin

from ..errors import FingerSimError
from . import rclpy_private


class Transitions(NamedTuple):
    """What each transition does. They raise FingerSimError where they cannot; the state stays as it was then."""

    configure: Callable[[], None]
    activate: Callable[[], None]
    deactivate: Callable[[], None]
    cleanup: Callable[[], None]
    shutdown: Callable[[], None]


class Lifecycle(LifecycleNodeMixin):  # type: ignore[misc]
    """Services and state of a node, which answers them with the thread that serves it."""

    _state_machine: Any

    def __init__(self, node: Any, transitions: Transitions) -> None:
        self._transitions, self._log = transitions, node.get_logger()
        rclpy_private.join(self, node)
        super().__init__()
        rclpy_private.refuse_what_cannot_be(self)

    def end(self) -> None:
        """Lets the state go, before the node is destroyed."""
        self._state_machine = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._made("configure", self._transitions.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._made("activate", self._transitions.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._made("deactivate", self._transitions.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._made("cleanup", self._transitions.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._made("shutdown", self._transitions.shutdown)

    def _made(self, name: str, transition: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            transition()
        except FingerSimError as error:
            self._log.error(f"{name} failed: {' '.join(str(error).split())}")
            return TransitionCallbackReturn.FAILURE
        self._log.info(f"{name}: done")
        return TransitionCallbackReturn.SUCCESS

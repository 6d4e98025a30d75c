"""What the node uses of rclpy beyond its public names, in one place.

Overrides that belong to no declared parameter have no public reader; messages that lie in a subscription are taken,
and waited for, without an executor. All was written for rclpy 7.1 (Jazzy). `require` tells at the start of a node what
another version lacks.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any, NamedTuple

from rclpy.guard_condition import GuardCondition

from ..errors import FingerSimError

_WAIT_SET = "rclpy.impl.implementation_singleton:rclpy_implementation.WaitSet"
NAMES = (
    "rclpy.node:Node.add_pre_set_parameters_callback",
    "rclpy.subscription:Subscription.handle",
    "rclpy.guard_condition:GuardCondition.handle",
    "rclpy.context:Context.handle",
    "rclpy.experimental.events_executor:EventsExecutor",
    "rclpy.impl.implementation_singleton:rclpy_implementation.Subscription.take_message",
    *(
        f"{_WAIT_SET}.{method}"
        for method in ("clear_entities", "add_subscription", "add_guard_condition", "wait", "get_ready_entities")
    ),
)
"""Module and attribute of all that is needed, apart from what only a node itself has."""
_OVERRIDES = "_parameter_overrides"
_SERVICES = "_services"
_CHANGE_STATE = "_service_change_state"


def require() -> None:
    """Raises FingerSimError naming what this rclpy lacks."""
    for name in NAMES:
        module, _, path = name.partition(":")
        try:
            found: Any = importlib.import_module(module)
            for attribute in path.split("."):
                found = getattr(found, attribute)
        except (ImportError, AttributeError):
            raise _missing(name.replace(":", ".")) from None


def overrides(node: Any) -> Mapping[str, Any]:
    """Values that `-p`, `--params-file` and launch files give to a node, declared or not. Raises FingerSimError."""
    found = getattr(node, _OVERRIDES, None)
    if not isinstance(found, Mapping):
        raise _missing(f"rclpy.node.Node.{_OVERRIDES}")
    return {name: parameter.value for name, parameter in found.items()}


def join(lifecycle: Any, node: Any) -> None:
    """What a LifecycleNodeMixin needs of a node that it is no part of; its services become the node's.

    To be called before the mixin is initialised, and before an executor has the node. Raises FingerSimError.
    """
    services = getattr(node, _SERVICES, None)
    if not isinstance(services, list):
        raise _missing(f"rclpy.node.Node.{_SERVICES}")
    setattr(lifecycle, _SERVICES, services)
    lifecycle.handle, lifecycle.default_callback_group = node.handle, node.default_callback_group


def refuse_what_cannot_be(lifecycle: Any) -> None:
    """A transition that the present state does not have is answered by no success; rclpy gives no answer at all.

    Raises FingerSimError.
    """
    service = getattr(lifecycle, _CHANGE_STATE, None)
    if service is None:
        raise _missing(f"rclpy.lifecycle.node.LifecycleNodeMixin.{_CHANGE_STATE}")
    made, (failure, _) = service.callback, failures()

    def answer(request: Any, response: Any) -> Any:
        try:
            return made(request, response)
        except failure:
            response.success = False
            return response

    service.callback = answer


class Taken(NamedTuple):
    """A message that was taken."""

    data: bytes
    """CDR"""
    received: int
    """Wall time of receipt [ns]."""
    sent: int
    """Stamp of the sender's middleware [ns]."""


def take(subscription: Any) -> Taken | None:
    """The oldest message that lies in a raw subscription."""
    handle = subscription.handle
    with handle:
        taken = handle.take_message(subscription.msg_type, True)
    return None if taken is None else Taken(taken[0], taken[1]["received_timestamp"], taken[1]["source_timestamp"])


def take_all(subscription: Any) -> list[bytes]:
    """The messages that lie in a raw subscription, oldest first."""
    handle, kind, out = subscription.handle, subscription.msg_type, []
    with handle:
        while (taken := handle.take_message(kind, True)) is not None:
            out.append(taken[0])
    return out


def held_address(entity: Any, keep: ExitStack) -> int:
    """Of what rcl has of a publisher or a subscription, which ends after `keep` is closed. Raises FingerSimError."""
    keep.enter_context(entity.handle)
    address = getattr(entity.handle, "pointer", None)
    if not isinstance(address, int) or address == 0:
        raise _missing(f"{type(entity).__name__}.handle.pointer")
    return address


def failures() -> tuple[type[Exception], ...]:
    """What publishing and taking raise."""
    from rclpy.impl.implementation_singleton import rclpy_implementation

    return rclpy_implementation.RCLError, rclpy_implementation.InvalidHandle


def acknowledged(publisher: Any, seconds: float) -> bool:
    """Whether reliable readers have all that the publisher sent; waits so long at most [s]. False where it is gone."""
    from rclpy.duration import Duration

    try:
        return bool(publisher.wait_for_all_acked(Duration(seconds=seconds)))
    except failures():
        return False


class Waiter:
    """Waits for a subscription without an executor."""

    def __init__(self, node: Any, subscription: Any) -> None:
        from rclpy.impl.implementation_singleton import rclpy_implementation

        self._subscription = subscription
        self._guard = GuardCondition(lambda: None, None, context=node.context)
        self._set = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, 0, node.context.handle)

    def wait(self, timeout: float) -> bool:
        """Until a message comes or `wake` is called; False when neither has after `timeout` [s]. Of one thread."""
        handle = self._subscription.handle
        with handle, self._guard.handle:
            self._set.clear_entities()
            self._set.add_subscription(handle)
            self._set.add_guard_condition(self._guard.handle)
            self._set.wait(round(1e9 * timeout))
            return any(self._set.get_ready_entities(kind) for kind in ("subscription", "guard_condition"))

    def wake(self) -> None:
        """Ends a `wait`, or the next one; from any thread."""
        self._guard.trigger()


def _missing(name: str) -> FingerSimError:
    return FingerSimError(
        f"rclpy {_version()} has no {name}, which finger_sim needs; it is tested with rclpy 7.1 (ROS 2 Jazzy)"
    )


def _version() -> str:
    """Of the rclpy that is installed, as a wheel or with a system ROS 2."""
    for package in ("ros-jazzy-rclpy", "rclpy"):
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return "of an unknown version"

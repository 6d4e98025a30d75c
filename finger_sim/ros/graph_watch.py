"""What the ROS graph shows to be wrong, and no message ever would.

DDS matches no publisher of another type with a subscription, nor one of best effort with a reliable subscription, so
their commands never come; and services of two nodes of one name answer from either.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.qos import ReliabilityPolicy

from .outputs import ros_type


class GraphWatch:
    """Looks at the graph around a node. A problem is logged once for as long as it lasts.

    node          : an rclpy node
    subscriptions : its subscriptions that others are to publish on
    """

    def __init__(self, node: Any, subscriptions: Sequence[Any]) -> None:
        self._node = node
        self._subscriptions = tuple(subscriptions)
        self._said: set[str] = set()

    def problems(self) -> list[str]:
        """What is wrong now, a line each."""
        found = [*self._namesakes(), *self._unheard()]
        for text in found:
            if text not in self._said:
                self._node.get_logger().warning(text)
        self._said = set(found)
        return found

    def _namesakes(self) -> list[str]:
        me = (self._node.get_name(), self._node.get_namespace())
        if self._node.get_node_names_and_namespaces().count(me) < 2:
            return []
        name = self._node.get_fully_qualified_name()
        return [f"another node is named {name}: its services and parameters may answer in place of this one's"]

    def _unheard(self) -> list[str]:
        found = set()
        for subscription in self._subscriptions:
            topic, kind = subscription.topic_name, ros_type(subscription.msg_type)
            strict = subscription.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            for info in self._node.get_publishers_info_by_topic(topic):
                if info.topic_type != kind:
                    how = f"{info.topic_type} on {topic}, must be {kind}"
                elif strict and info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                    how = (
                        f"{topic} best effort, must be reliable (or set qos_overrides.{topic}.subscription.reliability)"
                    )
                else:
                    continue
                found.add(f"{_full_name(info)} publishes {how}: none of it arrives")
        return sorted(found)


def _full_name(info: Any) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"

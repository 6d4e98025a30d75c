"""What the ROS graph shows to be wrong, and no message ever would.

DDS matches no publisher of another type with a subscription, so its commands never come; and services of two nodes
of one name answer from either.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .outputs import ros_type


class GraphWatch:
    """Looks at the graph around a node. A problem is logged once for as long as it lasts.

    node          : an rclpy node
    subscriptions : its subscriptions that others are to publish on
    """

    def __init__(self, node: Any, subscriptions: Sequence[Any]) -> None:
        self._node = node
        self._topics = {s.topic_name: ros_type(s.msg_type) for s in subscriptions}
        self._said: set[str] = set()

    def problems(self) -> list[str]:
        """What is wrong now, a line each."""
        found = [*self._namesakes(), *self._wrong_types()]
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

    def _wrong_types(self) -> list[str]:
        return sorted(
            {
                f"{_full_name(info)} publishes {info.topic_type} on {topic}, must be {kind}: none of it arrives"
                for topic, kind in self._topics.items()
                for info in self._node.get_publishers_info_by_topic(topic)
                if info.topic_type != kind
            }
        )


def _full_name(info: Any) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"

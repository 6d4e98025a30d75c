"""What is made of a node's messages, without a node."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("rclpy", reason="needs ROS 2: pip install 'finger_sim[ros]'")

from finger_sim.bags import cdr
from finger_sim.bags.layout import pack_points
from finger_sim.errors import FingerSimError
from finger_sim.view.eye import REPLACED, Eye
from finger_sim.view.protocol import Topology
from finger_sim.view.values import Values

REST = np.random.default_rng(0).random((5, 3))


class Messages:
    """A Link to nobody, with what is to be taken next."""

    target = "/finger"

    def __init__(self) -> None:
        self.next: dict[str, list[bytes]] = {}

    def taken(self, topic: str) -> list[bytes]:
        return self.next.pop(topic, [])


def cloud(rest: np.ndarray, at: int) -> bytes:
    """Of a body at rest in free air."""
    return cdr.point_cloud(at, "world", pack_points(rest, rest, 0.0 * rest, np.zeros(len(rest))))


def test_what_a_device_is_sent_is_in_picture_and_plot() -> None:
    """Its strength, from the first message on; before that it is not known."""
    link, eye = Messages(), Eye(Topology(REST, np.array([[0, 1, 2]], np.int32)), Values({}))
    link.next = {"mesh_points": [cloud(REST, 1_000_000_000)]}
    assert eye.look(link).device is None
    wrench = [0.3, 0.4, 1.2, 0.0, 0.0, 0.01]
    link.next = {
        "mesh_points": [cloud(REST, 2_000_000_000)],
        "device_wrench_throttle": [cdr.wrench_stamped(2_000_000_000, "finger_world_aligned", wrench)],
    }
    assert_allclose(eye.look(link).device, wrench)
    rows = np.frombuffer(eye.samples.since(-1, 2.0)[0], "<f4").reshape(-1, 5)
    assert np.isnan(rows[0, 3])
    assert_allclose(rows[1, 3], 1.3, rtol=1e-6)


def test_clouds_of_another_mesh_are_said() -> None:
    """Not the few of a node that was just replaced, but those of a second node of the same name."""
    link, eye = Messages(), Eye(Topology(REST, np.array([[0, 1, 2]], np.int32)), Values({}))
    for k in range(2 * REPLACED):
        own = k < REPLACED and k % 2 == 0
        link.next = {"mesh_points": [cloud(REST if own else REST[:4], k)]}
        if k < 2 * REPLACED - 1:
            assert (eye.look(link) is not None) == own
    with pytest.raises(FingerSimError, match="has 4 nodes, mesh_topology 5: there may be two nodes /finger"):
        eye.look(link)

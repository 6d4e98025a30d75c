"""A hand at 66 Hz, live and then through `finger_sim run`: the same forces, and of the steps it made the very same."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from ros_helpers import Client, NodeProcess
from small_fingers import SMALL_COUPLED, small

from finger_sim.bags import cdr
from finger_sim.simulation.replay import Selection, run

RATE, JITTER = 66.0, 0.2
TURN = math.sqrt(0.5)
TOUCH = 0.0071
"""Height of a finger that touches the plane [m], about."""


def palpate(client: Client, seconds: float) -> None:
    """Presses of up to 2 mm at 0.8 Hz, sliding to and fro by 1 cm: what a hand does that feels for something."""
    random = np.random.default_rng(3)
    begin = due = 0.0
    while due < seconds:
        t = due
        message = PoseStamped()
        message.header.frame_id = "world"
        down = 0.001 * (1.0 - math.cos(2.0 * math.pi * 0.8 * t))
        message.pose.position.x, message.pose.position.z = 0.01 * math.sin(1.9 * t), TOUCH + 2e-4 - down
        message.pose.orientation.x = message.pose.orientation.w = TURN
        client.publish(message)  # the first one waits for the node
        begin = time.monotonic() if due == 0.0 else begin
        due += (1.0 + JITTER * (random.random() - 0.5)) / RATE
        client.until(lambda end=begin + due: time.monotonic() >= end, period=0.002)  # type: ignore[misc]


def wrenches(bag: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Log times [ns] and wrenches (n, 6), read with the mcap library and rosbags."""
    with next(bag.glob("*.mcap")).open("rb") as stream:
        rows = [(m.log_time, m.data) for _, _, m in make_reader(stream).iter_messages(topics=[topic])]
    read = [cdr.deserialize(data, cdr.WRENCH_STAMPED).wrench for _, data in rows]
    values = [(w.force.x, w.force.y, w.force.z, w.torque.x, w.torque.y, w.torque.z) for w in read]
    return np.array([time for time, _ in rows]), np.array(values)


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "priority"), [(3.0, 0), (20.0, 20)])
def test_live_follows_offline(tmp_path: Path, seconds: float, priority: int) -> None:
    """Whatever the machine held: the recorded steps, computed again, are the live ones to the last bit.

    Where it held the rate: 99 of 100 forces are those of steps on an even clock within two of them, to 1 % of the peak.
    """
    bag = tmp_path / "live"
    arguments = ("-p", f"scene:={SMALL_COUPLED}", "-p", f"record:={bag}", "-p", f"realtime_priority:={priority}")
    with NodeProcess(tmp_path / "log", *arguments) as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            palpate(client, seconds)
            _, values = client.report()
        assert node.end() == 0
    scene = small("finger_coupled")
    run(scene, bag, tmp_path / "again", Selection(mode="recorded"))
    for topic in ("/contact_wrench", "/device_wrench"):
        (when, live), (when_again, again) = wrenches(bag, topic), wrenches(tmp_path / "again", topic)
        assert len(when_again) > 300
        begin = np.searchsorted(when, when_again[0])
        np.testing.assert_array_equal(when[begin : begin + len(when_again)], when_again)
        np.testing.assert_array_equal(live[begin : begin + len(when_again)], again)
    assert np.linalg.norm(again[:, :3], axis=1).max() > 0.3
    held = float(values["real-time factor since start"]) > 0.999 and int(values["overruns"]) == 0
    share, largest, peak = even_clock(bag, tmp_path / "even")
    print(f"within 1 % of {peak:.2f} N: {share:.2%}; largest difference {largest:.4f} N; rate held: {held}")
    if held:
        assert share >= 0.99


def even_clock(bag: Path, out: Path) -> tuple[float, float, float]:
    """Of `run` as it is: the share of live forces that are in it within two steps to 1 % of the peak; how far the
    farthest is off [N]; the peak [N]."""
    run(small("finger_coupled"), bag, out)
    (when, live), (when_even, even) = (wrenches(path, "/contact_wrench") for path in (bag, out))
    inside = (when > when_even[0] + 3_000_000) & (when < when_even[-1] - 3_000_000)
    live, ends = live[inside, :3], when[inside] + 1_000_000  # a live wrench is logged when its step began
    first, last = (np.searchsorted(when_even, ends + off) for off in (-2_000_000, 2_000_000))
    peak = float(np.linalg.norm(live, axis=1).max())
    near = [even[i - 1 : j + 1, :3] for i, j in zip(first, last, strict=True)]
    beyond = [np.maximum(n.min(axis=0) - f, f - n.max(axis=0)).clip(0.0) for n, f in zip(near, live, strict=True)]
    off = np.linalg.norm(beyond, axis=1)
    return float((off < 0.01 * peak).mean()), float(off.max()), peak

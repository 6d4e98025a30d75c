"""The loop in compiled code: no interpreter between steps, and what takes its place where it cannot be."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import PoseStamped, WrenchStamped
from ros_helpers import Client, NodeProcess, command, write_block

from finger_sim.bags.reader import BagReader
from finger_sim.ros.accounts import KEPT, Recent, Window, nothing_counted
from finger_sim.simulation import replay
from finger_sim.simulation.result import StepResult

HELD = """
import ctypes, sys, threading, time
import finger_sim.ros.node as node

class Told(node.Ticker):
    def _turn(self, origin):
        threading.Thread(target=self.hold, daemon=True).start()
        super()._turn(origin)

    def hold(self):
        while self.progress.steps < 10:
            time.sleep(0.01)
        before = self.progress.steps
        ctypes.PyDLL(None).usleep(1_000_000)  # a PyDLL keeps the interpreter while it works
        print("made while it was held:", self.progress.steps - before, flush=True)

node.Ticker = Told
sys.exit(node.main())
"""


def test_steps_go_on_while_another_thread_holds_the_interpreter(tmp_path):
    """For a second, at 200 Hz: they are made, published and recorded."""
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", "mesh_rate:=0.0")
    with NodeProcess(tmp_path / "log", *arguments, program=("-c", HELD)) as node:
        with Client(node.domain) as client:
            wrenches = client.collect(WrenchStamped, "contact_wrench")
            node.wait_for("made while it was held")
            client.until(lambda: len(wrenches) > 10)
        made = int(re.search(r"held: (\d+)", node.output)[1])
        assert made > 50
        assert node.end() == 0


MISFIT = """
import sys
import finger_sim.ros.ticker as ticker
from finger_sim.ros import node

class Misfit(ticker.Endpoints):
    def __init__(self, *given):
        super().__init__(*given)
        self.incoming = self.incoming._replace(since=2**61)  # no message can have come after that

ticker.Endpoints = Misfit
sys.exit(node.main())
"""


@pytest.mark.parametrize("misfit", [pytest.param("asked for", marks=pytest.mark.slow), "seen in the first message"])
def test_where_rcl_does_not_fit_messages_go_through_rclpy(tmp_path, misfit):
    """The node says so, and follows commands as ever, the first one too; a late misfit takes no step back."""
    changes = {"FINGER_SIM_RCL": "0"} if misfit == "asked for" else {}
    program = ("-m", "finger_sim.ros.node") if misfit == "asked for" else ("-c", MISFIT)
    arguments = ("-p", f"scene:={write_block(tmp_path)}")
    with NodeProcess(tmp_path / "log", *arguments, program=program, changes=changes) as node:
        with Client(node.domain) as client:
            poses = client.collect(PoseStamped, "pose")
            wrenches = client.collect(WrenchStamped, "contact_wrench")
            client.until(lambda: poses)
            client.until(lambda: poses[-1].pose.position.z == 0.0095, lambda: client.command(0.0095))
            client.until(lambda: wrenches[-1].wrench.force.z > 0.01, lambda: client.command(-0.0005))
            _, values = client.report(lambda: client.command(-0.0005))
            assert int(values["steps"]) >= len(poses) / 2
        assert "messages go through rclpy, which is slower: " in node.output
        assert node.end() == 0


FREE = """
mesh: {beam: {size: [0.02, 0.01, 0.01], cells: [2, 1, 1]}}
material: {density: 1000.0}
plane: {point: [0.0, 0.0, -0.002]}
solver: {sleep: false}
dt: 0.002
"""


@pytest.mark.slow
def test_a_body_without_a_bone_falls_and_comes_to_rest(tmp_path):
    """In the end the wrench is its weight; all the way it is what `run` computes of the recording, to the last bit."""
    scene, bag = tmp_path / "free.yaml", tmp_path / "bag"
    scene.write_text(FREE)
    arguments = ("-p", f"scene:={scene}", "-p", "mode:=triggered", "-p", f"record:={bag}")
    with NodeProcess(tmp_path / "log", *arguments) as node, Client(node.domain) as client:
        poses = client.collect(PoseStamped, "pose")
        node.wait_for("ready after")
        client.until(lambda: client.node.count_publishers("pose"))
        turned = command(0.0)
        turned.pose.orientation.y, turned.pose.orientation.w = math.sin(0.05), math.cos(0.05)
        for k in range(300):
            client.publish(turned)
            client.until(lambda k=k: len(poses) > k)
        assert node.end() == 0
    replay.run(None, bag, tmp_path / "again")
    for topic, size in (("/contact_wrench", 48), ("/pose", 56)):
        live, again = ([m.data[-size:] for m in BagReader(b).messages([topic])] for b in (bag, tmp_path / "again"))
        assert len(set(live)) > 100
        assert live == again
    forces = [np.frombuffer(m.data[-48:])[2] for m in BagReader(bag).messages(["/contact_wrench"])]
    weight = 1000.0 * 0.02 * 0.01 * 0.01 * 9.81
    assert max(forces) > 1.5 * weight
    np.testing.assert_allclose(forces[-20:], weight, rtol=0.02)


@pytest.mark.parametrize("frame", [pytest.param(frame, marks=pytest.mark.slow) for frame in ("finger", "world")])
def test_wrenches_in_other_frames(tmp_path, frame):
    """Of the same step, from pose and device_wrench: Rᵀ f and Rᵀ τ, or f and τ + p × f."""
    limits = ("-p", "coupling.force_limit:=1000.0", "-p", "coupling.torque_limit:=100.0")
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", f"wrench_frame:={frame}", *limits)
    turned = command(-0.0005, 0.004)
    turned.pose.orientation.y, turned.pose.orientation.w = math.sin(0.05), math.cos(0.05)
    with NodeProcess(tmp_path / "log", *arguments) as node, Client(node.domain) as client:
        poses = client.collect(PoseStamped, "pose")
        contacts = client.collect(WrenchStamped, "contact_wrench")
        devices = client.collect(WrenchStamped, "device_wrench")
        client.until(lambda: poses, lambda: client.publish(turned))
        stamp = lambda m: (m.header.stamp.sec, m.header.stamp.nanosec)  # noqa: E731

        def pressed():
            """A step whose three messages are here, pressed, its device's wrench whole."""
            by = [{stamp(m): m for m in messages[-50:]} for messages in (poses, contacts, devices)]
            both = sorted(by[0].keys() & by[1].keys() & by[2].keys())
            if not both or len(poses) <= 200 or not vector(by[2][both[-1]].wrench.force).any():
                return None  # none is sent either while commands are late
            return [m[both[-1]] for m in by]

        pose, contact, device = client.until(pressed, lambda: client.publish(turned))
        assert node.end() == 0
    p, q = pose.pose.position, pose.pose.orientation
    force, torque = vector(device.wrench.force), vector(device.wrench.torque)
    assert np.linalg.norm(force) > 0.01
    if frame == "world":
        expected = force, torque + np.cross([p.x, p.y, p.z], force)
    else:
        a = 2.0 * math.atan2(q.y, q.w)
        back = np.array([[math.cos(a), 0.0, -math.sin(a)], [0.0, 1.0, 0.0], [math.sin(a), 0.0, math.cos(a)]])
        expected = back @ force, back @ torque
    np.testing.assert_allclose(vector(contact.wrench.force), expected[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(vector(contact.wrench.torque), expected[1], rtol=1e-9, atol=1e-12)


def vector(v) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def test_recent_numbers_are_the_last_ones() -> None:
    recent = Recent.none()
    assert recent.percentiles(50, 99) == (0.0, 0.0)
    for k in range(KEPT + 100):
        recent.add(float(k))
    assert recent.percentiles(0, 100) == (100.0, KEPT + 99.0)


def test_a_window_of_compiled_counts_is_that_of_steps() -> None:
    """Field by field, and it begins anew."""
    counted, window = nothing_counted(), Window()
    counted.steps[0], counted.asleep[0], counted.status[0], counted.troubled[0], counted.doubtful[0] = 9, 2, 144, 3, 1
    counted.iterations[0], counted.residual[0] = 7, 0.5
    counted.most[:] = 40, 30, 20, 10, 1.5, 1e-4  # rows, tets, locked, contacts, strain, depth
    out = {
        "limit_rows": 40, "limited_tets": 30, "locked_tets": 20, "contacts": 10, "max_strain_ratio": 1.5,
        "max_penetration": 1e-4,
    }  # fmt: skip
    made = Window.of(counted)
    assert {name: getattr(made, name) for name in out} == out
    assert (made.steps, made.asleep, int(made.status), made.troubled, made.doubtful) == (9, 2, 144, 3, 1)
    assert (made.iterations, made.residual) == (7, 0.5)
    assert Window.of(counted) == window
    assert set(out) < set(StepResult.__slots__)

"""The loop closed over topics: a device simulated here renders device_wrench and sends command_pose."""

from __future__ import annotations

import itertools
import time
from collections import deque

import pytest
from geometry_msgs.msg import WrenchStamped
from ros_helpers import Client, NodeProcess, command, write_block

COUPLED = """
mesh: {beam: {size: [0.02, 0.01, 0.01], cells: [2, 1, 1]}}
driven: {box: [[-1, -1, 0.0099], [1, 1, 1]]}
material: {young: 5.0e4, poisson: 0.4}
limits: {projection: tensor, stretch: [1.05, 1.25, 1.02], compress: [0.95, 0.75, 0.98]}
plane: {point: [0, 0, 0], friction: 0.5}
gravity: [0, 0, 0]
solver: {method: newton}
coupling: {type: virtual, stiffness: 200.0, damping: 2.0}
initial_pose: {position: [0, 0, 0.002]}
dt: 0.002
"""
MASS, DAMPING, PUSH = 0.2, 2.0, -1.0
"""Of the device [kg], [N s/m], and the hand on it [N]."""
HOLD, MOST = 1e-3, 0.01
"""Largest step of its integration, and of it between two commands [s]."""
PERIOD = 0.002
"""Of the node [s]."""
FORCE_LIMIT = 10.0
LEAK = 4.0 * 0.01
"""What docs/device.md and `passivity` promise: four allowances of 10 mJ, beside what is in flight [J]."""


@pytest.mark.slow
def test_forces_come_in_on_a_ramp(tmp_path):
    """When commands start and when they resume: from nothing, a step of dt / force_ramp each, to the whole contact."""
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", "force_ramp:=2.0", "-p", "command_timeout:=0.5")
    with NodeProcess(tmp_path / "log", *arguments) as node, Client(node.domain) as client:
        node.wait_for("ready after")
        contacts = client.collect(WrenchStamped, "contact_wrench", 1000)
        devices = client.collect(WrenchStamped, "device_wrench", 1000)
        press = lambda: client.command(-0.0003)  # noqa: E731
        for _ in range(2):
            client.until(lambda: contacts and devices)
            client.until(lambda: devices[-1].wrench.force.z == 0.0)
            begin = devices[-1]
            client.until(lambda begin=begin: shares(contacts[-5:], devices[-1:], begin) == [pytest.approx(1.0)], press)
            ramp = shares(contacts, devices, begin)
            assert ramp[0] < 0.1
            assert all(-1e-9 <= b - a < 0.2 for a, b in itertools.pairwise(ramp))
            steps = [share / (0.005 / 2.0) for share in ramp if share < 1.0 - 1e-9]
            assert len(steps) > 100
            assert steps == pytest.approx([round(step) for step in steps], abs=1e-6)
        assert node.end() == 0


def shares(contacts, devices, begin):
    """device_wrench of each step since `begin`, as a share of its contact_wrench; only from the first on that is
    not zero."""
    whole = {stamp(c): c.wrench.force.z for c in contacts}
    return [
        d.wrench.force.z / whole[at]
        for d in devices
        if (at := stamp(d)) > stamp(begin) and d.wrench.force.z > 0.0 and at in whole
    ]


@pytest.mark.slow
def test_a_device_pushed_against_the_plane_comes_to_rest(tmp_path):
    """Under passivity control, over real transport: it takes the force of the hand and is not driven.

    What it is given, by its own integral of force and velocity, stays below LEAK and what is in flight: force limit
    times the longest path in a loop delay and a period. The node's account agrees to a tenth of the work done either
    way and 2 mJ: it takes delays to be even, and the motion within one.
    """
    path = tmp_path / "coupled.yaml"
    path.write_text(COUPLED)
    arguments = ("-p", f"scene:={path}", "-p", "passivity:=control", "-p", "command_timeout:=2.0")
    with NodeProcess(tmp_path / "log", *arguments) as node, Client(node.domain) as client:
        node.wait_for("ready after")
        device = Device(client)
        client.until(lambda: device.settled, device.step, period=0.002)
        client.reports.clear()
        status, values = client.report(lambda: client.command(device.z))
        assert node.end() == 0
    assert status.level < b"\x02"
    assert 0.5 * MASS * device.speed**2 < 1e-3
    in_flight = FORCE_LIMIT * device.fastest * (2.0 * device.oldest + 2.0 * PERIOD)
    assert device.most < LEAK + in_flight
    energy = float(values["energy to the device [J]"])
    assert abs(energy - device.energy) < 0.1 * device.work + 2e-3
    assert device.work > 0.03


class Device:
    """A mass on a rail along z, from 2 mm above the plane; it holds each force until the next one comes.

    energy : given to it by device_wrench [J]
    most   : the largest energy so far
    work   : sum of what went either way
    oldest : largest age of a force when it came, of the time of its step [s]
    fastest : largest speed so far [m/s]
    """

    def __init__(self, client):
        self.client = client
        self.z, self.v, self.force = 0.002, 0.0, 0.0
        self.energy = self.most = self.work = self.oldest = self.fastest = 0.0
        self.speeds = deque(maxlen=500)
        self.forces = deque(maxlen=100)
        self.last = None
        client.node.create_subscription(WrenchStamped, "device_wrench", self.hear, 1)

    def hear(self, message):
        self.force = message.wrench.force.z
        self.oldest = max(self.oldest, time.time() - stamp(message))

    @property
    def speed(self):
        """Largest of late."""
        return max(self.speeds)

    @property
    def settled(self):
        """At rest for a while, and so held by the force that the hand has."""
        held = all(abs(force + PUSH) < 0.3 for force in self.forces)
        return len(self.speeds) == 500 and self.speed < 0.05 and held

    def step(self):
        """Moves on to now and commands where it is; a pause of this process is no time for it."""
        now = time.monotonic()
        left = min(now - (self.last or now), MOST)
        self.last = now
        while left > 0.0:
            h = min(left, HOLD)
            left -= h
            self.v += h * (self.force + PUSH - DAMPING * self.v) / MASS
            self.z += h * self.v
            work = self.force * self.v * h
            self.energy += work
            self.work += abs(work)
            self.most = max(self.most, self.energy)
        self.fastest = max(self.fastest, abs(self.v))
        self.speeds.append(abs(self.v))
        self.forces.append(self.force)
        message = command(self.z)
        message.header.stamp = self.client.node.get_clock().now().to_msg()
        self.client.publish(message)


def stamp(message):
    """Time of a message [s]."""
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec

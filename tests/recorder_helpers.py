"""Recordings to a process that writes bags, and what is in them."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import time
from collections import defaultdict

from ros_helpers import bag_process

from finger_sim.bags.reader import BagReader, Qos
from finger_sim.ros.bag_pipe import COMMAND, Standby
from finger_sim.ros.recorder import RecordedTopic, Recorder

TOPICS = [
    RecordedTopic("/a", "geometry_msgs/msg/WrenchStamped", Qos()),
    RecordedTopic("/b", "geometry_msgs/msg/PoseStamped", Qos()),
]
WRENCH = bytes([0, 1, 0, 0]) + bytes(60)


class Disk:
    """A process that writes bags, and recordings to it; `told` is why they ended."""

    def __init__(self, folder, command=COMMAND):
        self.standby = Standby(command)
        self.path = folder / "bag"
        self.told = []

    def record(self, capacity=1000):
        return Recorder(self.path, TOPICS, capacity, self.standby.pipe(), failed=self.told.append)

    @property
    def pid(self):
        return bag_process(os.getpid())

    @contextlib.contextmanager
    def stalled(self):
        """It takes nothing meanwhile."""
        pid = self.pid
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)

    @contextlib.contextmanager
    def full(self):
        """The system refuses meanwhile to write more than so far."""
        pid = self.pid
        before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        used = max(file.stat().st_size for file in self.path.iterdir())
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (used, before[1]))
        try:
            yield
        finally:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def until(condition, repeat=lambda: None):
    """Waits for a condition and gives its value; `repeat` is called meanwhile."""
    end = time.monotonic() + 60
    while not (value := condition()):
        assert time.monotonic() < end, "the condition did not come true"
        repeat()
        time.sleep(0.01)
    return value


def sequences(path):
    """Sequence numbers by topic of a bag."""
    found = defaultdict(list)
    for message in BagReader(path).messages():
        found[message.topic].append(message.sequence)
    return found

"""The recorder never makes anyone wait, drops whole messages only, numbers them, and survives a bad disk."""

from __future__ import annotations

import signal
import threading
import time
from collections import defaultdict

import pytest
from ros_helpers import Client, NodeProcess, write_block

from finger_sim import BagError
from finger_sim.bags import BagReader, BagWriter, Qos
from finger_sim.ros.recorder import Recorder, Topic

TOPICS = [
    Topic("/a", "geometry_msgs/msg/WrenchStamped", Qos()),
    Topic("/b", "geometry_msgs/msg/PoseStamped", Qos()),
]
WRENCH = bytes([0, 1, 0, 0]) + bytes(60)


class Gate(BagWriter):
    """A disk that does not take a message while the gate is closed."""

    open = threading.Event()

    def write(self, *arguments, **options):
        assert self.open.wait(60)
        super().write(*arguments, **options)


class Broken(BagWriter):
    """A disk that is full from the third message on."""

    def write(self, *arguments, **options):
        if sum(self.counts.values()) == 2:
            self.abort()
            raise BagError(f"{self.files[-1]}: cannot be written: No space left on device")
        super().write(*arguments, **options)


def sequences(path):
    """Sequence numbers by topic of a bag."""
    found = defaultdict(list)
    for message in BagReader(path).messages():
        found[message.topic].append(message.sequence)
    return found


def test_a_full_queue_drops_whole_messages_and_the_gap_shows(tmp_path):
    """Of ten messages five fit; what is written next carries its own number."""
    Gate.open.clear()
    recorder = Recorder(tmp_path / "bag", TOPICS, 5, Gate)
    taken = [recorder.put("/a", WRENCH, 1000 + i) for i in range(10)]
    # The writer may hold one message in its hand, out of the queue.
    kept = sum(taken)
    assert kept in (5, 6)
    assert recorder.dropped == 10 - kept
    Gate.open.set()
    end = time.monotonic() + 60
    while recorder.written < kept and time.monotonic() < end:
        time.sleep(0.01)
    assert recorder.put("/a", WRENCH, 2000)
    assert recorder.put("/b", WRENCH, 2001)
    recorder.close()
    assert recorder.error is None
    accepted = [i + 1 for i, one in enumerate(taken) if one]
    assert sequences(tmp_path / "bag") == {"/a": [*accepted, 11], "/b": [1]}
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


def test_messages_arrive_as_they_were_given(tmp_path):
    """Bytes and log times, in order, nothing lost below capacity."""
    recorder = Recorder(tmp_path / "bag", TOPICS, 1000)
    for i in range(500):
        assert recorder.put("/a", WRENCH + bytes([i % 256]), 10_000 + i)
    recorder.close()
    messages = list(BagReader(tmp_path / "bag").messages())
    assert [m.log_time for m in messages] == list(range(10_000, 10_500))
    assert [m.data[-1] for m in messages] == [i % 256 for i in range(500)]
    assert (recorder.written, recorder.dropped) == (500, 0)


def test_a_bad_disk_ends_the_recording_with_its_reason(tmp_path):
    """No exception reaches who hands over messages; what was written before stays readable."""
    recorder = Recorder(tmp_path / "bag", TOPICS, 1000, Broken)
    for i in range(5):
        recorder.put("/a", WRENCH, 1000 + i)
    end = time.monotonic() + 60
    while recorder.error is None and time.monotonic() < end:
        time.sleep(0.01)
    assert "No space left" in (recorder.error or "")
    assert not recorder.active
    assert not recorder.put("/a", WRENCH, 2000)
    recorder.close()
    assert "No space left" in recorder.summary()
    assert sequences(tmp_path / "bag")["/a"] == [1, 2]


def test_an_existing_path_is_refused(tmp_path):
    """A recording never writes into another."""
    (tmp_path / "bag").mkdir()
    with pytest.raises(BagError, match="exists"):
        Recorder(tmp_path / "bag", TOPICS, 10)


def test_a_killed_node_loses_at_most_a_second(tmp_path):
    """After SIGKILL the bag is readable up to one second before."""
    bag = tmp_path / "bag"
    scene = write_block(tmp_path)
    with NodeProcess(tmp_path / "log", "-p", f"scene:={scene}", "-p", f"record:={bag}") as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            client.until(lambda: len(client.reports) >= 3, lambda: client.command(0.01))
        killed = time.time_ns()
        assert node.end(signal.SIGKILL) == -signal.SIGKILL
    last = max(message.log_time for message in BagReader(bag).messages())
    assert killed - last < 1_000_000_000
    assert not (bag / "metadata.yaml").exists()

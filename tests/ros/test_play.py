"""`finger_sim play` in a process of its own, while nobody listens."""

from __future__ import annotations

import signal
import subprocess
import sys

import numpy as np
import pytest
from domains import DOMAINS
from ros_helpers import environment

from finger_sim.bags.reader import write_commands


@pytest.fixture
def play(tmp_path):
    """Starts it with a bag of two commands."""
    write_commands(tmp_path / "commands", [0, 10_000_000], np.zeros((2, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))

    def start(*arguments: str) -> subprocess.Popen:
        return subprocess.Popen(
            [sys.executable, "-m", "finger_sim", "play", "commands", *arguments], cwd=tmp_path, text=True,
            env=environment(next(DOMAINS)), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    return start


def test_an_interrupt_ends_play_with_130(play):
    """While it waits for a subscriber: one line, no traceback."""
    waiting = play()
    assert waiting.stderr.readline().startswith("playing /command_pose")
    waiting.send_signal(signal.SIGINT)
    _, err = waiting.communicate(timeout=60)
    assert waiting.returncode == 130
    assert err.strip() == "finger_sim: interrupted"


def test_play_without_a_listener_says_so(play):
    """It waits as long as it was told and no longer."""
    waiting = play("--timeout", "0.2")
    _, err = waiting.communicate(timeout=60)
    assert waiting.returncode == 2
    assert "nobody subscribed to /command_pose" in err
    assert "Traceback" not in err

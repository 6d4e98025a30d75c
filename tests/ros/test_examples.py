"""Examples work as they are, against the real node."""

from __future__ import annotations

import re
import signal
import subprocess
import sys

import pytest
from geometry_msgs.msg import WrenchStamped
from ros_helpers import REPOSITORY, TIMEOUT, Client, NodeProcess, environment

LOOP = REPOSITORY / "examples" / "device_loop.py"
SCRIPTS = (
    "examples/device_loop.py", "examples/draw_frames.py", "examples/sim_time.py", "benchmarks/echo_node.py",
    "benchmarks/hand.py",
)  # fmt: skip


@pytest.mark.slow
def test_the_device_loop_feels_the_table_and_ends_with_ctrl_c(tmp_path):
    """Forces come while the hand presses; Ctrl-C ends it with exit code 0 and what it felt."""
    with NodeProcess(tmp_path / "log", "-p", "scene:=finger_coupled") as node:
        node.wait_for("ready after")
        loop = subprocess.Popen(
            [sys.executable, str(LOOP)],
            env=environment(node.domain),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            with Client(node.domain) as client:
                wrenches = client.collect(WrenchStamped, "device_wrench")
                client.until(lambda: any(w.wrench.force.z > 0.5 for w in wrenches[-50:]))
                count = len(wrenches)
                client.until(lambda: len(wrenches) > count + 200)
            loop.send_signal(signal.SIGINT)
            output, _ = loop.communicate(timeout=TIMEOUT)
        finally:
            if loop.poll() is None:
                loop.kill()
        assert loop.returncode == 0, output
        felt = re.search(r"(\d+) wrenches came, the largest force was ([\d.]+) N", output)
        assert felt, output
        assert int(felt[1]) > 10
        assert 0.5 < float(felt[2]) <= 10.0
        assert node.end() == 0, node.output


@pytest.mark.parametrize("script", SCRIPTS)
def test_help_is_help(script):
    """It begins nothing, and says what the script is for."""
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / script), "--help"], env=environment(0), capture_output=True, text=True,
        timeout=TIMEOUT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: ")
    purpose = (REPOSITORY / script).read_text().split('"""')[1].split()[:6]
    assert " ".join(purpose) in " ".join(done.stdout.split())

"""What /diagnostics tell of slow commands."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import WrenchStamped
from ros_helpers import Client, NodeProcess, write_block


@pytest.mark.slow
def test_a_device_that_is_fed_slowly_is_warned_of(tmp_path: Path) -> None:
    """Rate, jitter, mode and delay; a warning only while somebody listens to what a device is to render."""
    with NodeProcess(tmp_path / "log", "-p", f"scene:={write_block(tmp_path)}") as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:

            def told() -> tuple[str, dict[str, str]]:
                """Of a second of commands at up to 50 Hz."""
                client.report(lambda: client.command(0.01))
                status, values = client.report(lambda: client.command(0.01))
                return status.message, values

            message, values = told()
            assert "a device is fed" not in message
            assert 20.0 < float(values["command rate [Hz]"]) < 60.0
            assert 0.0 <= float(values["command jitter [ms]"]) < 20.0
            assert values["following"] == "auto: linear"
            assert 10.0 < float(values["following delay [ms]"]) < 100.0
            heard = client.collect(WrenchStamped, "device_wrench")
            client.until(lambda: heard, lambda: client.command(0.01))
            message, _ = told()
            assert "a device is fed" in message
            assert "commands a second, followed" in message
            assert client.set("coupling.following", "predict").successful
            message, values = told()
            assert values["following"] == "predict"
            assert "predicted" in message
        assert node.end() == 0

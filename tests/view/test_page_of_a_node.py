"""The page on the real server and node: what is dragged is simulated, and what is set is set."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from view.browser import Tab, until

pytest.importorskip("rclpy", reason="needs ROS 2: pip install 'finger_sim[ros]'")

import finger_sim

REPOSITORY = Path(__file__).resolve().parent.parent.parent
SCENE = f"""
mesh: {{file: {Path(finger_sim.__file__).parent.parent / "config/meshes/finger_500.vtu"}}}
driven: bone
material: {{density: 1000.0, young: 9.3e3, poisson: 0.45, volumetric: patch}}
limits: {{projection: tensor, stretch: [1.05, 1.25, 1.02], compress: [0.95, 0.75, 0.98], stiffness: 30.0}}
plane: {{friction: 0.5, stiffness: 100.0}}
solver: {{method: newton, level: lagged}}
dt: 0.005
initial_pose: {{position: [0, 0, 0.0095], orientation: [0.70710678, 0, 0, 0.70710678]}}
"""
"""A small finger at 200 Hz, 2 mm above the plane: browser and node may share one core."""


class Server:
    """`finger_sim view` with its node."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, "0"
        (folder / "small.yaml").write_text(SCENE)
        self.start()

    def start(self) -> None:
        """Starts it, again on the same port."""
        command = [sys.executable, "-m", "finger_sim", "view", "--no-browser", "--port", self.port]
        environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
        with (self.folder / "log").open("a") as log:
            self.process = subprocess.Popen(
                [*command, "--scene", "small.yaml"],
                stdout=subprocess.PIPE, stderr=log, text=True, cwd=self.folder, env=environment,
            )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        assert self.url.startswith("http://127.0.0.1:"), (self.folder / "log").read_text()
        self.port = self.url.rstrip("/").rpartition(":")[2]

    def stop(self, how: int = signal.SIGINT) -> None:
        if self.process.poll() is None:
            self.process.send_signal(how)
        self.process.wait(30)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    made = Server(tmp_path_factory.mktemp("view"))
    yield made
    made.stop()


def live(tab: Tab) -> Tab:
    """The first start of a node compiles its kernels."""
    tab.until(lambda data: data["condition"] == "live" and bool(data.get("finger")), within=200.0)
    return tab


def test_a_drag_presses_the_real_finger(server: Server, open_tab: Any) -> None:
    """Force and strain rise as it is pressed; it springs off the plane, and somebody else may hold it."""
    tab = live(open_tab(server.url))
    tab.until(lambda data: data["handle"] == "free" and data["force"] != "")
    x, y = tab.finger()
    tab.page.locator("#drag input[value=press]").check(force=True)
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.until(lambda data: data["handle"] == "mine")
    forces = []
    for k in range(1, 7):
        tab.page.mouse.move(x, y + 10 * k)
        tab.redrawn()
        forces.append(tab.number("force"))
    pressed = tab.until(lambda data: float(data["force"] or 0) > 0.3 and float(data["most"] or 0) > 0.3)
    assert float(pressed["depth"]) > 0.5
    until(lambda: tab.text("#value-device").replace(".", "").isdigit() and float(tab.text("#value-device")) > 0.3, tab)
    assert np.diff(forces).min() > -0.05
    tab.keep("real-press")
    tab.page.mouse.up()
    tab.until(lambda data: data["handle"] == "free" and float(data["force"] or 9) < 0.01)


def test_values_go_to_the_node_and_back(server: Server, open_tab: Any) -> None:
    """Friction is set in one page and shown in the other; the node's loop is reported."""
    tab = live(open_tab(server.url))
    field = "[data-group=often] [data-name='plane.friction'] input.number"
    number = tab.page.locator(field)
    number.fill("0.8")
    number.press("Enter")
    tab.page.locator("#filter").focus()
    other = live(open_tab(server.url))
    until(lambda: other.page.locator(field).input_value() == "0.8", other)
    tab.until(lambda data: float(data["rate"] if data["rate"] not in ("", "–") else "nan") > 20.0)
    number.fill("1e9")
    number.press("Enter")
    tab.page.locator("#notices li").wait_for()
    assert "plane.friction" in tab.text("#notices")


def test_yaml_recording_and_reset(server: Server, open_tab: Any) -> None:
    """Present values as a scene; a recording that can be fetched."""
    tab = live(open_tab(server.url))
    tab.page.locator("#yaml").click()
    text = tab.page.locator("#yaml-text")
    text.wait_for()
    assert "friction:" in text.input_value()
    tab.page.keyboard.press("Escape")
    tab.page.locator("#record").click()
    tab.until(lambda data: data["recording"] != "")
    tab.page.locator("#reset").click()
    tab.page.locator("#record").click()
    link = tab.page.locator("#recordings a")
    link.wait_for()
    with tab.page.expect_download() as download:
        link.click()
    assert Path(download.value.path()).stat().st_size > 1000


def test_a_restarted_server_is_found_again(server: Server, open_tab: Any) -> None:
    """On the same port, with a node of its own."""
    tab = live(open_tab(server.url))
    server.stop()
    tab.until(lambda data: data["condition"] == "waiting")
    server.start()
    live(tab)
    tab.until(lambda data: data["force"] != "")

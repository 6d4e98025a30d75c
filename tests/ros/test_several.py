"""Several fingers: a node each, in namespaces of their own, in one ROS domain."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from domains import DOMAINS
from geometry_msgs.msg import PoseStamped, WrenchStamped
from ros_helpers import BLOCK_DT, REPOSITORY, TIMEOUT, Client, NodeProcess, command, environment, write_block
from std_srvs.srv import SetBool

NAMES = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "little")


@pytest.mark.slow
def test_two_nodes_in_two_namespaces_do_not_disturb_each_other(tmp_path: Path) -> None:
    """Each follows its own commands, has its own parameters and records its own topics."""
    scene, domain = write_block(tmp_path), next(DOMAINS)

    def node(name: str) -> NodeProcess:
        arguments = (
            "-p",
            f"scene:={scene}",
            "-p",
            f"finger_frame:={name}",
            "-p",
            f"record_directory:={tmp_path / name}",
        )
        return NodeProcess(tmp_path / f"{name}.log", "-r", f"__ns:=/{name}", *arguments, domain=domain)

    with node("left") as left, node("right") as right, Client(domain) as client:
        for each in (left, right):
            each.wait_for("ready after")
        wrenches = {name: client.collect(WrenchStamped, f"/{name}/device_wrench") for name in NAMES}
        poses = {name: client.collect(PoseStamped, f"/{name}/pose") for name in NAMES}
        press = lambda: client.publish(command(-0.0003), "/left/command_pose")  # noqa: E731
        client.until(lambda: wrenches["left"] and wrenches["left"][-1].wrench.force.z > 0.1, press, BLOCK_DT)
        client.until(lambda: poses["right"])
        assert all(w.wrench.force.z == 0.0 for w in wrenches["right"])
        assert poses["right"][-1].pose.position.z == 0.01
        assert wrenches["left"][-1].header.frame_id == "left_world_aligned"
        assert wrenches["right"][-1].header.frame_id == "right_world_aligned"

        values = reports(client, press)
        assert int(values["left"]["received commands"]) > 0
        assert values["right"]["received commands"] == "0"
        assert all("another node is named" not in each["message"] for each in values.values())

        answer = client.call(SetBool, "/left/finger/record", SetBool.Request(data=True))
        assert answer.success, answer.message
        client.report(press)
        assert client.call(SetBool, "/left/finger/record", SetBool.Request(data=False)).success
        assert left.end() == 0
        assert right.end() == 0
    (bag,) = (tmp_path / "left").iterdir()
    said = (bag / "metadata.yaml").read_text()
    assert "/left/pose" in said
    assert "/right" not in said


def reports(client: Client, repeat: Any) -> dict[str, dict[str, str]]:
    """The next report of each node, by its namespace, with its message."""
    found: dict[str, dict[str, str]] = {}
    while set(found) != set(NAMES):
        for status in client.next(client.reports, repeat).status:
            name = status.name.removesuffix("/finger: simulation")
            found[name] = {"message": status.message, **{item.key: item.value for item in status.values}}
    return found


@pytest.mark.slow
def test_five_fingers_start_and_end_together(tmp_path: Path) -> None:
    """The example: a node for each finger, and Ctrl-C ends all of them."""
    domain = next(DOMAINS)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    with (tmp_path / "log").open("w+") as log:
        script = subprocess.Popen(
            ["sh", str(REPOSITORY / "examples" / "five_fingers.sh"), "-p", f"scene:={write_block(tmp_path)}"],
            env=environment(domain) | {"PATH": path}, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
        try:
            end = time.monotonic() + TIMEOUT
            said = lambda: (tmp_path / "log").read_text()  # noqa: E731
            while said().count("ready after") < len(FINGERS):
                assert script.poll() is None, said()
                assert time.monotonic() < end, said()
                time.sleep(0.1)
            with Client(domain) as client:
                client.until(lambda: all(client.node.count_publishers(f"/{name}/device_wrench") for name in FINGERS))
            os.killpg(script.pid, signal.SIGINT)
            script.wait(TIMEOUT)
        finally:
            if script.poll() is None:
                os.killpg(script.pid, signal.SIGKILL)
                script.wait()
    assert "Traceback" not in said()
    for name in FINGERS:
        assert subprocess.run(["pgrep", "-f", f"__ns:=/{name} .*{tmp_path}"], capture_output=True).stdout == b""

"""`ros2 run finger_sim finger_node` finds what an installation put into the environment, and that runs."""

from __future__ import annotations

import importlib.metadata
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ros_helpers import Client, NodeProcess, write_block

PREFIX = Path(sys.prefix)
EXECUTABLE = PREFIX / "lib" / "finger_sim" / "finger_node"


def installed() -> bool:
    try:
        importlib.metadata.distribution("finger_sim")
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


pytestmark = pytest.mark.skipif(
    not installed(),
    reason="finger_sim is not installed here: pip install -e '.[ros]' puts the executable in place",
)


@pytest.fixture
def ament(monkeypatch):
    """ament_index with the environment as its prefix, as `AMENT_PREFIX_PATH=$VIRTUAL_ENV` makes it."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(PREFIX))
    return pytest.importorskip("ament_index_python.packages")


def test_the_index_names_the_package(ament):
    """The package is found by name, at this prefix, with its manifest."""
    assert Path(ament.get_package_prefix("finger_sim")) == PREFIX
    share = Path(ament.get_package_share_directory("finger_sim"))
    assert "<name>finger_sim</name>" in (share / "package.xml").read_text()


def test_scenes_and_bags_are_shared(ament):
    """What a user names without a path lies in the share folder."""
    share = Path(ament.get_package_share_directory("finger_sim"))
    assert (share / "config" / "finger.yaml").is_file()
    assert (share / "bags").is_dir()


def test_the_executable_is_where_ros2_run_looks(ament):
    """In lib/<package> of the prefix, and executable."""
    assert os.access(Path(ament.get_package_prefix("finger_sim")) / "lib" / "finger_sim" / "finger_node", os.X_OK)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_the_executable_runs_as_a_node(tmp_path, number):
    """As ros2 run starts it: arguments through, topics there, exit code 0 on either signal."""
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-r", "pose:=/finger/pose")
    program = ("-c", f"import os, sys; os.execv({str(EXECUTABLE)!r}, ['finger_node', *sys.argv[1:]])")
    with NodeProcess(tmp_path / "log", *arguments, program=program) as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            client.until(lambda: client.node.get_publishers_info_by_topic("/finger/pose"))
            client.until(lambda: client.reports)
        assert node.end(number) == 0, node.output


@pytest.mark.slow
def test_the_executable_says_what_is_wrong(tmp_path):
    """A mistake shows as an exit code through the wrapper too."""
    done = subprocess.run(
        [str(EXECUTABLE), "--ros-args", "-p", "scene:=no_such_scene"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert "no_such_scene" in done.stderr

"""`colcon build` makes of a checkout a package of a ROS 2 workspace, and `ros2 run finger_sim finger_node` runs that.

ros2cli is in no wheel. What it does is done here: setup.sh of the workspace, the ament index, lib/<package>.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from processes import REPOSITORY
from ros_helpers import Client, NodeProcess

from finger_sim.scene.resources import shipped_names

COLCON = importlib.util.find_spec("colcon_core") is not None
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not COLCON and not os.environ.get("CI"), reason="needs the extra [install]"),
]

PACKAGES = """
from ament_index_python.packages import get_package_prefix, get_package_share_directory
print(get_package_prefix("finger_sim"), get_package_share_directory("finger_sim"))
"""
SHIPPED = """
import json, finger_sim
from finger_sim.scene.resources import shipped_names
from finger_sim import Scene
for name in shipped_names()["scenes"]:
    Scene.load(name)
print(json.dumps([finger_sim.__file__, shipped_names()]))
"""


def checkout(folder: Path) -> Path:
    """What a clone of this state of the repository would hold, and nothing that was made in it since."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for name in filter(None, listed.split("\0")):
        if (REPOSITORY / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(REPOSITORY / name, folder / name)
    return folder


class Workspace:
    """A workspace with the package built in it; `environment`: of a shell that has sourced its setup.sh."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.source = checkout(folder / "src" / "finger_sim")
        before = self.files()
        self.build = subprocess.run(
            [sys.executable, "-m", "colcon", "build", *options], cwd=folder, capture_output=True, text=True, timeout=200
        )
        self.left = self.files() - before
        self.prefix = folder / "install" / "finger_sim"
        sourced = subprocess.run(
            ["sh", "-c", ". install/setup.sh && exec env -0"], cwd=folder, capture_output=True, text=True, check=True
        ).stdout
        self.environment = dict(line.split("=", 1) for line in sourced.split("\0") if "=" in line)

    def files(self) -> set[Path]:
        """Of the source tree."""
        return set(self.source.rglob("*"))

    def python(self, code: str) -> str:
        """What a program prints there."""
        return subprocess.run(
            [sys.executable, "-c", code], cwd="/", env=self.environment, capture_output=True, text=True, check=True
        ).stdout


@pytest.fixture(scope="module", params=["copied", "linked"])
def workspace(request: Any, tmp_path_factory: Any) -> Workspace:
    """As `colcon build` and `colcon build --symlink-install` make it."""
    options = ["--symlink-install"] if request.param == "linked" else []
    return Workspace(tmp_path_factory.mktemp(request.param), *options)


def test_it_builds_without_a_warning_and_leaves_the_source_alone(workspace: Workspace) -> None:
    """Colcon warns where a package installs no marker and no manifest of its own."""
    assert workspace.build.returncode == 0, workspace.build.stderr
    assert "Finished <<< finger_sim" in workspace.build.stdout
    assert "WARNING" not in workspace.build.stdout + workspace.build.stderr
    assert "doesn't explicitly" not in workspace.build.stdout + workspace.build.stderr
    assert workspace.left == set()


def test_the_ament_index_has_it(workspace: Workspace) -> None:
    """Prefix and share folder by name, with the manifest and the shared files."""
    prefix, share = map(Path, workspace.python(PACKAGES).split())
    assert prefix == workspace.prefix
    assert (share / "package.xml").read_text() == (REPOSITORY / "package.xml").read_text()
    assert (share / "config" / "finger_haptic.yaml").is_file()
    assert (share / "bags" / "press_flat" / "metadata.yaml").is_file()


def test_shipped_files_are_found_from_anywhere(workspace: Workspace) -> None:
    """Scenes, bags and meshes by name, as in a checkout, from what was built there; each scene loads."""
    module, names = json.loads(workspace.python(SHIPPED))
    assert names == shipped_names()
    assert Path(module).is_relative_to(workspace.prefix.parent.parent)
    assert not Path(module).resolve().is_relative_to(REPOSITORY)


@pytest.mark.parametrize("name", ["finger_node", "finger_sim"])
def test_executables_are_where_ros2_run_looks(workspace: Workspace, name: str) -> None:
    """In lib/<package>, and executable; a mistake is an exit code there too."""
    path = workspace.prefix / "lib" / "finger_sim" / name
    assert os.access(path, os.X_OK)
    wrong = {"finger_node": ["--ros-args", "-p", "scene:=no_such"], "finger_sim": ["info", "no_such"]}[name]
    done = subprocess.run([path, *wrong], env=workspace.environment, capture_output=True, text=True, timeout=100)
    assert done.returncode in (1, 2), done.stdout + done.stderr
    assert "no_such" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_node_runs(workspace: Workspace, tmp_path: Path) -> None:
    """A shipped scene by its name, topics there, exit code 0."""
    path = workspace.prefix / "lib" / "finger_sim" / "finger_node"
    program = ("-c", f"import os, sys; os.execv({str(path)!r}, ['finger_node', *sys.argv[1:]])")
    arguments = ("-p", "scene:=finger_haptic")
    changes = {"PYTHONPATH": workspace.environment["PYTHONPATH"]}
    with NodeProcess(tmp_path / "log", *arguments, program=program, changes=changes) as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            client.until(lambda: client.node.get_publishers_info_by_topic("/device_wrench"))
        assert node.end() == 0, node.output

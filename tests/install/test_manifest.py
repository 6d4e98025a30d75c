"""package.xml names what the package needs: rosdep and colcon read that, and pip reads pyproject.toml."""

from __future__ import annotations

import re
import tomllib
import xml.etree.ElementTree as ElementTree

from processes import REPOSITORY

KEYS = {"pyyaml": "python3-yaml", "rosbags": "python3-rosbags-pip", "mcap": "mcap-ros2-support"}
"""Keys of rosdep that are not python3-NAME: there is none for mcap, which this one brings."""
IMPORT = re.compile(r"^\s*(?:from|import) (rclpy|\w+_msgs|std_srvs|rcl_interfaces|ament_index_python)\b", re.MULTILINE)


def manifest() -> set[str]:
    """What package.xml says that the package depends on."""
    root = ElementTree.parse(REPOSITORY / "package.xml").getroot()
    return {str(entry.text) for entry in root if entry.tag.endswith("depend")}


def test_the_manifest_names_the_ros_packages_that_are_imported() -> None:
    """By any module of ours; and tf2, which is imported where it is there."""
    modules = [path.read_text() for path in (REPOSITORY / "finger_sim").rglob("*.py")]
    imported = {name for text in modules for name in IMPORT.findall(text)}
    assert len(imported) > 8
    assert imported | {"tf2_ros", "tf2_ros_py"} <= manifest()


def test_the_manifest_names_what_pip_would_install() -> None:
    """By its key in rosdep: what the package needs, and what the extra [ros] adds for pictures and page."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *extras["plot"], *extras["view"]]
    names = [re.split(r"[<>=]", line)[0].lower() for line in lines]
    assert {KEYS.get(name, f"python3-{name}") for name in names} <= manifest()

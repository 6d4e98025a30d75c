"""`finger_sim params`: a commented file of all parameters, with which the node is what it is without."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from cases import for_each
from domains import DOMAINS
from ros_helpers import REPOSITORY, Client, NodeProcess, write_block

from finger_sim import Scene
from finger_sim.cli import main
from finger_sim.errors import SceneError
from finger_sim.ros import parameters, rclpy_private
from finger_sim.ros.options import NodeOptions
from finger_sim.ros.params_file import params_file
from finger_sim.scene.fields import specs
from finger_sim.scene.reference import dotted
from finger_sim.scene.resources import shipped_names

SCENES = shipped_names()["scenes"]


def handed(path: Path) -> dict[str, Any]:
    """What ROS itself reads in a params file for a node of any namespace, by name."""
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context, domain_id=next(DOMAINS))
    node = rclpy.create_node(
        "finger", namespace="left", context=context, enable_rosout=False, start_parameter_services=False
    )
    found = dict(rclpy_private.overrides(node))
    node.destroy_node()
    rclpy.shutdown(context=context)
    return found


@for_each("scene", SCENES)
def test_it_changes_nothing(scene: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Read by ROS, it gives the scene and the options of a node without it; no parameter is left out."""
    path = tmp_path_factory.mktemp("params") / "finger.yaml"
    path.write_text(params_file(scene))
    found = handed(path)
    alone = Scene.load(scene)
    assert parameters.options_from(found) == NodeOptions(scene=scene)
    again = parameters.scene_from(Scene.load(found["scene"]), found)
    assert again.to_dict() == alone.to_dict()
    assert set(found) == {name for name, _, _ in dotted(NodeOptions)} | {p.name for p in alone.parameters()}


def test_each_parameter_is_explained() -> None:
    """Meaning, unit, range and default stand above each value."""
    text = params_file("finger_coupled")
    told = " ".join(line.strip().lstrip("# ") for line in text.splitlines())
    for spec in (*specs(NodeOptions).values(), *(p.spec for p in Scene.load("finger_coupled").parameters())):
        assert f"{spec.doc}. " in told
    above = text[: text.index("      friction:")].splitlines()[-2:]
    assert above == ["      # Coulomb friction coefficient μ.", "      # 0 to 100; default 0.5; live"]
    assert "# 0.001 to 1e9; null; default 1000; live" in text
    assert "in units of E·V^(1/3)" in text
    assert "# 0.001 to 3600 s; default 0.1; live" in text
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.slow
def test_the_file_that_the_command_writes_starts_the_node(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Unchanged: the same values as of a scene alone, and no warning. One that is changed: that value."""
    scene = write_block(tmp_path)
    assert main(["params", str(scene)]) == 0
    text = capsys.readouterr().out
    file = tmp_path / "finger.yaml"
    file.write_text(text.replace("friction: 0.5", "friction: 0.25"))
    loaded = Scene.load(scene)
    with NodeProcess(tmp_path / "log", "-r", "__ns:=/left", "--params-file", str(file)) as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            names = sorted({p.name for p in loaded.parameters()} | {name for name, _, _ in dotted(NodeOptions)})
            values = {name: client.get(name, "/left/finger") for name in names}
        assert node.end() == 0
    assert "[WARN]" not in node.output
    assert values.pop("plane.friction") == 0.25
    assert values.pop("realtime_priority") == 20
    scene_again = parameters.scene_from(
        loaded, {k: v for k, v in values.items() if k not in NodeOptions.__annotations__}
    )
    assert scene_again == loaded


def test_a_mistake_names_the_scene(capsys: pytest.CaptureFixture[str]) -> None:
    """As every other verb does."""
    with pytest.raises(SceneError):
        params_file("no_such")
    assert main(["params", "no_such"]) == 2
    assert "no_such" in capsys.readouterr().err


def test_the_text_is_yaml_whatever_it_holds(tmp_path: Path) -> None:
    """A path with a quote, a colon and a letter beyond ASCII."""
    folder = tmp_path / 'it\'s "a": fü#r'
    folder.mkdir()
    scene = write_block(folder)
    values = yaml.safe_load(params_file(str(scene)))["/**"]["ros__parameters"]
    assert values["scene"] == str(scene)
    assert yaml.safe_load(values["driven"]) == yaml.safe_load((folder / "block.yaml").read_text())["driven"]
    assert not values["scene"].startswith(str(REPOSITORY))

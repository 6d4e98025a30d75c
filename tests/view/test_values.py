"""Parameters as the page has them: described, set within their range, written as a scene that loads to the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from cases import for_each

from finger_sim import Scene, SceneError
from finger_sim.scene.resources import shipped_names
from finger_sim.view.values import Described, of_scene

LIVE = {
    "plane.friction": Described(0.5, "Coulomb friction", True, 0.0, 100.0),
    "plane.normal": Described([0.0, 0.0, 1.0], "normal", True),
    "plane.stiffness": Described(250.0, "stiffness", True, 1e-3, float("inf")),
    "solver.level": Described("lagged", "level", True),
    "solver.max_iterations": Described(30, "iterations", True, 1, 1_000_000),
    "solver.sleep": Described(True, "sleep", False),
    "dt": Described(0.001, "step", False, 1e-6, 0.1),
    "command_timeout": Described(0.1, "timeout", True, 1e-3, 3600.0),
    "limits.stretch": Described([1.05, float("inf"), 1.02], "stretch", False),
    "use_sim_time": Described(False, "rclpy's own", True),
}


def values():
    from finger_sim.view.values import Values

    return Values(LIVE)


@for_each("name", shipped_names()["scenes"])
def test_the_yaml_of_every_scene_loads_to_the_same(name, tmp_path: Path) -> None:
    """From a folder where nothing else is; with changed values, those."""
    scene = Scene.load(name)
    changes = {"gravity": [0.0, 0.1, -9.0], "coupling.force_limit": 3.25}
    if scene.plane is not None:
        changes |= {"plane.friction": 0.123456789012345, "plane.normal": [0.1, 0.2, 0.9]}
    for wanted in (scene, scene.with_values(changes)):
        file = tmp_path / "again.yaml"
        file.write_text(of_scene(wanted).scene_yaml())
        assert Scene.load(file) == wanted


def test_what_changes_is_in_the_yaml(tmp_path: Path) -> None:
    """Values that a node told of, as ROS has them."""
    found = of_scene(Scene.load("finger_coupled"))
    shown = found.take({"plane.friction": 0.25, "coupling.stiffness": 800.0, "solver.budget_ms": 0.5, "nobody's": 1})
    assert shown == {"plane.friction": 0.25, "coupling.stiffness": 800.0, "solver.budget_ms": 0.5}
    file = tmp_path / "again.yaml"
    file.write_text(found.scene_yaml())
    scene = Scene.load(file)
    assert (scene.plane.friction, scene.coupling.stiffness, scene.solver.budget_ms) == (0.25, 800.0, 0.5)
    found.take({"solver.budget_ms": float("inf")})
    file.write_text(found.scene_yaml())
    assert Scene.load(file).solver.budget_ms is None


def test_descriptions() -> None:
    """Kind, range, unit and choices; what no scene and no node of finger_sim has is left out."""
    items = {item["name"]: item for item in values().items()}
    assert set(items) == set(LIVE) - {"use_sim_time"}
    kinds = {name: item["kind"] for name, item in items.items()}
    assert kinds == {
        "plane.friction": "number", "plane.normal": "vector", "plane.stiffness": "number", "solver.level": "choice",
        "solver.max_iterations": "number", "solver.sleep": "bool", "dt": "number", "command_timeout": "number",
        "limits.stretch": "vector",
    }  # fmt: skip
    friction, stiffness = items["plane.friction"], items["plane.stiffness"]
    assert (friction["low"], friction["high"], friction["live"], friction["log"]) == (0.0, 100.0, True, False)
    assert (stiffness["low"], stiffness["high"], stiffness["log"]) == (1e-3, 1e9, True)
    assert (friction["optional"], stiffness["optional"]) == (False, True)
    assert items["solver.level"]["choices"] == ["standard", "lagged"]
    assert items["limits.stretch"]["value"] == [1.05, None, 1.02]
    assert (items["command_timeout"]["group"], items["dt"]["group"]) == ("node", "scene")
    assert (items["command_timeout"]["unit"], items["solver.sleep"]["live"]) == ("s", False)


@for_each(
    "name, value, given",
    [
        ("plane.friction", 1, 1.0), ("plane.normal", [0, 1, 1], [0.0, 1.0, 1.0]),
        ("plane.stiffness", None, float("inf")),
        ("solver.level", "standard", "standard"), ("solver.max_iterations", 5, 5), ("command_timeout", 2, 2.0),
    ],
)  # fmt: skip
def test_what_is_set(name, value, given) -> None:
    """A value of JSON becomes one of ROS, of the parameter's own type."""
    got = values().ros_value(name, value)
    assert got == given
    assert type(got) is type(given)


@for_each(
    "name, value, told",
    [
        ("plane.friction", -1, "in [0, 100]"), ("plane.friction", "much", "a number"),
        ("plane.friction", None, "number"), ("plane.normal", [0, 1], "three numbers"),
        ("plane.normal", {}, "three numbers"), ("solver.level", "best", "lagged"),
        ("solver.max_iterations", 2.5, "a whole number"), ("dt", 0.002, "cannot be changed"),
        ("use_sim_time", True, "no such parameter"), ("__class__", 1, "no such parameter"),
    ],
)  # fmt: skip
def test_what_is_not_set(name, value, told) -> None:
    """The error names the parameter and what is allowed."""
    with pytest.raises(SceneError) as error:
        values().ros_value(name, value)
    assert name in str(error.value)
    assert told in str(error.value)

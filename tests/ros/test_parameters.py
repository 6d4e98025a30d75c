"""Every scene value is a ROS parameter with its unit, range and doc; every bound refuses what is beyond."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from cases import for_each
from ros_helpers import Client, NodeProcess, write_block

from finger_sim import FingerSimError, Scene, SceneError
from finger_sim.ros import parameters, rclpy_private
from finger_sim.ros.options import NodeOptions
from finger_sim.scene.fields import specs
from finger_sim.scene.ros_values import to_ros

SCENE = Scene.from_dict(
    {
        "mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [2, 1, 1]}},
        "driven": {"box": [[-1, -1, 0.0099], [1, 1, 1]]},
        "limits": {"stretch": [1.05, None, 1.02], "compress": [0.95, 0.75, 0.98]},
        "plane": {"stiffness": None},
    }
)
OWN = list(parameters.node_parameters(NodeOptions()))
OF_SCENE = list(SCENE.parameters())
ALL = OWN + OF_SCENE
BY_NAME = {p.name: p for p in ALL}


def beyond(parameter):
    """Values one step outside each bound of a parameter, in the type that ROS has for it."""
    spec, kind = parameter.spec, parameter.spec.kind
    if kind == "float":
        return [math.nextafter(spec.low, -math.inf), math.nextafter(spec.high, math.inf), math.nan]
    if kind == "int":
        return [int(spec.low) - 1, int(spec.high) + 1]
    if kind == "choice":
        return ["no such choice", ""]
    if kind == "cells":
        return [[1, 1, int(spec.low) - 1], [1, 1, int(spec.high) + 1], [1, 1]]
    if kind == "quaternion":
        return [[0.0] * 4, [0.0, 0.0, 1.0], [math.nan, 0.0, 0.0, 1.0]]
    if kind in ("vec3", "limit3"):
        out = [[1.0, 1.0], [math.nan, 1.0, 1.0]]
        if math.isfinite(spec.low):
            out += [
                [1.0, math.nextafter(spec.low, -math.inf), 1.0],
                [1.0, math.nextafter(spec.high, math.inf), 1.0],
            ]
        return out
    return [3.5]


def parsed(name, value):
    """What becomes of an override, in the options or in the scene."""
    if name in specs(NodeOptions):
        return getattr(parameters.options_from({name: value}), name)
    scene = parameters.scene_from(SCENE, {name: value})
    return next(p.value for p in scene.parameters() if p.name == name)


@for_each("name, value", [(p.name, value) for p in ALL for value in beyond(p)])
def test_an_override_beyond_a_bound_is_refused_by_name(name, value):
    """The error names parameter, value and what is allowed."""
    with pytest.raises(SceneError) as caught:
        parsed(name, value)
    assert caught.value.key.startswith(name)
    assert caught.value.allowed


@for_each("parameter", ALL)
def test_values_survive_the_way_through_ros(parameter):
    """A value made a ROS parameter and read back is the value, null included."""
    back = parsed(parameter.name, to_ros(parameter.value, parameter.spec))
    assert back == parameter.value or np.allclose(back, parameter.value, rtol=1e-15)


@for_each("parameter", ALL)
def test_descriptors_say_what_the_field_says(parameter):
    """Doc, unit, range and read-only of the descriptor are those of the field."""
    spec, shown = parameter.spec, parameters.descriptor(parameter)
    assert spec.doc in shown.description
    assert spec.unit in shown.description
    assert spec.allowed in shown.additional_constraints
    assert shown.read_only is not spec.live
    if spec.kind == "float":
        (span,) = shown.floating_point_range
        assert (span.from_value, span.to_value) == (spec.low, math.inf if spec.optional else spec.high)
    if spec.kind == "int":
        (span,) = shown.integer_range
        assert (span.from_value, span.to_value) == (spec.low, spec.high)


def test_a_list_of_blocks_is_a_text():
    """Terms of relaxation go to ROS as their YAML, and back; what is no such text is refused by name and place."""
    text = "[{time: 0.07, share: 0.3}]"
    scene = parameters.scene_from(SCENE, {"material.relaxation": text})
    (parameter,) = (p for p in scene.parameters() if p.name == "material.relaxation")
    assert [(term.time, term.share) for term in parameter.value] == [(0.07, 0.3)]
    assert to_ros(parameter.value, parameter.spec) == text
    assert parameters.descriptor(parameter).read_only
    for bad, place in (("[{time: 0.07}]", "[0].share"), ("0.3", ""), ("[{time", ""), ("", "")):
        with pytest.raises(SceneError, match="allowed") as caught:
            parameters.scene_from(SCENE, {"material.relaxation": bad})
        assert caught.value.key == f"material.relaxation{place}"


def test_defaults_of_the_options_are_allowed():
    """The node starts with no override at all."""
    assert parameters.options_from({}) == NodeOptions()


class Declared:
    """A node with parameters of these names."""

    def __init__(self, names):
        self.names = set(names)

    def has_parameter(self, name):
        return name in self.names

    def get_parameters_by_prefix(self, prefix):
        return {n.removeprefix(f"{prefix}."): None for n in self.names if n.startswith(f"{prefix}.")}


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("plane.fricton", "did you mean plane.friction?"),
        ("Dt", "did you mean dt?"),
        ("mash_rate", "did you mean mesh_rate?"),
        ("zzz", "the node has no such parameter"),
        ("solver.deadlines.zzz", "the node has no such parameter"),
        ("limits.viscosity", "the scene soft.yaml has no block 'limits'"),
        ("mesh.beam.size", "the scene soft.yaml has no block 'mesh.beam'"),
    ],
)
def test_a_name_that_the_node_does_not_have_is_refused(name, says):
    """With the nearest there is, or the block that this scene does not have."""
    scene = Scene.from_dict({"mesh": {"file": "meshes/finger.vtu"}, "plane": {}})
    node = Declared({p.name for p in scene.parameters()} | set(specs(NodeOptions)) | {"use_sim_time"})
    with pytest.raises(SceneError) as caught:
        parameters.require_known({"dt": 0.002, name: 0.2}, node, scene, "soft.yaml")
    assert str(caught.value).startswith(f"{name}: got 0.2")
    assert says in str(caught.value)


def test_names_that_ros_owns_are_not_refused():
    """Its own parameters, and overrides of qualities; of these one that changes nothing is told, with the nearest."""
    right = "qos_overrides./command_pose.subscription.reliability"
    node = Declared([*BY_NAME, "use_sim_time", "start_type_description_service", right])
    wrong = "qos_overrides./comand_pose.subscription.reliability"
    given = dict.fromkeys(["use_sim_time", "start_type_description_service", right, wrong], True)
    parameters.require_known(given, node, SCENE, "")
    assert list(parameters.unused_qualities([*given, "qos_overrides./clock.subscription.depth"], node)) == [
        f"parameter {wrong} changes nothing here; did you mean {right}?"
    ]


def test_an_rclpy_that_lacks_something_is_named(monkeypatch):
    """What is missing, and the version of rclpy; not an AttributeError later on."""
    rclpy_private.require()
    version = r"rclpy \S+ has no rclpy\."
    with pytest.raises(FingerSimError, match=version + r"node\.Node\._parameter_overrides"):
        rclpy_private.overrides(object())
    monkeypatch.delattr("rclpy.subscription.Subscription.handle")
    with pytest.raises(FingerSimError, match=version + r"subscription\.Subscription\.handle, which finger_sim needs"):
        rclpy_private.require()


def test_private_names_of_rclpy_are_used_in_one_file():
    """Where they are checked."""
    private = re.compile(
        r"rclpy\.impl|_rclpy|rclpy_implementation|\.handle\b|_parameter_overrides|\bself\._parameters\b"
    )
    folder = Path(parameters.__file__).parent
    assert [p.name for p in folder.glob("*.py") if private.search(p.read_text())] == ["rclpy_private.py"]


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parameters")
    overrides = ("-p", "plane.friction:=0.25", "-p", "solver.tolerance:=0.01", "-p", "gravity:=[0,0,-1]")
    scene = write_block(folder)
    with NodeProcess(folder / "log", "-p", f"scene:={scene}", *overrides) as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            client.log = node
            yield client
        assert node.end() == 0


def test_the_node_has_every_parameter_of_scene_and_options(client, tmp_path):
    """Names, types and values; overrides at start reach read-only ones too, whole numbers as well."""
    scene = Scene.load(write_block(tmp_path))
    wanted = {p.name for p in scene.parameters()} | set(specs(NodeOptions))
    assert wanted <= set(client.parameter_names())
    assert client.get("plane.friction") == 0.25
    assert list(client.get("gravity")) == [0.0, 0.0, -1.0]
    assert list(client.get("limits.stretch")) == [1.05, 1.25, math.inf]
    assert client.get("dt") == 0.005


def test_the_node_describes_unit_and_range(client):
    """What `ros2 param describe` shows."""
    shown = client.describe("coupling.force_limit")
    assert "[N]" in shown.description
    assert (shown.floating_point_range[0].from_value, shown.floating_point_range[0].to_value) == (0.0, 1e6)


@for_each("name, value", [(p.name, value) for p in ALL if p.spec.live for value in beyond(p)])
def test_the_running_node_refuses_what_is_beyond_a_bound(client, name, value):
    """The reason names the parameter; the value stays."""
    before = client.get(name)
    result = client.set(name, value)
    assert not result.successful
    # rclpy's own refusal of a type names the types only.
    assert name in result.reason or "Wrong parameter type" in result.reason
    assert client.get(name) == before


def test_the_running_node_refuses_what_needs_a_rebuild(client):
    """Read-only parameters stay as they are."""
    for name in ("dt", "scene", "material.young", "limits.stretch", "record_queue", "record_directory"):
        result = client.set(name, client.get(name))
        assert not result.successful, name
        assert name in result.reason


def test_a_whole_number_is_a_number(client):
    """`ros2 param set /finger plane.friction 1` does what it says."""
    assert client.set("plane.friction", 1).successful
    assert client.get("plane.friction") == 1.0
    assert client.set("plane.friction", 0.25).successful


STARTS = """
import sys, rclpy
from finger_sim.ros.node import main
scene, *overrides = sys.argv[1:]
for override in overrides:
    code = main(["--ros-args", "-p", f"scene:={scene}", "-p", override])
    rclpy.try_shutdown()
    print("ended with", code, file=sys.stderr, flush=True)
"""


def test_a_start_that_cannot_work_ends_with_one_line(tmp_path):
    """Exit code not 0, the reason by name, no traceback."""
    starts = {
        "scene:=no_such_scene": "no_such_scene",
        "dt:=0.5": "dt",
        "dt:=fast": "dt",
        "dt:=[0.1": "dt",
        "plane.friction:=-1.0": "plane.friction",
        "plane.fricton:=0.2": "plane.fricton: got 0.2, allowed: no value: the node has no such parameter; did",
        "record:=true": "record: got True, allowed: a text (Path of a bag",
        "wrench_frame:=sensor": "wrench_frame",
        "record:=/proc/no/such/place": "/proc/no/such/place",
    }
    with NodeProcess(tmp_path / "log", program=("-c", STARTS, str(write_block(tmp_path)), *starts)) as node:
        assert node.code() == 0, node.output
        output = node.output
    assert "Traceback" not in output
    said = output.split("ended with 1\n")
    assert len(said) == len(starts) + 1, output
    for text, (override, says) in zip(said, starts.items(), strict=False):
        assert says in text, override

"""Devices as YAML and as ROS parameters: what is refused, and that it is named with its place; the shipped ones."""

from __future__ import annotations

import numpy as np
import pytest

from finger_sim import SceneError
from finger_sim.ros.device import COMMANDS, FLAT, device_from, parsed
from finger_sim.scene.resources import shipped_names

SHIPPED = shipped_names()["devices"]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_devices_are_whole(name) -> None:
    """They are read, and their plain values give them back."""
    device = device_from(name, {})
    assert parsed(device.to_dict()) == device
    assert device.command_input.topic.startswith("/")


def test_without_a_device_there_is_none() -> None:
    assert device_from("", {"scene": "finger", "dt": 0.001}) is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("comand_input: {}", "line 1, column 1: comand_input: got {}, allowed: no such key; known here: command_inp"),
        ("[1]", "device: got [1], allowed: a block with the keys"),
        ("command_input: {type: Posed}", "line 1, column 23: command_input.type: got 'Posed', allowed: PoseStamped or"),
        ("command_input: {type: Float32MultiArray}", "command_input.columns: got '', allowed: names such as 'x y z'"),
        ("command_input: {columns: x y z}", "command_input.columns: got 'x y z', allowed: nothing"),
        *(
            (f"command_input: {{type: Float32MultiArray, columns: {columns}}}", "allowed: x y z in any order, once")
            for columns in ("x y", "x y z z", "x y z qx", "x y z r", "x y z qx qy qz")
        ),
        ("command_input: {type: tf, frame: a}", "command_input.child_frame: got '', allowed: the name of a frame"),
        ("command_input: {orientation_topic: q}", "orientation_topic: got 'q', allowed: none: poses have"),
        ("command_input: {type: Point, orientation_topic: q, orientation: [0, 0, 0, 1]}", "allowed: null, as there is"),
        ("command_input: {type: Point, orientation_topic: q, orientation_columns: qx qy qz}", "qx qy qz qw in any"),
        ("command_input: {unit: 0}", "command_input.unit: got 0, allowed: a number in [1e-06, 1000] m"),
        ("device_frame: {axes: x=x y=y z=-z}", "device_frame.axes: got 'x=x y=y z=-z', allowed: three axes such as"),
        ("device_frame: {rotate: 1 2}", "line 1, column 24: device_frame.rotate: got '1 2', allowed: three axes"),
        ("device_frame: {scale: -1}", "device_frame.scale: got -1, allowed: a number in [0.001, 1000]"),
        ("clutch: {type: Bool}", "clutch.topic: got None, allowed: a text (the key is missing)"),
        ("device_output: {topic: a}", "device_output: got {'topic': 'a'}, allowed: a list of blocks"),
        ("device_output:\n- {topic: a, type: Vector3}\n- {topic: b}", "line 3, column 3: device_output[1].type: got"),
        ("device_output: [{topic: a, type: Vector}]", "device_output[0].type: got 'Vector', allowed: Wrench, Wrench"),
        ("device_output: [{topic: a, type: Float32MultiArray}]", "device_output[0].columns: got '', allowed: words"),
        ("device_output: [{topic: a, type: Float32MultiArray, columns: fx fw}]", "columns: got 'fw', allowed: words"),
        ("device_output: [{topic: a, type: Vector3, columns: fx}]", "columns: got 'fx', allowed: nothing, as of"),
        ("device_output: [{topic: a, type: a_msgs/msg/B}]", "device_output[0].fields: got '', allowed: the fields of"),
        ("device_output: [{topic: a, type: Vector3, fields: x fy}]", "fields: got 'x', allowed: words such as force"),
        ("device_output: [{topic: a, type: Vector3, rate: -1}]", "device_output[0].rate: got -1, allowed: a number in"),
        ("command_input: {type: Point}\ndevice_output: [{topic: a, type: Vector3, axes: handle}]",
         "line 2, column 49: device_output[0].axes: got 'handle', allowed: device or world"),
    ],
)  # fmt: skip
def test_refusals_name_the_place(tmp_path, text, says) -> None:
    """File, line and column where there are any; key, value, and what is allowed."""
    file = tmp_path / "device.yaml"
    file.write_text(text)
    with pytest.raises(SceneError) as error:
        device_from(str(file), {})
    assert says in str(error.value)
    assert str(file) in str(error.value)


def test_a_name_that_is_no_device() -> None:
    with pytest.raises(
        SceneError, match="device: got 'haply', allowed: an existing YAML file, or a shipped device: crtk"
    ):
        device_from("haply", {})


def test_parameters_change_a_file_and_stand_by_themselves() -> None:
    """Those of the list by number; a new number adds to it. Arrays come as rclpy has them, null as inf."""
    given = {
        "command_input.topic": "/mine",
        "device_frame.offset": np.array([0.0, 1.0, 2.0]),
        "device_output_0.limit": 2.0,
        "device_output_1.topic": "/glove",
        "device_output_1.type": "Float32MultiArray",
        "device_output_1.columns": "0 intensity",
        "scene": "finger",
    }
    device = device_from("haply_inverse3", given)
    assert device.command_input.topic == "/mine"
    assert device.command_input.columns == "x y z - - -"
    assert device.device_frame.offset == (0.0, 1.0, 2.0)
    assert [output.limit for output in device.device_output] == [2.0, None]
    assert device.device_output[1].numbers == {"data.0": "0", "data.1": "intensity"}
    only = {"clutch.topic": "c", "command_input.orientation": [np.inf] * 4}
    only |= {"device_output_0.limit": 1.0, "device_output_0.topic": "o", "device_output_0.type": "Vector3"}
    alone = device_from("", only)
    assert alone.command_input.topic == COMMANDS
    assert alone.command_input.fixed is None
    assert alone.clutch.topic == "c"
    assert alone.device_output[0].limit == 1.0
    names = {parameter.name for parameter in alone.parameters()}
    assert {"command_input.type", "device_frame.scale", "clutch.button", "device_output_0.rate"} <= names


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"device_frame.scle": 1.0}, "device_frame.scle: got 1.0, allowed: no such key; known here: axes, scale"),
        (
            {"device_frame": 1.0},
            "device_frame: got 1.0, allowed: no value: a block, of which the",
        ),
        (
            {"device_output.rate": 1.0},
            "device_output.rate: got 1.0, allowed: no value: a block, of which the",
        ),
        ({"device_output_1.rate": 1.0}, "device_output_1.rate: got 1.0, allowed: device_output_0 to device_output_0"),
        ({"device_output_0.rate": 1.0}, "device_output[0].topic: got None"),
        ({"command_input.type": 3}, "command_input.type: got 3, allowed: PoseStamped or"),
    ],
)
def test_parameters_of_no_use(given, says) -> None:
    with pytest.raises(SceneError) as error:
        device_from("", given)
    assert says in str(error.value)


def test_what_has_no_orientation_lies_flat() -> None:
    """Unless it is said how."""
    assert parsed({"command_input": {"topic": "p", "type": "Point"}}).command_input.fixed == FLAT
    upright = {"topic": "p", "type": "PoseStamped", "orientation": [0, 0, 0, 2]}
    assert parsed({"command_input": upright}).command_input.fixed == (0.0, 0.0, 0.0, 1.0)

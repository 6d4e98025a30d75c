"""What a device is sent: each type is read back, in its axes, within its limits, when it is due, and zero at once."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import ros_helpers  # noqa: F401  (skips without ROS; checks fields of messages)
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from finger_sim import SceneError
from finger_sim.ros import device_out
from finger_sim.ros.device import parsed
from finger_sim.ros.device_fill import fill_outlets
from finger_sim.ros.device_in import DeviceIn
from finger_sim.ros.device_out import DeviceOut
from finger_sim.ros.wire import ADDRESS, LENGTH, WORDS, Outgoing
from finger_sim.scene.resources import shipped

WRENCH = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
LIMITS = np.array([10.0, 0.5])
STAMP = 7_000_000_008
FRAMES = {"device": "base", "handle": "tip", "world": "finger_world_aligned"}
NODE = SimpleNamespace(create_publisher=lambda kind, topic, qos: SimpleNamespace(kind=kind, topic=topic))


class Sent:
    """Messages to a device, filled as the loop fills them."""

    def __init__(self, *outputs, turn=(0.0, 0.0, 0.0, 1.0), **blocks) -> None:
        device = parsed({"device_output": list(outputs), **blocks})
        self.out = DeviceOut(NODE, device, FRAMES, None)
        self.inlet = DeviceIn(device, "world", np.zeros(1)).record
        self.inlet.grip[3:] = turn
        templates = [template for _, template in self.out.sent]
        messages = np.zeros((3 + len(templates), WORDS), np.int64)
        for words, template in zip(messages[3:], templates, strict=True):
            words[ADDRESS], words[LENGTH] = template.bytes.ctypes.data, len(template.bytes)
        none = np.zeros(len(messages), np.int64)
        self.outgoing = Outgoing(0, 0, none, messages, none)

    def fill(self, wrench=WRENCH, dt=0.001, limits=LIMITS):
        """Which are due."""
        fill_outlets(self.out.record, self.outgoing, self.inlet, np.array(wrench), limits, dt, STAMP)
        return self.out.record.due.tolist()

    def read(self, k=0):
        publisher, template = self.out.sent[k]
        return deserialize_message(template.bytes.tobytes(), publisher.kind)


def numbers(v):
    return [v.x, v.y, v.z]


@pytest.mark.parametrize("kind", ["Wrench", "WrenchStamped", "geometry_msgs/msg/WrenchStamped"])
def test_wrenches(kind) -> None:
    sent = Sent({"topic": "w", "type": kind})
    assert sent.fill() == [1]
    message = sent.read()
    wrench = message if kind == "Wrench" else message.wrench
    assert numbers(wrench.force) + numbers(wrench.torque) == WRENCH.tolist()
    if kind != "Wrench":
        stamp = message.header.stamp
        assert (message.header.frame_id, stamp.sec, stamp.nanosec) == ("base", 7, 8)


@pytest.mark.parametrize("kind", ["Vector3", "Vector3Stamped"])
def test_vectors(kind) -> None:
    sent = Sent({"topic": "v", "type": kind, "axes": "world", "frame": "mine" if "Stamped" in kind else ""})
    sent.fill()
    message = sent.read()
    assert numbers(message if kind == "Vector3" else message.vector) == WRENCH[:3].tolist()
    assert kind == "Vector3" or message.header.frame_id == "mine"


@pytest.mark.parametrize("kind", ["Float32MultiArray", "Float64MultiArray"])
def test_arrays_of_any_words(kind) -> None:
    """A joint each, with signs; size of the force; its part of full_scale, which ends at 1; nothing."""
    sent = Sent({"topic": "a", "type": kind, "columns": "-fz fy fx 0 tz force intensity", "full_scale": 4.0})
    sent.fill()
    size = np.linalg.norm(WRENCH[:3])
    expected = [-3.0, -2.0, 1.0, 0.0, -0.3, size, size / 4.0]
    np.testing.assert_allclose(sent.read().data, expected, rtol=1e-7 if "32" in kind else 1e-15)
    sent.fill(10.0 * WRENCH, limits=np.array([100.0, 10.0]))
    assert sent.read().data[6] == 1.0


def test_fields_of_other_messages() -> None:
    """By their names; others stay as they are."""
    sent = Sent({"topic": "t", "type": "geometry_msgs/msg/TwistStamped", "fields": "twist.linear.y=-fz"})
    sent.fill()
    twist = sent.read().twist
    assert numbers(twist.linear) + numbers(twist.angular) == [0.0, -3.0, 0.0, 0.0, 0.0, 0.0]


def test_a_type_that_the_wheels_lack_has_its_bytes(monkeypatch) -> None:
    """omni_msgs/OmniFeedback of the shipped geomagic_touch: bytes as rosbags makes and reads them by the .msg text."""
    store = get_typestore(Stores.ROS2_JAZZY)
    name = "omni_msgs/msg/OmniFeedback"
    store.register(get_types_from_msg("geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 position\n", name))
    vector, feedback = store.types["geometry_msgs/msg/Vector3"], store.types[name]

    class Vector(SimpleNamespace):
        def get_fields_and_field_types(self):
            return dict.fromkeys("xyz", "double")

    class OmniFeedback:
        """As rclpy's class, but for the library that serialises it."""

        def __init__(self) -> None:
            self.force, self.position = Vector(x=0.0, y=0.0, z=0.0), Vector(x=0.0, y=0.0, z=0.0)

        def get_fields_and_field_types(self):
            return dict.fromkeys(("force", "position"), "geometry_msgs/Vector3")

    def serialized(message):
        made = feedback(*(vector(*numbers(part)) for part in (message.force, message.position)))
        return bytes(store.serialize_cdr(made, name))

    module = ModuleType("omni_msgs.msg")
    module.OmniFeedback = OmniFeedback
    monkeypatch.setitem(sys.modules, "omni_msgs", ModuleType("omni_msgs"))
    monkeypatch.setitem(sys.modules, "omni_msgs.msg", module)
    monkeypatch.setattr(device_out, "serialize_message", serialized)
    from finger_sim.scene.yaml_text import YamlText

    data = YamlText(shipped("config") / "devices" / "geomagic_touch.yaml").data
    sent = Sent(*data.pop("device_output"), **data)
    sent.fill()
    message = store.deserialize_cdr(sent.out.sent[0][1].bytes.tobytes(), name)
    # world x is the driver's y, world y its -x; 3.3 N is less than the force
    expected = np.array([2.0, 1.0, 3.0]) * 3.3 / np.linalg.norm(WRENCH[:3])
    np.testing.assert_allclose(numbers(message.force), expected, atol=1e-12)
    assert numbers(message.position) == [0.0, 0.0, 0.0]


def test_axes() -> None:
    """The device's, its handle's and the world's, by scipy; the scale is in all but the last."""
    turn = Rotation.from_euler("xyz", [0.3, 0.4, 0.5])
    outputs = [{"topic": f"w{k}", "type": "Wrench", "axes": axes} for k, axes in enumerate(FRAMES)]
    sent = Sent(*outputs, turn=turn.as_quat(), device_frame={"axes": "x=-y y=x z=z", "scale": 0.5})
    sent.fill()
    base = Rotation.from_matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    force, torque = 0.5 * base.inv().apply(WRENCH[:3]), base.inv().apply(WRENCH[3:])
    expected = [(force, torque), (turn.inv().apply(force), turn.inv().apply(torque)), (WRENCH[:3], WRENCH[3:])]
    for k, (f, t) in enumerate(expected):
        np.testing.assert_allclose(numbers(sent.read(k).force), f, atol=1e-12)
        np.testing.assert_allclose(numbers(sent.read(k).torque), t, atol=1e-12)


def test_limits_hold_after_the_scale_and_in_each_output() -> None:
    """The scene's, which a scale above one would break, and the output's own; directions stay."""
    outputs = [{"topic": "a", "type": "Wrench"}, {"topic": "b", "type": "Wrench", "limit": 2.0}]
    outputs.append({"topic": "c", "type": "Vector3", "limit": 0.0})
    sent = Sent(*outputs, device_frame={"scale": 20.0})
    sent.fill(limits=np.array([10.0, 0.1]))
    for k, limit in enumerate((10.0, 2.0)):
        force = np.array(numbers(sent.read(k).force))
        assert np.linalg.norm(force) == pytest.approx(limit)
        np.testing.assert_allclose(np.cross(force, WRENCH[:3]), 0.0, atol=1e-9)
        assert np.linalg.norm(numbers(sent.read(k).torque)) == pytest.approx(0.1)
    assert numbers(sent.read(2)) == [0.0, 0.0, 0.0]


def test_a_rate_of_its_own_and_zero_at_once() -> None:
    """60 in a second of 1 kHz, evenly; the first zero does not wait for its turn, and the next one does."""
    sent = Sent({"topic": "slow", "type": "Vector3", "rate": 60.0}, {"topic": "fast", "type": "Vector3"})
    due = np.array([sent.fill() for _ in range(1000)])
    assert due[:, 1].all()
    assert due[:, 0].sum() in (59, 60)
    assert set(np.diff(np.flatnonzero(due[:, 0])).tolist()) <= {16, 17}
    while sent.fill()[0]:
        pass
    assert sent.fill(np.zeros(6)) == [1, 1]
    assert numbers(sent.read()) == [0.0, 0.0, 0.0]
    assert sent.fill(np.zeros(6)) == [0, 1]


def test_fields_that_are_not_there() -> None:
    """Named with the place."""
    for fields in ("force=fx", "forces.x=fx", "wrench.force.x=fx header.stamp.sec=fx", "header.frame_id=fx"):
        with pytest.raises(SceneError, match=r"^device_output\[0\]\.fields: got '.*=fx', allowed: a field of"):
            Sent({"topic": "w", "type": "WrenchStamped", "fields": fields})

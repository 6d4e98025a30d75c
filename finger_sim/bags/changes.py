"""What was changed while a bag was recorded: parameters set live, resets, and the clutch of a device.

A node records each on the steps' own thread when it takes effect, between the last step without it and the first one
with it: parameters on /parameter_events as rclpy publishes them, resets and the clutch on topics of their own.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from ..errors import SceneError
from ..scene import Scene
from ..scene.reference import dotted
from ..scene.ros_values import from_ros
from . import cdr
from .excerpt import Received
from .metadata import Qos
from .origin import Origin
from .reader import BagReader, Message, absolute

EVENTS = "/parameter_events"
EVENTS_QOS = Qos(depth=1000)
RESET = "reset"
"""Last part of the name of the topic with resets: as that of the service which makes them."""
RESET_QOS = Qos()
CLUTCH = "clutch"
"""Last part of the name of the topic with the clutch of a device, as std_msgs/Bool: true while it is open."""
CLUTCH_QOS = Qos()


class Change(NamedTuple):
    """One change of a recording."""

    time: int
    """Log time from which it holds: it is made before the first step that begins then or later [ns]."""
    scene: Mapping[str, Any]
    """Live values of the scene by their dotted keys, as `Simulator.apply` takes them."""
    options: Mapping[str, Any]
    """The node's own parameters, plain values by name."""
    reset: bool
    """Back to rest at the last command."""
    clutch: bool | None
    """Whether the clutch is open from then on; None: as before."""
    message: Message
    """As it was recorded."""
    number: int
    """Of the message on its topic, from 1 on."""

    @property
    def place(self) -> str:
        """As warnings name it."""
        return _place(self.message, self.number)


def changes_in(reader: BagReader) -> tuple[list[Change], list[str]]:
    """All changes of a bag in the order in which they were made; and of messages that say none, where and why."""
    topics = [topic.name for topic in reader.topics if topic.count and _tells_changes(topic.name, topic.type)]
    if not topics:
        return [], []
    scene_keys = {name: spec for name, spec, _ in dotted(Scene) if spec.live}
    out, left_out = [], []
    numbers: Counter[str] = Counter()
    for message in reader.messages(topics):
        if not _tells_changes(message.topic, message.type):
            continue
        numbers[message.topic] += 1
        number = numbers[message.topic]
        scene: dict[str, Any] = {}
        options: dict[str, Any] = {}
        reset, clutch = message.type == cdr.EMPTY, None
        try:
            if message.type == cdr.BOOL:
                clutch = bool(cdr.deserialize(message.data, cdr.BOOL).data)
            values = {} if reset or clutch is not None else dict(_set_values(message.data))
        except ValueError as error:
            left_out.append(f"{_place(message, number)}: {error}")
            continue
        for name, value in values.items():
            if name in scene_keys:
                scene[name] = from_ros(value, scene_keys[name])
            else:
                options[name] = value
        out.append(Change(message.log_time, scene, options, reset, clutch, message, number))
    return out, left_out


def accepted(scene: Scene, changes: Iterable[Change]) -> tuple[list[Change], list[str]]:
    """Those that the scene takes one after another, as a node has; and of the others, where and why not."""
    good, left_out = [], []
    for change in changes:
        try:
            scene = changed(scene, [change])
            good.append(change)
        except SceneError as error:
            left_out.append(f"{change.place}: {error}")
    return good, left_out


def changed(scene: Scene, changes: Iterable[Change]) -> Scene:
    """The scene after these changes. Raises SceneError for a value that it refuses."""
    for change in changes:
        scene = scene.with_values(change.scene) if change.scene else scene
    return scene


def after(origin: Origin, changes: Iterable[Change]) -> Origin:
    """What made a bag, with scene and options after these changes, whatever they are."""
    scene, options = copy.deepcopy(dict(origin.scene)), dict(origin.options)
    for change in changes:
        options.update(change.options)
        for key, value in change.scene.items():
            *blocks, name = key.split(".")
            block = scene
            for part in blocks:
                block = block.setdefault(part, {})
            block[name] = value
    return replace(origin, scene=scene, options=options)


def before_their_steps(reader: BagReader, commands: Iterator[Received], changes: list[Change]) -> list[Change]:
    """The changes of a recording in mode triggered, each by the receipt of the first command whose step had it.

    A command may have waited for its step while a change was made: the wrenches recorded by then tell how many steps
    had been.
    """
    names = {absolute(topic.name) for topic in reader.topics if topic.type == cdr.WRENCH_STAMPED}
    wrenches = [name for name in names if name.endswith("/contact_wrench")]
    if not changes or len(wrenches) != 1:
        return changes
    steps = (message.log_time for message in reader.messages(wrenches, cdr.WRENCH_STAMPED))
    end = next(steps, None)
    command = next(commands, None)
    out = []
    for change in changes:
        while end is not None and end < change.time:
            end, command = next(steps, None), next(commands, None)
        out.append(change if command is None else change._replace(time=min(change.time, command.log_time)))
    return out


def _tells_changes(name: str, kind: str) -> bool:
    name = absolute(name)
    by_name = {cdr.EMPTY: RESET, cdr.BOOL: CLUTCH}.get(kind)
    return (name == EVENTS and kind == cdr.PARAMETER_EVENT) or (by_name is not None and name.endswith(f"/{by_name}"))


def _place(message: Message, number: int) -> str:
    return f"topic {absolute(message.topic)}, message {number}"


def _set_values(data: bytes) -> Iterator[tuple[str, Any]]:
    """Names and values that a ParameterEvent tells of. Raises ValueError for bytes that are none."""
    event = cdr.deserialize(data, cdr.PARAMETER_EVENT)
    for parameter in (*event.new_parameters, *event.changed_parameters):
        if parameter.value.type in cdr.PARAMETER_FIELDS:
            value = getattr(parameter.value, cdr.PARAMETER_FIELDS[parameter.value.type])
            yield parameter.name, value.tolist() if hasattr(value, "tolist") else value

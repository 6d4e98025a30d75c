"""A bag on the page: what was recorded is shown at its time, wherever one jumps to. Bags are made by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from view.serving import Served, until

from finger_sim import Pose, Scene
from finger_sim.bags import cdr
from finger_sim.bags.layout import pack_points
from finger_sim.bags.origin import origin_of
from finger_sim.bags.reader import BagWriter
from finger_sim.cli import main
from finger_sim.errors import BagError
from finger_sim.scene import place
from finger_sim.scene.resources import find_bag
from finger_sim.view.playback import Playback
from finger_sim.view.recording import Recording
from finger_sim.view.tape import DIAGNOSTICS

START = 1_700_000_000_000_000_000
CLOUDS, RATE = 60, 20.0
"""Three seconds."""
SCENE = Scene.from_dict(
    {
        "mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [2, 1, 1]}},
        "driven": {"box": [[-1, -1, 0.0099], [1, 1, 1]]},
        "limits": {"stretch": [1.05, 1.25, None], "compress": [0.95, 0.75, 0.98]},
        "plane": {"point": [0, 0, 0.001], "friction": 0.5},
        "solver": {"method": "newton"},
    }
)


def pose_at(k: int) -> Pose:
    """It goes down and turns about z."""
    angle = 0.02 * k
    return Pose((1e-4 * k, 0.0, 0.004 - 1e-4 * k), (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)))


def make_bag(path: Path, origin: bool = True, clouds: int = CLOUDS, wrenches: bool = True) -> Path:
    """A body that moves rigidly. Nodes 0 and 3 of cloud k are pushed by k mN up and half of that along x."""
    mesh = SCENE.load_mesh()
    words = origin_of("run", SCENE, mesh, {"finger_frame": "finger"}).words() if origin else None
    bag = BagWriter(path, origin=words)
    for topic, kind in (
        ("mesh_topology", cdr.MESH), ("mesh_points", cdr.POINT_CLOUD), ("contact_wrench", cdr.WRENCH_STAMPED),
        ("device_wrench", cdr.WRENCH_STAMPED), ("command_pose", cdr.POSE_STAMPED),
        ("/parameter_events", cdr.PARAMETER_EVENT),
    ):  # fmt: skip
        bag.add_topic(topic, kind)
    bag.write("mesh_topology", cdr.mesh(mesh.points, mesh.surface), START)
    for k in range(clouds):
        time = START + round(k / RATE * 1e9)
        placed = place(mesh.points, pose_at(k))
        forces = np.zeros((len(placed), 3))
        forces[[0, 3]] = [5e-4 * k, 0.0, 1e-3 * k]
        strain = np.full(len(placed), 0.01 * k)
        bag.write("mesh_points", cdr.point_cloud(time, "world", pack_points(placed, placed, forces, strain)), time)
        if wrenches:
            for i in range(50):
                at = time + i * 1_000_000
                bag.write(
                    "contact_wrench", cdr.wrench_stamped(at, "finger_world_aligned", [0.3, 0.4, 2e-3 * k, 0, 0, 0]), at
                )
                bag.write(
                    "device_wrench", cdr.wrench_stamped(at, "finger_world_aligned", [0, 0, -1e-3 * k, 0, 0, 0]), at
                )
        bag.write("command_pose", cdr.pose_stamped(time, "world", *_parts(pose_at(k))), time)
        if k == clouds // 2:
            bag.write("/parameter_events", cdr.parameter_event(time, "/finger", {"plane.friction": 0.25}), time)
    bag.close()
    return path


def _parts(pose: Pose):
    return pose.position, pose.orientation


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return make_bag(tmp_path_factory.mktemp("bags") / "made")


def stands(page) -> bool:
    """Whether the last position that was told is that of one that does not play."""
    positions = [each for each in page.said if each["type"] == "position"]
    return bool(positions) and not positions[-1]["playing"]


def shown_at(page, time):
    """The frame after a jump to a time."""
    page.say("play", on=False)
    page.until(lambda: stands(page))
    count = len(page.frames)
    page.say("seek", time=time)
    return page.until(lambda: page.frames[-1] if len(page.frames) > count else None)


def test_a_recording_is_what_was_recorded(bag) -> None:
    """Pose, depth, forces, centre, samples and parameters at any time; the scene gives what the bag does not hold."""
    with Served(Playback(Recording(bag))) as served, served.page() as page:
        frame = page.until(lambda: page.frames)[0]
        hello = page.said[0]
        assert (hello["source"], hello["drive"], hello["bag"]["name"]) == ("bag", False, "made")
        assert abs(hello["bag"]["duration"] - (CLOUDS - 1) / RATE) < 0.06
        topology = page.topologies[0]
        assert topology.known == 3
        assert len(topology.tets) == 10
        assert sum(flag & 1 for flag in topology.flags) == 6
        assert np.isnan(topology.limits[2, 0])
        for k in (59, 7, 40, 41, 0, 30):
            frame = shown_at(page, k / RATE + 0.01)
            pose = pose_at(k)
            assert_allclose(frame.pose, [*pose.position, *pose.orientation], atol=1e-6)
            assert_allclose(frame.floats[7:14], [*pose.position, *pose.orientation], atol=1e-6)
            assert_allclose(frame.floats[14:21], [0, 0, 0.001, 0, 0, 0, 1], atol=1e-9)
            assert abs(frame.time - k / RATE) < 1e-6
            assert_allclose(frame.force, [1e-3 * k, 0.0, 2e-3 * k], atol=1e-8)
            assert abs(frame.floats[37] - max(0.0, 0.001 - pose.position[2])) < 1e-7
            assert abs(frame.floats[36] - (0.5 if k < 30 else 0.25)) < 1e-7
            assert frame.strain[0] == round(1.28 * k)
            assert [node for node, _, _ in frame.contacts] == ([0, 3] if k else [])
            assert_allclose(frame.floats[27:30], [0, 0, -1e-3 * k], atol=1e-7)
            if k:
                middle = frame.positions[[0, 3]].mean(axis=0)
                assert_allclose(frame.floats[33:36], middle, atol=1e-7)
                # the push along is half of that across: more than friction holds only once μ is 0.25; and it moves
                assert {slips for _, _, slips in frame.contacts} == {1}
            assert frame.flags & 16
            times = [row[0] for row in frame.samples]
            assert times == sorted(times)
            assert -0.006 < times[-1] <= 0.0
            assert abs(frame.samples[-1][1] - 2e-3 * k) < 1e-6
            assert abs(frame.samples[-1][2] - 0.5) < 1e-6
            assert abs(frame.samples[-1][3] - 1e-3 * k) < 1e-4
            assert 180 * (k / RATE) <= len(times) <= 210 * (k / RATE) + 3


def test_it_plays_pauses_and_ends(bag) -> None:
    """In real time and faster; at its end it stands, and plays again from the start."""
    with Served(Playback(Recording(bag))) as served, served.page() as page:
        page.say("play", on=True, speed=10)
        page.until(lambda: stands(page))
        seqs = [frame.time for frame in page.frames]
        assert seqs == sorted(seqs)
        assert abs(page.frames[-1].time - (CLOUDS - 1) / RATE) < 1e-6
        changed = [each["values"] for each in page.said if each["type"] == "values"]
        assert changed[-1]["plane.friction"] == 0.25
        assert all(
            item["live"] is False for each in page.said if each["type"] == "parameters" for item in each["items"]
        )
        count = len(page.frames)
        page.say("play", on=True, speed=1)
        page.until(lambda: len(page.frames) > count and page.frames[-1].time < 0.5)
        page.say("play", on=False)
        page.until(lambda: stands(page))
        where = next(each["time"] for each in reversed(page.said) if each["type"] == "position")
        page.next("status")
        page.say("seek", time=1e6)
        assert abs(page.next("position")["time"] - page.said[0]["bag"]["duration"]) < 1e-9
        assert where < 1.0


def test_it_waits_for_somebody_to_look(bag) -> None:
    """Nothing is missed while no page is open."""
    playback = Playback(Recording(bag))
    with Served(playback) as served:
        with served.page() as page:
            page.say("play", on=True, speed=0.5)
            page.until(lambda: page.frames and page.frames[-1].time > 0.05)
        until(lambda: not playback._seen)
        where = playback._now()
        assert playback._now() == where
        assert where < 2.0


def test_what_cannot_be_asked_of_a_recording(bag) -> None:
    """Each order is answered in words."""
    with Served(Playback(Recording(bag))) as served, served.page() as page:
        page.next("hello")
        assert "this is a recording" in page.notice("reset")
        assert "this is a recording" in page.notice("set", name="plane.friction", value=1)
        assert "this is a recording" in page.notice("record", on=True)
        assert "only shows it" in page.notice("take")


def test_the_yaml_of_a_moment(bag, tmp_path: Path) -> None:
    """It has the values of that moment, and loads."""
    with Served(Playback(Recording(bag))) as served, served.page() as page:
        for time, friction in ((0.5, 0.5), (2.0, 0.25)):
            shown_at(page, time)
            page.say("yaml")
            file = tmp_path / "moment.yaml"
            file.write_text(page.next("yaml")["text"])
            assert Scene.load(file) == SCENE.with_values({"plane.friction": friction})


def test_a_bag_that_says_nothing_of_its_making(tmp_path: Path) -> None:
    """It is shown, without plane, tetrahedra and axes, and without wrenches by its clouds; a notice says so."""
    path = make_bag(tmp_path / "bare", origin=False, clouds=5, wrenches=False)
    with Served(Playback(Recording(path))) as served, served.page() as page:
        frame = shown_at(page, 0.16)
        assert page.topologies[0].known == 0
        assert not frame.flags & 2
        assert [node for node, _, _ in frame.contacts] == [0, 3]
        assert_allclose(frame.samples[-1][1:3], [6e-3, 3e-3], atol=1e-7)
    assert any("not known" in note for note in Recording(path).notes)


@for_each(
    "names, shown",
    [
        (("finger: simulation", "left/finger: simulation"), "left/finger: simulation"),
        (("left/finger: simulation", "finger: simulation"), "left/finger: simulation"),
        (("finger: simulation",), "finger: simulation"), (("left/joystick: buttons",), None),
        (("finger: simulation", "right/finger: simulation"), None),
    ],
)  # fmt: skip
def test_reports_are_of_the_node_that_is_shown(names, shown, tmp_path: Path) -> None:
    """Those of another that were recorded with them are left out; where only one reports, its name does not matter."""
    mesh = SCENE.load_mesh()
    path = tmp_path / str(sum(1 for _ in tmp_path.iterdir()))
    with BagWriter(path) as bag:
        topics = {"/left/mesh_topology": cdr.MESH, "/left/mesh_points": cdr.POINT_CLOUD, "/diagnostics": DIAGNOSTICS}
        for topic, kind in topics.items():
            bag.add_topic(topic, kind)
        bag.write("/left/mesh_topology", cdr.mesh(mesh.points, mesh.surface), START)
        points = pack_points(mesh.points, mesh.points, 0.0 * mesh.points, np.zeros(len(mesh.points)))
        bag.write("/left/mesh_points", cdr.point_cloud(START, "world", points), START)
        for name in names:
            bag.write("/diagnostics", report(name), START)
    told = Recording(path).tape.reports.at(1.0)
    assert (told.message if told else None) == shown


def report(name: str) -> bytes:
    """A DiagnosticArray with one status, whose message is its name, too."""
    kinds = (DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticStatus", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    array, status, header, time = (cdr.typestore().types[kind] for kind in kinds)
    told = array(header(time(0, 0), ""), [status(0, name, name, "", [])])
    return bytes(cdr.typestore().serialize_cdr(told, DIAGNOSTICS))


def test_bags_without_a_finger_are_refused(tmp_path: Path, capsys) -> None:
    """Of commands, and none at all: exit code 2, what is missing, and how to make it."""
    with pytest.raises(BagError, match="holds no mesh"):
        Recording(find_bag("press_slide"))
    assert main(["view", "press_slide", "--no-browser"]) == 2
    assert "finger_sim run SCENE --bag" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "nothing"), "--no-browser"]) == 2
    assert "no such bag" in capsys.readouterr().err
    assert main(["view", str(make_bag(tmp_path / "empty", clouds=0)), "--no-browser"]) == 2
    assert "holds no clouds" in capsys.readouterr().err

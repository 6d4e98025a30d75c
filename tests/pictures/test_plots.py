"""What is read out of a recording, and the picture drawn of it."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from finger_sim import BagError, FingerSimError, MissingExtraError, Scene
from finger_sim.bags.cdr import typestore
from finger_sim.bags.reader import BagWriter, write_commands
from finger_sim.pictures.report import DIAGNOSTICS, read_health, read_recording
from finger_sim.scene import Plane
from finger_sim.simulation.replay import run


def block(**changes):
    """A block of 10 tetrahedra, its upper side driven; at height z its lower side is z above the plane."""
    return Scene.from_dict({
        "mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [2, 1, 1]}},
        "driven": {"box": [[-1, -1, 0.0099], [1, 1, 1]]},
        "material": {"young": 5e4, "poisson": 0.4},
        "limits": {"stretch": [1.05, 1.25, None], "compress": [0.95, 0.75, 0.98]},
        "plane": {"friction": 0.5},
        "dt": 0.005,
    } | changes)  # fmt: skip


def press(folder, scene, lateral=0.0):
    """The recording of a press into the plane, then `lateral` metres along x."""
    z = np.concatenate([np.linspace(0.002, -0.0004, 40), np.full(60, -0.0004)])
    x = np.concatenate([np.zeros(40), np.linspace(0.0, lateral, 60)])
    position = np.stack([x, np.zeros(100), z], axis=1)
    times = [1_000_000_000 + 5_000_000 * k for k in range(100)]
    write_commands(folder / "in", times, position, np.tile([0.0, 0.0, 0.0, 1.0], (100, 1)))
    run(scene, folder / "in", folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    pytest.importorskip("matplotlib")
    return press(tmp_path_factory.mktemp("press"), block(), lateral=0.002)


def test_depth_is_how_far_the_undeformed_skin_is_commanded_below_the_plane(pressed):
    """The lower side of the block lies at its origin, so depth is −z of the command, less the plane's."""
    recorded = read_recording(pressed, Plane())
    assert recorded.depth[0] == pytest.approx(-0.002, abs=1e-12)
    assert recorded.depth[-1] == pytest.approx(0.0004, abs=1e-12)
    lower = read_recording(pressed, Plane(point=(0.0, 0.0, -0.001), normal=(0.0, 0.0, 3.0)))
    np.testing.assert_allclose(lower.depth, recorded.depth - 0.001, atol=1e-12)


def test_forces_are_split_along_the_plane_s_normal(pressed):
    """Pressing pushes along +z, sliding drags along x; a plane that stood upright would swap the two."""
    recorded = read_recording(pressed, Plane())
    assert recorded.normal[-1] > 0.1
    assert 0.0 < recorded.tangential[-1] <= 0.5 * recorded.normal[-1] * 1.01
    np.testing.assert_allclose(recorded.normal[:10], 0.0)
    np.testing.assert_allclose(recorded.force, np.hypot(recorded.normal, recorded.tangential))
    upright = read_recording(pressed, Plane(normal=(1.0, 0.0, 0.0)))
    np.testing.assert_allclose(upright.force, recorded.force)
    assert upright.normal[-1] < -0.9 * recorded.tangential[-1]


def test_the_moment_of_peak_force_is_that_of_the_recorded_cloud(pressed):
    """Its forces add up to the wrench of that time; strains and triangles are those of the block."""
    recorded = read_recording(pressed, Plane())
    peak = recorded.peak
    at = np.argmin(np.abs(recorded.wrench_time - peak.time))
    assert np.linalg.norm(peak.forces.sum(axis=0)) == pytest.approx(recorded.force[at], rel=1e-5)
    assert recorded.force[at] > 0.9 * recorded.force.max()
    assert peak.points.shape == (12, 3)
    assert peak.triangles.max() < 12
    assert peak.strain.max() > 0.05


def test_a_bag_of_commands_alone_is_refused(tmp_path, pressed):
    """The missing topic is named."""
    with pytest.raises(BagError, match="Mesh was recorded"):
        read_recording(pressed.parent / "in", None)
    with pytest.raises(BagError, match=r"no .*DiagnosticArray was recorded"):
        read_health(pressed)


def test_health_is_the_worst_of_all_reports_and_the_last_of_totals(tmp_path):
    """Reports before the first step hold no values and do not count."""
    common = {"late steps": "4", "overruns": "3", "steps": "100", "refused commands": "0",
              "dropped records": "0", "real-time factor since start": "0.5",
              "step time p99 [ms]": "9.5"}  # fmt: skip
    reports = [
        {"refused commands": "0"},
        common | {"step time p50 [ms]": "3", "limited tets": "7", "max strain/limit": "1.5",
                  "penetration [mm]": "0.25", "status": "LOCKED|INVERTED", "steps with status": "2"},
        common | {"step time p50 [ms]": "2", "limited tets": "5", "max strain/limit": "1.0",
                  "penetration [mm]": "0.5", "status": "OK", "steps with status": "0", "steps": "200"},
    ]  # fmt: skip
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/diagnostics", DIAGNOSTICS)
        for second, report in enumerate(reports):
            bag.write("/diagnostics", diagnostics(report), second * 1_000_000_000)
    health = read_health(tmp_path / "bag")
    assert health.step_median == pytest.approx(2e-3)
    assert health.step_p99 == pytest.approx(9.5e-3)
    assert (health.steps, health.late, health.overruns) == (200, 4, 3)
    assert (health.limited_tets, health.max_strain_ratio, health.max_penetration) == (7, 1.5, 5e-4)
    assert (health.status, health.troubled) == ("LOCKED, INVERTED", 2)


def test_the_picture_says_what_it_shows(tmp_path, pressed):
    """Axes with units, the limit on the colour bar, one scale in all directions, many colours."""
    from matplotlib.image import imread

    from finger_sim.pictures.plots import draw, make_figure

    recorded = read_recording(pressed, Plane())
    figure = make_figure(recorded)
    labels = {text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())}
    assert {"time [s]", "commanded depth [mm]", "contact force [N]", "strain / limit"} <= labels
    body = next(axes for axes in figure.axes if axes.name == "3d")
    spans = [np.ptp(limit) for limit in (body.get_xlim3d(), body.get_ylim3d(), body.get_zlim3d())]
    assert spans == pytest.approx([spans[0]] * 3)
    pixels = imread(draw(recorded, tmp_path / "picture.png"))
    assert min(pixels.shape[:2]) > 500
    assert len(np.unique((pixels[..., :3] * 15).astype(int).reshape(-1, 3), axis=0)) > 50


@pytest.mark.parametrize("without", ["plane", "limits"])
def test_a_scene_without_plane_or_limits_is_drawn_too(tmp_path, without):
    """No force, or no strain: the picture has the rest."""
    from finger_sim.pictures.plots import draw

    pytest.importorskip("matplotlib")
    data = block().to_dict()
    data[without] = None
    scene = Scene.from_dict({key: value for key, value in data.items() if value is not None})
    recorded = read_recording(press(tmp_path, scene), scene.plane)
    assert draw(recorded, tmp_path / "picture.png").stat().st_size > 10_000


def test_a_tilted_plane_is_drawn_level(pressed):
    """The body is seen in the plane's own frame, so that it lies on it as on a table."""
    from finger_sim.pictures.plots import make_figure

    recorded = dataclasses.replace(read_recording(pressed, None), plane=Plane(normal=(0.0, 1.0, 1.0)))
    assert make_figure(recorded)


def test_what_cannot_be_drawn_says_so(tmp_path, pressed, monkeypatch):
    """A folder that is not there, and matplotlib that is not installed."""
    from finger_sim.pictures.plots import draw

    recorded = read_recording(pressed, Plane())
    with pytest.raises(FingerSimError, match=r"picture\.png: the picture cannot be written"):
        draw(recorded, tmp_path / "none" / "picture.png")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"\[plot\]"):
        draw(recorded, tmp_path / "picture.png")


def diagnostics(values):
    """CDR bytes of a report with these values."""
    new = typestore().types
    pairs = [new["diagnostic_msgs/msg/KeyValue"](key, value) for key, value in values.items()]
    status = new["diagnostic_msgs/msg/DiagnosticStatus"](0, "finger", "ok", "finger_sim", pairs)
    header = new["std_msgs/msg/Header"](new["builtin_interfaces/msg/Time"](0, 0), "")
    return bytes(typestore().serialize_cdr(new[DIAGNOSTICS](header, [status]), DIAGNOSTICS))

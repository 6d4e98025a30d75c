"""A plane that moves: the body goes with it as it would if the two were seen from the plane."""

from __future__ import annotations

import numpy as np
import pytest
from physics_helpers import Array, pose
from scipy.spatial.transform import Rotation
from small_fingers import small

from finger_sim import Pose, SceneError, Simulator

LAID = Rotation.from_euler("x", 90, degrees=True)
DOWN = 0.0058
"""Height of the bone that presses the pad 1.5 mm [m]."""


def finger(**values: object) -> Simulator:
    scene = small("finger_haptic").with_values({k.replace("__", "."): v for k, v in values.items()})
    sim = Simulator(scene)
    for k in range(200):
        sim.step(pose((0.0, 0.0, 0.02 + (DOWN - 0.02) * (k + 1) / 200), LAID))
    for _ in range(100):
        sim.step()
    return sim


def far_over_a_plane(**values: object) -> Simulator:
    sim = Simulator(small("finger_haptic").with_values({k.replace("__", "."): v for k, v in values.items()}))
    sim.reset(pose((0, 0, 5.0), LAID))
    return sim


@pytest.mark.parametrize("friction", [0.5, 0.05])
def test_a_table_drawn_away_is_a_finger_drawn_back(friction: float) -> None:
    """Moving the plane gives the force of moving the finger the other way over a plane at rest."""
    forces: list[list[Array]] = []
    for moves in ("plane", "finger"):
        sim, forces_here = finger(plane__friction=friction), []
        sim.step(None, pose())
        for k in range(150):
            way = 2e-5 * (k + 1)
            out = (
                sim.step(None, pose((way, 0.5 * way, 0.0)))
                if moves == "plane"
                else sim.step(pose((-way, -0.5 * way, DOWN), LAID), pose())
            )
            forces_here.append(out.contact_wrench[:3])
        forces.append(forces_here)
    carried, drawn = np.array(forces)
    np.testing.assert_allclose(carried, drawn, atol=0.02 * np.abs(drawn).max())
    assert carried[-1, 0] == pytest.approx(2.0 * carried[-1, 1], rel=0.1)
    assert np.hypot(*carried[-1, :2]) == pytest.approx(friction * carried[-1, 2], rel=0.02)
    assert carried[-1, 0] > 0.0


def test_a_plane_that_rises_presses_as_a_finger_that_sinks() -> None:
    forces = []
    for moves in ("plane", "finger"):
        sim = finger()
        sim.step(None, pose())
        for k in range(100):
            way = 5e-6 * (k + 1)
            out = sim.step(None, pose((0, 0, way))) if moves == "plane" else sim.step(pose((0, 0, DOWN - way), LAID))
        forces.append(out.contact_wrench[:3])
    np.testing.assert_allclose(forces[0], forces[1], rtol=0.03, atol=0.02)


def test_in_each_substep_the_plane_is_where_it_is_then() -> None:
    """Four substeps to a target are four steps to the targets on the way there, rising, sliding and turning."""
    awake = {"solver__settle": False, "solver__sleep": False, "solver__tolerance": 1e-8, "dt": 1e-3}
    coarse, fine = finger(**awake, substeps=4), finger(**awake, substeps=4)
    steps = Simulator(fine.scene.with_values({"substeps": 1, "dt": 2.5e-4}))
    steps.reset(fine.pose)
    coarse.reset(fine.pose)
    target = lambda t: pose((2e-2 * t, 0.0, 1e-2 * t), Rotation.from_rotvec([0.0, 5.0 * t, 0.0]))  # noqa: E731
    coarse.step(None, target(0.0))
    for _ in range(4):
        steps.step(None, target(0.0))
    for k in range(30):
        whole = coarse.step(None, target(1e-3 * (k + 1)))
        for quarter in range(4):
            one = steps.step(None, target(1e-3 * (k + 0.25 * (quarter + 1))))
        np.testing.assert_allclose(whole.contact_wrench, one.contact_wrench, rtol=1e-6, atol=1e-6)
    assert whole.contact_wrench[2] > 0.5


def test_a_turntable_drags_by_its_point_under_the_finger() -> None:
    """Spinning about an axis 10 cm to the left: the surface moves across, and pulls the finger with it."""
    sim = finger()
    centre = (0.0, -0.1, 0.0)
    sim.step(None, pose(centre))
    for k in range(200):
        out = sim.step(None, pose(centre, Rotation.from_rotvec([0.0, 0.0, 2e-4 * (k + 1)])))
    x, y, z = out.contact_wrench[:3]
    assert np.hypot(x, y) == pytest.approx(0.5 * z, rel=0.03)
    assert x < -0.9 * 0.5 * z


def test_a_tilting_plane_pushes_along_its_normal() -> None:
    sim = finger(plane__friction=0.0)
    sim.step(None, pose())
    for k in range(200):
        turn = Rotation.from_rotvec([5e-4 * (k + 1), 0.0, 0.0])
        out = sim.step(None, pose((0.0, 0.0, 0.0), turn))
    normal = turn.as_matrix()[:, 2]
    force = out.contact_wrench[:3]
    np.testing.assert_allclose(force / np.linalg.norm(force), normal, atol=1e-6)


def test_a_finger_asleep_wakes_when_the_plane_moves() -> None:
    sim = finger()
    sim.step(None, pose())
    for _ in range(5000):
        if sim.step().asleep:
            break
    assert sim.step().asleep
    before = sim.step().contact_wrench[0]
    first = sim.step(None, pose((1e-4, 0.0, 0.0)))
    assert not first.asleep
    for _ in range(100):
        out = sim.step()
    assert out.contact_wrench[0] > before + 0.01


def test_targets_that_come_seldom_give_an_even_motion() -> None:
    """A target every ten steps: reached in ten, at the speed that they were sent with; then it stops."""
    sim, heights, speeds = far_over_a_plane(), [], []
    for k in range(100):
        sim.step(None, pose((0, 0, 1e-3 * k)) if k % 10 == 0 else None)
        assert sim.plane_pose is not None
        heights.append(sim.plane_pose.position[2])
        speeds.append(sim.plane_twist[2])
    assert speeds[12:] == pytest.approx([1.0] * 88)
    assert np.diff(heights[12:]) == pytest.approx(1e-3)
    for _ in range(20):
        sim.step()
    assert sim.plane_pose is not None
    assert sim.plane_pose.position[2] == pytest.approx(0.09)
    assert not sim.plane_twist.any()


def test_it_moves_no_faster_than_the_coupling_allows() -> None:
    sim = far_over_a_plane(coupling__max_speed=0.5, coupling__max_angular_speed=3.0)
    sim.step(None, pose())
    sim.step(None, pose((1.0, 0, 0), Rotation.from_rotvec([2.0, 0, 0])))
    for _ in range(50):
        sim.step()
        assert np.linalg.norm(sim.plane_twist[:3]) <= 0.5 + 1e-9
        assert np.linalg.norm(sim.plane_twist[3:]) <= 3.0 + 1e-9
        assert np.linalg.norm(sim.plane_twist) > 0.4


def test_a_plane_set_anew_rests_there() -> None:
    sim = finger()
    sim.step(None, pose())
    sim.step(None, pose((0, 0, 1e-4)))
    sim.apply({"plane.point": [0.0, 0.0, -0.05]})
    for _ in range(50):
        out = sim.step()
    assert out.contacts == 0
    assert not out.contact_wrench.any()


@pytest.mark.parametrize(
    ("plane", "names"),
    [(Pose((0, 0, float("nan"))), "plane.position"), (Pose((0, 0, 0), (0, 0, 0, 0)), "plane.orientation")],
)
def test_a_pose_of_no_use_is_refused(plane: Pose, names: str) -> None:
    sim = finger()
    before = sim.positions.copy()
    with pytest.raises(SceneError, match=names):
        sim.step(None, plane)
    np.testing.assert_array_equal(sim.positions, before)


def test_a_scene_without_a_plane_has_none_to_move() -> None:
    with pytest.raises(SceneError, match="plane"):
        Simulator(small("finger_haptic").with_values({"plane": None})).step(None, pose())

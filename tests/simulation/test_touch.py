"""`StepResult.touch`: contact area, centre of pressure and slip of a block on a plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from physics_helpers import beam_scene, pose, rotations, run
from scipy.spatial.transform import Rotation

from finger_sim import Scene, Simulator, StepResult
from finger_sim.simulation.touch import NOTHING, Imprint, Touch

SIDE = 0.04
MIDDLE = SIDE / 2
DEEP = 3e-4
STUCK = 1e-8
"""Way along a rigid plane in one step up to which a node rests [m]: 10 µm a second."""
DRIVEN = {"box": [[-1, -1, 0.0199], [1, 1, 1]]}


def block(*, poisson: float = 0.0, friction: float = 0.4, driven: Any = DRIVEN, **values: Any) -> Scene:
    """A soft block whose top is driven, its bottom of SIDE by SIDE on the plane."""
    scene = beam_scene(
        (SIDE, SIDE, 0.02),
        (4, 4, 2),
        young=5e4,
        poisson=poisson,
        damping=(0.0, 0.002),
        driven=driven,
        plane={"point": [0, 0, 0], "friction": friction},
        solver={"tolerance": 1e-6, "max_iterations": 20_000},
    )
    return scene.with_values({key.replace("__", "."): value for key, value in values.items()})


def touch_of(out: StepResult) -> Touch:
    assert out.touch is not None
    return out.touch


def test_the_area_of_a_block_pressed_flat_is_that_of_its_face() -> None:
    """Exactly, wherever the plane lies and however the block on it is turned; without friction all of it is free."""
    for turn in rotations(1, seed=5):
        normal = [float(x) for x in turn.apply([0.0, 0.0, 1.0])]
        scene = block(friction=0.0, plane__normal=normal)
        sim = Simulator(scene, touch=True)
        sim.reset(pose(turn=turn))
        out = run(sim, 100, pose(-DEEP * np.array(normal), turn))
        touch = touch_of(out)
        assert out.contacts == 25
        assert touch.area == pytest.approx(SIDE**2, rel=1e-9)
        assert touch.centre == pytest.approx(turn.apply([MIDDLE, MIDDLE, 0.0]), abs=1e-5)
        assert touch.slipping == 0.0


def test_a_tilted_block_touches_with_the_nodes_of_its_edge() -> None:
    """A row of nodes at the edge of four cells has an eighth of the face, as the plane sees it."""
    tilt = Rotation.from_rotvec([0.0, 0.01, 0.0])
    sim = Simulator(block(friction=0.0), touch=True)
    lowest = float(tilt.apply(np.array(sim.mesh.points))[:, 2].min())
    sim.reset(pose((0.0, 0.0, -lowest), tilt))
    out = run(sim, 100, pose((0.0, 0.0, -lowest - 2e-5), tilt))
    assert out.contacts == 5
    assert touch_of(out).area == pytest.approx(SIDE**2 / 8, rel=0.01)


def test_the_centre_of_pressure_balances_the_moment() -> None:
    """Tilted and slid, the contact's torque about the finger frame is that of its force at the centre of pressure."""
    sim = Simulator(block(poisson=0.4), touch=True)
    for k in range(100):
        out = sim.step(pose((5e-5 * k, 2e-5 * k, -DEEP), Rotation.from_rotvec([2e-5 * k, 4e-5 * k, 0.0])))
    fx, fy, fz, tx, ty, _ = out.contact_wrench
    ox, oy, oz = out.pose.position
    expected = [ox - (ty + oz * fx) / fz, oy + (tx - oz * fy) / fz]
    centre = touch_of(out).centre
    assert centre is not None
    assert np.hypot(centre[0] - ox - MIDDLE, centre[1] - oy - MIDDLE) > 1e-3
    assert centre[:2] == pytest.approx(expected, abs=1e-6)
    assert abs(centre[2]) < 1e-5


def shares_of_slip(**values: Any) -> list[tuple[float, float]]:
    """Of a block pressed flat, then slid: the share that is told, and that of the contact nodes that moved sideways."""
    sim = Simulator(block(poisson=0.4, solver__tolerance=1e-9, **values), touch=True)
    shares = []
    run(sim, 5, pose((0.0, 0.0, -DEEP)))
    for k in range(60):
        before = sim.positions.copy()
        out = sim.step(pose((2e-5 * k, 1e-5 * k, -DEEP)))
        moved = np.linalg.norm((sim.positions - before)[sim.contact_forces[:, 2] > 0.0][:, :2], axis=1)
        shares.append((touch_of(out).slipping, float(np.mean(moved > STUCK))))
    return shares


def test_nothing_slips_that_sticks_and_all_that_slides() -> None:
    """On a rigid plane what moves slips, first none, in the end all; on one that gives both solvers tell alike."""
    told, moved = zip(*shares_of_slip(plane__stiffness=None), strict=True)
    assert told == moved
    assert told[0] == 0.0
    assert any(0.0 < share < 1.0 for share in told)
    assert told[-10:] == (1.0,) * 10
    pgs, newton = (
        [share for share, _ in shares_of_slip(plane__stiffness=30.0, solver__method=method)]
        for method in ("pgs", "newton")
    )
    assert pgs == newton
    assert any(0.0 < share < 1.0 for share in pgs)


@pytest.mark.parametrize("method", ["pgs", "newton"])
def test_what_rests_at_the_cone_does_not_slip(method: str) -> None:
    """A block on a slope rests, a node left with all the friction it can have; on a slicker slope it slides."""
    scene = beam_scene(
        (0.2, 0.2, 0.1),
        (2, 2, 1),
        young=1e6,
        damping=(0.0, 0.01),
        gravity=[4.2, 0.0, -9.1],
        plane={"point": [0, 0, 0], "friction": 0.5},
        solver={"method": method, "tolerance": 1e-5, "max_iterations": 5000},
    )
    sim = Simulator(scene, touch=True)
    out = run(sim, 1000)
    forces = sim.contact_forces[sim.contact_forces[:, 2] > 0.0]
    assert (np.hypot(*forces[:, :2].T) >= (0.5 - 1e-5) * forces[:, 2]).any()
    assert touch_of(out).slipping == 0.0
    sim.apply({"plane.friction": 0.3})
    assert touch_of(run(sim, 50)).slipping == 1.0


def test_what_goes_along_with_the_plane_does_not_slip() -> None:
    """A pressed block that stays over a plane that slides slips, and one that goes along does not."""
    for along, slipping in ((0.0, 1.0), (1.0, 0.0)):
        sim = Simulator(block(poisson=0.4), touch=True)
        run(sim, 20, pose((0.0, 0.0, -DEEP)))
        for way in np.linspace(0.0, 1e-2, 200):
            out = sim.step(pose((along * way, 0.0, -DEEP)), pose((way, 0.0, 0.0)))
        assert touch_of(out).slipping == slipping


def test_a_body_asleep_touches_as_it_did() -> None:
    """What the last computed step told goes on."""
    sim = Simulator(block(solver__sleep=True, solver__method="newton"), touch=True)
    out = before = run(sim, 5, pose((0.0, 0.0, -DEEP)))
    for _ in range(3000):
        before, out = out, sim.step(None)
        if out.asleep:
            break
    assert out.asleep
    assert out.touch == before.touch
    assert touch_of(out).area == pytest.approx(SIDE**2, rel=1e-6)


def test_nothing_touches_in_free_air_nor_without_a_plane() -> None:
    """No area, no centre, no slip."""
    sim = Simulator(block(), touch=True)
    sim.reset(pose((0.0, 0.0, 0.1)))
    assert sim.step(None).touch == NOTHING == Touch(0.0, None, 0.0)
    assert Simulator(beam_scene(), touch=True).step(None).touch == NOTHING


def test_nothing_is_computed_unasked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step takes no imprint; one that is taken tells of its moment, whatever steps come after it."""
    sim = Simulator(block())
    with monkeypatch.context() as patch:
        patch.setattr(Imprint, "of", lambda *_: pytest.fail("an imprint is taken"))
        assert run(sim, 20, pose((0.0, 0.0, -DEEP))).touch is None
    imprint = Imprint.of(sim)
    touch = imprint.touch()
    assert touch.area > 0.0
    run(sim, 50, pose((0.0, 0.0, 0.01)))
    assert imprint.touch() == touch
    assert Imprint.of(sim).touch() == NOTHING

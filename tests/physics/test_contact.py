"""Contact with the plane: weight, reaction at the bone, Coulomb's cone, and the wrench's point and sign."""

from __future__ import annotations

from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, beam_scene, finger_scene, healthy, lumped_mass, pose, rotations, run, settle
from scipy.spatial.transform import Rotation

from finger_sim import Scene, Simulator
from finger_sim.physics.contact import plane_frame

G = 9.81


def block(angle: float = 0.0, mu: float = 0.5, towards: float = 0.0, **blocks: Any) -> tuple[Scene, Array, Array]:
    """A free block lying on a plane tilted by `angle` [rad] downhill `towards`; with the normal and the way down.

    The plane is horizontal in the mesh's axes and gravity is tilted: the same physics.
    """
    downhill = np.array([np.cos(towards), np.sin(towards), 0.0])
    gravity = G * (np.sin(angle) * downhill - np.cos(angle) * np.array([0.0, 0.0, 1.0]))
    scene = beam_scene(
        (0.2, 0.2, 0.1),
        (2, 2, 1),
        young=1e6,
        damping=(0.0, 0.01),
        gravity=list(gravity),
        plane={"point": [0, 0, 0], "friction": mu},
        solver={"tolerance": 1e-8, "max_iterations": 5000},
        **blocks,
    )
    return scene, np.array([0.0, 0.0, 1.0]), downhill


@for_each("index", range(4))
def test_wrench_balances_the_weight_at_rest(index: int) -> None:
    """A block at rest on the plane: force m g upwards to 1e-4, about the frame's origin the torque of the weight.

    Also with plane, gravity and body turned together: the wrench turns along.
    """
    turn = [Rotation.identity(), *rotations(1, seed=21)[1:]][index] if index < 4 else Rotation.identity()
    scene, normal, _ = block()
    scene = scene.with_values(
        {
            "gravity": list(turn.apply([0, 0, -G])),
            "plane.normal": list(turn.apply(normal)),
            "plane.point": [0.3, -0.2, 0.1],
        }
    )
    sim = Simulator(scene)
    placed = turn.apply(np.array(sim.mesh.points)) + [0.3, -0.2, 0.1]
    sim.set_state(placed, np.zeros_like(placed))
    out = settle(sim, speed=1e-8)
    mass = lumped_mass(scene, sim.mesh)
    weight = mass.sum() * G
    assert healthy(out)
    assert_allclose(out.contact_wrench[:3], turn.apply([0, 0, weight]), rtol=0, atol=1e-4 * weight)
    arm = mass @ sim.positions / mass.sum() - out.pose.position
    torque = np.cross(arm, turn.apply([0, 0, weight]))
    assert_allclose(out.contact_wrench[3:], torque, rtol=0, atol=1e-4 * weight * 0.2)
    assert_allclose(sim.contact_forces.sum(axis=0), out.contact_wrench[:3], rtol=1e-12, atol=1e-12 * weight)
    assert out.contacts == 9
    assert out.max_penetration < 1e-5


@for_each("mu", [0.2, 0.5, 1.0])
@for_each("towards", [0.0, np.pi / 4, 2.0])
def test_block_sticks_below_the_angle_of_friction(mu: float, towards: float) -> None:
    """tan θ = 0.95 μ: no creep, and the friction carries m g sin θ."""
    angle = np.arctan(0.95 * mu)
    scene, normal, downhill = block(angle, mu, towards)
    sim = Simulator(scene)
    out = settle(sim, speed=1e-7)
    start = sim.positions.copy()
    out = run(sim, 200)
    assert healthy(out)
    assert np.abs(sim.positions - start).max() < 1e-8
    weight = lumped_mass(scene, sim.mesh).sum() * G
    assert_allclose(
        out.contact_wrench[:3], weight * (np.cos(angle) * normal - np.sin(angle) * downhill), rtol=0, atol=1e-4 * weight
    )


@for_each("mu", [0.2, 0.5])
@for_each("towards", [0.0, np.pi / 4, 2.0])
def test_block_slides_above_the_angle_of_friction(mu: float, towards: float) -> None:
    """tan θ = 1.5 μ: a = g (sin θ − μ cos θ) downhill; |F_t| = μ F_n whatever the direction: a cone, not a box."""
    angle = np.arctan(1.5 * mu)
    scene, normal, downhill = block(angle, mu, towards)
    sim = Simulator(scene)
    mass = lumped_mass(scene, sim.mesh)
    run(sim, 150)
    times, speeds = [], []
    for _ in range(150):
        out = sim.step()
        times.append(out.time)
        speeds.append(mass @ sim.velocities / mass.sum())
        force = out.contact_wrench[:3]
        tangential = force - normal * (force @ normal)
        assert np.linalg.norm(tangential) == pytest.approx(mu * (force @ normal), rel=1e-3)
        assert tangential @ -downhill == pytest.approx(np.linalg.norm(tangential), rel=1e-4)
    assert healthy(out)
    acceleration = np.polyfit(times, speeds, 1)[0]
    expected = G * (np.sin(angle) - mu * np.cos(angle))
    assert_allclose(acceleration, expected * downhill, rtol=0, atol=5e-3 * expected)


def test_no_friction_without_a_coefficient() -> None:
    """μ = 0: the block slides at g sin θ and the force has no tangential part at all."""
    scene, _, downhill = block(0.3, 0.0)
    sim = Simulator(scene)
    out = run(sim, 100)
    assert_allclose(out.contact_wrench[:2], 0.0, rtol=0, atol=1e-14)
    mass = lumped_mass(scene, sim.mesh)
    speed = mass @ sim.velocities / mass.sum()
    assert_allclose(speed @ downhill, G * np.sin(0.3) * out.time, rtol=1e-6)


def test_a_rolling_stop_is_a_stop() -> None:
    """A block thrown along the plane stops after v² / 2 μ g, and does not come back."""
    scene, _, _ = block(0.0, 0.5)
    sim = Simulator(scene)
    settle(sim, speed=1e-7)
    speed = 0.5
    start = sim.positions[:, :2].mean(axis=0)
    sim.set_state(sim.positions.copy(), np.tile([speed * 0.6, speed * 0.8, 0.0], (len(sim.positions), 1)))
    settle(sim, speed=1e-7)
    slid = sim.positions[:, :2].mean(axis=0) - start
    assert_allclose(slid, speed**2 / (2 * 0.5 * G) * np.array([0.6, 0.8]), rtol=0.02)


def coulomb_holds(sim: Simulator, before: Array, mu: float, h: float, tolerance: float) -> tuple[int, int]:
    """Check Coulomb's conditions node by node on a horizontal plane; numbers of sticking and slipping nodes."""
    sticks = slips = 0
    force, slip = sim.contact_forces, (sim.positions - before)[:, :2] / h
    largest, fastest = np.abs(force).max(), max(np.linalg.norm(slip, axis=1).max(), 1e-12)
    for f, s in zip(force, slip, strict=True):
        assert f[2] >= 0.0
        tangential, speed = np.linalg.norm(f[:2]), np.linalg.norm(s)
        assert tangential <= mu * f[2] + tolerance * largest
        if f[2] <= 10 * tolerance * largest:
            continue
        if tangential < (mu - 10 * tolerance) * f[2] - 10 * tolerance * largest:
            sticks += 1
            assert speed <= 1e-3 * fastest, "a node inside its cone does not slip"
        elif speed > 1e-2 * fastest:
            slips += 1
            assert -(f[:2] @ s) >= (1.0 - 1e-3) * tangential * speed, "friction opposes slip"
    return sticks, slips


def sheared_block(stiffness: float | None) -> Scene:
    """A soft driven block over a plane."""
    return beam_scene(
        (0.04, 0.04, 0.02),
        (4, 4, 2),
        young=5e4,
        poisson=0.4,
        damping=(0.0, 0.002),
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
        plane={"point": [0, 0, 0], "friction": 0.4, "stiffness": stiffness},
        solver={"tolerance": 1e-9, "max_iterations": 20_000},
    )


def test_every_node_obeys_coulomb() -> None:
    """Nodal forces of a soft driven block that is sheared over a rigid plane: nodes stick or slip, and all obey."""
    scene = sheared_block(None)
    sim = Simulator(scene)
    for depth in np.linspace(0.0, 1e-3, 40):
        sim.step(pose((0, 0, -depth)))
    seen = np.zeros(2, int)
    for shift in np.linspace(0.0, 6e-4, 40)[1:]:
        before = sim.positions.copy()
        out = sim.step(pose((0.8 * shift, 0.6 * shift, -1e-3)))
        assert healthy(out)
        seen += coulomb_holds(sim, before, 0.4, scene.dt, 1e-6)
    assert seen.min() > 30, f"sticking and slipping nodes seen: {seen}"


@pytest.mark.parametrize("method", ["pgs", "newton"])
@pytest.mark.parametrize("stiffness", [1.0, 1000.0])
def test_a_contact_is_a_spring_while_its_force_changes(method: str, stiffness: float) -> None:
    """Step by step and node by node: depth = ε (λ_n − λ_n⁰); a node that sticks moves by −ε (λ_t − λ_t⁰) across,
    one that slips is on the cone, its force along −(slip + ε (λ_t − λ_t⁰)). ε = min(1/k, h² / 30 m).
    """
    scene = sheared_block(stiffness).with_values({"solver.method": method})
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    soft = np.array([naive.contact_compliance(body, scene, node, scene.dt) for node in range(len(body.points))])
    assert (soft < scene.dt**2 / body.mass / 29.9).all()
    seen = np.zeros(2, int)
    for k in range(1, 71):
        before, force = sim.positions.copy(), sim.contact_forces.copy()
        out = sim.step(pose((0.8e-5 * max(0, k - 30), 0.6e-5 * max(0, k - 30), -3e-5 * min(k, 30))))
        assert healthy(out)
        after = sim.contact_forces
        size = 1e-6 * np.abs(after).max() * soft.max()
        for node in np.flatnonzero(after[:, 2] > 1e-5 * after[:, 2].max()):
            change = soft[node] * (after[node] - force[node])
            assert -sim.positions[node, 2] == pytest.approx(change[2], abs=size)
            slip = (sim.positions[node] - before[node])[:2] + change[:2]
            pressed, across = after[node, 2], np.linalg.norm(after[node, :2])
            assert across <= 0.4 * pressed * (1 + 1e-6)
            if across < 0.399 * pressed:
                seen[0] += 1
                assert_allclose(slip, 0.0, rtol=0, atol=size)
            elif np.linalg.norm(slip) > 100 * size:
                seen[1] += 1
                assert_allclose(-after[node, :2] * np.linalg.norm(slip), slip * across, rtol=0, atol=size * across)
    assert seen.min() > 30, f"sticking and slipping nodes seen: {seen}"


@pytest.mark.parametrize("mesh", ["beam", "finger"])
def test_contact_force_is_the_reaction_at_the_bone(mesh: str) -> None:
    """At rest under a press, plane + weight of the free nodes + elastic pull of the bone = 0, to 1e-4.

    The bone's pull is −Σ of the elastic forces on driven nodes, by Voigt assembly of its own; so is its torque.
    """
    if mesh == "beam":
        scene = beam_scene(
            (0.04, 0.04, 0.02),
            (4, 4, 2),
            young=5e4,
            poisson=0.4,
            damping=(0.0, 0.01),
            driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
            plane={"point": [0, 0, 0], "friction": 0.5},
            gravity=[0, 0, -G],
            solver={"tolerance": 1e-8, "max_iterations": 20_000},
        )
        command, ticks = pose((2e-4, 1e-4, -1e-3)), 40
    else:  # without limits: what they carry is no elastic force
        data = finger_scene().to_dict()
        del data["limits"]
        scene = Scene.from_dict(data).with_values(
            {"solver.tolerance": 1e-8, "solver.max_iterations": 20_000, "material.damping.stiffness": 0.01}
        )
        turn = Rotation.from_quat(scene.initial_pose.orientation)
        height = turn.apply(np.array(scene.load_mesh().points))[:, 2].min()
        command, ticks = pose((0.0, 2e-4, -height - 1e-3), turn), 150
    sim = Simulator(scene)
    if mesh == "finger":
        sim.reset(pose((0.0, 0.0, command.position[2] + 1e-3), Rotation.from_quat(command.orientation)))
    run(sim, ticks, command)
    out = settle(sim, command, speed=2e-7)
    assert healthy(out)
    body = naive.Body.of(scene, sim.mesh)
    forces = body.forces(sim.positions)
    driven = scene.driven_nodes(sim.mesh)
    free = np.setdiff1d(np.arange(len(body.points)), driven)
    weight = np.outer(body.mass, scene.gravity)
    pulled = -forces[driven]  # elastic forces sum to none over the whole body: this is what free nodes have
    force = out.contact_wrench[:3]
    assert np.linalg.norm(force) > 0.1
    assert_allclose(
        force + weight[free].sum(axis=0) + pulled.sum(axis=0), 0.0, rtol=0, atol=1e-4 * np.linalg.norm(force)
    )
    arms = sim.positions - np.array(out.pose.position)
    torque = np.cross(arms[free], weight[free]).sum(axis=0) + np.cross(arms[driven], pulled).sum(axis=0)
    assert_allclose(out.contact_wrench[3:] + torque, 0.0, rtol=0, atol=1e-4 * np.linalg.norm(force) * 0.05)


def test_lever_arm_gives_sign_and_point_of_the_torque() -> None:
    """Pressed on one edge far along +x, the torque about the frame's origin is −x F about y; moved origins shift it."""
    scene = beam_scene(
        (0.1, 0.04, 0.02),
        (5, 2, 1),
        young=5e4,
        poisson=0.3,
        damping=(0.0, 0.01),
        driven={"box": [[-1, -1, 0.0199], [1, 1, 1]]},
        plane={"point": [0, 0, 0], "friction": 0.0},
        solver={"tolerance": 1e-8, "max_iterations": 5000},
    )
    tilt = Rotation.from_euler("y", 2.0, degrees=True)  # +x end down
    sim = Simulator(scene)
    lowest = tilt.apply(np.array(sim.mesh.points))[:, 2].min()
    sim.reset(pose((0, 0, -lowest + 1e-5), tilt))
    run(sim, 20, pose((0, 0, -lowest - 2e-4), tilt))
    out = settle(sim, speed=1e-7)
    fx, fy, fz, tx, ty, tz = out.contact_wrench
    assert out.contacts == 3
    assert fz > 0.01
    assert abs(fx) + abs(fy) < 1e-12
    edge = sim.positions[sim.contact_forces[:, 2] > 0.0]
    assert -ty == pytest.approx(edge[:, 0].mean() * fz, rel=2e-3)
    assert tx == pytest.approx(0.02 * fz, rel=1e-2)  # the edge's middle lies at y = 0.02
    assert tz == pytest.approx(0.0, abs=1e-12)
    # The same press with the whole world moved sideways: the origin goes along, the wrench does not change.
    moved = Simulator(scene.with_values({"plane.point": [5.0, 7.0, 0.0]}))
    moved.reset(pose((3.0, -4.0, -lowest + 1e-5), tilt))
    run(moved, 20, pose((3.0, -4.0, -lowest - 2e-4), tilt))
    other = settle(moved, speed=1e-7)
    assert_allclose(other.contact_wrench, out.contact_wrench, rtol=1e-4, atol=1e-6 * fz)
    # The same placement of the nodes by a frame whose origin stands elsewhere, as a mesh shifted by −a would have it.
    arms = sim.positions - np.array([0.1, 0.0, 0.0])
    shifted = np.cross(arms, sim.contact_forces).sum(axis=0)
    origin = np.array(out.pose.position)
    assert_allclose(shifted, out.contact_wrench[3:] + np.cross(origin - [0.1, 0, 0], [fx, fy, fz]), atol=1e-12)


def test_device_wrench_is_the_contact_wrench_clamped() -> None:
    """Force and torque scaled back to their limits, each by itself, directions kept."""
    scene = finger_scene(coupling__force_limit=0.5, coupling__torque_limit=1e-3)
    sim = Simulator(scene)
    turn = Rotation.from_quat(scene.initial_pose.orientation)
    height = -turn.apply(np.array(sim.mesh.points))[:, 2].min()
    sim.reset(pose((0, 0, height), turn))
    clamped = 0
    for depth in np.linspace(0, 1.5e-3, 60):
        out = sim.step(pose((0, 0.3 * depth, height - depth), turn))
        for part, limit in ((slice(0, 3), 0.5), (slice(3, 6), 1e-3)):
            whole, device = out.contact_wrench[part], out.device_wrench[part]
            size = np.linalg.norm(whole)
            clamped += size > limit
            expected = whole * min(1.0, limit / size) if size > 0.0 else whole
            assert_allclose(device, expected, rtol=1e-12, atol=0)
    assert clamped > 10


NORMALS = [*np.eye(3), *-np.eye(3), *np.random.default_rng(0).standard_normal((6, 3))]


@for_each("normal", NORMALS)
def test_plane_frame_is_right_handed(normal: Array) -> None:
    """n, t₁, t₂ are orthonormal, right-handed, n is the normal."""
    n = normal / np.linalg.norm(normal)
    frame = np.empty((3, 3))
    plane_frame(n, frame)
    assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert_allclose(frame[0], n, rtol=0, atol=1e-15)


def test_penetration_is_that_of_the_deepest_surface_node() -> None:
    """max_penetration against the positions, step for step; while a block lands it is deeper in a softer plane.

    The softest is kept at 30 times the nodes' inertia, here eight times as soft as the stiff one.
    """
    scene, _, _ = block()
    deepest = []
    for stiffness in (1.0, 1000.0, None):
        sim = Simulator(scene.with_values({"plane.stiffness": stiffness}))
        depths = []
        for _ in range(60):
            out = sim.step()
            assert out.max_penetration == pytest.approx(max(0.0, -sim.positions[:, 2].min()), abs=1e-15)
            depths.append(out.max_penetration)
        deepest.append(max(depths))
    assert deepest[0] > 5 * deepest[1] > 0.0
    assert deepest[2] < 1e-9


@for_each("stiffness", [0.01, 1.0, 1000.0, None])
def test_nothing_sinks_in_at_rest(stiffness: float | None) -> None:
    """A block at rest stands on the plane and not in it, however soft: the force that holds it has stopped changing."""
    scene, _, _ = block()
    sim = Simulator(scene.with_values({"plane.stiffness": stiffness}))
    out = settle(sim, speed=1e-9)
    assert out.contacts == 9
    assert out.max_penetration < 1e-9


def test_contact_pushes_and_never_pulls() -> None:
    """A block lifted off the plane has no contact force in any later step; a thrown one bounces by no more."""
    scene, _, _ = block()
    sim = Simulator(scene)
    settle(sim, speed=1e-6)
    sim.set_state(sim.positions.copy(), np.tile([0.0, 0.0, 0.5], (len(sim.positions), 1)))
    energy = 0.5 * 0.5**2
    for _ in range(100):
        out = sim.step()
        assert (sim.contact_forces[:, 2] >= 0.0).all()
    assert out.contacts == 0
    mass = lumped_mass(scene, sim.mesh)
    height = mass @ sim.positions[:, 2] / mass.sum()
    assert 0.05 < height < 0.05 + energy / G + 1e-3


@pytest.mark.parametrize("method", ["newton", "pgs"])
def test_what_falls_from_rest_meets_the_plane_within_the_step(method: str) -> None:
    """A beam 5 mm over the plane would fall 16 mm in a step of 40 ms: its velocity of now, none, does not tell."""
    bottom = float(beam_scene().load_mesh().points[:, 2].min())
    solver = {"method": method, "tolerance": 1e-8, "max_iterations": 10_000}
    plane = {"point": [0.0, 0.0, bottom - 5e-3], "stiffness": 1000.0, "friction": 0.0}
    sim = Simulator(beam_scene(plane=plane, gravity=[0, 0, -G], dt=0.04, solver=solver))
    assert sim.step().contacts > 0
    assert sim.positions[:, 2].min() > bottom - 5.4e-3

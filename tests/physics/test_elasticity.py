"""Corotational elasticity: rest, rigid motion, uniaxial stress, tangents, beams, and another FEM package."""

from __future__ import annotations

from typing import Any

import naive
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, assembled, beam_scene, finger_scene, healthy, nodal_forces, rotations, run, settle
from scipy.spatial.transform import Rotation

from finger_sim import Scene, Simulator

TIGHT = {"projection": "hyperbolic", "stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]}


def free_finger() -> Scene:
    """The finger's mesh and material as a free body in empty space."""
    data = finger_scene().to_dict()
    del data["driven"], data["plane"], data["limits"], data["initial_pose"]
    data["material"]["young"] = 100.0
    return Scene.from_dict(data | {"gravity": [0, 0, 0]})


def test_rest_gives_zero_force() -> None:
    """Without gravity a body at rest stays there, to roundoff, also with limits: for both meshes."""
    for scene in (beam_scene(limits=TIGHT), free_finger()):
        sim = Simulator(scene)
        out = run(sim, 50)
        size = np.ptp(sim.mesh.points, axis=0).max()
        assert_allclose(sim.positions, sim.mesh.points, rtol=0, atol=1e-13 * size)
        assert out.limit_rows == 0
        assert out.max_strain_ratio < 1e-10
        assert healthy(out)


@for_each("index", range(6))
def test_rigid_motion_gives_zero_force(index: int) -> None:
    """Rotated (half turns too) and moved bodies have no elastic force: 1e-9 of E times a tetrahedron's face."""
    turn = rotations(3, seed=5)[index]
    for scene in (beam_scene(), free_finger()):
        points = np.array(scene.load_mesh().points)
        size = np.ptp(points, axis=0).max()
        forces = nodal_forces(scene, turn.apply(points) + size * np.array([3.0, -1.0, 2.0]))
        assert np.abs(forces).max() < 1e-11 * scene.material.young * size**2


@for_each("index", range(6))
def test_forces_rotate_with_a_deformed_body(index: int) -> None:
    """f(Q x + t) = Q f(x) at a random finite deformation."""
    scene = beam_scene()
    points = np.array(scene.load_mesh().points)
    x = points + 0.02 * np.random.default_rng(3).standard_normal(points.shape)
    turn = rotations(3, seed=8)[index]
    forces = nodal_forces(scene, x)
    assert_allclose(
        nodal_forces(scene, turn.apply(x) + [1.0, 2.0, 3.0]),
        turn.apply(forces),
        rtol=0,
        atol=1e-7 * np.abs(forces).max(),
    )


def test_forces_against_the_energy() -> None:
    """f = −dΨ/dx, by central differences of the elastic energy; they sum to no force and no torque."""
    scene = beam_scene(poisson=0.45)
    body = naive.Body.of(scene, scene.load_mesh())
    x = body.points + 0.02 * np.random.default_rng(4).standard_normal(body.points.shape)
    forces, numeric = nodal_forces(scene, x), np.zeros_like(x)
    for index in np.ndindex(x.shape):
        offset = np.zeros_like(x)
        offset[index] = 1e-6
        numeric[index] = -(body.energy(x + offset) - body.energy(x - offset)) / 2e-6
    size = np.abs(numeric).max()
    assert_allclose(forces, numeric, rtol=0, atol=2e-6 * size)
    assert np.abs(forces.sum(axis=0)).max() < 1e-9 * size
    assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-6 * size


@for_each("poisson", [-0.3, 0.0, 0.3, 0.49])
@for_each("strain", [1e-4, -1e-4])
def test_uniaxial_stress(strain: float, poisson: float) -> None:
    """Stretched by ε and narrowed by ν ε, a beam pulls with E ε times its section at the ends and nowhere else."""
    young, size = 2e5, (0.6, 0.2, 0.3)
    scene = beam_scene(size, (3, 1, 2), young=young, poisson=poisson)
    points = np.array(scene.load_mesh().points)
    turn = Rotation.from_rotvec([0.4, -1.2, 2.0])
    F = np.diag([1.0 + strain, 1.0 - poisson * strain, 1.0 - poisson * strain])
    forces = turn.inv().apply(nodal_forces(scene, turn.apply(points @ F)))
    pull = young * strain * size[1] * size[2]
    left, right = points[:, 0] == 0.0, points[:, 0] == points[:, 0].max()
    assert_allclose(forces[left].sum(axis=0), [pull, 0, 0], rtol=0, atol=1e-5 * abs(pull))
    assert_allclose(forces[right].sum(axis=0), [-pull, 0, 0], rtol=0, atol=1e-5 * abs(pull))
    assert_allclose(forces[~left & ~right], 0.0, rtol=0, atol=1e-5 * abs(pull))
    assert_allclose(forces[:, 1:], 0.0, rtol=0, atol=1e-5 * abs(pull))


@for_each("young", [1.0, 1e3, 1e6, 1e9])
def test_tangent_stiffness_is_the_derivative_of_the_forces(young: float) -> None:
    """(A − M) / h² is −∂f/∂x with R frozen, by differences of independent forces, from E = 1 Pa to 1 GPa."""
    h = 0.1
    scene = beam_scene(young=young, poisson=0.4, density=1.0)
    body = naive.Body.of(scene, scene.load_mesh())
    rng = np.random.default_rng(6)
    x = body.points + 0.02 * rng.standard_normal(body.points.shape)
    A, _ = assembled(scene, x, h)
    K = (A - np.diag(np.repeat(body.mass, 3))) / h**2
    frozen = np.array([naive.rotation_of(F) for F in body.deformation(x)])
    for _ in range(4):
        dx = rng.standard_normal(x.shape)
        numeric = (body.forces(x - dx, frozen) - body.forces(x + dx, frozen)) / 2.0  # linear: any step is exact
        assert_allclose((K @ dx.ravel()).reshape(-1, 3), numeric, rtol=0, atol=1e-11 * np.abs(numeric).max() + 1e-14)


@for_each("young", [1.0, 1e3, 1e6, 1e9])
@for_each("driven", [False, True])
def test_unconstrained_step_against_dense_numpy(young: float, driven: bool) -> None:
    """One backward Euler step of a deformed, moving body: A v = b by Voigt assembly and numpy.linalg.solve."""
    scene = beam_scene(
        (0.3, 0.2, 0.2),
        (3, 2, 2),
        young=young,
        poisson=0.45,
        damping=(3.0, 0.004),
        dt=0.01,
        gravity=[1.0, -2.0, -9.81],
        **({"driven": "base"} if driven else {}),
    )
    sim = Simulator(scene)
    body = naive.Body.of(scene, sim.mesh)
    rng = np.random.default_rng(7)
    held = sim.mesh.node_sets["base"] if driven else np.empty(0, int)
    x = body.points + 0.01 * rng.standard_normal(body.points.shape)
    v = 0.3 * rng.standard_normal(x.shape)
    v_held = (body.points[held] - x[held]) / scene.dt
    sim.set_state(x, v)
    out = sim.step()
    system = body.system(x, v, scene.dt, held, v_held)
    expected = system.whole(np.linalg.solve(system.A, system.b))
    assert_allclose(sim.velocities, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert_allclose(sim.positions, x + scene.dt * expected, rtol=0, atol=1e-11)
    assert out.iterations == 0


def test_assembly_on_the_finger() -> None:
    """A and b of the shipped finger, its material axes and driven bone included, against dense Voigt assembly."""
    scene = finger_scene(gravity=[0.0, -3.0, 1.0])
    body = naive.Body.of(scene, scene.load_mesh())
    held = scene.driven_nodes(scene.load_mesh())
    x = body.points + 2e-4 * np.random.default_rng(8).standard_normal(body.points.shape)
    A, b = assembled(scene, x, 1e-3)
    there = Rotation.from_quat(scene.initial_pose.orientation).apply(body.points) + scene.initial_pose.position
    system = body.system(x, np.zeros_like(x), 1e-3, held, (there[held] - x[held]) / 1e-3)
    assert_allclose(A, system.A, rtol=0, atol=1e-12 * np.abs(system.A).max())
    assert_allclose(b, system.b, rtol=0, atol=1e-11 * np.abs(system.b).max())


def static_sag(scene: Scene) -> Array:
    """Displacement (n, 3) of a scene at rest under its own gravity; long steps of backward Euler go there fast."""
    sim = Simulator(scene)
    settle(sim, speed=1e-11, steps=400)
    return sim.positions - sim.mesh.points


def test_hanging_bar_stretches_by_its_own_weight() -> None:
    """Mean displacement of each section of a hanging bar, ν = 0: u(z) = ρ g / E (L z − z²/2), to 0.5 %."""
    length, young, g = 1.0, 1e6, 9.81
    scene = beam_scene(
        (length, 0.2, 0.2), (10, 2, 2), young=young, poisson=0.0, driven="base", dt=0.1, gravity=[g, 0.0, 0.0]
    )
    sim = Simulator(scene)
    settle(sim, speed=1e-11, steps=400)
    z = sim.mesh.points[:, 0]
    u = sim.positions - sim.mesh.points
    expected = 1000.0 * g / young * (length * z - 0.5 * z * z)
    mean = np.array([u[z == level, 0].mean() for level in np.unique(z)])
    exact = np.array([expected[z == level].mean() for level in np.unique(z)])
    assert_allclose(mean, exact, rtol=5e-3, atol=0)


def test_cantilever_against_beam_theory() -> None:
    """Tip sag under weight: w L⁴ / 8 E I + w L² / 2 κ G A (Timoshenko): what finer and finer meshes converge to.

    Linear tetrahedra are too stiff in bending: by 33, 12 and 4 % with 2, 4 and 8 cubes over the depth. What the three
    extrapolate to with their own order of convergence (Aitken) is theory within 1 %.
    """
    length, depth, young, poisson, g = 1.0, 0.125, 1e9, 0.3, 1.0
    sags = []
    for n in (2, 4, 8):
        scene = beam_scene(
            (length, depth, depth),
            (8 * n, n, n),
            young=young,
            poisson=poisson,
            driven="base",
            dt=0.1,
            gravity=[0.0, 0.0, -g],
        )
        u = static_sag(scene)
        points = np.array(scene.load_mesh().points)
        sags.append(-u[points[:, 0] == points[:, 0].max(), 2].mean())
    weight = 1000.0 * g * depth**2
    inertia, shear = depth**4 / 12.0, young / (2.0 * (1.0 + poisson))
    kappa = 10.0 * (1.0 + poisson) / (12.0 + 11.0 * poisson)
    theory = weight * length**4 / (8.0 * young * inertia) + weight * length**2 / (2.0 * kappa * shear * depth**2)
    errors = 1.0 - np.array(sags) / theory
    assert (errors > 0.0).all()
    assert errors[2] < 0.05
    gain = (sags[1] - sags[0]) / (sags[2] - sags[1])
    assert 1.3 < np.log2(gain) < 2.3
    assert sags[2] + (sags[2] - sags[1]) / (gain - 1.0) == pytest.approx(theory, rel=0.01)


@pytest.mark.parametrize("body", ["beam", "finger"])
def test_static_sag_against_scikit_fem(body: str) -> None:
    """The same mesh in scikit-fem's small-strain elasticity sags alike at every node, to 0.1 % of the largest."""
    skfem = pytest.importorskip("skfem")
    from skfem.helpers import ddot, eye, sym_grad, trace
    from skfem.models.elasticity import lame_parameters

    young, poisson, force = 1e7, 0.4, np.array([1.0, -3.0, 2.0]) * 1e-2
    if body == "beam":
        scene = beam_scene(
            (1.0, 0.2, 0.3), (10, 2, 3), young=young, poisson=poisson, driven="base", dt=0.1, gravity=list(force)
        )
    else:
        data = finger_scene().to_dict()
        del data["limits"], data["plane"], data["initial_pose"]
        material = {"young": young, "poisson": poisson}
        scene = Scene.from_dict(data | {"material": material, "driven": "base", "dt": 0.1, "gravity": list(force)})
    u = static_sag(scene)

    ours = scene.load_mesh()
    mesh = skfem.MeshTet(np.array(ours.points).T, np.array(ours.tets, np.int64).T)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()))
    lame_lambda, lame_mu = lame_parameters(young, poisson)

    @skfem.BilinearForm
    def elasticity(u: Any, v: Any, w: Any) -> Any:
        strain = sym_grad(u)
        return ddot(2.0 * lame_mu * strain + lame_lambda * eye(trace(strain), 3), sym_grad(v))

    @skfem.LinearForm
    def weight(v: Any, w: Any) -> Any:
        return scene.material.density * (force[0] * v[0] + force[1] * v[1] + force[2] * v[2])

    held = basis.nodal_dofs[:, scene.driven_nodes(ours)].ravel()
    solution = skfem.solve(*skfem.condense(elasticity.assemble(basis), weight.assemble(basis), D=held))
    expected = solution[basis.nodal_dofs].T
    assert np.abs(expected).max() > 0.0
    assert_allclose(u, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_material_axes_do_not_matter_to_an_isotropic_material() -> None:
    """The same deformed tetrahedra under other material axes give the same forces."""
    scene = free_finger()
    mesh = scene.load_mesh()
    x = mesh.points + 2e-4 * np.random.default_rng(9).standard_normal(mesh.points.shape)
    reference = nodal_forces(scene, x)
    turned = np.array([Rotation.random(random_state=k).as_matrix() for k in range(len(mesh.tets))])
    body = naive.Body.of(scene, type(mesh).from_arrays(mesh.points, mesh.tets, mesh.node_sets, turned))
    assert_allclose(reference, body.forces(x), rtol=0, atol=1e-6 * np.abs(reference).max())

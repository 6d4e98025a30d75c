"""MuJoCo and Drake on the mesh, motion and plane of a benchmark, in this process. Both are optional: extra [peers].

What they share with `Simulator`: linear tetrahedra, Rayleigh damping β K, prescribed nodes, a plane with Coulomb
friction. What they do not:

* MuJoCo's flex is Saint Venant-Kirchhoff, which softens under compression, or stable neo-Hookean, which stiffens;
  both agree with corotated elasticity at small strain only.
* MuJoCo's contact gives way however stiff solref and solimp are: its impedance is bounded, the more so as nodes get
  lighter. Under 60 N the deepest node is 50 μm below the plane at 350 tetrahedra, 110 μm at 2000.
* MuJoCo's friction is a cone from 3.13 on. Before, under the implicit integrators, it is a pyramid whose rows give way
  to speed: a slide at 2 cm/s reaches T/N = 0.38 where μ = 0.5.
* Drake's contact acts on the overlap of faces with the plane, not at nodes, and its positions follow the midpoint
  rule q' = q + dt (v + v')/2.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import meshio
import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import Floats, Ints
from ...errors import MissingExtraError

EXTRA = "peers"
OLDEST_MUJOCO = (3, 11)  # before, 3-D flexes were explicit under every integrator, unless interpolated


@dataclass(frozen=True, eq=False)
class PeerCase:
    """One soft body for another simulator. SI units, world axes, z up; the plane, if any, is z = 0, the body above."""

    points: Floats  # (n, 3) positions at the start, at rest [m]
    tets: Ints  # (T, 4) det(x1 - x4, x2 - x4, x3 - x4) > 0, as in TetMesh
    surface: Ints  # (k, 3) boundary triangles; here for peers that want them, both of these find their own
    driven: Ints  # (nd,) nodes that follow targets, all moving as one rigid body
    density: float  # [kg/m^3]
    young: float  # [Pa]
    poisson: float
    damping_stiffness: float  # β of the Rayleigh damping β K [s]
    dt: float  # [s]
    gravity: Floats  # (3,) [m/s^2]
    friction: float | None  # Coulomb's μ; None: no plane

    @property
    def volumes(self) -> Floats:
        """Volume of each tet, (T,) [m^3]."""
        x = self.points[self.tets]
        volumes: Floats = np.linalg.det(x[:, :3] - x[:, 3:]) / 6.0
        return volumes

    @property
    def mass(self) -> Floats:
        """Mass of each node, a quarter of that of each of its tets, (n,) [kg]."""
        mass = np.zeros(len(self.points))
        np.add.at(mass, self.tets, self.density * self.volumes[:, None] / 4.0)
        return mass


class Peer(Protocol):
    """Another simulator that runs a `PeerCase`. Only `step` is meant to be timed: it holds nothing but its own work."""

    name: str  # simulator, version, model and solver

    def step(self, targets: Floats) -> None:
        """Advance by dt; driven nodes are at `targets` (nd, 3) [m], in the order of `driven`, at its end."""

    def force(self) -> Floats:
        """Force of the plane on the body during the last step, (3,) [N], world."""

    def positions(self) -> Floats:
        """Node positions after the last step, (n, 3) [m], world."""


def mujoco_peer(case: PeerCase, *, neo_hookean: bool = False) -> Peer:
    """The case as a 3-D flex of MuJoCo; Saint Venant-Kirchhoff unless `neo_hookean`, which takes MuJoCo 4.

    Raises MissingExtraError when MuJoCo is not installed, or too old.
    """
    oldest = (4, 0) if neo_hookean else OLDEST_MUJOCO
    if _why_not("mujoco", oldest):
        raise MissingExtraError("MuJoCo {}.{}".format(*oldest), EXTRA)
    return _MuJoCo(case, neo_hookean)


def drake_peer(case: PeerCase) -> Peer:
    """The case as a deformable body of Drake. Raises MissingExtraError when Drake is not installed."""
    if _why_not("pydrake"):
        raise MissingExtraError("Drake", EXTRA)
    return _Drake(case)


_PEERS: dict[str, tuple[str, Callable[[PeerCase], Peer]]] = {
    "MuJoCo": ("mujoco", mujoco_peer),
    "Drake": ("pydrake", drake_peer),
}


def available() -> dict[str, Callable[[PeerCase], Peer]]:
    """The peers that can be run here, by name."""
    return {name: make for name, (module, make) in _PEERS.items() if not _why_not(module)}


def missing() -> dict[str, str]:
    """Why each of the other peers cannot be run here, by name."""
    reasons = {name: _why_not(module) for name, (module, _) in _PEERS.items()}
    return {name: reason for name, reason in reasons.items() if reason}


def _why_not(module: str, oldest_mujoco: tuple[int, int] = OLDEST_MUJOCO) -> str:
    """What keeps `module` from being used here; empty when nothing does."""
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        return f"{error}; it comes with the extra [{EXTRA}]"
    if module == "mujoco" and _release(found.__version__) < oldest_mujoco:
        return "MuJoCo {} is older than {}.{}".format(found.__version__, *oldest_mujoco)
    return ""


def _release(number: str) -> tuple[int, int]:
    major, minor = number.split(".")[:2]
    return int(major), int(minor)


class _MuJoCo:
    """A flex of point masses on three slides each, stepped by the integrator that is implicit in it (M + h D + h² K).

    From MuJoCo 3.13 on that is `discrete`, with contacts as stiff as one likes. In 3.11 and 3.12 it is `implicitfast`
    (`implicit` does the same work), and only under the solver CG with pyramidal friction: under any other, flexes are
    explicit without saying so, and blow up. Its contacts are springs explicit in time. If they are faster than 2 h, as
    with solref -1e8 -2e4, nodes bounce and forces mean nothing; with friction rows stiffer than impratio 1 they hop
    as they slide. Either tolerance leaves forces within 0.1 % of converged; a hundred times looser does not.

    Driven nodes are vertices fixed to the world, whose place in the model is rewritten before each step: no degrees
    of freedom, no constraint, and the elastic force is that of the end of the step. To MuJoCo such a vertex has no
    velocity, so damping misses the force β K v of its motion; it is put β v ahead of its target instead, which gives
    that force.
    """

    def __init__(self, case: PeerCase, neo_hookean: bool) -> None:
        import mujoco

        discrete = hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE")
        law = "neo-Hookean" if neo_hookean else "Saint Venant-Kirchhoff"
        self.name = f"MuJoCo {mujoco.__version__} flex, {law}, {'discrete' if discrete else 'implicitfast'}, CG"
        self._rest, self._driven, self._targets = case.points, case.driven, case.points[case.driven]
        self._free = np.setdiff1d(np.arange(len(case.points)), case.driven)
        self._lead = case.damping_stiffness / case.dt

        spec = mujoco.MjSpec()
        solref, impedance = self._solve(spec, case.dt, discrete)
        spec.option.gravity = case.gravity
        names = np.full(len(case.points), "world", dtype=object)
        mass = case.mass
        for node in self._free:
            names[node] = f"node{node}"
            body = spec.worldbody.add_body(name=names[node], pos=case.points[node], explicitinertial=True)
            body.mass, body.inertia = mass[node], np.full(3, 1e-6 * mass[node])
            for axis in np.eye(3):
                body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        at = np.where(np.isin(np.arange(len(case.points)), case.driven)[:, None], case.points, 0.0)
        flex = spec.add_flex(dim=3, radius=0.0, vertbody=names.tolist(), vert=at.ravel(), elem=case.tets.ravel())
        flex.young, flex.poisson, flex.damping = case.young, case.poisson, case.damping_stiffness
        if _release(mujoco.__version__) < (4, 0):  # twice the λ of what it is given: this has half, and the same μ
            flex.poisson = case.poisson / (2.0 - 2.0 * case.poisson)
            flex.young = case.young * (1.0 + flex.poisson) / (1.0 + case.poisson)
        flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE
        if neo_hookean:
            flex.elastic3d = 1
        if case.friction is not None:
            plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 1.0])
            for side in (plane, flex):
                side.condim, side.friction = 3, [case.friction, 0.0, 0.0]
                side.solref, side.solimp = solref, [impedance, impedance, 1e-3, 0.5, 2.0]

        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._vertices = self._model.flex_vert
        self._advance, self._contact_force = mujoco.mj_step, mujoco.mj_contactForce

    @staticmethod
    def _solve(spec: Any, dt: float, discrete: bool) -> tuple[list[float], float]:
        """Chooses integrator, solver and friction's cone; gives solref and impedance of the contacts for them."""
        import mujoco

        spec.option.timestep = dt
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged body stays diverged
        spec.option.solver = mujoco.mjtSolver.mjSOL_CG
        if discrete:
            spec.option.integrator, spec.option.tolerance = mujoco.mjtIntegrator.mjINT_DISCRETE, 1e-5
            # Coulomb's cone; friction rows ten times stiffer than by default, else nodes that should stick creep.
            spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
            solref, impedance = [-1e8, -2e4], 0.99  # stiffer changes nothing
        else:
            spec.option.integrator, spec.option.tolerance = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 1e-3
            spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0
            solref, impedance = [2.0 * dt, 1.0], 0.9999  # the largest there is
        return solref, impedance

    def step(self, targets: Floats) -> None:
        self._vertices[self._driven] = targets + self._lead * (targets - self._targets)
        self._advance(self._model, self._data)
        self._targets[:] = targets

    def force(self) -> Floats:
        total, wrench = np.zeros(3), np.zeros(6)
        for k, contact in enumerate(self._data.contact):  # frame: rows n t1 t2, n from the plane to the body
            self._contact_force(self._model, self._data, k, wrench)
            total += wrench[:3] @ contact.frame.reshape(3, 3)
        return total

    def positions(self) -> Floats:
        x = self._rest.copy()
        x[self._free] += self._data.qpos.reshape(-1, 3)
        x[self._driven] = self._targets
        return x


class _Drake:
    """A linear corotated deformable body under the SAP solver, held by fixed constraints to a rigid bone.

    The bone is a free body, far heavier than the soft one and without gravity, put where the targets were and given
    the velocity that takes it where they are: Drake's bindings have no prescribed motion of deformable vertices.

    Lengths are in millimetres: Drake gives deformable bodies a contact stiffness of 10⁸ in its own units, which in
    metres, 10⁸ Pa/m, is softer than a finger; in millimetres it is 10¹⁴ Pa/m. That leaves the stiffness given to the
    plane: of a layer of the body's material, a thirtieth of a tetrahedron thick.
    """

    UNIT = 1e-3  # length unit [m]; kilograms and seconds stay, so forces are in mN, pressures in kPa
    HEAVIER = 1e5  # mass of the bone, in masses of the body
    PLANE = 2.0, 2.0, 0.1  # size of the box that stands for the plane [m]: half spaces do not meet deformables

    def __init__(self, case: PeerCase) -> None:
        import pydrake.geometry as shapes
        from pydrake.math import RigidTransform, RotationMatrix
        from pydrake.multibody.fem import DeformableBodyConfig, MaterialModel
        from pydrake.multibody.math import SpatialVelocity
        from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
        from pydrake.multibody.tree import SpatialInertia, UnitInertia
        from pydrake.systems.analysis import Simulator
        from pydrake.systems.framework import DiagramBuilder

        self.name = f"Drake {version('drake')} deformable, linear corotated, SAP"
        self._dt, self._steps = case.dt, 0
        points, unit = case.points / self.UNIT, self.UNIT
        self._centre = points[case.driven].mean(axis=0)
        self._arms = points[case.driven] - self._centre
        self._turn = np.eye(3)
        self._pose: Callable[[Floats, Floats], Any] = lambda turn, at: RigidTransform(RotationMatrix(turn), at)
        self._velocity = SpatialVelocity

        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=case.dt, discrete_contact_approximation="sap")
        self._plant, _ = AddMultibodyPlant(config, builder)
        self._plant.mutable_gravity_field().set_gravity_vector(case.gravity / unit)

        def surface() -> Any:
            properties = shapes.ProximityProperties()
            friction = case.friction or 0.0
            shapes.AddContactMaterial(None, None, CoulombFriction(friction, friction), properties)
            return properties

        material = DeformableBodyConfig()
        material.set_material_model(MaterialModel.kLinearCorotated)
        material.set_youngs_modulus(case.young * unit)
        material.set_poissons_ratio(case.poisson)
        material.set_mass_density(case.density * unit**3)
        material.set_stiffness_damping_coefficient(case.damping_stiffness)
        skin = surface()
        skin.AddProperty("material", "relaxation_time", case.dt)  # the default, 0.1 s, drags contacts along
        self._soft = self._plant.mutable_deformable_model()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "body.vtk"
            cells = [("tetra", case.tets[:, [1, 0, 2, 3]])]  # VTK's order
            meshio.write(file, meshio.Mesh(points, cells), file_format="vtk42", binary=True)
            body = shapes.GeometryInstance(RigidTransform(), shapes.Mesh(file), "body")
            body.set_proximity_properties(skin)
            self._id = self._soft.RegisterDeformableBody(body, material, 1.0)

        if case.friction is not None:
            across, along, thick = (size / unit for size in self.PLANE)
            gradient = 30.0 * case.young / np.cbrt(case.volumes.mean()) * unit**2  # pressure per depth
            table = surface()
            table.AddProperty("material", "relaxation_time", 0.0)
            # The pressure peaks in the middle.
            shapes.AddCompliantHydroelasticProperties(across, gradient * thick / 2.0, table)
            below = RigidTransform([0.0, 0.0, -thick / 2.0])
            box = shapes.Box(across, along, thick)
            self._plant.RegisterCollisionGeometry(self._plant.world_body(), below, box, "plane", table)

        weightless = self._plant.AddModelInstance("bone")
        self._plant.set_gravity_enabled(weightless, False)
        inertia = UnitInertia.SolidSphere(np.ptp(self._arms))
        heavy = SpatialInertia(self.HEAVIER * case.mass.sum(), np.zeros(3), inertia)
        self._bone = self._plant.AddRigidBody("bone", weightless, heavy)
        here = RigidTransform(-self._centre)
        for arm in self._arms:  # a ball that holds one vertex and no other
            ball = shapes.Sphere(1e-6 / unit)
            self._soft.AddFixedConstraint(self._id, self._bone, here, ball, RigidTransform(arm))

        self._plant.Finalize()
        diagram = builder.Build()
        self._simulator = Simulator(diagram)
        self._context = self._plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        self._contacts = self._plant.get_contact_results_output_port()
        self._simulator.Initialize()

    def step(self, targets: Floats) -> None:
        turn, centre = self._fit(targets / self.UNIT)
        spin = Rotation.from_matrix(turn @ self._turn.T).as_rotvec() / self._dt
        velocity = self._velocity(spin, (centre - self._centre) / self._dt)
        self._plant.SetFreeBodyPose(self._context, self._bone, self._pose(self._turn, self._centre))
        self._plant.SetFreeBodySpatialVelocity(self._context, self._bone, velocity)
        self._steps += 1
        self._simulator.AdvanceTo(self._steps * self._dt)
        self._turn, self._centre = turn, centre

    def force(self) -> Floats:
        results, total = self._contacts.Eval(self._context), np.zeros(3)
        for k in range(results.num_deformable_contacts()):
            total += results.deformable_contact_info(k).F_Ac_W().translational()
        return total * self.UNIT

    def positions(self) -> Floats:
        x: Floats = self._soft.GetPositions(self._context, self._id).T * self.UNIT
        return x

    def _fit(self, targets: Floats) -> tuple[Floats, Floats]:
        """Turn (3, 3) and centre (3,) of the rigid motion nearest to `targets` (Kabsch)."""
        centre = targets.mean(axis=0)
        u, _, vt = np.linalg.svd((targets - centre).T @ self._arms)
        u[:, 2] *= np.linalg.det(u @ vt)
        return u @ vt, centre

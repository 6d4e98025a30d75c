"""From a scene and its mesh to the model that physics steps: the only place that knows both."""

from __future__ import annotations

import math

import numpy as np

from ..physics.methods import LEVELS, METHODS, PROJECTIONS
from ..physics.model import Model
from ..physics.prepare import UNLIMITED, Body, Live, Setting, Strains, Tissue, prepare_model, rest_of
from ..scene import Limits, Scene
from ..scene.locking import ends
from ..scene.mesh import TetMesh


def build_model(scene: Scene, mesh: TetMesh) -> Model:
    """The model of a scene on its mesh. Raises MeshError when the scene's driven nodes cannot be found."""
    tets, driven = mesh.tets.astype(np.int64), scene.driven_nodes(mesh).astype(np.int64)
    body = Body(mesh.points, tets, mesh.axes, mesh.surface, driven, scene.coupling.type == "virtual")
    rest = rest_of(mesh.points, tets, mesh.axes)
    material, solver = scene.material, scene.solver
    tissue = Tissue(
        material.density,
        material.young,
        material.poisson,
        material.damping.mass,
        material.damping.stiffness,
        material.volumetric == "patch",
        tuple((term.time, term.share) for term in material.relaxation),
        material.relaxes == "stress",
    )
    setting = Setting(np.array(scene.gravity), scene.plane is not None, METHODS[solver.method], solver.relinearizations)
    strains = _strains(scene.limits) if scene.limits else UNLIMITED
    return prepare_model(body, rest, tissue, strains, setting, _live(scene, rest.length))


def with_live_values(model: Model, scene: Scene) -> Model:
    """The model with those fields that may change while running as the scene now has them."""
    return model._replace(**_live(scene, model.length)._asdict())


def _strains(limits: Limits) -> Strains:
    return Strains(PROJECTIONS[limits.projection], limits.stretch_room, limits.compress_room, *ends(limits))


def _live(scene: Scene, length: float) -> Live:
    """What may change while running, for a mesh of that length (Model.length)."""
    limits, plane, solver, coupling = scene.limits, scene.plane, scene.solver, scene.coupling
    young = scene.material.young
    return Live(
        limit_compliance=1.0 / (limits.stiffness * young) if limits and limits.stiffness else 0.0,
        limit_inertia=limits.inertia if limits else 0.0,
        limit_viscosity=limits.viscosity if limits else 0.0,
        mu_friction=plane.friction if plane else 0.0,
        contact_compliance=1.0 / (plane.stiffness * young * length) if plane and plane.stiffness else 0.0,
        spring=np.array(
            [[coupling.stiffness, coupling.damping], [coupling.rotational_stiffness, coupling.rotational_damping]]
        ),
        spring_limit=np.array([coupling.force_limit, coupling.torque_limit]),
        tolerance=solver.tolerance,
        felt_force=solver.least_force,
        max_iterations=solver.max_iterations,
        settles=solver.settle,
        turn=math.cos(0.5 * LEVELS[solver.level]) ** 2,
        deadline=solver.deadline or 0.0,
    )

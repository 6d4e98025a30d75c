"""What importing the package drags in, and kernels that run uncompiled."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import REPOSITORY, python


def test_physics_needs_no_ros() -> None:
    """A simulator is built and stepped where rclpy and message packages cannot be imported at all."""
    out = python(
        "import sys\n"
        "for name in ('rclpy', 'std_msgs', 'geometry_msgs', 'sensor_msgs', 'builtin_interfaces', 'rclpy.node'):\n"
        "    sys.modules[name] = None\n"
        "import finger_sim, finger_sim.simulation.replay, finger_sim.bags.reader, finger_sim.bags.imports.poses\n"
        "sim = finger_sim.Simulator(finger_sim.Scene.load('finger'))\n"
        "print(int(sim.step().status), any(n.startswith('finger_sim.ros') for n in sys.modules))\n"
    )
    assert out.split() == ["0", "False"]


def test_import_is_light() -> None:
    """Importing neither draws, nor meshes, nor talks: no matplotlib, gmsh, rclpy, and no test tools."""
    modules = "finger_sim, finger_sim.simulation.simulator, finger_sim.physics.step, finger_sim.bags.reader"
    out = python(f"import sys, {modules}\nprint(*sys.modules)")
    loaded = {name.split(".")[0] for name in out.split()}
    assert not loaded & {"matplotlib", "gmsh", "rclpy", "pytest", "hypothesis", "skfem", "clarabel"}


def test_a_process_that_writes_bags_is_lean() -> None:
    """It starts fast: neither numbers nor compilers nor ROS."""
    out = python("import sys, finger_sim.bags.process\nprint(*sys.modules)")
    loaded = {name.split(".")[0] for name in out.split()}
    assert not loaded & {"numpy", "numba", "scipy", "rosbags", "rclpy", "rich"}


def test_public_names() -> None:
    """The names that users' scripts import, and nothing that does not exist."""
    import finger_sim

    assert {"Scene", "Simulator", "Pose", "SceneError"} <= set(finger_sim.__all__)
    assert all(hasattr(finger_sim, name) for name in finger_sim.__all__)


TINY = """
import json, sys
import numpy as np
from finger_sim import Pose, Scene, Simulator
from numba import config
sim = Simulator(Scene.from_dict({
    "mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [1, 1, 1]}},
    "driven": {"box": [[-1, -1, 0.0099], [1, 1, 1]]},
    "material": {"young": 5e4, "poisson": 0.4},
    "limits": {"stretch": [1.02, 1.02, None], "compress": [0.98, None, 0.98]},
    "plane": {"point": [0, 0, 0], "friction": 0.3},
}))
rows = []
for k in range(12):
    out = sim.step(Pose((2e-5 * k, 1e-5 * k, -4e-5 * k)))
    rows.append([*out.contact_wrench, out.limit_rows, out.contacts, int(out.status), out.max_strain_ratio])
free = Simulator(Scene.from_dict({"mesh": {"beam": {"size": [0.02, 0.01, 0.01], "cells": [2, 1, 1]}}}))
for _ in range(3):
    free.step()
print(json.dumps([bool(config.DISABLE_JIT), rows, sim.positions.tolist(), free.velocities.tolist()]))
"""


def test_uncompiled_kernels_give_the_same() -> None:
    """NUMBA_DISABLE_JIT=1: the same kernels as plain Python, step for step, to 1e-10."""
    slow = json.loads(python(TINY, NUMBA_DISABLE_JIT="1"))
    fast = json.loads(python(TINY, NUMBA_DISABLE_JIT="0"))
    assert (slow[0], fast[0]) == (True, False)
    wrenches = np.array(fast[1])
    assert wrenches[-1, 6] >= 4  # limit rows
    assert wrenches[-1, 7] >= 2  # contacts
    for a, b in zip(slow[1:], fast[1:], strict=True):
        assert_allclose(np.array(a), np.array(b), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    "solver",
    [
        "physics/test_linear_solver.py::test_panels_of_many_shapes",
        pytest.param("physics/test_linear_solver.py", marks=pytest.mark.slow),
    ],
)
def test_kernel_twin_tests_run_uncompiled(solver: str) -> None:
    """The suite's own kernel tests pass with NUMBA_DISABLE_JIT=1, as on a processor without registers of eight."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-n",
            "0",
            "-p",
            "no:cacheprovider",
            "-x",
            solver,
            "physics/test_strain_limits.py::test_values_along_the_axes_by_hand",
            "physics/test_strain_limits.py::test_number_of_rows",
            "physics/test_strain_limits.py::test_gradients_are_those_of_perturbation_theory",
            "physics/test_kinematics.py::test_svd_of_degenerate_matrices",
            "physics/test_kinematics.py::test_svd_of_reflections",
            "physics/test_elasticity.py::test_tangent_stiffness_is_the_derivative_of_the_forces",
            "physics/test_pgs.py::test_tangents_stay_in_the_disk_and_reduce_slip",
        ],
        cwd=REPOSITORY / "tests",
        capture_output=True,
        text=True,
        timeout=200,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "NUMBA_CPU_FEATURES": "-avx512f", "PYTHONPATH": str(REPOSITORY)},
    )
    assert done.returncode == 0, done.stdout[-3000:]

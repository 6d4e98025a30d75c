"""Physics without the rest of the package: arrays and plain numbers come in."""

from __future__ import annotations

from processes import python


def test_physics_needs_neither_scenes_nor_files_nor_ros() -> None:
    """Every module of it is imported where scenes, YAML, meshio, bags, the simulator and ROS cannot be."""
    out = python(
        "import importlib, pkgutil, sys\n"
        "away = ('scene', 'simulation', 'bags', 'haptics', 'ros', 'pictures', 'studies', 'cli')\n"
        "for name in ('yaml', 'meshio', 'rclpy', *(f'finger_sim.{room}' for room in away)):\n"
        "    sys.modules[name] = None\n"
        "import finger_sim.physics as physics\n"
        "for module in pkgutil.iter_modules(physics.__path__):\n"
        "    importlib.import_module(f'finger_sim.physics.{module.name}')\n"
        "print(sorted(n for n in sys.modules if n.startswith('finger_sim.physics.'))[-1])\n"
    )
    assert out.strip() == "finger_sim.physics.workspace"

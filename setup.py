"""What colcon builds the package with in a ROS 2 workspace. pip does not read it: that builds with pyproject.toml.

Version and data come from there, so that nothing is said twice. What it depends on stands in package.xml.
"""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from setuptools import Distribution, find_packages, setup

HERE = Path(__file__).resolve().parent
"""The checkout, also where colcon runs a link to this file in another folder."""
PROJECT = tomllib.loads((HERE / "pyproject.toml").read_text(encoding="utf-8"))
WHEEL = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
DATA = {name.replace("/", "."): folder for folder, name in WHEEL["sources"].items()}
"""Packages that are folders beside the package here, and in it once it is installed."""


class WithoutPyproject(Distribution):
    """Reads no pyproject.toml: the setuptools of Ubuntu 24.04 refuses one that names its licence as PEP 639 has it."""

    def parse_config_files(self, filenames: Any = None, **options: Any) -> None:
        super().parse_config_files(self.find_config_files() if filenames is None else filenames, **options)


def shared() -> Iterator[tuple[str, list[str]]]:
    """Folder of the prefix, and the file that goes there, of all that is no part of the package."""
    for source, target in WHEEL["shared-data"].items():
        if (HERE / source).is_dir():
            for path in sorted((HERE / source).rglob("*")):
                if path.is_file():
                    inside = path.relative_to(HERE / source)
                    yield str(Path(target, inside).parent), [str(Path(source, inside))]
        elif not target.startswith("lib/"):  # the executable is made of its entry point, and has colcon's interpreter
            yield str(Path(target).parent), [source]


setup(
    name="finger_sim",
    version=PROJECT["project"]["version"],
    distclass=WithoutPyproject,
    packages=[*find_packages(include=["finger_sim*"]), *DATA],
    package_dir=DATA,
    package_data={
        "finger_sim.view": ["bundle/*"],
        "finger_sim.data.config": ["*.yaml", "devices/*", "meshes/*", "presets/*"],
        "finger_sim.data.bags": ["*/*"],
    },
    data_files=list(shared()),
    entry_points={"console_scripts": ["finger_node = finger_sim.ros.node:main", "finger_sim = finger_sim.cli:main"]},
)

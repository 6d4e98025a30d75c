"""Wheel and sdist, built as a release builds them, in an environment that has nothing else: no ROS, no extra."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tarfile
import venv
from pathlib import Path

import pytest
from processes import REPOSITORY

from finger_sim.scene.resources import shipped_names

TIMEOUT = 900.0
"""For what is downloaded, built or compiled [s]."""
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(2 * TIMEOUT),
    pytest.mark.skipif(
        importlib.util.find_spec("build") is None and not os.environ.get("CI"), reason="needs the extra [install]"
    ),
]

NAMES = """
import json, importlib.util
from finger_sim.scene.resources import shipped_names
print(json.dumps([shipped_names(), importlib.util.find_spec("rclpy") is not None]))
"""


def alone() -> dict[str, str]:
    """An environment without what the wheels of ROS hand down, and without this checkout."""
    mine = ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "AMENT_PREFIX_PATH", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if name not in mine}


def ran(*words: str | Path, cwd: Path, code: int = 0) -> str:
    """What a program prints; it ends with that exit code. Whatever it keeps, it keeps in `cwd`."""
    kept = {"PIPX_HOME": str(cwd / "pipx"), "UV_CACHE_DIR": str(cwd / "uv")}
    done = subprocess.run(
        list(map(str, words)), cwd=cwd, env=alone() | kept, capture_output=True, text=True, timeout=TIMEOUT
    )
    assert done.returncode == code, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The wheel, made from the sdist, and the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    ran(sys.executable, "-m", "build", "--outdir", folder, REPOSITORY, cwd=folder)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


@pytest.fixture(scope="module")
def prefix(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel and what it needs."""
    folder = tmp_path_factory.mktemp("clean") / "venv"
    venv.create(folder, with_pip=True)
    ran(folder / "bin" / "pip", "install", "--quiet", built[0], cwd=folder)
    return folder


def test_the_sdist_holds_what_tests_and_colcon_need(built: tuple[Path, Path]) -> None:
    """Sources, tests, documentation, manifest; nothing that a build made."""
    with tarfile.open(built[1]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"setup.py", "setup.cfg", "package.xml", "pyproject.toml", "tests/conftest.py", "docs/index.md"} <= names
    assert {"config/finger.yaml", "bags/press_flat/metadata.yaml", "finger_sim/view/bundle/index.html"} <= names
    assert not [name for name in names if "__pycache__" in name or "node_modules" in name or name.startswith("site/")]


def test_shipped_files_are_found_and_no_ros_is_there(prefix: Path, tmp_path: Path) -> None:
    """As in a checkout."""
    names, ros = json.loads(ran(prefix / "bin" / "python", "-c", NAMES, cwd=tmp_path))
    assert names == shipped_names()
    assert not ros


def test_the_base_alone_runs(prefix: Path, tmp_path: Path) -> None:
    """`run`, `info`, `stress`, `params`, and what needs an extra names it."""
    program = prefix / "bin" / "finger_sim"
    assert "finger_haptic" in ran(program, "info", "finger_haptic", cwd=tmp_path)
    ran(program, "run", "finger_haptic", "--bag", "press_flat", "--duration", "0.3", "-o", "pressed", cwd=tmp_path)
    assert "contact_wrench" in ran(program, "info", "pressed", cwd=tmp_path)
    ran(program, "stress", "--cases", "3", "--minutes", "0.1", cwd=tmp_path)
    assert "ros__parameters" in ran(program, "params", cwd=tmp_path)
    assert "finger_sim[ros]" in ran(program, "node", cwd=tmp_path, code=2)


@pytest.mark.parametrize("tool", ["uvx", "pipx"])
def test_it_runs_without_an_installation(tool: str, built: tuple[Path, Path], tmp_path: Path) -> None:
    """`uvx --from` and `pipx run --spec`, each from an environment that has that tool alone."""
    venv.create(tmp_path / "venv", with_pip=True)
    binaries = tmp_path / "venv" / "bin"
    ran(binaries / "pip", "install", "--quiet", {"uvx": "uv"}.get(tool, tool), cwd=tmp_path)
    words = {"uvx": ("uvx", "--from", built[0]), "pipx": ("pipx", "run", "--spec", built[0])}[tool]
    said = ran(binaries / words[0], *words[1:], "finger_sim", "info", "press_flat", cwd=tmp_path)
    assert "command_pose" in said

"""A small package with kernels, and processes that call them: for tests of how kernels are compiled and kept."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from finger_sim.physics import compile as compiling

PACKAGE = Path(compiling.__file__).parents[1]


def tiny(root: Path) -> Path:
    """A package of that name with a kernel, its callee in another file and a constant outside physics/."""
    physics = root / "finger_sim" / "physics"
    physics.mkdir(parents=True)
    for name in (
        "atomics",
        "beside",
        "compile",
        "folders",
        "kept",
        "lanes",
        "libraries",
        "lowering",
        "progress",
        "sources",
    ):
        shutil.copy(PACKAGE / "physics" / f"{name}.py", physics)
    shutil.copy(PACKAGE / "arrays.py", physics.parent)
    for file in (physics / "__init__.py", physics.parent / "__init__.py", physics.parent / "apart.py"):
        file.touch()
    (physics.parent / "numbers.py").write_text("TEN = 10.0\n")
    (physics.parent / "late").mkdir()
    (physics.parent / "late" / "three.py").touch()
    (physics.parent / "late" / "four.py").touch()
    (physics.parent / "late" / "__init__.py").write_text(
        "from typing import TYPE_CHECKING\n\n"
        "if TYPE_CHECKING:\n    from .three import THREE\n    from .four import FOUR\n"
        "def __getattr__(name):\n    return 3.0\n"
    )
    (physics / "callee.py").write_text(
        "from .compile import stage\n\n@stage\ndef twice(x):\n    return 2.0 * x\n",
    )
    (physics / "step.py").write_text(
        "from ..late import THREE\n"
        "from ..numbers import TEN\nfrom .callee import twice\nfrom .compile import kernel\n\n"
        "@kernel\ndef step(x):\n    return TEN + twice(x)\n\n@kernel\ndef other(x):\n    return twice(x)\n",
    )
    return physics.parent


START = """
import sys
from finger_sim.physics.compile import cache_folder, compiled_before, compiling
from finger_sim.physics.step import step
with compiling(lambda text: print(text, flush=True)):
    sys.stdin.readline()
    print(step(1.0))
print(sum(step.stats.cache_hits.values()), compiled_before(), cache_folder())
"""


BOTH = "from finger_sim.physics.step import other\nother(1.0)\n" + START


def start(package: Path, cache: Path, code: str = START) -> subprocess.Popen[str]:
    """A process that says what it does, warnings among it, and waits for a line before it calls the kernel."""
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": str(package.parent), "NUMBA_CACHE_DIR": str(cache), "NUMBA_DISABLE_JIT": "0"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=package.parent,
    )


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def finish(process: subprocess.Popen[str]) -> list[str]:
    out, _ = process.communicate("\n", timeout=100)
    assert process.returncode == 0, out
    return out.splitlines()

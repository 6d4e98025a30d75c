"""The process that compiles kernels computes what those that load them do, to the last bit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PRESS = """
import hashlib, os, sys
import numpy as np
from finger_sim import Scene, Simulator
from finger_sim.studies.shared import poses

if sys.argv[1] == "alone":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
scene = Scene.load("finger").with_values({"solver.sleep": False})
sim, way = Simulator(scene, lambda text: print(text, file=sys.stderr)), poses(scene, "press_slide")[:1100]
sim.reset(way[0])
wrenches = np.array([sim.step(pose).contact_wrench for pose in way])
print(np.abs(wrenches).max(), hashlib.sha256(wrenches.tobytes()).hexdigest())
"""


def pressed(cache: Path, how: str) -> tuple[str, str]:
    """The force [N] and hash of all wrenches of a press; what was told about kernels."""
    done = subprocess.run(
        [sys.executable, "-c", PRESS, how], env=os.environ | {"NUMBA_CACHE_DIR": str(cache), "NUMBA_DISABLE_JIT": "0"},
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("how", ["alone", "by two"])
def test_a_first_start_steps_as_later_ones(tmp_path: Path, how: str) -> None:
    """Compiled in this process, or in two: through the first touch and on into the press."""
    first, told = pressed(tmp_path, how)
    again, told_again = pressed(tmp_path, how)
    assert "compiling kernels: once" in told
    assert "compiling kernels" not in told_again
    assert float(first.split()[0]) > 0.2
    assert first == again

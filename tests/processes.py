"""Fresh interpreters that tests start."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent


def python(code: str, *arguments: str, **environment: str) -> str:
    """Standard output of a fresh interpreter."""
    path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        timeout=200,
        env=os.environ | {"PYTHONPATH": path} | environment,
        cwd=REPOSITORY / "tests",
    )
    assert done.returncode == 0, done.stderr
    return done.stdout

"""What tests of bags share."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

FOXGLOVE = Path(__file__).parent / "foxglove"


@pytest.fixture(scope="session")
def foxglove() -> tuple[str, ...]:
    """The command that reads a bag with Foxglove's packages; skips where they are not installed, in CI it fails."""
    missing = [name for name in json.loads((FOXGLOVE / "package.json").read_text())["dependencies"]
               if not (FOXGLOVE / "node_modules" / name).is_dir()]  # fmt: skip
    missing += [] if shutil.which("node") else ["node"]
    if missing:
        reason = f"needs {', '.join(missing)}: npm ci --prefix tests/bags/foxglove"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(reason)
    return ("node", str(FOXGLOVE / "read.js"))

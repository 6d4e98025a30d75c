"""Sizes of what is downloaded and installed: wheel, sdist, the package, and all it needs; by extra."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from finger_sim.plain import printing

REPOSITORY = Path(__file__).resolve().parent.parent
HANDED_DOWN = ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "VIRTUAL_ENV")
"""Variables of this environment that another one must not see."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--extras", nargs="*", default=["ros"], help="(default: ros)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ran(sys.executable, "-m", "build", "--outdir", folder, REPOSITORY)
        (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
        print(f"wheel {megabytes(wheel):.1f} MB, sdist {megabytes(sdist):.1f} MB")
        for extra in ("", *args.extras):
            prefix = folder / f"venv_{extra}"
            venv.create(prefix, with_pip=True)
            before = megabytes(prefix)
            ran(prefix / "bin" / "pip", "install", "--quiet", "--no-compile", f"{wheel}[{extra}]" if extra else wheel)
            (package,) = prefix.glob("lib/python*/site-packages/finger_sim")
            what = f"with the extra [{extra}]" if extra else "without an extra"
            print(f"installed {what}: the package {megabytes(package):.1f} MB, all {megabytes(prefix) - before:.0f} MB")


def ran(*words: str | Path) -> None:
    """Runs a program of another environment."""
    environment = {name: value for name, value in os.environ.items() if name not in HANDED_DOWN}
    subprocess.run(list(map(str, words)), check=True, env=environment, stdout=subprocess.DEVNULL)


def megabytes(path: Path) -> float:
    """Of a file, or of all files in a folder, in millions of bytes."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
    return 1e-6 * sum(file.stat().st_size for file in files)


if __name__ == "__main__":
    raise SystemExit(printing("install_size", main))

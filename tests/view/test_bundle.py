"""The committed bundle: made of the sources beside it, small, whole, with the licences of what is in it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import finger_sim

VIEW = Path(finger_sim.__file__).parent / "view"
BUNDLE = VIEW / "bundle"
FILES = ("index.html", "page.css", "page.js", "licences.txt")


@pytest.fixture(scope="module")
def packages() -> Path:
    """A copy of the page's sources with its packages installed; skips without npm, in CI it fails."""
    if shutil.which("npm") is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)("needs npm, of Node 20 or later")
    return VIEW / "page"


@pytest.fixture(scope="module")
def page(packages: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("page") / "page"
    shutil.copytree(packages, copy, ignore=shutil.ignore_patterns("node_modules"))
    run(copy, "npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--prefer-offline")
    return copy


def run(folder: Path, *command: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_is_built_of_its_sources(page: Path) -> None:
    """The same bytes, in another folder; types are right."""
    run(page, "npm", "run", "build")
    for name in FILES:
        assert (page.parent / "bundle" / name).read_bytes() == (BUNDLE / name).read_bytes(), name
    run(page, "npm", "run", "check")


def test_it_is_small() -> None:
    """Less than 800 kB altogether, and nothing but what is served."""
    assert sorted(path.name for path in BUNDLE.iterdir()) == sorted(FILES)
    assert sum((BUNDLE / name).stat().st_size for name in FILES) < 800e3


def test_it_asks_nobody() -> None:
    """No address but those that name formats and licences."""
    for name in ("index.html", "page.css"):
        assert not re.search(
            r"https?://|//[a-z]", (BUNDLE / name).read_text().replace("http://www.w3.org/2000/svg", "")
        )
    html = (BUNDLE / "index.html").read_text()
    assert not re.search(r"<script(?![^>]*src=)|\bstyle=|<style|\bon\w+=", html)


def test_licences_are_in_it() -> None:
    """Of each package that is bundled, with its exact version."""
    wanted = json.loads((VIEW / "page" / "package.json").read_text())["dependencies"]
    text = (BUNDLE / "licences.txt").read_text()
    for name, version in wanted.items():
        assert f"{name} {version} (MIT)" in text
    assert text.count("Permission is hereby granted") == len(wanted)

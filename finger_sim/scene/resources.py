"""Where the shipped scenes, meshes and bags are: beside the package in a checkout, in share/ when installed."""

from __future__ import annotations

import sys
from pathlib import Path

_CHECKOUT = Path(__file__).resolve().parents[2]
_SHARE = Path(sys.prefix) / "share" / "finger_sim"


def shipped(kind: str) -> Path:
    """Folder of shipped files of one `kind`: "config" or "bags"."""
    checkout = _CHECKOUT / kind
    return checkout if (_CHECKOUT / "package.xml").is_file() and checkout.is_dir() else _SHARE / kind


def find_scene(name: str | Path) -> Path:
    """Path of a scene given as a file, or by the name of a shipped one ("finger", "finger.yaml")."""
    return _find(name, shipped("config"), ".yaml")


def find_bag(name: str | Path) -> Path:
    """Path of a bag given as a folder or .mcap file, or by the name of a shipped one ("press_slide")."""
    return _find(name, shipped("bags"), "")


def _find(name: str | Path, folder: Path, suffix: str) -> Path:
    """The path itself if it exists, else the shipped one of that name, else the path as given."""
    path = Path(name)
    if path.exists():
        return path
    for candidate in (folder / path, folder / f"{path}{suffix}"):
        if candidate.exists():
            return candidate
    return path

"""Scenes, devices, bags and meshes by name: a file of the user's first, if it can be what is meant, then what ships.

What ships lies in the package, and in a checkout beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib.resources import files
from pathlib import Path

from ..errors import BagError, SceneError

SCENES, MESH = (".yaml", ".yml"), ".vtu"
_STORAGE, PACKED = (".mcap", ".db3"), ("", ".zstd", ".zst", ".lz4", ".gz")
BAGS = (".bag", *(f"{storage}{packed}" for storage in _STORAGE for packed in PACKED))
"""How names of bags' files end."""
"""How the names of files end: of scenes, of recordings in a bag, of shipped meshes."""
CLAIMS = {"claims", "rungs"}
"""Files beside the presets that are no scenes: what was measured."""


def shipped(kind: str) -> Path:
    """Folder of shipped files of one `kind`: "config" (scenes, `presets/`, `meshes/`) or "bags"."""
    package = Path(str(files(__name__.partition(".")[0]))).resolve()  # colcon build --symlink-install makes a link
    packaged = package / "data" / kind
    return packaged if packaged.is_dir() else package.parent / kind


def shipped_names() -> dict[str, list[str]]:
    """Names of all that ships, by kind: "scenes", "bags", "meshes" and "devices"."""
    config, bags = shipped("config"), shipped("bags")
    presets = [f"presets/{path.stem}" for path in config.glob("presets/*.yaml") if path.stem not in CLAIMS]
    return {
        "scenes": sorted(path.stem for path in config.glob("*.yaml")) + sorted(presets),
        "bags": sorted(path.parent.name for path in bags.glob("*/metadata.yaml")),
        "meshes": sorted(path.name for path in config.glob(f"meshes/*{MESH}")),
        "devices": sorted(path.stem for path in config.glob("devices/*.yaml")),
    }


def scene_named(name: str | Path) -> Path | None:
    """A YAML file at a path, or a shipped scene by its name ("finger", "finger.yaml"); None if it is neither."""
    config = shipped("config")
    return _first((Path(name), config / name, config / f"{name}.yaml"), lambda path: path.suffix in SCENES)


def bag_named(name: str | Path) -> Path | None:
    """A bag at a path, as a folder or a file, or a shipped one by its name ("press_slide"); None if it is neither."""
    return next((path for path in (Path(name), shipped("bags") / name) if _tried(_is_bag, path)), None)


def mesh_named(name: str | Path, base: Path = Path()) -> Path | None:
    """A file at a path relative to `base`, or a shipped mesh by its name ("finger", "meshes/finger.vtu"); or None."""
    config = shipped("config")
    of_shipped = (folder / f"{name}{suffix}" for folder in (config, config / "meshes") for suffix in ("", MESH))
    own = _own(name, base)
    return (
        _first((own,), lambda path: path.suffix != "")  # a mesh without suffix cannot be read: it hides no shipped one
        or _first(of_shipped, lambda path: path.suffix == MESH)
        or _first((own,), lambda path: True)
    )


def existing(name: str | Path) -> Path | None:
    """What lies at a path, whatever it is; None where there is nothing."""
    return Path(name) if _tried(Path.exists, Path(name)) else None


def find_scene(name: str | Path) -> Path:
    """As `scene_named`, or a file whose name does not end as those of scenes. Raises SceneError when there is none."""
    found = scene_named(name) or _first((Path(name),), lambda path: True)
    if found is None:
        names = ", ".join(shipped_names()["scenes"])
        raise SceneError("scene", str(name), f"an existing YAML file, or a shipped scene: {names}")
    return found


def find_device(name: str | Path) -> Path:
    """A YAML file at a path, or a shipped device by its name ("haply_inverse3"). Raises SceneError if it is neither."""
    folder = shipped("config") / "devices"
    found = _first((Path(name), folder / name, folder / f"{name}.yaml"), lambda path: path.suffix in SCENES)
    if found is None:
        names = ", ".join(shipped_names()["devices"])
        raise SceneError("device", str(name), f"an existing YAML file, or a shipped device: {names}")
    return found


def find_bag(name: str | Path) -> Path:
    """As `bag_named`, or whatever else is at that path. Raises BagError when there is nothing."""
    found = bag_named(name) or existing(name)
    if found is None:
        names = ", ".join(shipped_names()["bags"])
        raise BagError(f"{name}: no such bag; give a rosbag2 folder or an .mcap file, or a shipped bag: {names}")
    return found


def find_mesh(name: str | Path, base: Path) -> Path:
    """As `mesh_named`, absolute. Raises SceneError at the key mesh.file when there is none."""
    found = mesh_named(name, base)
    if found is None:
        names = ", ".join(shipped_names()["meshes"])
        where = "" if base == Path() else f" relative to {base}"
        raise SceneError("mesh.file", str(name), f"an existing mesh file{where}, or a shipped one: {names}")
    return found.resolve()


def _first(paths: Iterable[Path], fits: Callable[[Path], bool]) -> Path | None:
    """The first of the paths that is a file and fits."""
    return next((path for path in paths if fits(path) and _tried(Path.is_file, path)), None)


def _own(name: str | Path, base: Path) -> Path:
    """The path that a user gave, relative to `base`, `~` resolved where there is such a home."""
    try:
        return base / Path(name).expanduser()
    except RuntimeError:
        return base / name


def _is_bag(path: Path) -> bool:
    """Whether it is a recording, or a folder with one."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(file.name.endswith(BAGS) for file in path.iterdir())
    return path.name.endswith(BAGS) and path.is_file()


def _tried(test: Callable[[Path], bool], path: Path) -> bool:
    """The test's answer; False where the system refuses to look: a name too long, a folder that is closed."""
    try:
        return test(path)
    except (OSError, ValueError):
        return False

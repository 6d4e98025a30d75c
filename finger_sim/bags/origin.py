"""What made a bag: version, scene, options, mesh, machine. A bag holds it in its metadata, and so does each file of it.

It is words by name, as rosbag2's `custom_data` and a metadata record of MCAP take them: in the record `finger_sim` of a
file, and in the metadata.yaml with the prefix `finger_sim.`.

version      of finger_sim
made_by      node or run
scene        YAML, with the values live at the bag's beginning; a mesh that ships by its name, another by its path
options      YAML: the node's own parameters then, or what a run took of them
mesh_sha256  of nodes, tetrahedra, material axes and node sets themselves, wherever they came from
machine      YAML: cpu and cores (of a node; a run gives the same everywhere)
reached      YAML: rate, steps, late and skipped ones, since the bag's beginning (of a node that ended the bag itself)
part         number of the file in its bag, counted from 0 (in files after the first)
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from ..errors import BagError, FingerSimError
from ..scene import Scene
from ..scene.mesh import TetMesh
from ..scene.resources import shipped
from .reader import BagReader

PACKAGE = "finger_sim"
SHOWN_DIGITS = 12
"""Digits of a hash that a person is shown."""


@dataclass(frozen=True)
class Origin:
    """What made a bag, as plain values; see this module."""

    version: str
    made_by: str
    scene: Mapping[str, Any]
    options: Mapping[str, Any]
    mesh_sha256: str
    machine: Mapping[str, Any] = field(default_factory=dict)
    reached: Mapping[str, Any] = field(default_factory=dict)
    part: int = 0

    def words(self) -> dict[str, str]:
        """As a BagWriter takes them; what only a recording's end knows is left out, and so is an empty block."""
        blocks = {"scene": self.scene, "options": self.options, "machine": self.machine}
        return {
            "version": self.version,
            "made_by": self.made_by,
            "mesh_sha256": self.mesh_sha256,
            **{name: block_text(block) for name, block in blocks.items() if block},
        }


def origin_of(
    made_by: str, scene: Scene, mesh: TetMesh, options: Mapping[str, Any], machine: Mapping[str, Any] | None = None
) -> Origin:
    """What is to be said of a bag that begins with this scene, mesh and options."""
    return Origin(version(), made_by, described(scene), dict(options), mesh_hash(mesh), machine or {})


def read_origin(reader: BagReader) -> Origin | None:
    """What a bag says of its making; None where it says nothing. Raises BagError for what cannot be read."""
    words = reader.origin
    if "scene" not in words:
        return None
    try:
        blocks = {name: yaml.safe_load(words.get(name, "{}")) for name in ("scene", "options", "machine", "reached")}
        part = int(words.get("part", "0"))
    except (yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise BagError(f"{reader.path}: what it says of its making cannot be read: {reason}") from None
    for name, block in blocks.items():
        if not isinstance(block, dict):
            raise BagError(f"{reader.path}: what it says of its making: {name}: got {block!r}, allowed: a block")
    version, made_by, mesh = (words.get(name, "unknown") for name in ("version", "made_by", "mesh_sha256"))
    scene, options, machine, reached = blocks.values()
    return Origin(version, made_by, scene, options, mesh, machine, reached, part)


def recorded_scene(reader: BagReader, origin: Origin | None) -> Scene:
    """The scene that a bag was made with, on the same mesh. Raises BagError where it holds none, or none can be had."""
    advice = f"give a scene: finger_sim run SCENE --bag {reader.path}"
    if origin is None:
        raise BagError(f"{reader.path}: holds no scene, as bags of the node and of run do; {advice}")
    if origin.part:
        where = f"{reader.path}: is file {origin.part} of a bag, after live changes that only the whole folder tells"
        raise BagError(f"{where}; give the folder, or {advice}")
    try:
        scene = Scene.from_dict(origin.scene, base=shipped("config"))
        found = mesh_hash(scene.load_mesh())
    except FingerSimError as error:
        raise BagError(f"{reader.path}: the recorded scene cannot be had: {error}; {advice}") from None
    if found != origin.mesh_sha256:
        mesh = origin.scene["mesh"].get("file") or "the beam"
        two = f"{mesh} has the sha256 {found} now, had {origin.mesh_sha256}"
        raise BagError(f"{reader.path}: the mesh is not the recorded one: {two}; {advice}")
    return scene


def described(scene: Scene) -> dict[str, Any]:
    """A scene in plain values, a mesh that ships by its name: the same wherever finger_sim is installed."""
    data = scene.to_dict()
    if scene.mesh.file is not None:
        file, config = Path(scene.mesh.file), shipped("config").resolve()
        data["mesh"]["file"] = file.relative_to(config).as_posix() if file.is_relative_to(config) else str(file)
    return data


def differences(ours: Origin, theirs: Origin) -> Iterator[str]:
    """How what makes a bag is different from what made another; a text for each key. Options are those of both."""
    yield from _differences(ours.scene, theirs.scene)
    for name in ours.options:
        yield from _differences(ours.options[name], theirs.options.get(name, ours.options[name]), name)
    yield from _differences(ours.mesh_sha256, theirs.mesh_sha256, "sha256 of the mesh")
    yield from _differences(ours.version, theirs.version, "finger_sim")


def _differences(ours: Any, theirs: Any, key: str = "") -> Iterator[str]:
    """What is different in two plain values, a text for each key: ours, and theirs as the recorded."""
    if isinstance(ours, Mapping) and isinstance(theirs, Mapping):
        for name in dict.fromkeys([*ours, *theirs]):
            yield from _differences(ours.get(name), theirs.get(name), f"{key}.{name}" if key else name)
    elif ours != theirs:
        yield f"{key} {_flow(ours)} (recorded: {_flow(theirs)})"


def mesh_hash(mesh: TetMesh) -> str:
    """sha256 of nodes, tetrahedra, material axes and node sets, in hexadecimal."""
    arrays: dict[str, NDArray[Any]] = {"points": mesh.points, "tets": mesh.tets, "axes": mesh.axes}
    arrays |= {f"set {name}": nodes for name, nodes in sorted(mesh.node_sets.items())}
    found = hashlib.sha256()
    for name, array in arrays.items():
        found.update(f"{name} {array.shape}\n".encode())
        found.update(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes())
    return found.hexdigest()


def version() -> str:
    """Of finger_sim."""
    try:
        return importlib.metadata.version(PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def machine() -> dict[str, Any]:
    """The processor's model, and how many cores this process may use."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": models[0] if models else platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
    }


def block_text(block: Mapping[str, Any]) -> str:
    """Plain values as YAML; `yaml.safe_load` gives them back, to the last bit."""
    return yaml.safe_dump(dict(block), sort_keys=False, default_flow_style=None, allow_unicode=True, width=100)


def _flow(value: Any) -> str:
    """A value in one line of YAML."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")

"""What a scene, a bag or a mesh holds, as tables."""

from __future__ import annotations

import dataclasses
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from ..bags.changes import changes_in
from ..bags.choice import command_topic
from ..bags.course import Course, doubts, figures, rows
from ..bags.origin import SHOWN_DIGITS, read_origin
from ..bags.reader import BagReader, absolute, commands_of
from ..console import table
from ..errors import BagError, FingerSimError
from ..physics.locking import STIFF_BULK, STRAINS
from ..scene import Limits, Plane, Scene, locking
from ..scene.fields import to_dict
from ..scene.mesh import TetMesh
from ..scene.parts import Material
from ..scene.resources import bag_named, existing, mesh_named, scene_named, shipped_names


def info(name: str) -> Iterator[tuple[str, Table]]:
    """Titles and tables about a file, or a shipped scene, bag or mesh by its name.

    Raises FingerSimError when there is no such thing, or it is broken.
    """
    scene, mesh = scene_named(name), mesh_named(name)
    bag = bag_named(name) or (None if mesh else existing(name))
    if scene is not None and scene.name == "metadata.yaml":
        yield from _bag(scene.parent)
    elif scene is not None:
        yield from _scene(scene)
    elif bag is not None:
        yield from _bag(bag)
    elif mesh is not None:
        yield from _mesh(mesh)
    else:
        names = shipped_names()
        raise FingerSimError(
            f"{name}: no such file; give a scene (.yaml), a bag (folder, .mcap) or a mesh, "
            f"or a shipped scene ({', '.join(names['scenes'])}), bag ({', '.join(names['bags'])}) "
            f"or mesh ({', '.join(names['meshes'])})"
        )


def _mesh(path: Path) -> Iterator[tuple[str, Table]]:
    yield f"mesh {path}", _pairs(TetMesh.load(path).summary())


def _bag(path: Path) -> Iterator[tuple[str, Table]]:
    reader = BagReader(path)
    lost = [topic.lost for topic in reader.topics if topic.lost is not None]
    facts = {
        "duration": f"{reader.duration:.3f} s",
        "messages": str(reader.message_count),
        "whole": f"no: {reader.warning or reader.cut}" if reader.warning or reader.cut else "yes",
        "numbers missing": str(sum(lost)) if lost else "not known: there are none, or of several writers",
    }
    about = _pairs(facts | _origin(reader))
    for (name, kind), encoding in reader.foreign.items():
        about.add_row("not read", f"{name} ({kind}): messages in {encoding}, not of ROS 2 (cdr)")
    for note in reader.notes:
        about.add_row("note", note)
    yield f"bag {path}", about
    times = {(topic.name, topic.type): array("Q") for topic in reader.topics}
    for message in reader:
        times[message.topic, message.type].append(message.log_time)
    topics = table("topic", "type", "messages", "rate [Hz]", "longest gap [s]", "lost")
    for topic in reader.topics:
        intervals = np.diff(np.array(times[topic.name, topic.type])) * 1e-9
        usual = float(np.median(intervals)) if len(intervals) else 0.0
        topics.add_row(
            topic.name,
            topic.type,
            str(topic.count),
            f"{1.0 / usual:.4g}" if usual > 0.0 else "–",
            f"{intervals.max():.3g}" if len(intervals) else "–",
            "–" if topic.lost is None else str(topic.lost),
        )
    yield "topics", topics
    yield from _commands(reader)


def _commands(reader: BagReader) -> Iterator[tuple[str, Table]]:
    """The commands of a bag by times of receipt, as the node follows them; nothing where there are none."""
    try:
        topic = command_topic(reader, None)
    except BagError:
        return
    try:
        commands = commands_of(reader, topic, allow_gaps=True)
    except BagError as error:
        if any(absolute(each.name) == topic and each.count for each in reader.topics):
            yield f"commands on {topic}", _pairs({"warning": str(error)})
        return
    found = figures(Course(commands.receipt_ns, commands.position, commands.orientation))
    steps = np.diff(commands.stamp)
    facts = rows(found)
    facts["header stamps"] = f"{int((steps == 0.0).sum())} repeated, {int((steps < 0.0).sum())} fall"
    if commands.refused:
        facts["refused"] = f"{commands.refused}; {commands.refusal}"
    out = _pairs(facts)
    for doubt in doubts(found):
        out.add_row("warning", doubt)
    yield f"commands on {topic} in frame {commands.frame_id!r}, by times of receipt", out


def _origin(reader: BagReader) -> dict[str, str]:
    """What made a bag, in few words; nothing where it does not say."""
    try:
        origin = read_origin(reader)
    except BagError as error:
        return {"made by": str(error)}
    if origin is None:
        return {}
    scene, reached = origin.scene, dict(origin.reached)
    named = f"{origin.options['scene']}, " if "scene" in origin.options else ""
    mesh = scene.get("mesh", {}).get("file") or "a beam"
    facts = {
        "made by": f"{origin.made_by} of finger_sim {origin.version}",
        "scene": f"{named}{mesh} (sha256 {origin.mesh_sha256[:SHOWN_DIGITS]}…), dt {scene.get('dt')} s",
    }
    if origin.machine:
        facts["machine"] = f"{origin.machine.get('cpu')}, {origin.machine.get('cores')} cores"
    if reached:
        counts = ", ".join(f"{reached.get(name)} {name}" for name in ("steps", "late", "skipped"))
        facts["rate reached"] = f"{reached.get('rate')} Hz: {counts}"
    changes, left_out = changes_in(reader)
    names = Counter(name for change in changes for name in (*change.scene, *change.options))
    live = ", ".join(f"{name} ({count}×)" if count > 1 else name for name, count in names.items())
    facts["changed live"] = live or "nothing"
    if left_out:
        facts["live changes that cannot be read"] = f"{len(left_out)}; {left_out[0]}"
    if resets := sum(change.reset for change in changes):
        facts["resets"] = str(resets)
    if opened := sum(change.clutch is True for change in changes):
        facts["clutch opened"] = f"{opened}×"
    return facts


def _scene(path: Path) -> Iterator[tuple[str, Table]]:
    scene = Scene.load(path)
    mesh = scene.load_mesh()
    driven = len(scene.driven_nodes(mesh))
    material = scene.material
    facts = {
        "mesh": scene.mesh.file or f"beam, {_numbers(scene.mesh.beam)}",
        "tets, nodes": f"{len(mesh.tets)}, {len(mesh.points)}",
        "driven": f"{driven} nodes ({to_dict(scene)['driven']})" if driven else "nothing: a free body",
        "free": f"{len(mesh.points) - driven} nodes",
        "material": f"E {material.young:g} Pa, ν {material.poisson:g}, {material.density:g} kg/m³, "
                    f"damping {material.damping.mass:g} 1/s · M + {material.damping.stiffness:g} s · K",
        "relaxation": _relaxation(material),
        "limits": _limits(scene.limits),
        "plane": _plane(scene.plane),
        "solver": f"{scene.solver.method}, tolerance {scene.solver.tolerance:g}, "
                  f"at most {scene.solver.max_iterations} iterations",
        "dt": f"{scene.dt:g} s ({1.0 / scene.dt:g} Hz)"
              + (f" in {scene.substeps} substeps" if scene.substeps > 1 else ""),
        "arrays": f"{_memory(scene, mesh) / 2**20:.1f} MiB",
    }  # fmt: skip
    yield f"scene {path}", _pairs(facts)
    yield "mesh", _pairs(mesh.summary())
    if scene.limits is not None:
        yield "over-constraint", _pairs(_locking(scene, scene.limits, mesh))
    parameters = table("name", "value", "unit", "live", "meaning")
    for name, value, spec in ((p.name, p.value, p.spec) for p in scene.parameters()):
        parameters.add_row(name, _plain(value), spec.unit, "live" if spec.live else "", spec.doc)
    yield "parameters", parameters


def _locking(scene: Scene, limits: Limits, mesh: TetMesh) -> dict[str, str]:
    """What may lock, before a run."""
    is_free = np.ones(len(mesh.points), bool)
    is_free[scene.driven_nodes(mesh)] = False
    counted = locking.count(limits, is_free[mesh.tets].sum(axis=1), int(is_free.sum()))
    material = scene.material.lasting
    stiffness = locking.bulk_to_shear(material)
    stiff = stiffness >= STIFF_BULK
    strain, volume = locking.isochoric_strain(limits), locking.volume_at_limit(limits)
    facts = {
        "rows against freedoms": f"up to {counted.rows_each} rows a tetrahedron, on {STRAINS} strains at most: "
        f"{counted.crowded} tetrahedra can have more rows than ways to deform; "
        f"one row each are {counted.rows} rows on {counted.freedoms} freedoms of the mesh",
        "bulk against shear": f"K/μ = {stiffness:.3g} at ν {material.poisson:g}: "
        + ("stiff, so volume is all but kept" if stiff else "not stiff, so volume gives"),
    }
    for side, word, sign in ((0, "stretch", 1.0), (1, "compression", -1.0)):
        for j in np.flatnonzero(np.isfinite(strain[side])):
            reached = f"s{j + 1} = {1.0 + sign * strain[side, j]:.4g}"
            end = "no limit of its own" if np.isnan(volume[side, j]) else f"at its limit V/V₀ = {volume[side, j]:.4g}"
            facts[f"{word} along e{j + 1}"] = (
                f"at constant volume the other limits end it at {reached}; {end}"
                + (": locks beyond" if stiff else "")
            )  # fmt: skip
    if not np.isfinite(strain).any():
        facts["limits against volume"] = "every limit can be met at constant volume"
    return facts


def _memory(scene: Scene, mesh: TetMesh) -> int:
    """Bytes of the arrays that a simulation of the scene owns."""
    from ..physics.workspace import build_state
    from ..simulation.build import build_model

    model = build_model(scene, mesh)
    arrays = _arrays((model, build_state(model, mesh.points)))
    return sum({id(array): array.nbytes for array in arrays}.values())


def _arrays(record: Iterable[Any]) -> Iterator[NDArray[Any]]:
    """The arrays in a record and the records within; one that has two names comes twice."""
    for value in record:
        if isinstance(value, np.ndarray):
            yield value
        elif isinstance(value, tuple):
            yield from _arrays(value)


def _limits(limits: Limits | None) -> str:
    if limits is None:
        return "none"
    ranges = (
        f"{'free' if low is None else f'{low:g}'} … {'free' if high is None else f'{high:g}'}"
        for low, high in zip(limits.compress, limits.stretch, strict=True)
    )
    axes = ", ".join(f"e{axis} {text}" for axis, text in enumerate(ranges, start=1))
    stiffness = "rigid" if limits.stiffness is None else f"stiffness {limits.stiffness:g} E"
    return f"{limits.projection}, stretch along {axes}, {stiffness}"


def _relaxation(material: Material) -> str:
    """What fades while a strain is held, and what stays."""
    if not material.relaxation:
        return "none"
    terms = ", ".join(f"{term.share:g} with {term.time:g} s" for term in material.relaxation)
    stays = 1.0 - sum(term.share for term in material.relaxation)
    return f"of the {material.relaxes}: {terms}; {stays:.3g} stays"


def _plane(plane: Plane | None) -> str:
    if plane is None:
        return "none"
    return f"through {_plain(plane.point)} m, normal {_plain(plane.normal)}, friction {plane.friction:g}"


def _numbers(part: Any) -> str:
    return ", ".join(f"{name} {_plain(value)}" for name, value in to_dict(part).items())


def _plain(value: Any) -> str:
    """A value as a scene file would have it."""
    if hasattr(value, "as_plain"):
        return str(value.as_plain())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(item) for item in value) + "]"
    if isinstance(value, float):
        return f"{value:g}"
    if dataclasses.is_dataclass(value):
        return f"{{{', '.join(f'{name}: {_plain(part)}' for name, part in to_dict(value).items())}}}"
    return "null" if value is None else str(value)


def _pairs(pairs: Mapping[str, str]) -> Table:
    """A table of names and texts."""
    out = table()
    for name, text in pairs.items():
        out.add_row(name, text)
    return out

"""Scenes: round trips, every bound by a rejection, and errors that name key, value and what is allowed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from finger_sim import MeshError, Pose, Scene, SceneError, Simulator
from finger_sim.scene import Beam, Coupling, Damping, Limits, Material, MeshSource, Plane, Solver
from finger_sim.scene.fields import Field, specs

CONFIG = Path(__file__).resolve().parents[2] / "config"
SHIPPED = sorted(path.stem for path in CONFIG.glob("*.yaml"))

# A scene with every block there is.
FULL: dict[str, Any] = {
    "mesh": {"beam": {"size": [0.4, 0.2, 0.2], "cells": [2, 1, 1]}},
    "driven": "base",
    "material": {
        "density": 900.0,
        "young": 2e4,
        "poisson": 0.3,
        "volumetric": "patch",
        "damping": {"mass": 0.5, "stiffness": 0.01},
        "relaxation": [{"time": 0.004, "share": 0.3}, {"time": 1.5, "share": 0.2}],
        "relaxes": "stress",
    },
    "limits": {
        "projection": "hyperbolic",
        "stretch": [1.1, None, 1.3],
        "compress": [None, 0.8, 0.9],
        "stiffness": None,
        "inertia": 30.0,
        "viscosity": 4.0,
    },
    "plane": {"point": [0, 0, -1], "normal": [0, 0, 2], "friction": 0.7, "stiffness": 50.0},
    "gravity": [0, 0, -1],
    "solver": {
        "method": "pgs",
        "tolerance": 1e-4,
        "least_force": 0.1,
        "max_iterations": 50,
        "relinearizations": 1,
        "settle": False,
        "sleep": False,
        "level": "standard",
        "budget_ms": 0.8,
        "deadline": 5e-4,
    },
    "coupling": {
        "type": "kinematic",
        "following": "linear",
        "stiffness": 250.0,
        "damping": 2.0,
        "rotational_stiffness": 0.5,
        "rotational_damping": 0.01,
        "max_speed": 1.0,
        "max_angular_speed": 2.0,
        "force_limit": 3.0,
        "torque_limit": 4.0,
    },
    "dt": 0.002,
    "substeps": 2,
    "initial_pose": {"position": [1, 2, 3], "orientation": [0, 0, 1, 1]},
}


def changed(key: str, value: Any) -> dict[str, Any]:
    """FULL with one dotted key changed."""
    data = yaml.safe_load(yaml.safe_dump(FULL))
    block = data
    *path, name = key.split(".")
    for part in path:
        block = block.setdefault(part, {})
    block[name] = value
    return data  # type: ignore[no-any-return]


def refusal(data: Any, what: object = "it") -> SceneError:
    """The SceneError that a scene is refused by; `what` is named where it is not."""
    try:
        Scene.from_dict(data)
    except SceneError as error:
        return error
    except Exception as error:
        pytest.fail(f"{what}: refused by {error!r}")
    pytest.fail(f"{what}: not refused")


def refused_key(key: str, value: Any) -> SceneError:
    """The refusal of FULL with one dotted key changed; it names that key, or a component of it."""
    error = refusal(changed(key, value), f"{key}: {value!r}")
    assert error.key.split("[")[0] == key, f"{key}: {value!r}: {error}"
    return error


def keys_of(cls: type, prefix: str = "") -> Iterator[tuple[str, Field]]:
    """Every key that a scene may have, whether in FULL or not."""
    for name, spec in specs(cls).items():
        if spec.kind == "part":
            assert spec.part is not None
            yield from keys_of(spec.part, f"{prefix}{name}.")
        else:
            yield prefix + name, spec


KEYS = dict(keys_of(Scene))


def wrapped(spec: Field, number: Any) -> Any:
    """A value of the key's kind with `number` in it, fine in its other places."""
    good = min(max(1.0, spec.low), spec.high)
    good = int(good) if spec.kind in ("cells", "int") else good
    return {
        "vec3": [good, number, good],
        "cells": [good, good, number],
        "limit3": [number, None, None],
        "quaternion": [0.0, number, 0.0, 1.0],
    }.get(spec.kind, number)


def out_of_range() -> Iterator[tuple[str, Any, Any]]:
    """Key, the value next beyond a bound of it, and the bound."""
    for key, spec in KEYS.items():
        if spec.kind in ("text", "choice", "bool", "parts"):
            continue
        whole = spec.kind in ("int", "cells")
        for bound, step in ((spec.low, -1), (spec.high, +1)):
            if math.isfinite(bound):
                beyond = int(bound) + step if whole else np.nextafter(bound, step * math.inf)
                yield key, wrapped(spec, beyond), wrapped(spec, int(bound) if whole else bound)


def test_every_bound_is_kept() -> None:
    """The bound itself is allowed, the next number beyond it is not; the error names key, value and range."""
    cases = list(out_of_range())
    assert len(cases) > 50
    for key, beyond, bound in cases:
        try:
            Scene.from_dict(changed(key, bound))
        except SceneError as error:
            pytest.fail(f"{key}: {bound} is allowed, and was refused: {error}")
        error = refused_key(key, beyond)
        low, high = KEYS[key].low, KEYS[key].high
        assert f"{low:g}" in error.allowed or f"{high:g}" in error.allowed, error
        assert all(word in str(error) for word in (key, "got", "allowed")), error


NUMBERS = [key for key, spec in KEYS.items() if spec.kind not in ("text", "choice", "bool", "parts")]
ARRAYS = [key for key, spec in KEYS.items() if spec.kind in ("vec3", "cells", "quaternion", "limit3")]
TEXTS = [key for key, spec in KEYS.items() if spec.kind in ("text", "choice") and key != "driven"]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, "1.0", True, [], {}, "x"], ids=repr)
def test_no_nan_infinity_or_wrong_type_gets_in(bad: Any) -> None:
    """Every numeric key refuses NaN, ±∞, texts, booleans and containers, by name."""
    assert len(NUMBERS) > 30
    for key in NUMBERS:
        refused_key(key, wrapped(KEYS[key], bad))
        if key in ARRAYS:
            refused_key(key, bad)


def test_wrong_number_of_components() -> None:
    """Two or five numbers are neither a vector nor a quaternion, null is no number."""
    assert len(ARRAYS) == 9
    for key in ARRAYS:
        for value in ([1, 1], [1, 1, 1, 1, 1], [[1], [1], [1]]):
            refused_key(key, value)
        if KEYS[key].kind != "limit3":
            assert refused_key(key, None).key == key


def test_texts_and_choices() -> None:
    """A text or choice key refuses anything else; a choice names what there is to choose from."""
    assert len(TEXTS) == 8
    for key in TEXTS:
        for bad in (3, 1.5, True, ["a"], {"a": 1}):
            assert refused_key(key, bad).key == key
        if KEYS[key].kind == "choice":
            error = refused_key(key, "other")
            assert all(choice in error.allowed for choice in KEYS[key].choices), error
            assert refused_key(key, None).key == key


@pytest.mark.parametrize(
    ("bad", "key", "allowed"),
    [
        ([{"time": 0, "share": 0.3}], "[0].time", "[1e-05, 100000] s"),
        ([{"time": 1, "share": 0.3}, {"time": 1, "share": 1.0}], "[1].share", "[0, 0.999]"),
        ([{"time": 1, "share": math.nan}], "[0].share", "[0, 0.999]"),
        ([{"time": "1", "share": 0.1}], "[0].time", "a number"),
        ([{"time": 1}], "[0].share", "missing"),
        ([{"time": 1, "share": 0.1, "g": 2}], "[0].g", "no such key"),
        ([[1, 0.3]], "[0]", "keys time, share"),
        ([{"time": 1, "share": 0.6}, {"time": 2, "share": 0.4}], "", "less than 1 together"),
        ([{"time": 1, "share": 0.1}] * 9, "", "at most 8"),
        ({"time": 1, "share": 0.3}, "", "a list"),
        (None, "", "a list"),
        ("x", "", "a list"),
    ],
)
def test_relaxation_that_cannot_be(bad: Any, key: str, allowed: str) -> None:
    """The place in the list, the value, and what is allowed."""
    error = refused_key("material.relaxation", bad)
    assert error.key == f"material.relaxation{key}"
    assert allowed in error.allowed
    assert "got" in str(error)


def test_a_mistake_in_a_list_is_found_in_the_file(tmp_path: Path) -> None:
    """Line and column of the value, with a caret below it."""
    path = tmp_path / "soft.yaml"
    terms = "    - {time: 0.1, share: 0.3}\n    - {time: -1, share: 0}\n"
    path.write_text(f"mesh: {{beam: {{}}}}\nmaterial:\n  relaxation:\n{terms}")
    with pytest.raises(SceneError, match=r"soft.yaml, line 5, column 14: material.relaxation\[1\].time: got -1"):
        Scene.load(path)


@pytest.mark.parametrize("relaxes", ["deviator", "stress"])
def test_what_lasts_of_a_material(relaxes: str) -> None:
    """μ falls to the part that shares leave; K stays, or falls alike, and ν with it."""
    terms = [{"time": 0.004, "share": 0.3}, {"time": 1.5, "share": 0.2}]
    given = {"young": 2e4, "poisson": 0.3, "relaxation": terms, "relaxes": relaxes}
    lasting = Scene.from_dict({"mesh": {"beam": {}}, "material": given}).material.lasting
    shear, bulk = 2e4 / 2.6, 2e4 / 1.2 * (0.5 if relaxes == "stress" else 1.0)
    assert lasting.young / (2.0 * (1.0 + lasting.poisson)) == pytest.approx(0.5 * shear)
    assert lasting.young / (3.0 * (1.0 - 2.0 * lasting.poisson)) == pytest.approx(bulk)
    assert lasting.relaxation == ()
    assert Material().lasting == Material()


def test_the_relaxing_finger_becomes_the_everyday_one() -> None:
    """In the end it has the moduli of finger_haptic, and its limits and contact were as stiff all the time."""
    soft, everyday = Scene.load("finger_relaxing"), Scene.load("finger_haptic")
    lasting = soft.material.lasting
    assert lasting.young == pytest.approx(everyday.material.young, rel=1e-4)
    assert lasting.poisson == pytest.approx(everyday.material.poisson, rel=1e-4)
    for name in ("limits", "plane"):
        stiffness, wanted = getattr(soft, name).stiffness, getattr(everyday, name).stiffness
        assert stiffness * soft.material.young == pytest.approx(wanted * everyday.material.young, rel=1e-4)
    assert [term.time for term in soft.material.relaxation] == [0.004, 0.07, 1.4]


def test_a_scene_that_does_not_relax_is_written_as_before() -> None:
    """Neither key is there: what is kept by a scene's values, as errors of presets, stays known."""
    written = Scene.from_dict({"mesh": {"beam": {}}}).to_dict()["material"]
    assert set(written) == {"density", "young", "poisson", "damping", "volumetric"}
    assert Scene.from_dict({"mesh": {"beam": {}}, "material": {"relaxes": "stress"}}).to_dict()["material"]["relaxes"]


def test_whole_numbers_are_whole() -> None:
    """2.5 sweeps or substeps are refused, 2.0 is two."""
    for key in (k for k, s in KEYS.items() if s.kind == "int" and s.high > 1):
        assert refusal(changed(key, 2.5)).key == key
        assert Scene.from_dict(changed(key, 2.0)) == Scene.from_dict(changed(key, 2))
    assert refusal(changed("mesh.beam.cells", [2, 1.5, 1])).key == "mesh.beam.cells"


def test_unknown_keys_and_wrong_blocks() -> None:
    """A key that no block knows is an error by its path, with the known ones; a block is not a number or a list."""
    blocks = ("mesh", "mesh.beam", "material", "material.damping", "limits", "plane", "solver", "coupling")
    for block in ("", *blocks, "initial_pose"):
        error = refused_key(f"{block}.frictoin".removeprefix("."), 1.0)
        assert "known here" in error.allowed, error
        for bad in (3.0, [1], "text") if block else ():
            assert refused_key(block, bad).key == block
    for bad in (None, 3, [FULL], "scene"):
        assert refusal(bad, bad).key == "scene"


def test_shipped_scenes_go_round(tmp_path: Path) -> None:
    """load → to_dict → from_dict and YAML and back give the same scene; by name, by path; it can be meshed."""
    assert len(SHIPPED) >= 10
    for name in SHIPPED:
        scene = Scene.load(name)
        assert scene == Scene.load(CONFIG / f"{name}.yaml") == Scene.load(f"{name}.yaml"), name
        assert Scene.from_dict(scene.to_dict()) == scene, name
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(scene.to_dict()))
        assert Scene.load(path) == scene, name
        assert len(scene.load_mesh().tets) > 0, name
        assert dataclasses.replace(scene) == scene, name


def test_every_block_goes_round() -> None:
    """Each value of FULL comes back as given (normal and limits too), quaternions at length one."""
    for driven in (None, "base", {"box": [[-1, -1, -1], [0, 1, 1]]}):
        data = FULL | {"driven": driven}
        scene = Scene.from_dict(data)
        back = scene.to_dict()
        assert Scene.from_dict(back) == scene
        for block in ("limits", "plane", "material", "solver", "coupling"):
            assert back[block] == data[block], block
        assert back.get("driven") == driven
        assert back["initial_pose"]["orientation"] == pytest.approx([0, 0, math.sqrt(0.5), math.sqrt(0.5)])
        assert (scene.dt, scene.substeps, scene.gravity) == (0.002, 2, (0, 0, -1))


def test_what_is_left_out_is_not_there() -> None:
    """A mesh alone makes a scene: no limits, no plane, no drive; and the mesh cannot be left out."""
    scene = Scene.from_dict({"mesh": {"beam": {}}})
    assert (scene.limits, scene.plane, scene.driven) == (None, None, None)
    assert "limits" not in scene.to_dict()
    assert "plane" not in scene.to_dict()
    assert refusal({}).key == "mesh"
    assert "missing" in str(refusal({"gravity": [0, 0, 0]}))


# As architecture.md's example and physics.md have them.
DEFAULTS: list[tuple[type, dict[str, Any]]] = [
    (Scene, {"driven": None, "limits": None, "plane": None, "gravity": (0.0, 0.0, -9.81), "dt": 0.001, "substeps": 1}),
    (Material, {"density": 1000.0, "young": 2.0e6, "poisson": 0.4, "volumetric": "element"}),
    (Damping, {"mass": 0.0, "stiffness": 0.002}),
    (Limits, {"projection": "hyperbolic", "stiffness": 30.0, "stretch": (None,) * 3, "compress": (None,) * 3}),
    (Plane, {"point": (0, 0, 0), "normal": (0, 0, 1), "friction": 0.5}),
    (Solver, {"tolerance": 1.0e-3, "relinearizations": 0}),
    (Coupling, {"type": "kinematic"}),
    (Pose, {"position": (0, 0, 0), "orientation": (0, 0, 0, 1)}),
    (Beam, {"size": (1.0, 0.2, 0.2), "cells": (10, 2, 2)}),
    (MeshSource, {"file": None, "beam": None}),
]


def test_defaults() -> None:
    """Every default is that of the design's example, and passes its own range."""
    for cls, expected in DEFAULTS:
        fields: dict[str, Any] = {f.name: f for f in dataclasses.fields(cls)}
        for name, value in expected.items():
            assert fields[name].default == value, (cls, name)
        for name, spec in specs(cls).items():
            default = fields[name].default
            assert spec.doc, (cls, name)
            if default is not dataclasses.MISSING and spec.kind != "part":
                assert spec.parse(default, name) == default, (cls, name)


def test_parameters_are_every_value_of_the_scene() -> None:
    """`parameters()` has each key of the blocks that are there, once, with its value and range; live ones known."""
    names = {p.name: p for p in Scene.from_dict(FULL).parameters()}
    assert set(names) == set(KEYS)
    assert names["material.young"].value == 2e4
    assert names["plane.friction"].spec.high == KEYS["plane.friction"].high
    live = {name for name, p in names.items() if p.spec.live}
    assert {
        "plane.friction",
        "plane.point",
        "plane.normal",
        "solver.tolerance",
        "solver.max_iterations",
        "coupling.force_limit",
    } <= live
    assert not live & {"dt", "material.young", "mesh.file", "limits.stretch"}
    bare = {p.name for p in Scene.from_dict({"mesh": {"beam": {}}}).parameters()}
    assert not {n for n in bare if n.startswith(("plane.", "limits."))}


def test_with_values_changes_copies_only() -> None:
    """Dotted keys, several at once, checked as loading does; the scene itself stays as it was."""
    scene = Scene.from_dict(FULL)
    other = scene.with_values({"plane.friction": 0.1, "limits.stretch": [1.2, 1.2, 1.2], "dt": 0.01})
    assert (other.plane.friction, other.dt, scene.plane.friction, scene.dt) == (0.1, 0.01, 0.7, 0.002)  # type: ignore[union-attr]
    assert other.with_values({"plane.friction": 0.7, "limits.stretch": FULL["limits"]["stretch"], "dt": 0.002}) == scene
    for key, value in (("plane.friction", -1.0), ("plane.frictoin", 1.0), ("nowhere.friction", 1.0), ("dt.x", 1.0)):
        with pytest.raises(SceneError) as error:
            scene.with_values({key: value})
        assert error.value.key == key
    with pytest.raises(SceneError):
        Scene.from_dict({"mesh": {"beam": {}}}).with_values({"plane.friction": 0.1})


# --- YAML as people write it ---


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_numbers_in_scientific_notation(tmp_path: Path) -> None:
    """1e-3 is a number (YAML 1.1 would read a text)."""
    for number in ("1e-3", "1E-3", "1.0e-3", ".1e-2", "+1e-3", "10e-4", "0.001"):
        assert Scene.load(written(tmp_path, f"mesh: {{beam: {{}}}}\ndt: {number}\n")).dt == 1e-3, number


def test_a_key_given_twice_is_an_error(tmp_path: Path) -> None:
    """At the top and inside a block; the key and its line are named."""
    for text, key, line in (
        ("mesh: {beam: {}}\ndt: 0.001\ndt: 0.002\n", "dt", 3),
        ("mesh: {beam: {}}\nplane:\n  friction: 1\n  friction: 0\n", "friction", 4),
    ):
        with pytest.raises(SceneError) as error:
            Scene.load(written(tmp_path, text))
        assert error.value.key == key
        assert f"line {line}" in str(error.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- 1\n- 2\n",
        "just text",
        "mesh: [unclosed",
        "mesh: {beam: {}}\n\tdt: 1",
        "a: &x\n b: *y",
        "mesh: !!python/object:os.system {}",
    ],
)
def test_files_that_are_no_scene(tmp_path: Path, text: str) -> None:
    """Empty, listed, broken or dangerous YAML: a SceneError that names the file."""
    path = written(tmp_path, text)
    with pytest.raises(SceneError, match=r"scene\.yaml"):
        Scene.load(path)


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    """A binary file in place of YAML: a SceneError that names it."""
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xff\xfe\x00\x9f")
    with pytest.raises(SceneError, match=r"scene\.yaml"):
        Scene.load(path)


def test_missing_files(tmp_path: Path) -> None:
    """A scene that is not there lists the shipped ones; a mesh that is not there names its key."""
    with pytest.raises(SceneError) as error:
        Scene.load(tmp_path / "nowhere.yaml")
    assert "finger" in str(error.value)
    with pytest.raises(SceneError) as error:
        Scene.load(written(tmp_path, "mesh: {file: nowhere.vtu}\n"))
    assert error.value.key == "mesh.file"
    assert "nowhere.vtu" in str(error.value)
    with pytest.raises(SceneError):
        Scene.load(tmp_path)


def test_mesh_file_is_relative_to_the_scene(tmp_path: Path) -> None:
    """Beside the YAML file first; a shipped mesh by its short name from anywhere; absolute in to_dict."""
    Scene.load("beam_stiff").load_mesh().save(tmp_path / "own.vtu")
    scene = Scene.load(written(tmp_path, "mesh: {file: own.vtu}\n"))
    assert scene.mesh.file == str(tmp_path / "own.vtu")
    assert len(scene.load_mesh().tets) == 200
    assert len(Scene.from_dict({"mesh": {"file": "meshes/finger.vtu"}}, base=tmp_path).load_mesh().tets) > 300


def test_mesh_is_a_file_or_a_beam() -> None:
    """Neither or both is an error at `mesh`."""
    both = {"file": "meshes/finger.vtu", "beam": {}}
    for mesh in ({}, both):
        error = refusal({"mesh": mesh})
        assert error.key == "mesh"
        assert "exactly one" in error.allowed


def test_null_vectors_are_refused() -> None:
    """A plane without a normal, an orientation without a direction."""
    assert refusal(changed("plane.normal", [0, 0, 0])).key == "plane.normal"
    assert refusal(changed("initial_pose.orientation", [0, 0, 0, 0])).key == "initial_pose.orientation"


def test_isotropic_limits_are_one_pair() -> None:
    """`isotropic` takes one value for all axes, as a number or three times; hyperbolic ones may differ."""
    for name in ("stretch", "compress"):
        pair: dict[str, Any] = {"stretch": 1.1, "compress": 0.9}
        data = changed("limits", {"projection": "isotropic"} | pair | {name: [1.0, None, 1.0]})
        error = refusal(data)
        assert error.key == f"limits.{name}"
        assert "isotropic" in error.allowed
    scene = Scene.from_dict(changed("limits", {"projection": "isotropic", "stretch": 1.1, "compress": [0.9] * 3}))
    assert scene.limits is not None
    assert scene.limits.stretch == (1.1,) * 3


def test_free_axes_are_null() -> None:
    """null on an axis (or for all) leaves it free: infinite room; 1.0 leaves none."""
    limits = Scene.from_dict(changed("limits", {"stretch": [1.25, None, 1.0], "compress": None})).limits
    assert limits is not None
    np.testing.assert_array_equal(limits.stretch_room, [0.25, np.inf, 0.0])
    np.testing.assert_array_equal(limits.compress_room, [np.inf] * 3)


# --- what is driven ---


def test_driven_sets_and_boxes_select_nodes() -> None:
    """A node set by name, a box by its corners, bounds included; nothing for a free body."""
    scene = Scene.from_dict(FULL)
    mesh = scene.load_mesh()
    assert set(scene.driven_nodes(mesh)) == set(np.flatnonzero(mesh.points[:, 0] == 0.0))
    boxed = Scene.from_dict(FULL | {"driven": {"box": [[0.0, 0.0, 0.0], [0.2, 0.0, 0.2]]}})
    expected = (mesh.points[:, 0] <= 0.2) & (mesh.points[:, 1] == 0.0)
    assert set(boxed.driven_nodes(mesh)) == set(np.flatnonzero(expected))
    assert Scene.from_dict(FULL | {"driven": None}).driven_nodes(mesh).size == 0


def test_driven_that_cannot_be() -> None:
    """Anything but a name or a box of two ordered corners is refused at `driven`."""
    bad: tuple[Any, ...] = (
        3,
        True,
        [1, 2],
        {},
        {"box": [[0, 0, 0]]},
        {"box": [[0, 0, 0], [1, 1]]},
        {"box": [[1, 0, 0], [0, 1, 1]]},
        {"box": [[0, 0, 0], [1, 1, math.nan]]},
        {"box": 3},
        {"box": [[0, 0, 0], [1, 1, 1]], "set": "bone"},
        {"sphere": 1},
    )
    for driven in bad:
        assert refusal(FULL | {"driven": driven}, driven).key.startswith("driven"), driven


def test_driven_that_selects_nothing_or_all() -> None:
    """An unknown set lists the mesh's; an empty selection and one of every node say so, when the mesh is known."""
    cases: tuple[tuple[Any, str], ...] = (
        ("nail", "base"),
        ({"box": [[5, 5, 5], [6, 6, 6]]}, "no node"),
        ({"box": [[-9, -9, -9], [9, 9, 9]]}, "all"),
    )
    for driven, says in cases:
        with pytest.raises(MeshError, match=rf"driven.*{says}"):
            Simulator(Scene.from_dict(FULL | {"driven": driven}))


def test_numpy_numbers_are_numbers() -> None:
    """Scripts give arrays and NumPy scalars; they are kept as plain numbers."""
    scene = Scene.from_dict(
        changed("gravity", np.array([0.0, 1.0, 2.0])) | {"dt": np.float64(0.002), "substeps": np.int64(3)}
    )
    assert scene.gravity == (0.0, 1.0, 2.0)
    assert (type(scene.dt), type(scene.substeps)) == (float, int)
    assert yaml.safe_load(yaml.safe_dump(scene.to_dict()))["gravity"] == [0.0, 1.0, 2.0]


def test_scenes_are_frozen() -> None:
    """A scene cannot be changed in place."""
    scene = Scene.from_dict(FULL)
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.dt = 0.1  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.plane.friction = 0.1  # type: ignore[misc, union-attr]

"""What a scene file may hold, and the place that an error shows: file, line, column, and a caret under it."""

from __future__ import annotations

from pathlib import Path

import pytest

from finger_sim import Scene, SceneError
from finger_sim.cli import main
from finger_sim.studies.tradeoff.errors import TradeoffError
from finger_sim.studies.tradeoff.grid import Grid

BEAM = b"mesh: {beam: {}}\n"
LAUGHS = b"a: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + b"".join(
    b"b%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 14)
)


def written(folder: Path, text: bytes) -> Path:
    path = folder / "scene.yaml"
    path.write_bytes(text)
    return path


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        (BEAM + b"dt: " + b"1" * 400, (2, "1"), "dt: got 1"),
        (BEAM + b"dt: " + b"1" * 9000, (2, "1"), "cannot be read as int"),
        (BEAM + b"dt: 2020-13-45", (2, "2020"), "dt: got '2020-13-45', allowed: a number"),
        (BEAM + b"dt: !!timestamp soon", (2, "!!"), "'soon' cannot be read as timestamp"),
        (BEAM + b"gravity: [0, .nan, 0]", (2, "["), "gravity: got [0, nan, 0]"),
        (BEAM + b"limits:\n  stretch: [1.1, 0.2, 1]", (3, "0.2"), "limits.stretch[e2]: got 0.2"),
        (BEAM + b"plane:\n  frictoin: 0.5", (3, "frictoin"), "plane.frictoin: got 0.5, allowed: no such key"),
        (BEAM + b"plane: {friction: -1}", (2, "-1"), "plane.friction: got -1"),
        (BEAM + b"? [a, b]\n: 1", (2, "[a"), "a list or a block as a key"),
        (BEAM + b"dt: 1e-3\ndt: 2e-3", (3, "dt"), "dt is given twice"),
        (b'mesh: {file: "a\\0b.vtu"}', (1, '"a'), r"mesh.file: got 'a\x00b.vtu'"),
        (b"mesh: {file: ~nobody/a.vtu}", (1, "~"), "mesh.file: got '~nobody/a.vtu'"),
        (b"mesh: {file: " + b"x" * 5000 + b"}", (1, "xxx"), "an existing mesh file"),
        (BEAM + b"plane: &p {<<: *p}", (2, "&p"), "merged into itself"),
        (BEAM + b"plane: {<<: 3}", (2, "3"), "<< takes a block"),
        (b"mesh: &m {beam: *m}", (1, "beam"), "mesh.beam.beam: got"),
        (BEAM + b"plane: {friction: 0.5\ndt: 1", (3, ":"), "expected ',' or '}', but got ':'"),
        (BEAM + b"\tdt: 1", (2, " dt"), "cannot start any token"),
        (BEAM + b"dt: \xff", (2, "\ufffd"), "0xff, a byte that is no UTF-8 text"),
        (BEAM + b"dt: \x01", (2, " "), "the character 0x01"),
        (b"[" * 5000, (1, "["), "too many blocks within blocks"),
        (LAUGHS, (1, "a"), "a: got ['ha', 'ha'"),
        (BEAM + b"1: 2", (2, "1"), "1: got 2, allowed: no such key"),
    ],
    ids=range(23),
)
def test_a_mistake_is_shown_in_its_line(tmp_path: Path, text: bytes, place: tuple[int, str], says: str) -> None:
    """A SceneError of a few lines: file, line and column, what is wrong; below, the line and a caret at the place."""
    path = written(tmp_path, text)
    with pytest.raises(SceneError) as error:
        Scene.load(path)
    first, excerpt, caret = str(error.value).split("\n")
    line, begins = place
    assert first.startswith(f"{path}, line {line}, column ")
    assert says in first
    assert "unicode string" not in first
    assert caret.strip() == "^"
    assert excerpt[caret.index("^") :].startswith(begins)
    assert len(first) < 1500


@pytest.mark.parametrize("text", [b"", b"# nothing yet\n", b"\xff\xfe\x00\x9f", b"\x7fELF\x02\x01\x01\0"])
def test_a_file_that_holds_no_scene(tmp_path: Path, text: bytes) -> None:
    """Empty or binary: a SceneError that names the file."""
    with pytest.raises(SceneError, match=r"scene\.yaml"):
        Scene.load(written(tmp_path, text))


def test_anchors_and_merge_keys(tmp_path: Path) -> None:
    """`<<` takes the keys of another block, of several, of one that itself took some; own keys come before them."""
    text = BEAM + (
        b"plane: &p {point: [0, 0, 1], friction: 0.1}\n"
        b"solver: {method: newton}\n"
        b"coupling: &c\n  <<: {damping: 7.0, stiffness: 5.0}\n  stiffness: 6.0\n"
        b"material: {<<: [{young: 2.0e+3}, {young: 3.0e+3, density: 5.0}]}\n"
        b"initial_pose: {<<: &i {position: &v [1, 2, 3]}, position: [4, 5, 6]}\n"
        b"gravity: *v\n"
    )
    scene = Scene.load(written(tmp_path, text))
    assert (scene.coupling.damping, scene.coupling.stiffness) == (7.0, 6.0)
    assert (scene.material.young, scene.material.density) == (2e3, 5.0)
    assert (scene.initial_pose.position, scene.gravity) == ((4.0, 5.0, 6.0), (1.0, 2.0, 3.0))
    with pytest.raises(SceneError, match=r"line 2, column 12: limits\.friction.* no such key"):
        Scene.load(written(tmp_path, BEAM + b"plane: &p {friction: 0, point: [0, 0, 0]}\nlimits: {<<: *p}\n"))


def test_dates_are_texts(tmp_path: Path) -> None:
    """A node set may be called 2020-01-01."""
    assert Scene.load(written(tmp_path, BEAM + b"driven: 2020-01-01")).driven == "2020-01-01"


def test_the_command_line_shows_the_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three lines, as in the error, and exit code 2."""
    path = written(tmp_path, BEAM + b"dt: -1\n")
    assert main(["info", str(path)]) == 2
    first, excerpt, caret = capsys.readouterr().err.splitlines()
    assert first == f"finger_sim: error: {path}, line 2, column 5: dt: got -1, allowed: a number in [1e-06, 0.1] s"
    assert (excerpt.strip(), caret.index("^")) == ("dt: -1", excerpt.index("-1"))


def test_grid_files_show_the_place_too(tmp_path: Path) -> None:
    """Those of the trade-off study are read alike: broken YAML and values that are refused."""
    for text, says in (
        (b"base: {dt: 1\nsweeps: {}\n", "line 2, column 7: not well-formed YAML"),
        (b"base: {dt: 1}\nsweeps: {solver.tolerance: 3}\n", "line 2, column 28: sweeps.solver.tolerance: got 3"),
        (b"points: [{dt: 1}, 3]\n", "line 1, column 19: points[1]: got 3"),
    ):
        path = written(tmp_path, text)
        with pytest.raises(TradeoffError) as error:
            Grid.load(path)
        first, _, caret = str(error.value).split("\n")
        assert first.startswith(f"--grid: {path}, {says}")
        assert caret.strip() == "^"


def test_values_that_are_refused_are_shown_in_short() -> None:
    """However large or deep a value is, an error about it is a few lines."""
    deep: list[object] = []
    for _ in range(5000):
        deep = [deep, deep]
    for value in (deep, 10**5000, "x" * 10**6, dict.fromkeys(range(1000), "y" * 1000)):
        with pytest.raises(SceneError) as error:
            Scene.from_dict({"mesh": {"beam": {}}, "gravity": value})
        assert len(str(error.value)) < 1000

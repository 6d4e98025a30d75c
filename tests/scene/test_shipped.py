"""What ships is found by its name: whatever else lies in the folder, and wherever pip has put the package."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from processes import REPOSITORY

from finger_sim import BagError, Scene, SceneError, Simulator
from finger_sim.bags.reader import BagReader
from finger_sim.cli import main
from finger_sim.scene.resources import find_bag, find_mesh, find_scene, shipped


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_folders_and_files_of_the_same_name_hide_nothing(here: Path) -> None:
    """A folder or a file without suffix is no scene, a folder without a recording no bag, a folder no mesh."""
    for folder in ("finger", "finger.yaml", "press_slide", "finger.vtu", "meshes/finger.vtu", "presets/haptic"):
        (here / folder).mkdir(parents=True)
    for file in ("finger_haptic", "finger_2000", "press_flat", "press_slide/notes.txt"):
        (here / file).write_text("mine\n")
    config = shipped("config")
    for name, path in (("finger", "finger"), ("finger.yaml", "finger"), ("finger_haptic", "finger_haptic")):
        assert find_scene(name) == config / f"{path}.yaml"
    assert Scene.load("finger") == Scene.load(config / "finger.yaml")
    assert find_scene("presets/haptic") == config / "presets" / "haptic.yaml"
    assert find_bag("press_slide") == shipped("bags") / "press_slide"
    assert find_bag("press_flat") == shipped("bags") / "press_flat"
    for name in ("finger.vtu", "meshes/finger.vtu", "finger"):
        assert find_mesh(name, here) == (config / "meshes" / "finger.vtu").resolve()
    assert find_mesh("finger_2000", here) == (config / "meshes" / "finger_2000.vtu").resolve()


def test_files_of_the_user_come_first(here: Path) -> None:
    """A YAML file, a recording and a mesh of a shipped name, and a scene file of any suffix."""
    (here / "finger.yaml").write_text("mesh: {beam: {}}\n")
    (here / "my.scene").write_text("mesh: {beam: {}}\n")
    (here / "press_slide").symlink_to(shipped("bags") / "press_flat")
    Scene.load("finger.yaml").load_mesh().save(here / "finger.vtu")
    assert find_scene("finger.yaml") == Path("finger.yaml")
    assert Scene.load("my.scene").mesh.beam is not None
    assert BagReader(find_bag("press_slide")).message_count == BagReader(find_bag("press_flat")).message_count
    assert len(Scene.from_dict({"mesh": {"file": "finger.vtu"}}).load_mesh().tets) == 200


def test_info_finds_shipped_meshes(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By file name, with its folder, and without suffix where no scene has that name."""
    for name, tets in (("finger.vtu", 900), ("meshes/finger.vtu", 900), ("finger_paper.vtu", 350)):
        assert main(["info", name]) == 0
        out = capsys.readouterr().out
        assert out.startswith("mesh ")
        assert str(tets) in out


@pytest.mark.parametrize("name", ["nothing", "no/where.yaml", "a\0b", "~nobody/x", "x" * 5000], ids=range(5))
def test_what_is_not_there_is_said_with_what_ships(here: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No traceback: an error that lists the names there are, of scenes, bags and meshes."""
    with pytest.raises(SceneError, match=r"finger_haptic, finger_paper, finger_relaxing, presets/balanced"):
        Scene.load(name)
    with pytest.raises(BagError, match=r"no such bag.*press_flat, press_side, press_slide$"):
        find_bag(name)
    with pytest.raises(SceneError, match=r"finger\.vtu, finger_16000\.vtu"):
        Scene.from_dict({"mesh": {"file": name}})
    assert main(["info", name]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("finger_haptic", "press_slide", "finger.vtu"))


def test_live_values_do_not_need_the_mesh_file(tmp_path: Path) -> None:
    """Friction changes in a running simulator whose mesh file is gone; a new file is looked for, the old one too."""
    file = tmp_path / "block.vtu"
    Scene.from_dict({"mesh": {"beam": {"cells": [1, 1, 1]}}}).load_mesh().save(file)
    scene = Scene.from_dict({"mesh": {"file": str(file)}, "plane": {"point": [0, 0, -1]}})
    sim = Simulator(scene)
    file.unlink()
    sim.apply({"plane.friction": 0.3})
    assert sim.scene.plane is not None
    assert sim.scene.plane.friction == 0.3
    assert scene.with_values({"dt": 0.002, "mesh.file": str(file)}).dt == 0.002
    assert scene.with_values({"mesh.file": "meshes/finger.vtu"}).load_mesh() is not None
    with pytest.raises(SceneError, match=r"mesh\.file"):
        scene.with_values({"mesh.file": "other.vtu"})
    with pytest.raises(SceneError, match=r"mesh\.file"):
        Scene.from_dict(scene.to_dict())


@pytest.mark.slow
def test_a_wheel_brings_its_data_wherever_it_is_unpacked(tmp_path: Path) -> None:
    """`pip install --target`: scenes, meshes, bags and the page are found there, as under --user; ROS has share/."""
    pip = [sys.executable, "-m", "pip", "--quiet"]
    command = [*pip, "wheel", "--no-deps", "--wheel-dir", str(tmp_path), str(REPOSITORY)]
    built = subprocess.run(command, capture_output=True, text=True, timeout=200)
    if built.returncode and "hatchling" in built.stderr:
        pytest.skip(f"no wheel can be built here: {built.stderr.splitlines()[-1]}")
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    target = tmp_path / "target"
    subprocess.run([*pip, "install", "--no-deps", "--target", str(target), str(wheel)], check=True, timeout=100)
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert not [name for name in names if name.endswith(".png") and "share" not in name]
    assert any(name.endswith("data/share/finger_sim/config/finger.yaml") for name in names)
    program = (
        "import finger_sim\n"
        "from finger_sim.cli import main\n"
        "print(finger_sim.__file__)\n"
        "print([main(['info', name]) for name in ('press_flat', 'finger.vtu', 'presets/haptic')])\n"
        "from finger_sim.view.files import PAGE, page_file\n"
        "print('page', sum(len(page_file(path)[0]) for path in PAGE))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(target)!r})\n{program}"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=100,
    )
    assert str(target) in done.stdout, done.stderr
    assert "[0, 0, 0]" in done.stdout, done.stderr
    (size,) = re.findall(r"^page (\d+)$", done.stdout, re.MULTILINE)
    assert int(size) > 500e3
    assert not [name for name in names if "view/page/" in name]
    assert f"bag {target}/finger_sim/data/bags/press_flat" in done.stdout.replace("\n", "")

"""The command line as a new user meets it: help, results, and one clear line for every mistake."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from cases import for_each

from finger_sim.bags.cdr import POSE_STAMPED, pose_stamped
from finger_sim.bags.reader import BagReader, BagWriter, write_commands
from finger_sim.cli import main
from finger_sim.scene.meshing import beam

REPOSITORY = Path(__file__).resolve().parents[2]
VERBS = (
    "demo", "run", "play", "import", "info", "compare", "mesh", "bench", "figures", "stress", "tradeoff", "node",
)  # fmt: skip
SCENE = """
mesh: {beam: {size: [0.02, 0.01, 0.01], cells: [2, 1, 1]}}
driven: {box: [[-1, -1, 0.0099], [1, 1, 1]]}
material: {young: 5.0e4, poisson: 0.4}
plane: {friction: 0.5}
dt: 0.005
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working folder with a scene and a bag of 20 commands."""
    monkeypatch.chdir(tmp_path)
    Path("block.yaml").write_text(SCENE)
    position = np.stack([np.zeros(20), np.zeros(20), np.linspace(0.001, -0.0003, 20)], axis=1)
    times = [10_000_000 * k for k in range(20)]
    write_commands(Path("commands"), times, position, np.tile([0.0, 0.0, 0.0, 1.0], (20, 1)))
    return tmp_path


def fails(capsys, *arguments):
    """What a mistake prints: one line on stderr, and the place in a file below it; exit code 2."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line]
    assert out == ""
    assert lines[0].startswith("finger_sim: error: ")
    assert all(line.startswith("    ") for line in lines[1:])
    return lines[0]


def does(capsys, *arguments):
    """What a job that was done prints on stdout."""
    assert main(arguments) == 0
    return capsys.readouterr().out


@for_each("verb", [*VERBS, "mesh finger", "mesh beam", "mesh convert"])
def test_help_of_every_verb_has_an_example_of_it(capsys, verb):
    """The example begins with the verb and holds no argument that the verb does not know."""
    with pytest.raises(SystemExit, match="0"):
        main([*verb.split(), "--help"])
    text = capsys.readouterr().out
    example = text.split("example:\n  ")[1].splitlines()[0]
    assert example.startswith(f"finger_sim {verb}")
    own = example.partition("--ros-args")[0]
    assert all(option in text.split("example:")[0] for option in re.findall(r"--[a-z-]+", own))


def test_help_lists_the_verbs(capsys):
    """Exit code 0; each verb with what it does."""
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    text = capsys.readouterr().out
    assert all(re.search(rf"^    {verb} +\S", text, re.MULTILINE) for verb in VERBS)


@for_each(
    "arguments, says",
    [
        ([], "VERB"),
        (["fly"], "'fly'"),
        (["run", "finger"], "--bag"),
        (["demo", "--rate", "fast"], "--rate: got 'fast', allowed: a finite number > 0"),
        (["demo", "--duration", "-1"], "--duration: got '-1', allowed: a finite number > 0"),
        (["play", "press_slide", "--speed", "0"], "--speed: got '0'"),
        (["import", "poses.csv"], "-o/--out"),
        (["import", "poses.csv", "-o", "bag", "--set", "z"], "--set: got 'z', allowed: COLUMN=VALUE"),
        (["import", "poses.csv", "-o", "bag", "--set", "z=up"], "--set: z: got 'up', allowed: a number"),
        (["mesh", "cube", "-o", "a.vtu"], "'cube'"),
        (["mesh", "beam", "-o", "a.vtu", "--tets", "9"], "--tets"),
        (["stress", "--cases", "-3"], "--cases: got '-3', allowed: a whole number from 0 on"),
        (["stress", "--minutes", "0"], "--minutes: got '0', allowed: a finite number > 0"),
        (["tradeoff", "--workers", "0"], "--workers: got '0', allowed: a whole number from 1 on"),
        (["tradeoff", "--for-rate", "fast"], "--for-rate: got 'fast', allowed: a finite number > 0"),
        (["node", "--fast"], "--fast"),
    ],
)
def test_wrong_arguments_are_named(capsys, arguments, says):
    """Usage and the argument at fault on stderr, exit code 2."""
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err


@for_each(
    "arguments, says",
    [
        (["run", "nowhere", "--bag", "commands"], "nowhere"),
        (["run", "block.yaml", "--bag", "nowhere"], "nowhere"),
        (["run", "commands", "--bag", "commands"], "commands"),
        (["run", "block.yaml", "--bag", "block.yaml"], "not an MCAP file"),
        (["run", "block.yaml", "--bag", "commands", "--topic", "pose"], "found /command_pose"),
        (["run", "block.yaml", "--bag", "commands", "--plane-topic", "table"], "no topic /table; found /command_pose"),
        (["run", "block.yaml", "--bag", "commands", "-o", "commands"], "exists already"),
        (["play", "nowhere"], "nowhere"),
        (["play", "commands", "--topic", "pose"], "found /command_pose"),
        (["import", "nowhere.csv", "-o", "bag"], "nowhere.csv"),
        (["import", "block.yaml", "-o", "bag"], "block.yaml"),
        (["run", "block.yaml", "--bag", "hand.bag"], "`rosbags-convert --src hand.bag --dst FOLDER`"),
        (["info", "hand.bag"], "a ROS 1 bag: `finger_sim import hand.bag -o NAME`"),
        (["info", "nowhere"], "press_slide"),
        (["info", "notes.txt"], "notes.txt"),
        (["info", "bad.yaml"], "dt: got -1"),
        (["info", "empty"], "not a bag"),
        (["mesh", "beam", "-o", "beam.vtu", "--cells", "0", "1", "1"], "cells"),
        (["mesh", "beam", "-o", "block.yaml"], "exists already"),
        (["mesh", "beam", "-o", "beam.stl"], ".vtu"),
        (["mesh", "convert", "notes.txt", "-o", "mesh.vtu"], "notes.txt: unreadable"),
        (["mesh", "beam", "-o", "nowhere/beam.vtu"], "nowhere"),
        (["mesh", "finger", "-o", "finger.vtu", "--tets", "0"], "tets: got 0"),
    ],
)
def test_mistakes_are_one_clear_line(capsys, here, arguments, says):
    """Files that are not there, of the wrong kind, or in the way: no traceback, exit code 2."""
    Path("notes.txt").write_text("no mesh")
    Path("hand.bag").write_bytes(b"#ROSBAG V2.0\n")
    Path("bad.yaml").write_text("mesh: {beam: {}}\ndt: -1\n")
    Path("empty").mkdir(exist_ok=True)
    assert says in fails(capsys, *arguments)


def test_info_of_a_scene(capsys):
    """Counts, what is driven, limits, plane, time step, memory, and the parameters that are live."""
    text = does(capsys, "info", "finger")
    rows = dict(re.findall(r"^(\S[^\n]*?) {2,}(\S.*?) *$", text.split("\n\n")[0], re.MULTILINE))
    assert re.fullmatch(r"\d+, \d+", rows["tets, nodes"])
    assert re.fullmatch(r"\d+ nodes \(bone\)", rows["driven"])
    assert "e2 0.75 … 1.25" in rows["limits"]
    assert "friction 0.5" in rows["plane"]
    assert rows["dt"].startswith("0.001 s (1000 Hz)")
    assert rows["arrays"].endswith("MiB")
    assert re.search(r"^plane\.friction +\S+ +live ", text, re.MULTILINE)
    assert not re.search(r"^material\.young .* live ", text, re.MULTILINE)


def test_info_of_a_scene_without_limits_and_plane(capsys, here):
    """What is left out is named as not there."""
    Path("free.yaml").write_text("mesh: {beam: {size: [1, 1, 1], cells: [1, 1, 1]}}\n")
    text = does(capsys, "info", "free.yaml")
    assert re.search(r"^driven +nothing: a free body", text, re.MULTILINE)
    assert re.search(r"^limits +none", text, re.MULTILINE)
    assert re.search(r"^plane +none", text, re.MULTILINE)


def test_info_of_a_bag_whole_and_cut_off(capsys, here):
    """Topics, types, counts, rates, lost numbers; a bag that was cut off is said to be, and is shown."""
    with BagWriter("touch") as bag:
        bag.add_topic("command_pose", POSE_STAMPED)
        for k in range(1000):
            data = pose_stamped(0, "world", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            bag.write("command_pose", data, 4_000_000 * k, sequence=k + 1 + 3 * (k >= 500))
    text = does(capsys, "info", "touch")
    assert re.search(r"^/command_pose +geometry_msgs/msg/PoseStamped +1000 +250 +0\.004 +3 *$", text, re.M)
    assert re.search(r"^duration +3\.996 s", text, re.MULTILINE)
    assert re.search(r"^whole +yes", text, re.MULTILINE)
    assert re.search(r"^numbers missing +3", text, re.MULTILINE)
    file = next(Path("touch").glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    text = does(capsys, "info", "touch")
    assert re.search(r"^whole +no: .*cut off", text, re.MULTILINE)
    assert does(capsys, "info", "touch/metadata.yaml").splitlines()[1:] == text.splitlines()[1:]


def test_run_tells_what_a_mesh_lost(capsys, here):
    """A node that no tetrahedron has, by file and number, on stderr."""
    body = beam((0.02, 0.01, 0.01), (2, 1, 1))
    meshio.write("block.vtu", meshio.Mesh([*body.points, [1, 1, 1]], [("tetra", body.tets)]))
    Path("block.yaml").write_text(re.sub(r"(?m)^mesh: .*", "mesh: {file: block.vtu}", SCENE))
    assert main(["run", "block.yaml", "--bag", "commands"]) == 0
    assert f"warning: {here / 'block.vtu'}: 1 unreferenced node left out" in capsys.readouterr().err


def test_mesh_makes_what_info_shows(capsys, here):
    """The paper's beam; a file in the way stays unless --force is given."""
    made = does(capsys, "mesh", "beam", "-o", "beam.vtu")
    assert made.split() == does(capsys, "info", "beam.vtu").split()
    assert re.search(r"^tets +200 *$", made, re.MULTILINE)
    assert re.search(r"^nodes +99,", made, re.MULTILINE)
    assert "exists already" in fails(capsys, "mesh", "beam", "-o", "beam.vtu")
    again = does(capsys, "mesh", "beam", "-o", "beam.vtu", "--cells", "1", "1", "1", "--force")
    assert re.search(r"^tets +5 *$", again, re.MULTILINE)


def test_import_passes_its_options_on(capsys, here):
    """Rows, constants, offsets, topic and frame arrive in the bag."""
    Path("poses.csv").write_text("rep,t,x,y\n0,0.0,1,2\n1,0.0,3,4\n1,0.5,5,6\n")
    said = does(
        capsys, "import", "poses.csv", "-o", "bag", "--where", "rep=1", "--set", "z=0.25", "--offset", "x=-1",
        "--topic", "/device/pose", "--frame-id", "table",
    )  # fmt: skip
    assert said.startswith("bag: 2 poses on /device/pose in frame 'table'")
    assert re.search(r"^assumed +not in the file: qx, qy, qz, qw, taken as 0, qw as 1", said, re.MULTILINE)
    assert re.search(r"^x +2.0000 … 4.0000 m", said, re.MULTILINE)
    from finger_sim.bags.reader import read_commands

    commands = read_commands("bag")
    assert commands.frame_id == "table"
    np.testing.assert_allclose(commands.position, [[2, 4, 0.25], [4, 6, 0.25]])
    np.testing.assert_allclose(commands.receipt, [0.0, 0.5])


def test_import_says_what_cannot_be_a_finger(capsys, here):
    """Millimetres taken for metres: a warning names the option, with which it is gone; `info` tells the same."""
    rows = [f"{k};{k * k};0;{40 + k}" for k in range(10)]
    Path("hand.csv").write_text("ms;px;py;pz\n" + "\n".join(rows))
    columns = ["--columns", "t=ms", "x=px", "y=py", "z=pz", "--time-unit", "ms"]
    assert main(["import", "hand.csv", "-o", "metres", *columns]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"^speed .* largest 1.7e\+04 m/s at 0.008 s", out, re.MULTILINE)
    assert re.search(r"^finger_sim: warning: moves 81 m along x, .*millimetres[?] import --scale 0.001$", err, re.M)
    told = does(capsys, "info", "metres")
    assert re.search(r"^commands on /command_pose in frame 'world', by times of receipt", told, re.MULTILINE)
    assert re.search(r"^warning +moves 81 m along x, farther", told, re.MULTILINE)
    assert re.search(r"^speed .* largest 1.7e\+04 m/s at 0.008 s", told, re.MULTILINE)
    assert re.search(r"^header stamps +0 repeated, 0 fall", told, re.MULTILINE)
    slower = [
        "--scale",
        "0.001",
        "--offset",
        "z=-0.035",
        "--set",
        "qx=0.7071",
        "--set",
        "qw=0.7071",
        "--resample",
        "500",
    ]
    assert main(["import", "hand.csv", "-o", "finger", *columns, *slower, "--time-unit", "s"]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"^rate +500 Hz", out, re.MULTILINE)
    assert re.search(r"^depth +shipped finger, undeformed, .* below the plane z = 0 m at 0.000 s", out, re.MULTILINE)
    assert err == ""


def test_import_chooses_in_bags(capsys, here):
    """Another topic's name, a frame that is not there, and options of the other kind: one line each."""
    assert "no topic /hand; found /command_pose (geometry_msgs/msg/PoseStamped, 20 messages)" in fails(
        capsys, "import", "commands", "-o", "bag", "--from-topic", "hand"
    )
    assert "no way from frame 'base' to 'hand'; found no transforms" in fails(
        capsys, "import", "commands", "-o", "bag", "--tf", "base", "hand"
    )
    assert "--times is for text files" in fails(capsys, "import", "commands", "-o", "bag", "--times", "t.txt")
    assert "20 poses on /again" in does(
        capsys, "import", "commands", "-o", "bag", "--topic", "again", "--clock", "receipt"
    )


def test_run_writes_a_bag_named_after_what_went_in(capsys, here):
    """The table names the bag; a second time it is in the way, before anything is simulated."""
    said = does(capsys, "run", "block.yaml", "--bag", "commands")
    assert re.search(r"^bag +commands_block *$", said, re.MULTILINE)
    assert re.search(r"^peak force +0\.\d+ N at", said, re.MULTILINE)
    counts = {topic.name: topic.count for topic in BagReader("commands_block").topics}
    assert counts["/contact_wrench"] == 39
    assert "commands_block: exists already" in fails(capsys, "run", "block.yaml", "--bag", "commands")


def test_run_without_a_scene_takes_the_recorded_one(capsys, here):
    """And says so; another scene is said to be one, key by key; a bag that holds none needs one. `info` tells too."""
    does(capsys, "run", "block.yaml", "--bag", "commands", "-o", "made")
    said = does(capsys, "run", "--bag", "made")
    assert re.search(r"^scene +as recorded, 0 live changes made again *$", said, re.MULTILINE)
    assert re.search(r"^bag +made_again *$", said, re.MULTILINE)
    forces = [[m.data for m in BagReader(path).messages(["contact_wrench"])] for path in ("made", "made_again")]
    assert forces[0] == forces[1]
    Path("other.yaml").write_text(SCENE.replace("friction: 0.5", "friction: 0.25"))
    said = does(capsys, "run", "other.yaml", "--bag", "made")
    assert re.search(r"^scene +as given, other than the recorded one *$", said, re.MULTILINE)
    assert re.search(r"^differs +plane\.friction 0\.25 \(recorded: 0\.5\) *$", said, re.MULTILINE)
    said = does(capsys, "info", "made")
    assert re.search(r"^made by +run of finger_sim \d", said, re.MULTILINE)
    assert re.search(r"^scene +a beam \(sha256 [0-9a-f]{12}…\), dt 0\.005 s *$", said, re.MULTILINE)
    assert re.search(r"^changed live +nothing *$", said, re.MULTILINE)
    assert "commands: holds no scene" in fails(capsys, "run", "--bag", "commands")


def test_run_into_a_place_that_cannot_be_made(capsys, here):
    """The last line says so, exit code 2."""
    assert main(["run", "block.yaml", "--bag", "commands", "-o", "block.yaml/out"]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "finger_sim: error: block.yaml/out: cannot be made: Not a directory"


def test_without_ros_the_extra_is_named(capsys, here, monkeypatch):
    """demo, play and node say what to install; run and info need no ROS."""
    monkeypatch.setitem(sys.modules, "rclpy", None)
    for arguments in (["demo"], ["play", "commands"], ["node"]):
        said = fails(capsys, *arguments)
        assert "finger_sim[ros]" in said
        assert "source" in said
    assert not list(here.glob("finger_sim_demo*"))
    does(capsys, "run", "block.yaml", "--bag", "commands")


def process(*arguments, cwd):
    """The command line in a process of its own."""
    path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.Popen(
        [sys.executable, "-m", "finger_sim", *arguments], cwd=cwd, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def test_python_m_finger_sim_is_the_same(here):
    """Version on stdout, mistakes on stderr, exit codes as the shell sees them."""
    version = process("--version", cwd=here)
    mistake = process("info", "nowhere", cwd=here)
    out, err = version.communicate(timeout=60)
    assert (version.returncode, err) == (0, "")
    assert out.startswith("finger_sim ")
    out, err = mistake.communicate(timeout=60)
    assert (mistake.returncode, out) == (2, "")
    assert err.startswith("finger_sim: error: nowhere: ")

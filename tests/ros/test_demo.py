"""The demo as a new user runs it: real node, real topics, recording, picture, table; and its failures."""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import for_each
from rich.console import Console

pytest.importorskip("rclpy", reason="needs ROS 2: pip install 'finger_sim[ros]'")
pytest.importorskip("matplotlib")

from finger_sim import FingerSimError, Scene
from finger_sim.bags.reader import BagReader, BagWriter, read_commands
from finger_sim.cli import _parser, main
from finger_sim.pictures.report import read_health
from finger_sim.ros import demo
from finger_sim.ros.demo_verdict import held_rate
from finger_sim.ros.loop import StepCounts
from finger_sim.ros.options import NodeOptions
from finger_sim.ros.play import Played
from finger_sim.scene.resources import find_bag

REPOSITORY = Path(__file__).resolve().parents[2]
ROWS = (
    "rate reached", "real-time factor", "late steps", "late steps of a bare loop", "late steps above it",
    "priority of both loops", "step time median", "step time p99", "overruns", "peak force",
    "most tetrahedra at a limit", "max strain/limit", "max penetration", "solver status", "commands",
    "messages recorded", "bag", "picture", "log of the node",
)  # fmt: skip
FLOOR = StepCounts(steps=2000, late=30, overruns=5, begin=10.0, last=11.999)


def rows(text):
    """The table in what a demo printed: values by name, and what is said of them."""
    return {
        name: (value, said) for name, value, said in re.findall(r"^(\S.*?) {2,}(\S.*?)(?: {2,}(.*?))? *$", text, re.M)
    }


def process(*arguments, cwd):
    """`finger_sim` in a process of its own, checking what is put into messages."""
    path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": path, "ROS_PYTHON_CHECK_FIELDS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "finger_sim", *arguments], cwd=cwd, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A demo of one second in a folder with a blank in its name: exit code, stdout, stderr, folder."""
    folder = tmp_path_factory.mktemp("a folder")
    run = process("demo", "--duration", "1", "--rate", "100", cwd=folder)
    out, err = run.communicate(timeout=200)
    return run.returncode, out, err, folder / "finger_sim_demo"


def test_a_short_demo_does_its_whole_job(done):
    """Exit code 0; the table has every row; progress is told on stderr."""
    code, out, err, folder = done
    assert code == 0, err
    table = rows(out)
    assert [name for name in ROWS if name not in table] == []
    assert float(table["peak force"][0].split()[0]) > 0.0
    assert table["bag"][0] == f"{folder.name}/recording"
    assert err.index("watching a bare loop of 100 Hz") < err.index("starting the node")
    assert "playing /command_pose" in err
    assert "Traceback" not in err


def test_the_recording_holds_the_commands_and_what_came_of_them(done):
    """Nothing lost; the commands that were heard are the bag's; the node ended in order."""
    folder = done[3]
    reader = BagReader(folder / "recording")
    topics = {topic.name: topic for topic in reader.topics}
    assert reader.warning is None
    assert all(topic.lost == 0 for topic in topics.values())
    assert topics["/contact_wrench"].count >= 100
    assert topics["/diagnostics"].count >= 2
    sent = read_commands(find_bag("press_slide"))
    heard = read_commands(folder / "recording")
    assert len(heard) <= np.count_nonzero(sent.receipt <= 1.0)
    assert {tuple(p) for p in heard.position} <= {tuple(p) for p in sent.position}
    assert "Traceback" not in (folder / "node.log").read_text()


def test_the_picture_is_not_blank(done):
    """A PNG of some size and many colours."""
    from matplotlib.image import imread

    pixels = imread(done[3] / "demo.png")
    assert min(pixels.shape[:2]) > 500
    assert len(np.unique((pixels[..., :3] * 15).astype(int).reshape(-1, 3), axis=0)) > 50


@pytest.fixture
def outcome(done, tmp_path):
    """Of the demo, beside a bare loop of which 1.5 % of the steps were late; played at 100 Hz."""
    scene = Scene.load("finger_haptic").with_values({"dt": 0.01})
    played = Played("/command_pose", 501, 1.0, 0.0, 0.0, 0.0)
    return demo.sum_up(done[3] / "recording", tmp_path / "log", tmp_path / "demo.png", played, scene, 350, FLOOR, 20)


@for_each("late, above, noted", [(19, "0.40 %", 0), (25, "1.00 %", 1), (0, "-1.50 %", 0)])
def test_the_table_tells_late_steps_beside_those_of_a_bare_loop(outcome, late, above, noted):
    """The node's, the bare loop's, the difference and what is wanted; too many are told, and are no failure."""
    outcome.rate = 100.0
    outcome.health = dataclasses.replace(outcome.health, steps=1000, late=late, overruns=2)
    console = Console(width=200)
    with console.capture() as capture:
        console.print(outcome.table())
    table = rows(capture.get())
    assert table["late steps"] == (f"{late / 10:.2f} %", f"{late} of 1000, not done when the next was due")
    assert table["late steps of a bare loop"][0] == "1.50 %"
    assert "30 of 2000" in table["late steps of a bare loop"][1]
    assert table["late steps above it"] == (above, "wanted: at most 0.5 %")
    assert table["real-time factor"] == ("1.0000", "simulated time / wall time; wanted: at least 0.99")
    assert table["priority of both loops"] == ("20", "SCHED_FIFO")
    assert table["overruns"] == ("2", "steps skipped, of 1002")
    assert len(outcome.shortfalls) == noted
    assert all("1.00 % more steps were late than of a bare loop" in text for text in outcome.shortfalls)
    assert bool(outcome.advice) == bool(noted)
    assert outcome.failures == []


def test_what_the_machine_did_not_hold_is_advice_and_strict_judges_it(outcome, capsys, monkeypatch):
    """Slow as it may be, a demo whose parts all worked ends with 0, and says what to change; with --strict with 1."""
    monkeypatch.setattr(demo, "run_demo", lambda *_, **__: outcome)
    outcome.rate = 52.0
    for step_p99, outcome.priority, advised in (
        (0.013, 20, ["--rate 69"]),
        (0.013, 0, ["--rate 69", "--priority 20"]),
        (0.002, 0, ["--priority 20"]),
        (0.002, 20, ["quieter machine"]),
    ):
        outcome.health = dataclasses.replace(outcome.health, steps=1000, late=150, step_p99=step_p99)
        assert main(["demo"]) == 0
        err = capsys.readouterr().err
        assert "slower than real time: 52 steps a second, of 100 asked for" in err
        assert "13.50 % more steps were late than of a bare loop" in err
        assert [word for word in ("--rate 69", "--priority 20", "quieter machine") if word in err] == advised
        assert "failed" not in err
        assert main(["demo", "--strict"]) == 1
        capsys.readouterr()
    outcome.rate, outcome.health = 100.0, dataclasses.replace(outcome.health, late=0)
    assert outcome.advice == []
    assert main(["demo", "--strict"]) == 0
    outcome.failures.append("the picture was not written")
    assert main(["demo"]) == 1


def test_the_rate_that_is_advised_leaves_each_step_its_time():
    """By hand; round, and never below the lowest rate there is."""
    assert [held_rate(p99) for p99 in (0.6e-3, 1.05e-3, 6.5e-3, 13e-3, 0.5)] == [1500.0, 850.0, 130.0, 69.0, 10.0]


def test_steps_are_counted_while_commands_are_played(done):
    """From the last report before a time to the first one after another; from the first step if there is none."""
    recording = done[3] / "recording"
    times = [m.log_time for m in BagReader(recording).messages(["/diagnostics"])]
    total = read_health(recording)
    first = read_health(recording, end=times[-2])
    later = read_health(recording, times[-2], times[-1])
    assert 0 < later.steps < total.steps
    assert first.steps + later.steps == total.steps
    assert (first.late + later.late, first.overruns + later.overruns) == (total.late, total.overruns)


def test_a_bare_loop_makes_steps_in_a_process_of_its_own(capsys):
    """Each step is made or skipped; the fractions are of the steps made."""
    floor = demo.bare_loop(0.01, 0.3, 0)
    assert floor.steps >= 1
    assert floor.late <= floor.steps
    assert floor.last - floor.begin < 0.01 * (floor.steps + floor.overruns) + 0.01 * floor.late
    assert "watching a bare loop of 100 Hz" in capsys.readouterr().err
    assert FLOOR.late_fraction == pytest.approx(0.015)
    assert FLOOR.real_time_factor(0.001) == pytest.approx(1.0)
    assert StepCounts(0, 0, 0, 1.0, 1.0).late_fraction == 0.0
    assert StepCounts(0, 0, 0, 1.0, 1.0).real_time_factor(0.001) == 0.0


def test_a_bare_loop_that_does_not_run_fails_the_demo(tmp_path, capsys, monkeypatch):
    """Exit code 1, and its last words."""
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho 'out of luck' >&2\nexit 3\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr(demo, "_drive", lambda *_: pytest.fail("a node was started"))
    assert main(["demo", "--out", str(tmp_path / "out")]) == 1
    assert "the demo failed: the bare loop ended with code 3: out of luck" in capsys.readouterr().err


@pytest.mark.parametrize(("permitted", "given", "priority"), [(True, "7", 7), (False, "7", 0), (False, "0", 0)])
def test_both_loops_get_the_priority_that_is_permitted(tmp_path, capsys, monkeypatch, permitted, given, priority):
    """That asked for, or none, which is said."""
    got = []

    def schedule(*_):
        if not permitted:
            raise PermissionError(1, "Operation not permitted")

    def drive(parameters, *_):
        got.append(parameters["realtime_priority"])
        raise demo.DemoError("far enough")

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    monkeypatch.setattr(demo, "bare_loop", lambda dt, seconds, priority: got.append(priority))
    monkeypatch.setattr(demo, "_drive", drive)
    assert main(["demo", "--priority", given, "--out", str(tmp_path / "out")]) == 1
    assert got == [priority, priority]
    assert ("priority 7 is not permitted here" in capsys.readouterr().err) == (not permitted and given != "0")


def test_demo_and_node_ask_for_the_same_priority():
    """Unless told otherwise."""
    assert _parser().parse_args(["demo"]).priority == demo.PRIORITY == NodeOptions().realtime_priority == 20


def test_the_help_says_that_a_demo_has_a_domain_of_its_own(capsys):
    """So that nobody looks for its topics where other nodes are."""
    with pytest.raises(SystemExit, match="0"):
        main(["demo", "--help"])
    assert "in a ROS domain of their own" in capsys.readouterr().out


@for_each("given", ["-1", "100", "high"])
def test_a_priority_that_does_not_exist_is_refused(capsys, given):
    """Exit code 2, with what is allowed."""
    with pytest.raises(SystemExit, match="2"):
        main(["demo", "--priority", given])
    assert f"got '{given}', allowed: a whole number from 0 to 99" in capsys.readouterr().err


@pytest.mark.parametrize(("gone", "counted"), [("/contact_wrench", 0), ("/command_pose", 0), ("/contact_wrench", 1)])
def test_a_lost_message_fails_the_demo(done, tmp_path, monkeypatch, gone, counted):
    """A gap in the sequence numbers is named with its topic; one that the node counted is the machine's."""
    health = lambda *_: dataclasses.replace(read_health(*_), dropped=counted)  # noqa: E731
    monkeypatch.setattr("finger_sim.pictures.report.read_health", health)
    folder = done[3]
    with BagWriter(tmp_path / "recording") as bag:
        for message in BagReader(folder / "recording"):
            bag.add_topic(message.topic, message.type)
            if message.topic != gone or message.sequence != 40:
                bag.write(message.topic, message.data, message.log_time, sequence=message.sequence)
    scene = Scene.load("finger").with_values({"dt": 0.01})
    log = tmp_path / "node.log"
    for recording, failures in ((folder / "recording", []), (tmp_path / "recording", [gone])):
        played = Played("/command_pose", 501, 1.0, 0.0, 0.0, 0.0)
        outcome = demo.sum_up(recording, log, tmp_path / "demo.png", played, scene, 350, FLOOR, 0)
        assert [failure.split(":")[0] for failure in outcome.failures] == ([] if counted else failures)
        assert len(outcome.losses) == (len(failures) + 1 if counted else 0)


@for_each(
    "arguments, says",
    [
        (("--scene", "nowhere"), "nowhere"),
        (("--scene", "broken.yaml"), "material.young: got -1"),
        (("--scene", "meshless.yaml"), "no node set is named 'bone'"),
        (("--bag", "nowhere"), "nowhere"),
        (("--bag", "broken.yaml"), "not an MCAP file"),
        (("--rate", "1e9"), "rate: got 1000000000.0, allowed: a number in [10, 1e+06] Hz"),
        (("--out", "full"), "full: is not empty"),
        (("--out", "broken.yaml"), "broken.yaml: cannot be made"),
        (("--out", "broken.yaml/here"), "cannot be made"),
        (("--out", "/proc/here"), "/proc/here: cannot be made"),
    ],
)
def test_mistakes_are_named_before_a_node_is_started(tmp_path, capsys, monkeypatch, arguments, says):
    """Exit code 2, no traceback; no folder is left behind."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "_drive", lambda *_: pytest.fail("a node was started"))
    monkeypatch.setattr(demo, "bare_loop", lambda *_: pytest.fail("a loop was started"))
    Path("broken.yaml").write_text("mesh: {beam: {}}\nmaterial: {young: -1}\n")
    Path("meshless.yaml").write_text("mesh: {beam: {}}\ndriven: bone\n")
    Path("full").mkdir(exist_ok=True)
    Path("full/mine.txt").write_text("keep")
    before = sorted(tmp_path.iterdir())
    assert main(["demo", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("finger_sim: error: ")
    assert says in err
    assert "Traceback" not in err
    assert sorted(tmp_path.iterdir()) == before


def test_each_demo_gets_a_folder_of_its_own(tmp_path, monkeypatch):
    """Numbered where none is given; an empty one that was asked for is used."""
    monkeypatch.chdir(tmp_path)
    assert [str(demo._make_folder(None)) for _ in range(3)] == [
        "finger_sim_demo", "finger_sim_demo_2", "finger_sim_demo_3"
    ]  # fmt: skip
    assert demo._make_folder("new/one") == demo._make_folder("new/one") == Path("new/one")
    Path("new/one/mine.txt").write_text("keep")
    with pytest.raises(FingerSimError, match="is not empty"):
        demo._make_folder("new/one")


BROKEN = """
import sys
import finger_sim.ros.node as node

class Broken(node.Ticker):
    def _run_compiled(self):
        if self.progress.steps > 20 and self._stepper.newest:
            raise ValueError("no such luck")
        return super()._run_compiled()

main = node.main
{then}
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("then", "says"),
    [
        ("sys.exit('out of luck')", "the node ended with code 1: out of luck"),
        pytest.param("node.Ticker = Broken", "no such luck", marks=pytest.mark.slow),
        ("import os; main = lambda: os.kill(os.getpid(), 9)", "the node ended with code -9"),
    ],
)
def test_a_node_that_dies_fails_the_demo(tmp_path, capsys, monkeypatch, then, says):
    """At its start, among the commands, or killed: exit code 1, and its last words."""
    (tmp_path / "broken.py").write_text(BROKEN.format(then=then))
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{tmp_path}/broken.py" "$@"\n')
    python.chmod(0o755)
    path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))
    monkeypatch.setenv("PYTHONPATH", path)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr(demo, "bare_loop", lambda *_: FLOOR)
    assert main(["demo", "--rate", "100", "--duration", "2", "--out", str(tmp_path / "out")]) == 1
    err = capsys.readouterr().err
    assert "finger_sim: the demo failed: " in err
    assert says in err


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_demo_and_its_node(tmp_path, number, code):
    """While commands are played: the node is gone, its bag closed, no traceback."""
    run = process("demo", "--rate", "100", "--out", "out", cwd=tmp_path)
    said = iter(run.stderr.readline, "")
    assert any(line.startswith("playing") for line in said)
    run.send_signal(number)
    _, err = run.communicate(timeout=60)
    assert run.returncode == code
    assert "Traceback" not in err
    assert (tmp_path / "out" / "recording" / "metadata.yaml").is_file()

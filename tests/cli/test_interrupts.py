"""Verbs that are ended before their end: by Ctrl-C, by SIGTERM, by a disk that is full."""

from __future__ import annotations

import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from processes import REPOSITORY
from rosbags.rosbag2 import Reader

from finger_sim.bags.cdr import POSE_STAMPED
from finger_sim.bags.reader import BagReader, write_commands

SCENE = """
mesh: {beam: {size: [0.02, 0.01, 0.01], cells: [2, 1, 1]}}
driven: {box: [[-1, -1, 0.0099], [1, 1, 1]]}
material: {young: 5.0e4, poisson: 0.4}
plane: {friction: 0.5}
dt: 0.005
"""
HOUR, OFTEN = 3_600_000_000_000, 50_000_000_000
"""[ns]; commands come often enough that no gap is told."""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """A folder with a scene, and commands that it takes minutes to follow."""
    (tmp_path / "block.yaml").write_text(SCENE)
    times = range(10**18, 10**18 + HOUR + 1, OFTEN)
    position = np.array([[0.0, 0.0, -0.0003 + 0.0001 * (k % 2)] for k in range(len(times))])
    write_commands(tmp_path / "long", times, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))
    return tmp_path


def started(here: Path, *arguments: str, most: int | None = None) -> subprocess.Popen[str]:
    """The command line in a process of its own; `most`: bytes that a file may have there."""
    path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))

    def limit() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if most is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    return subprocess.Popen(
        [sys.executable, "-m", "finger_sim", *arguments], cwd=here, text=True, preexec_fn=limit,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip


def said(process: subprocess.Popen[str], pattern: str) -> None:
    """Waits for a line on stderr."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if re.search(pattern, line):
            return
    raise AssertionError(f"ended before {pattern!r}: {lines}")


def ended(process: subprocess.Popen[str], number: int | None = None) -> tuple[int, list[str]]:
    """Exit code and the last lines on stderr, after a signal."""
    if number is not None:
        process.send_signal(number)
    _, err = process.communicate(timeout=100)
    return process.returncode, err.splitlines()


def require_finished(bag: Path) -> BagReader:
    """The bag, which three readers read to its end; it says that it was cut."""
    reader = BagReader(bag)
    assert reader.warning is None
    assert reader.cut is not None
    counts = {topic.name: topic.count for topic in reader.topics}
    assert counts["/pose"] == counts["/contact_wrench"] > 0
    with Reader(bag) as other:
        assert other.message_count == reader.message_count
        assert sum(1 for _ in other.messages()) == reader.message_count
    with next(bag.glob("*.mcap")).open("rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages()) == reader.message_count
    return reader


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [pytest.param(signal.SIGINT, 130, "interrupted", marks=pytest.mark.slow), (signal.SIGTERM, 143, "terminated")],
)
def test_a_run_that_is_ended_leaves_a_finished_bag(here: Path, number: int, code: int, word: str) -> None:
    """What was simulated by then is in a bag that says where and why it was cut; so does the last but one line."""
    process = started(here, "run", "block.yaml", "--bag", "long", "-o", "out")
    said(process, r"^simulating long: \d+ %")
    found, lines = ended(process, number)
    assert found == code
    assert lines[-1] == f"finger_sim: {word}"
    assert re.fullmatch(r"finger_sim: out: cut after \d+ of 720001 steps, readable up to there", lines[-2])
    assert re.fullmatch(r"interrupted after \d+ of 720001 steps", str(require_finished(here / "out").cut))
    shown = started(here, "info", "out")
    assert "no: interrupted after" in shown.communicate(timeout=100)[0]


@pytest.mark.slow
def test_a_run_that_has_not_begun_leaves_nothing(here: Path) -> None:
    """SIGTERM while kernels are loaded."""
    process = started(here, "run", "block.yaml", "--bag", "long", "-o", "deep/out")
    said(process, "^mesh: ")
    assert ended(process, signal.SIGTERM)[0] == 143
    assert not (here / "deep").exists()


@pytest.mark.parametrize(("most", "remains"), [(400_000, True), pytest.param(30_000, False, marks=pytest.mark.slow)])
def test_a_disk_that_is_full_leaves_a_finished_bag_or_none(here: Path, most: int, remains: bool) -> None:
    """The last whole chunks give way to the end of the file; where nothing would be left there is no bag."""
    process = started(here, "run", "block.yaml", "--bag", "long", "-o", "out", most=most)
    code, lines = ended(process)
    assert code == 2
    assert re.fullmatch(r"finger_sim: error: out/out_0.mcap: cannot be written: File too large", lines[-1])
    if remains:
        assert "cut after" in lines[-2]
        assert "File too large after" in str(require_finished(here / "out").cut)
    else:
        assert "out: removed" in lines[-2]
        assert not (here / "out").exists()


@pytest.mark.slow
def test_an_import_that_is_ended_leaves_no_bag(here: Path) -> None:
    """SIGTERM once the folder is there."""
    rows = "\n".join(f"{0.001 * k:.3f},0" for k in range(300_000))
    (here / "poses.csv").write_text(f"t,x\n{rows}\n")
    process = started(here, "import", "poses.csv", "-o", "made")
    while not (here / "made").exists() and process.poll() is None:
        time.sleep(0.005)
    assert ended(process, signal.SIGTERM) == (143, ["finger_sim: terminated"])
    assert not (here / "made").exists()


def test_sigterm_ends_a_study(here: Path) -> None:
    """Exit code 143, no traceback, nothing in the folder for failed cases."""
    process = started(here, "stress", "--cases", "1000")
    said(process, "^stress: ")
    assert ended(process, signal.SIGTERM) == (143, ["finger_sim: terminated"])
    assert not (here / "stress_failed").exists()


@pytest.mark.slow
def test_the_window_of_a_run(here: Path) -> None:
    """--start and --duration arrive; what is not in the bag is refused before kernels are loaded."""
    process = started(here, "run", "block.yaml", "--bag", "long", "-o", "out", "--start", "3599.9")
    out, err = process.communicate(timeout=100)
    assert process.returncode == 0, err
    assert "0.105 s in 21 steps" in out
    times = [m.log_time for m in BagReader(here / "out").messages() if m.type == POSE_STAMPED]
    assert min(times) == 10**18 + 3_599_900_000_000
    for window, says in (
        (("--start", "3600.1"), "start: got 3600.1 s, allowed: 0 to 3600 s"),
        (
            ("--start", "3000", "--duration", "601"),
            "duration: got 601 s from 3000 s on, allowed: more than 0, up to 600",
        ),
        (("--duration", "nan"), "--duration: got 'nan', allowed: a finite number > 0"),
        (("--start=-1",), "--start: got '-1', allowed: a finite number >= 0"),
    ):
        process = started(here, "run", "block.yaml", "--bag", "long", "-o", "refused", *window)
        code, lines = ended(process)
        assert code == 2
        assert says in lines[-1]
        assert not any(line.startswith("mesh: ") for line in lines)
    assert not (here / "refused").exists()

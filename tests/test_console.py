"""What people see: whole words at any width, a line for each state of a piece of work, files from a command line."""

from __future__ import annotations

import io
import itertools
import re
from pathlib import Path

import pytest
from rich.console import Console

from finger_sim import console
from finger_sim.console import Gauge, make_files, show, table
from finger_sim.errors import FingerSimError
from finger_sim.pictures.info import info


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """What a terminal of 60 columns is sent."""
    sent = io.StringIO()
    narrow = Console(file=sent, width=60, force_terminal=True, color_system=None, highlight=False, markup=False)
    monkeypatch.setattr(console, "console", lambda *_: narrow)
    return sent


@pytest.mark.parametrize("what", ["finger_haptic", "press_slide", "finger.vtu"])
def test_no_word_is_broken_at_60_columns(terminal: io.StringIO, what: str) -> None:
    """All words of a table are in what is shown, and lines fit but for words that are longer themselves."""
    for title, rows in info(what):
        terminal.truncate(terminal.seek(0))
        words = {word for column in rows.columns for cell in column.cells for word in str(cell).split()}
        show(title, rows)
        lines = terminal.getvalue().splitlines()
        assert lines[0] == title
        assert words <= {word for line in lines[1:] for word in line.split()}
        assert all(len(line.rstrip()) <= 60 or len(line.split()) <= 2 for line in lines[1:])


def test_a_long_line_is_left_to_the_terminal(terminal: io.StringIO) -> None:
    """No line break is put into it."""
    line = " ".join(["/a/long/path/to/a/bag"] * 8)
    show(line)
    assert terminal.getvalue() == f"{line}\n"


def test_a_pipe_gets_tables_side_by_side_however_wide(capsys: pytest.CaptureFixture[str]) -> None:
    """Programs read them: a row stays a row."""
    rows = table("name", "path", "other")
    rows.add_row("a", "x" * 150, "y" * 150)
    show(rows)
    assert capsys.readouterr().out.splitlines()[1].split() == ["a", "x" * 150, "y" * 150]


def test_progress_in_a_pipe_says_nothing_twice(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long a piece of work stands where it is."""
    clock = itertools.count(0.0, console.LINE_PERIOD)
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    gauge = Gauge("work")
    for done in (0, 0, 0, 1, 1, 2):
        gauge(done, 3)
    assert capsys.readouterr().err.splitlines() == ["work: 0 %", "work: 33 %", "work: 67 %"]


def test_a_module_that_makes_files_says_which_or_why_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Paths on stdout and exit code 0, or the reason on stderr and 1."""

    def refuse(_: Path) -> list[Path]:
        raise FingerSimError("no room")

    assert make_files("a.module", "Makes.", "where", lambda place: [place / "one"], [str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'one'}\n"
    assert make_files("a.module", "Makes.", "where", refuse, [str(tmp_path)]) == 1
    assert capsys.readouterr().err == "no room\n"
    with pytest.raises(SystemExit, match="0"):
        make_files("a.module", "Makes.", "where", refuse, ["--help"])
    assert re.search(r"python -m a\.module .*Makes\..* where", capsys.readouterr().out, re.DOTALL)

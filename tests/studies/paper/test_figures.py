"""`finger_sim figures`: what it writes and prints, and mistakes named before anything long."""

from __future__ import annotations

import json
import sys
import types

import numpy as np
import pytest
from cases import for_each

from finger_sim import FingerSimError
from finger_sim.cli import main
from finger_sim.pictures.surfaces import new_figure
from finger_sim.studies.paper.figures import FIGURES, Finding, figures, module_of, plain

pytest.importorskip("matplotlib")


@pytest.fixture
def isotropy(monkeypatch):
    """A study in place of `isotropy` that measures nothing; the list it fills tells what was called."""
    calls: list[str] = []

    def measure(progress):
        calls.append("measure")
        progress(1, 2)
        return 7

    study = types.SimpleNamespace(
        measure=measure,
        numbers=lambda result: {"count": np.int64(result), "curve_n": np.array([1.0, np.nan]), "no": None},
        findings=lambda result: [Finding("under 1 Hz", f"{result} Hz", False, "13 years")],
        draw=lambda result: new_figure(2.0, 1.0),
    )
    monkeypatch.setitem(sys.modules, "finger_sim.studies.paper.isotropy", study)
    return calls


def test_a_picture_and_a_json_of_each_figure(isotropy, tmp_path, capsys):
    """<name>.png and <name>.json in a folder that is made; a table of what agrees and what does not."""
    out = tmp_path / "new" / "folder"
    assert main(["figures", "--only", "isotropy", "--out", str(out)]) == 0
    assert isotropy == ["measure"]
    assert (out / "isotropy.png").read_bytes().startswith(b"\x89PNG")
    data = json.loads((out / "isotropy.json").read_text(encoding="utf-8"))
    assert data["numbers"] == {"count": 7, "curve_n": [1.0, None], "no": None}
    assert data["findings"] == [{"paper": "under 1 Hz", "measured": "7 Hz", "agrees": False, "reason": "13 years"}]
    printed = capsys.readouterr()
    assert all(word in printed.out for word in ("under 1 Hz", "7 Hz", "differs", "13 years", str(out)))
    assert "isotropy" in printed.err


@pytest.mark.parametrize("given", [["--only", "beam"], ["--only"]])
def test_an_unknown_figure_is_named(capsys, given):
    """argparse's message, with what is allowed."""
    with pytest.raises(SystemExit, match="2"):
        main(["figures", *given])
    assert "--only" in capsys.readouterr().err
    with pytest.raises(FingerSimError, match="'beam', allowed: beams, finger"):
        next(figures(["beam"], None))  # type: ignore[arg-type]


def test_a_folder_that_cannot_be_is_named(isotropy, tmp_path, capsys):
    """Nothing is measured first."""
    (tmp_path / "file").touch()
    assert main(["figures", "--only", "isotropy", "--out", str(tmp_path / "file" / "figures")]) == 2
    assert "--out" in capsys.readouterr().err
    assert isotropy == []


def test_without_matplotlib_the_extra_is_named(isotropy, tmp_path, capsys, monkeypatch):
    """Before anything is measured."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["figures", "--only", "isotropy", "--out", str(tmp_path)]) == 2
    assert "plot" in capsys.readouterr().err
    assert isotropy == []


@for_each("name", FIGURES)
def test_every_figure_is_there(name):
    """A module of its own, with what the protocol asks for; the command line knows it."""
    study = module_of(name)
    assert all(callable(getattr(study, part)) for part in ("measure", "numbers", "findings", "draw"))


def test_plain_values():
    """NumPy's numbers and arrays as Python's, what is not finite as null."""
    assert plain({1: (np.float64(2.0), np.array([[1, 2]]), float("inf"), "text")}) == {
        "1": [2.0, [[1, 2]], None, "text"]
    }

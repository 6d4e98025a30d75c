"""Where the output goes: terminals that are not UTF-8, pipes whose reader goes, full disks, closed streams."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from processes import REPOSITORY

from finger_sim.plain import in_words

SCENE = """
mesh: {beam: {size: [0.02, 0.01, 0.01], cells: [2, 1, 1]}}
driven: {box: [[-1, -1, 0.0099], [1, 1, 1]]}
dt: 0.005
"""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """A folder with a scene."""
    (tmp_path / "block.yaml").write_text(SCENE)
    return tmp_path


def shell(here: Path, line: str, **environment: str) -> subprocess.Popen[bytes]:
    """A line of sh in which `python -m` finds this package."""
    path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        ["sh", "-c", line.replace("python", sys.executable)], cwd=here,
        env=os.environ | {"PYTHONPATH": path} | environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def test_what_an_encoding_lacks_is_put_in_words() -> None:
    """Greek letters by their names, indices by their digits; bytes of a name that is no text stay as they are."""
    assert in_words("ν 0.45, K/μ, 10 kg/m³, 5 µs – 2×", "ascii") == "nu 0.45, K/mu, 10 kg/m^3, 5 us - 2x"
    assert in_words("ν 0.45, K/μ, 10 kg/m³, 5 µs – 2×", "latin-1") == "nu 0.45, K/mu, 10 kg/m³, 5 µs - 2×"
    assert in_words("V/V₀ ≥ 1, Ω, é, 中", "ascii") == r"V/V0 >= 1, Omega, \xe9, \u4e2d"
    assert in_words("a\udce9", "utf-8").encode("utf-8", "surrogateescape") == b"a\xe9"


@pytest.mark.parametrize(
    ("environment", "encoding"),
    [
        ({"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}, "ascii"),
        ({"PYTHONIOENCODING": "latin-1"}, "latin-1"),
    ],
)
def test_a_terminal_that_is_not_utf_8(here: Path, environment: dict[str, str], encoding: str) -> None:
    """Exit code 0, every row there, in columns."""
    done = shell(here, "python -m finger_sim info block.yaml", **environment)
    out, err = (data.decode(encoding) for data in done.communicate(timeout=100))
    assert (done.returncode, err) == (0, "")
    cubic = "kg/m³" if encoding == "latin-1" else "kg/m^3"
    assert re.search(rf"^material +E \S+ Pa, nu \S+, \S+ {re.escape(cubic)}, damping", out, re.MULTILINE)
    names = [line.index("Mass density") for line in out.splitlines() if "Mass density" in line]
    assert names == [line.index("Young's modulus") for line in out.splitlines() if "Young's modulus" in line]


def test_a_stream_that_cannot_be_written(here: Path) -> None:
    """A closed one, and a pipe whose reader has gone, change no exit code; a full disk makes 0 to 1, in one line.

    The work is done all the same, and its file is not taken for a stream.
    """
    full = b"finger_sim: error: stdout: cannot be written: No space left on device\n"
    version, made = "python -m finger_sim --version", "python -m finger_sim mesh beam -o"
    where = "python -c \"import finger_sim.ros, os; os.mkdir(os.readlink('/proc/self/fd/1').replace('/', '_'))\""
    cases = [
        (f"{where} >&-", 0, b""),
        (f"{made} plain.vtu", 0, b""),
        (f"{made} full.vtu > /dev/full", 1, full),
        (f"{made} closed.vtu <&- >&- 2>&-", 0, b""),
        (f"{{ {made} gone.vtu; echo $? > code; }} | true; exit $(cat code)", 0, b""),
        (f"{version} > /dev/full", 1, full),
        (f"{version} > /dev/full 2> /dev/full", 1, b""),
        (f"{version} >&-", 0, b""),
        ("python -m finger_sim fly 2> /dev/full", 2, b""),
        ("python -m finger_sim fly >&- 2>&-", 2, b""),
    ]
    started = [shell(here, line) for line, _, _ in cases]
    for process, (line, code, err) in zip(started, cases, strict=True):
        said = process.communicate(timeout=100)[1]
        assert (process.returncode, said) == (code, err), line
    assert (here / "_dev_null").exists()  # where stdout of the first leads to
    meshes = [file.read_bytes() for file in here.glob("*.vtu")]
    assert len(meshes) == 4
    assert set(meshes) == {meshes[0]}

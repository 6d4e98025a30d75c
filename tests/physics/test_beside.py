"""A second process that compiles a kernel: it is loaded then; whatever becomes of the process, it is compiled."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from kernel_package import finish, said, start, tiny

BESIDE = """
import os, signal, sys
from numba import types
from finger_sim.physics import beside
from finger_sim.physics.compile import compiling
from finger_sim.physics.step import step

class Seen(beside.subprocess.Popen):
    def __init__(self, *given, **named):
        super().__init__(*given, **named)
        seen.append(self)

seen, beside.subprocess.Popen = [], Seen
with compiling(lambda text: print(text, flush=True), [step]):
    BEFORE
    with beside.compiled_beside(step, (types.float64,)):
        print(*(process.pid for process in seen), flush=True)
        MEANWHILE
    print(step(1.0))
print(sum(step.stats.cache_hits.values()), sum(step.stats.cache_misses.values()))
"""
COMPILED = ["compiling kernels: 50 % of 2", "compiling kernels: 100 % of 2"]


def code(before: str = "pass", meanwhile: str = "pass") -> str:
    return BESIDE.replace("BEFORE", before).replace("MEANWHILE", meanwhile)


def test_what_the_second_process_compiled_is_loaded(tmp_path: Path) -> None:
    """All of it is counted; the next start needs no second process."""
    package = tiny(tmp_path / "package")
    told, pid, *rest, value, last = finish(start(package, tmp_path / "cache", code()))
    assert told.startswith("compiling kernels: once")
    assert int(pid) > 0
    assert rest == COMPILED
    assert (value, last) == ("12.0", "1 0")
    assert finish(start(package, tmp_path / "cache", code())) == ["loading compiled kernels", "", "12.0", "1 0"]


@pytest.mark.parametrize(
    ("before", "meanwhile", "second"),
    [
        ("pass", "seen[0].kill(); seen[0].wait()", True),
        pytest.param("os.environ['NUMBA_CACHE_DIR'] += '/other'", "pass", True, marks=pytest.mark.slow),
        ("beside.sys.executable = '/nowhere/python'", "pass", False),
        pytest.param("os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})", "pass", False, marks=pytest.mark.slow),
    ],
)
def test_without_its_help_the_kernel_is_compiled_here(
    tmp_path: Path, before: str, meanwhile: str, second: bool
) -> None:
    """It is killed, keeps kernels elsewhere, cannot be started, or would only be in the way."""
    _, pid, *told, value, last = finish(start(tiny(tmp_path / "package"), tmp_path, code(before, meanwhile)))
    assert (pid != "") == second
    assert told == COMPILED
    assert (value, last) == ("12.0", "0 1")


def slowly(package: Path) -> None:
    """The kernel's file takes as long to import as SLOW says."""
    step = package / "physics" / "step.py"
    step.write_text("import os, time\ntime.sleep(float(os.environ.get('SLOW', 0)))\n" + step.read_text())


def ended(process: int) -> bool:
    """Whether it ends within 20 s."""
    return bool(select.select([process], [], [], 20.0)[0])


def test_it_does_not_outlive_who_asked_for_it(tmp_path: Path) -> None:
    """Killed: the second process ends too, whatever it is at."""
    package = tiny(tmp_path / "package")
    slowly(package)
    asking = start(package, tmp_path, code("os.environ['SLOW'] = '1000'", "sys.stdin.readline()"))
    said(asking)
    second = os.pidfd_open(int(said(asking)))
    asking.kill()
    asking.communicate()
    assert ended(second)


def test_an_interrupt_ends_both_and_says_nothing_twice(tmp_path: Path) -> None:
    """Ctrl-C goes to both processes; only the first one has something to say."""
    package = tiny(tmp_path / "package")
    slowly(package)
    asking = subprocess.Popen(
        [sys.executable, "-c", code("os.environ['SLOW'] = '1000'", "sys.stdin.readline()")],
        env=os.environ | {"PYTHONPATH": str(package.parent), "NUMBA_CACHE_DIR": str(tmp_path)},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, process_group=0,
    )  # fmt: skip
    said(asking)
    second = os.pidfd_open(int(said(asking)))
    os.killpg(asking.pid, signal.SIGINT)
    out, _ = asking.communicate(timeout=20)
    assert out.count("Traceback") == 1
    assert ended(second)

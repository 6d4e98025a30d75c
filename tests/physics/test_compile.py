"""Where compiled kernels are kept: by what is in the sources, ours alone, compiled once, removed when old."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any

import llvmlite.binding
import numba
import pytest
from kernel_package import BOTH, PACKAGE, START, finish, said, start, tiny
from numba.core.dispatcher import Dispatcher

from finger_sim.physics import compile as compiling
from finger_sim.physics import folders, progress, sources
from finger_sim.physics.methods import ISOTROPIC, PGS
from finger_sim.physics.ready import kernels
from finger_sim.simulation.ground import KERNELS as GROUND
from finger_sim.simulation.whole import KERNELS as STEP

NAME, OTHER = "0123456789abcdef", "fedcba9876543210"


def files(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("*.nb*")}


@pytest.mark.slow
def test_kernels_go_by_content_not_by_place_and_time(tmp_path: Path) -> None:
    """A copy elsewhere with other times finds everything compiled; an edit of callee or constant does not."""
    first, cache = tiny(tmp_path / "first"), tmp_path / "cache"
    told, value, last = finish(start(first, cache))
    hits, before, folder = last.split()
    assert (told.split(":")[0], value, hits, before) == ("compiling kernels", "12.0", "0", "True")
    made = files(Path(folder))
    assert len(made) == 2  # of the kernel; its callee's code is in it
    second = Path(shutil.copytree(first, tmp_path / "second" / "finger_sim"))
    for path in second.rglob("*.py"):
        os.utime(path, (1e9, 1e9))
    assert finish(start(second, cache)) == ["loading compiled kernels", "12.0", f"1 True {folder}"]
    assert files(Path(folder)) == made
    for name, text, value in (("numbers.py", "TEN = 20.0", "22.0"), ("physics/callee.py", None, "23.0")):
        edited = second / name
        edited.write_text(text or edited.read_text().replace("2.0", "3.0"))
        told, now, last = finish(start(second, cache))
        assert (told.split(":")[0], now, last.split()[2] == folder) == ("compiling kernels", value, False)


@compiling.exact
def rest_exact(a: float, b: float) -> float:
    return a * a - b


@compiling.stage
def rest_fused(a: float, b: float) -> float:
    return a * a - b


@compiling.kernel
def exact(a: float, b: float) -> float:
    return rest_exact(a, b)


@compiling.kernel
def fused(a: float, b: float) -> float:
    return rest_fused(a, b)


def test_exact_functions_round_as_python_does() -> None:
    """Of a square less its rounded value nothing is left; where the two are fused, the rounding is."""
    numbers = (1.1, 1.3, 1.7, 2.3)
    assert [exact(a, a * a) for a in numbers] == [0.0] * 4
    if not numba.config.DISABLE_JIT and llvmlite.binding.get_host_cpu_features().get("fma"):
        assert any(fused(a, a * a) for a in numbers)


def whole(x: float) -> float:
    return 2.0 * x


compiling._into_callers(whole, _dbg_optnone=True)  # called, not inlined


def test_a_kernel_has_no_other_name_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second version of a stage, in another kernel of the process, is not called from the first one."""
    monkeypatch.setattr(compiling, "cache_folder", lambda: None)
    names: dict[str, Any] = {"whole": whole}
    exec("def outer(x):\n    return whole(x) + 1.0", names)
    outer = compiling.kernel(names["outer"])
    assert outer(1.0) == 3.0
    if not numba.config.DISABLE_JIT:
        (compiled,) = outer.overloads.values()
        linkages = {each.name: each.linkage for each in compiled.library.get_defined_functions()}
        own = {compiled.fndesc.llvm_func_name, compiled.fndesc.llvm_cpython_wrapper_name}
        assert len(linkages) == 3
        assert {linkages.pop(name) for name in own} == {llvmlite.binding.Linkage.external}
        assert {*linkages.values()} == {llvmlite.binding.Linkage.internal}


def test_sources_are_those_that_imports_lead_to(tmp_path: Path) -> None:
    """Of the real package: everything that importing the kernels loads, and nothing of ROS or the studies."""
    package = tiny(tmp_path)
    found = sources.imported(package, [package / "physics" / "step.py"])
    names = {path.relative_to(package).as_posix() for path in found}
    assert names >= {"__init__.py", "numbers.py", "physics/__init__.py", "physics/callee.py", "physics/compile.py"}
    assert names >= {"late/__init__.py", "late/three.py"}  # imported when asked for
    assert not names & {"apart.py", "late/four.py"}
    of_kernels = sources.imported(PACKAGE, sorted((PACKAGE / "physics").glob("*.py")))
    assert PACKAGE / "arrays.py" in of_kernels
    assert not [path for path in of_kernels if {"ros", "studies", "cli"} & set(path.parts[len(PACKAGE.parts) :])]


@pytest.mark.parametrize("killed", [False, True])
def test_two_first_starts_compile_once(tmp_path: Path, killed: bool) -> None:
    """The second waits and says so; then it loads what the first compiled, or compiles where that was killed."""
    package, cache = tiny(tmp_path / "package"), tmp_path / "cache"
    first = start(package, cache)
    assert said(first).startswith("compiling kernels: once")
    second = start(package, cache)
    assert said(second).startswith("compiling kernels: another process")
    if killed:
        first.kill()
        first.communicate()
    else:
        finish(first)
    told, value, last = finish(second)
    assert told.startswith("compiling kernels: once" if killed else "loading compiled kernels")
    assert (value, last.split()[0]) == ("12.0", "0" if killed else "1")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The package and a cache that it filled: for tests that change the cache, to copy."""
    root = tmp_path_factory.mktemp("compiled")
    finish(start(tiny(root / "package"), root / "cache", BOTH))
    return root / "package" / "finger_sim", root / "cache"


def the_file(cache: Path, kind: str) -> Path:
    """Of the compiled kernel `step`."""
    (file,) = cache.glob(f"finger_sim/*/*step.step-*.{kind}")
    return file


def test_a_damaged_cache_is_compiled_anew_and_said_once(tmp_path: Path, compiled: tuple[Path, Path]) -> None:
    """All files that are damaged go, also those that this start does not load; the next start finds a whole folder."""
    package, cache = compiled[0], Path(shutil.copytree(compiled[1], tmp_path / "cache"))
    for file in (the_file(cache, "nbi"), *cache.glob("finger_sim/*/*.other-*.nbc")):
        file.write_bytes(b"")
    first, damage, anew, value, last = finish(start(package, cache))
    assert first == "loading compiled kernels"
    assert damage.startswith("damaged kernels in ")
    assert "step.step-" in damage
    assert anew.startswith("compiling kernels: once")
    folder = Path(last.split()[2])
    assert (value, last) == ("12.0", f"0 True {folder}")
    made = files(folder)
    assert len(made) == 3  # two of the kernel, and the index of the other one
    assert all(path.stat().st_size for path in folder.glob("*.nb*"))
    assert finish(start(package, cache)) == ["loading compiled kernels", "12.0", f"1 True {folder}"]
    assert files(folder) == made


DAMAGE = """
from finger_sim.physics.compile import cache_folder, kernel
from finger_sim.physics.step import step
step(1.0)
def flipped(content, place):
    return content[:place] + bytes([content[place] ^ 4]) + content[place + 1:]
def cut(content, place):
    return content[:place]
for kind in "nbi", "nbc":
    for damaged in flipped, cut:
        for part in range(8):
            (file,) = cache_folder().glob(f"*step.step-*.{kind}")
            content = file.read_bytes()
            file.write_bytes(damaged(content, len(content) * part // 8))
            again = kernel(step.py_func)
            print(again(1.0), *again.stats.cache_hits.values())
"""


@pytest.mark.slow
def test_no_damage_is_loaded_wherever_it_is(tmp_path: Path, compiled: tuple[Path, Path]) -> None:
    """Bits of the index, of the data around the machine code and of that itself; files cut anywhere."""
    damage, *values = finish(start(compiled[0], tmp_path / "cache", DAMAGE))
    assert damage.startswith("damaged kernels in ")
    assert values == ["12.0"] * 32


def test_two_starts_on_a_damaged_cache_compile_once(tmp_path: Path, compiled: tuple[Path, Path]) -> None:
    """One that finds damage while another process compiles waits for it, and loads what that one made."""
    package, cache = compiled[0], Path(shutil.copytree(compiled[1], tmp_path / "cache"))
    file = the_file(cache, "nbc")
    whole = file.read_bytes()
    file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with folders.alone(file.parent / compiling.LOCK, lambda: None):
        second = start(package, cache)
        assert said(second) == "loading compiled kernels\n"
        assert second.stdin is not None
        second.stdin.write("\n")
        second.stdin.flush()
        assert said(second).startswith("compiling kernels: another process")
        file.write_bytes(whole)
    value, last = finish(second)
    assert (value, last.split()[0]) == ("12.0", "1")


FULL = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))\n" + START
REMOVED = "import shutil\nfrom finger_sim.physics import step, compile\nshutil.rmtree(compile.cache_folder())" + START


@pytest.mark.slow
def test_a_full_disk_costs_time_and_no_more(tmp_path: Path, compiled: tuple[Path, Path]) -> None:
    """It is said once that nothing is kept; a later start does not take for compiled what could not be kept."""
    for code in (FULL, START):
        told, *full, value, last = finish(start(compiled[0], tmp_path, code))
        assert told.startswith("compiling kernels: once")
        assert len(full) == (code == FULL)
        assert all(line.startswith("compiled kernels cannot be kept in ") for line in full)
        assert (value, last.split()[:2]) == ("12.0", ["0", str(code != FULL)])


def test_a_folder_that_is_removed_meanwhile_is_made_again(tmp_path: Path, compiled: tuple[Path, Path]) -> None:
    """Closed to others, as it was."""
    told, value, last = finish(start(compiled[0], tmp_path, REMOVED))
    assert (told.split(":")[0], value, last.split()[:2]) == ("compiling kernels", "12.0", ["0", "True"])
    assert the_file(tmp_path, "nbc").parent.stat().st_mode & 0o777 == 0o700


def test_a_filled_folder_is_read_where_nothing_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is not filled, or that others can change, is of no use there."""
    monkeypatch.setattr(compiling.numba.config, "DISABLE_JIT", 0)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling.tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    choose = compiling.cache_folder.__wrapped__
    folder = choose()
    assert folder.parent == tmp_path / "finger_sim"
    real = folders.tempfile.TemporaryFile

    def full(dir: Path) -> Any:
        if dir == folder:
            raise OSError(30, "Read-only file system")
        return real(dir=dir)

    monkeypatch.setattr(folders.tempfile, "TemporaryFile", full)
    assert choose().is_relative_to(tmp_path / "temporary")
    (folder / compiling.DONE).touch()
    assert choose() == folder
    folder.chmod(0o777)
    assert choose().is_relative_to(tmp_path / "temporary")


@pytest.mark.slow
def test_run_goes_on_with_a_damaged_cache(tmp_path: Path) -> None:
    """The whole package: bits flipped in the machine code of a step."""
    own = compiling.cache_folder()
    assert own is not None
    copy = tmp_path / "finger_sim" / own.name
    shutil.copytree(own, copy)
    run = [sys.executable, "-m", "finger_sim", "run", "finger", "--bag", "press_flat", "--duration", "0.01", "-o"]
    for number, told in enumerate(("", "loading compiled kernels", "damaged")):
        if told == "damaged":
            for file in copy.glob("*step.step-*.nbc"):
                content = bytearray(file.read_bytes())
                content[len(content) // 4 :: 1001] = b"?" * len(content[len(content) // 4 :: 1001])
                file.write_bytes(content)
        done = subprocess.run(
            [*run, str(tmp_path / f"out{number}")],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(PACKAGE.parent)},
            capture_output=True, text=True, timeout=230, cwd=PACKAGE.parent,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert told in done.stderr
        assert done.stderr.count("damaged") == (told == "damaged")


def test_a_folder_is_ours_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made closed to others; refused where others own it, could have written to it, or can replace it."""
    folder = folders.use(tmp_path / "new" / "finger_sim", NAME)
    assert {oct(path.stat().st_mode & 0o777) for path in (folder, folder.parent, tmp_path / "new")} == {"0o700"}
    folder.chmod(0o755)
    folders.private(folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o770)
    with pytest.raises(folders.UnsafeError, match="others can write"):
        folders.private(folder)
    folder.chmod(0o700)
    link = folder.parent / OTHER
    link.symlink_to(folder)
    folders.private(link)
    folder.parent.chmod(0o777)
    with pytest.raises(folders.UnsafeError, match="anyone can replace"):
        folders.private(folder)
    folder.parent.chmod(0o700)

    def of_another(path: Any, real: Any = os.lstat) -> os.stat_result:
        seen = list(real(path))
        seen[4] = os.geteuid() + 1
        return os.stat_result(seen)

    monkeypatch.setattr(os, "lstat", of_another)
    with pytest.raises(folders.UnsafeError, match="belongs to user"):
        folders.private(link)


def test_where_others_own_the_folders_kernels_go_to_a_fresh_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Neither the cache's folder nor that in the temporary directory is trusted then; it is said why."""
    monkeypatch.setattr(compiling.numba.config, "DISABLE_JIT", 0)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "home"))
    monkeypatch.setattr(compiling.tempfile, "tempdir", str(tmp_path))
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    with caplog.at_level(logging.WARNING):
        folder = compiling.cache_folder.__wrapped__()
    assert folder is not None
    assert folder.parent == tmp_path
    assert folder.name.startswith("finger_sim-")
    assert folder.name != f"finger_sim-{me + 1}"
    assert folder.stat().st_mode & 0o777 == 0o700
    (warning,) = caplog.messages
    assert f"belongs to user {me}" in warning


def test_without_any_folder_kernels_are_compiled_and_not_kept(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A warning, no error."""

    def refuse(*arguments: Any, **named: Any) -> Any:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(compiling, "use", refuse)
    monkeypatch.setattr(compiling, "read_only", refuse)
    monkeypatch.setattr(compiling.tempfile, "mkdtemp", refuse)
    with caplog.at_level(logging.WARNING):
        assert compiling.cache_folder.__wrapped__() is None
    assert len(caplog.messages) == 1
    monkeypatch.setattr(compiling, "cache_folder", lambda: None)
    told: list[str] = []
    names: dict[str, Any] = {}
    exec("def inner(x):\n    return x + 1.0\ndef outer(x):\n    return 2.0 * inner(x)", names)
    names["inner"] = compiling.stage(names["inner"])
    outer = compiling.kernel(names["outer"])
    with compiling.compiling(told.append, [outer]):
        assert outer(1.0) == 4.0
    assert told == [
        "compiling kernels: up to a minute, not kept", "compiling kernels: 50 % of 2", "compiling kernels: 100 % of 2"
    ]  # fmt: skip


def test_what_is_told_to_compile_is_all_that_a_start_compiles() -> None:
    """Every function of physics/ is counted, but for two: one is done by then, one is for users to call."""
    paper: Any = SimpleNamespace(method=PGS, projection=ISOTROPIC, relaxation=(1.0,))
    counted = progress.called(kernel.py_func for kernel in (*kernels(paper), *GROUND, *STEP))
    known = {
        function
        for name, module in list(sys.modules.items())
        if name.startswith("finger_sim.physics.")
        for value in vars(module).values()
        if isinstance(value, Dispatcher | FunctionType)
        for function in [getattr(value, "py_func", value)]
        if isinstance(value, Dispatcher) or function in progress._in_callers
    }
    assert {function.__name__ for function in known - counted} == {"limit_factors", "evaluate_tensor"}
    assert {function for function in counted if function.__module__.startswith("finger_sim.physics.")} <= known


def test_old_folders_go_but_none_in_use(tmp_path: Path) -> None:
    """What was long unused, and what is beyond the newest; not what a process uses, nor what is not ours to judge."""
    now = time.time()

    def made(number: int, age: float) -> Path:
        folder = tmp_path / f"{number:016x}"
        folders.private(folder)
        (folder / folders.IN_USE).touch()
        (folder / "kernel.nbc").touch()
        os.utime(folder, (now - age, now - age))
        return folder

    kept = [made(k, 60.0 * k) for k in range(1, folders.KEPT)]
    beyond = made(99, 60.0 * 99)
    used = folders.use(tmp_path, OTHER)  # this process
    old = made(100, 2.0 * folders.UNUSED)
    os.utime(used, (now - 2.0 * folders.UNUSED,) * 2)
    strange = tmp_path / "something else"
    strange.mkdir()
    os.utime(strange, (1.0, 1.0))
    half_removed = tmp_path / f".{NAME}.123"
    half_removed.mkdir()
    folder = folders.use(tmp_path, NAME)
    assert not any(path.exists() for path in (old, beyond, half_removed))
    assert all(path.exists() for path in (used, folder, strange, *kept))

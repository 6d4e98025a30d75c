"""`kernel`: how every compiled function of this package is compiled, and where its machine code is kept."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from . import lowering  # noqa: F401  (lanes mean nothing to the compiler without it)

Function = TypeVar("Function", bound=Callable[..., Any])

# Fused multiply-add only. nnan and ninf would compile guards such as isfinite away; reassoc gave other last bits in
# the process that compiles than in those that load its code, so that a replay would not repeat on a fresh cache.
FASTMATH = {"contract"}


@cache
def cache_folder() -> str:
    """Folder of compiled kernels, one for each state of the sources.

    numba's own cache looks only at the file of the function itself: after an edit of a callee in another file
    it would go on using the old one. A folder named by a hash over all sources cannot. Place and time of the files
    are in the hash because numba compiles anew when they change.
    """
    here = Path(__file__).parent
    digest = hashlib.sha256(f"{numba.__version__} {here}".encode())
    for source in sorted(here.glob("*.py")):
        digest.update(f"{source.name} {source.stat().st_mtime_ns} ".encode() + source.read_bytes())
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    folder = Path(home) / "finger_sim" / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return str(folder)
    except OSError:
        return str(Path(tempfile.gettempdir()) / f"finger_sim-{os.getuid()}" / folder.name)


def compiled_before() -> bool:
    """Whether kernels of exactly these sources are in the cache: a start will take seconds, not a minute."""
    return any(Path(cache_folder()).rglob("step.step-*.nbc"))


def kernel(function: Function) -> Function:
    """Compile `function` when first called: cached on disk, without the GIL, IEEE division, no NaN assumptions."""
    return _compiled(function, called_from_python=True)


def stage(function: Function) -> Function:
    """A `kernel` that only other kernels call.

    Unpacking a Model and a State from Python is code by the ten thousand lines; leaving it out of the stages of a
    step halves the time to compile them all.
    """
    return _compiled(function, called_from_python=False)


def formula(function: Function) -> Function:
    """A `stage` that is compiled into each of its callers: for a few lines on lanes, which no call should interrupt."""
    return _compiled(function, called_from_python=False, inline=True)


def _compiled(function: Function, called_from_python: bool, inline: bool = False) -> Function:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = cache_folder()
    try:
        compiled = numba.njit(
            cache=True,
            nogil=True,
            error_model="numpy",
            fastmath=FASTMATH,
            no_cfunc_wrapper=True,
            no_cpython_wrapper=not called_from_python,
            forceinline=inline,
        )(function)
    finally:
        numba.config.CACHE_DIR = before
    return cast(Function, compiled)

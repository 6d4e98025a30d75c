"""`kernel`: how every compiled function of this package is compiled, and where its machine code is kept.

Machine code is kept by what is in the sources, not by where they lie or when they were written: a second environment
with the same package finds it. numba's own cache goes by place and time, and looks only at the file of the function
itself: after an edit of a callee in another file it would go on using the old one.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import importlib.machinery
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.datamodel import models
from numba.core.extending import register_model
from numba.core.types.misc import unliteral
from numba.core.typing.templates import infer_global

from . import lowering  # noqa: F401  (lanes mean nothing to the compiler without it)
from .folders import UnsafeError, alone, private, read_only, use
from .kept import DamagedError, Kept, remove_damaged
from .libraries import ForCallers, ForItself
from .progress import counted, goes_into_callers, is_there
from .sources import digest, imported

Function = TypeVar("Function", bound=Callable[..., Any])

# Fused multiply-add only. nnan and ninf would compile guards such as isfinite away; reassoc gave other last bits in
# the process that compiles than in those that load its code, so that a replay would not repeat on a fresh cache.
FASTMATH = {"contract"}

OPTIONS = (
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "ENABLE_AVX", "BOUNDSCHECK", "CPU_NAME", "CPU_FEATURES",
    "DEBUGINFO_DEFAULT", "EXTEND_VARIABLE_LIFETIMES", "DISABLE_INTEL_SVML", "USING_SVML", "LLVM_REFPRUNE_PASS",
    "LLVM_REFPRUNE_FLAGS", "ENABLE_PROFILING",
)  # fmt: skip
"""Settings of numba (NUMBA_…) that change the machine code."""
REGISTERS_OF_EIGHT = "+avx512f" in (numba.config.CPU_FEATURES or llvmlite.binding.get_host_cpu_features().flatten())
"""Whether a vector of eight numbers is one register, of 32, and not two of 16."""
DONE = "compiled"
"""Stands in a folder whose kernels a simulator once had all."""
LOCK = "compiling"

_PACKAGE = Path(__file__).parents[1]
_log = logging.getLogger(__name__)
_turns: list[_Turn] = []
"""Of the blocks of `compiling` that this process is in."""
_damaged: list[str] = []
"""What was damaged of compiled kernels that this process found."""
_lost: list[str] = []
"""Why compiled kernels of this process could not be kept."""


@cache
def code_digest() -> str:
    """Hash of all that machine code depends on: sources that kernels can take a constant from, compiler, processor."""
    sources = imported(_PACKAGE, sorted([*Path(__file__).parent.glob("*.py"), *_kernels_elsewhere()]))
    versions = (
        numba.__version__, llvmlite.__version__, np.__version__, importlib.machinery.EXTENSION_SUFFIXES[0],
        llvmlite.binding.get_process_triple(), llvmlite.binding.get_host_cpu_name(),
        llvmlite.binding.get_host_cpu_features().flatten(),
        *(f"{name}={getattr(numba.config, name, None)}" for name in OPTIONS),
    )  # fmt: skip
    return hashlib.sha256("\n".join([digest(_PACKAGE, sources), *versions]).encode()).hexdigest()


def _kernels_elsewhere() -> list[Path]:
    """Files with kernels beside those of physics."""
    rooms = ("bags", "haptics", "ros", "simulation")
    files = (file for room in rooms for file in (_PACKAGE / room).glob("*.py"))
    return [file for file in files if "from ..physics.compile import" in file.read_text(encoding="utf-8")]


@cache
def cache_folder() -> Path | None:
    """Folder of compiled kernels, one for each `code_digest`; None: there is nowhere to keep them.

    In NUMBA_CACHE_DIR or XDG_CACHE_HOME, else ~/.cache; where that cannot be used, in the temporary directory. What
    is there is loaded as code: the folder is ours alone (see `private`), or it is not used.
    """
    name = code_digest()[:16]
    unsafe = []
    for home in (_home, _temporary_home):
        try:
            return use(home(), name)
        except UnsafeError as error:
            unsafe.append(str(error))
        except (OSError, RuntimeError):  # cannot be written, or there is no such directory
            with contextlib.suppress(OSError, RuntimeError):
                folder = read_only(home(), name)
                if (folder / DONE).exists():
                    return folder
    why = "; ".join(unsafe) or "neither the cache's nor the temporary directory can be used"
    try:
        folder = Path(tempfile.mkdtemp(prefix="finger_sim-"))
    except OSError:
        _log.warning("compiled kernels are not kept, every start compiles them anew: %s", why)
        return None
    atexit.register(_remove_own, folder, os.getpid())
    _log.warning("compiled kernels are not kept beyond this process (%s): %s", folder, why)
    return folder


def _home() -> Path:
    """Raises RuntimeError without a home directory."""
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    return (Path(chosen) if chosen else Path.home() / ".cache").absolute() / "finger_sim"


def _temporary_home() -> Path:
    """Raises FileNotFoundError without a temporary directory."""
    return Path(tempfile.gettempdir()) / f"finger_sim-{os.geteuid()}"


def _remove_own(folder: Path, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


def compiled_before() -> bool:
    """Whether kernels of exactly these sources are in the cache: a start will take seconds, not a minute."""
    folder = None if numba.config.DISABLE_JIT else cache_folder()
    return folder is not None and os.path.exists(folder / DONE)  # False also for a folder that is closed to us


@contextlib.contextmanager
def compiling(tell: Callable[[str], None], kernels: Iterable[Any] = ()) -> Iterator[None]:
    """For a block that calls every kernel once: says what goes on, and keeps two processes from compiling the same.

    The second waits for the first, and then loads what that one compiled.

    kernels : those that the block calls; while they compile it is said how many of them and of what they call are done
    """
    folder = None if numba.config.DISABLE_JIT else cache_folder()
    if folder is None:
        tell("kernels run uncompiled" if numba.config.DISABLE_JIT else "compiling kernels: up to a minute, not kept")
        with counted(tell, kernels):
            yield
        return
    with contextlib.ExitStack() as end:
        turn = _Turn(tell, kernels, folder / LOCK, end)
        if not compiled_before():
            turn.wait()
        if compiled_before():
            tell("loading compiled kernels")
        else:
            turn.begin()
        _turns.append(turn)
        end.callback(_turns.remove, turn)
        yield
        if not _lost:
            with contextlib.suppress(OSError):
                (folder / DONE).touch()


class _Turn:
    """When this process compiles: once no other one does. It says so, however late it finds that it must."""

    def __init__(
        self, tell: Callable[[str], None], kernels: Iterable[Any], lock: Path, end: contextlib.ExitStack
    ) -> None:
        self._tell, self._kernels, self._lock, self._end = tell, kernels, lock, end
        self._waited = self._begun = False

    def wait(self) -> None:
        """For the end of another process that compiles the same."""
        if not self._waited:
            self._waited = True
            told = "compiling kernels: another process is at it, waiting for its end"
            self._end.enter_context(alone(self._lock, lambda: self._tell(told)))

    def begin(self) -> None:
        if not self._begun:
            self._begun = True
            self._tell("compiling kernels: once on this machine for these sources, up to a minute")
            self._end.enter_context(counted(self._tell, self._kernels))


def kernel(function: Function) -> Function:
    """Compile `function` when first called: cached on disk, without the GIL, IEEE division, no NaN assumptions.

    Python and other kernels call it; of the latter each has its code as that of a stage.
    """
    if numba.config.DISABLE_JIT:
        return function
    compiled = _compiled(function, ForItself)
    compiled._cache = _NoCache(function) if cache_folder() is None else _Cache(function)
    compiled.typingctx._remove_global(compiled)
    compiled.typingctx.insert_global(compiled, _of_stage(function))  # what other kernels take it for
    return cast(Function, compiled)


def stage(function: Function) -> Function:
    """A function that kernels call compiled: its code goes into each of them. Python calls it as it is.

    Compiled, it can neither make an array nor return one that it was not given: nobody counts who refers to it.
    """
    return _into_callers(function)


def formula(function: Function) -> Function:
    """A `stage` that goes into each of its callers for sure: a few lines on lanes, which no call should interrupt."""
    return _into_callers(function, forceinline=True)


def exact(function: Function) -> Function:
    """A `stage` none of whose products and sums are fused: each is rounded by itself, as Python rounds it."""
    return _into_callers(function, fastmath=False)


def _into_callers(function: Function, **options: Any) -> Function:
    if not numba.config.DISABLE_JIT:
        infer_global(function, _of_stage(function, **options))
    return function


def _of_stage(function: Any, **options: Any) -> _OfTypes:
    """numba's type of a function whose code goes into its callers."""
    compiled = _compiled(function, ForCallers, no_cpython_wrapper=True, _nrt=False, **options)
    compiled._cache = _NoCache(function)
    goes_into_callers(function, compiled)
    return _OfTypes(compiled)


def _compiled(function: Any, where: type, **options: Any) -> Any:
    chosen = {"nogil": True, "error_model": "numpy", "fastmath": FASTMATH, "no_cfunc_wrapper": True}
    return numba.njit(pipeline_class=where, **chosen | options)(function)


class _OfTypes(types.Dispatcher):
    """A function that is compiled for the types of its arguments, and not once more for each literal."""

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Arguments by place and by name."""
        named = {name: unliteral(kind) for name, kind in kws.items()}
        return super().get_call_type(context, tuple(unliteral(kind) for kind in args), named)


register_model(_OfTypes)(models.OpaqueModel)


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Where numba keeps a function: by its name in `cache_folder`, fresh as long as `code_digest` is the same."""

    def __init__(self, function: Any) -> None:
        self._py_file = function.__code__.co_filename
        self._line = function.__code__.co_firstlineno
        self._outside = not Path(self._py_file).is_relative_to(_PACKAGE)

    def ensure_cache_path(self) -> None:
        """Raises OSError."""
        private(Path(self.get_cache_path()))

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def get_source_stamp(self) -> str:
        """A function from outside the package is not in the digest: its own file is looked at."""
        own = hashlib.sha256(Path(self._py_file).read_bytes()).hexdigest() if self._outside else ""
        return code_digest() + own

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Implementation(CompileResultCacheImpl):  # type: ignore[misc]
    """numba's way to write compiled functions, with our locator and no other."""

    def __init__(self, function: Any) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Locator(function)
        self._filename_base = self.get_filename_base(f"{function.__module__}.{function.__qualname__}", sys.abiflags)


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's cache of a function; files that cannot be read or written any more cost time, and no more."""

    _impl_class = _Implementation

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = Kept(
            Path(self._impl.locator.get_cache_path()), self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    @property
    def is_kept(self) -> bool:
        """Whether there is a file of it, for some arguments."""
        return self._cache_file.exists

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        loaded, damage = self._load(signature, target_context)
        if loaded is None and _turns:
            _turns[-1].wait()  # for another process that may be making it
            loaded, damage = self._load(signature, target_context)
        if damage:
            _mend(damage)
        if loaded is not None:
            is_there(self._py_func)
        elif _turns:
            _turns[-1].begin()
        return loaded

    def _load(self, signature: Any, target_context: Any) -> tuple[Any, str]:
        """What is in the cache and whole, else what is damaged."""
        try:
            return super().load_overload(signature, target_context), ""
        except DamagedError as error:
            return None, str(error)

    def save_overload(self, signature: Any, result: Any) -> None:
        try:
            super().save_overload(signature, result)
        except OSError as error:
            _cannot_keep(error)
        is_there(self._py_func)


class _NoCache(NullCache):  # type: ignore[misc]
    """Where there is no folder: nothing is kept, but what was compiled is known."""

    def __init__(self, function: Any) -> None:
        self._function = function

    def save_overload(self, signature: Any, result: Any) -> None:
        is_there(self._function)


def _mend(damage: str) -> None:
    """Where a part of the folder is damaged, others may be: all that is goes, to be compiled anew. Says so once."""
    folder = cache_folder()
    if folder is not None:
        if not _damaged:
            _log.warning("damaged kernels in %s are removed and compiled anew: %s", folder, damage)
        _damaged.append(damage)
        remove_damaged(folder)


def _cannot_keep(error: OSError) -> None:
    """Says so once."""
    why = error.strerror or str(error)
    if not _lost:
        _log.warning("compiled kernels cannot be kept in %s, later starts compile them anew: %s", cache_folder(), why)
    _lost.append(why)

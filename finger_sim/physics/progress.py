"""How many kernels are compiled, for those who wait for them."""

from __future__ import annotations

import contextlib
import dis
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from types import FunctionType, ModuleType
from typing import Any

from numba.core.dispatcher import Dispatcher

STEP = 5
"""Per cent of the kernels after which it is told anew how many are compiled."""

_watchers: list[Callable[[Any], None]] = []
"""Are told each Python function that was compiled or loaded."""
_there: set[Any] = set()
"""Those functions, so far."""
_told: list[Callable[[], Iterator[tuple[str, str]]]] = []
"""What other processes have told of since these were last called: see `is_told`."""
_in_callers: dict[Any, Any] = {}
"""Python functions whose compiled code goes into those that call them, and numba's versions: it does not keep them."""


def goes_into_callers(function: Any, compiled: Any) -> None:
    """The compiled code of a Python function does."""
    _in_callers[function] = compiled


def is_there(function: Any) -> None:
    """The machine code of a Python function is in this process."""
    _there.add(function)
    for watcher in _watchers:
        watcher(function)
    for told in _told:
        for module, name in told():
            is_told(module, name)


def tell_each(watcher: Callable[[Any], None]) -> None:
    """Tell it each Python function that is compiled or loaded from now on."""
    _watchers.append(watcher)


def is_told(module: str, name: str) -> None:
    """Another process has the machine code of the Python function of that name, and has kept it."""
    found = getattr(sys.modules.get(module), name, None)
    function = getattr(found, "py_func", found)
    for watcher in _watchers:
        watcher(function)


@contextlib.contextmanager
def also_told(told: Callable[[], Iterator[tuple[str, str]]]) -> Iterator[None]:
    """A block in which `told` is called now and then, for what `is_told` is to know."""
    _told.append(told)
    try:
        yield
    finally:
        _told.remove(told)


def called(functions: Iterable[Any]) -> set[Any]:
    """Python functions of kernels, and of all kernels that these call by a name of their module."""
    found, waiting = set[Any](), [*functions]
    while waiting:
        function = waiting.pop()
        if function not in found:
            found.add(function)
            waiting += _called_by(function)
    return found


@cache
def _called_by(function: Any) -> list[Any]:
    """Those that it calls itself."""
    code = list(dis.get_instructions(function))
    named = [function.__globals__.get(each.argval) for each in code if "GLOBAL" in each.opname]
    modules = [each for each in named if isinstance(each, ModuleType)]
    attributes = [each.argval for each in code if each.opname in ("LOAD_ATTR", "LOAD_METHOD")]
    named += [getattr(module, name, None) for module in modules for name in attributes]
    kernels = [each.py_func for each in named if isinstance(each, Dispatcher)]
    return kernels + [each for each in named if isinstance(each, FunctionType) and each in _in_callers]


@contextlib.contextmanager
def counted(tell: Callable[[str], None], kernels: Iterable[Any]) -> Iterator[None]:
    """Tells how many of the kernels and of those that they call are compiled, in per cent."""
    missing = called(kernel.py_func for kernel in kernels if isinstance(kernel, Dispatcher)) - called(_there)
    total, due = len(missing), STEP

    def watch(function: Any) -> None:
        nonlocal due
        missing.difference_update(called([function]))
        percent = 100 * (total - len(missing)) // max(total, 1)
        if total and percent >= due:
            due = percent - percent % STEP + STEP
            tell(f"compiling kernels: {percent} % of {total}")

    _watchers.append(watch)
    try:
        yield
    finally:
        _watchers.remove(watch)

"""How many kernels are compiled, for those who wait for them."""

from __future__ import annotations

import contextlib
import dis
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

from numba.core.dispatcher import Dispatcher

STEP = 5
"""Per cent of the kernels after which it is told anew how many are compiled."""

_watchers: list[Callable[[Any], None]] = []
"""Are told each Python function that was compiled or loaded."""
_there: set[Any] = set()
"""Those functions, so far."""


def is_there(function: Any) -> None:
    """The machine code of a Python function is in this process."""
    _there.add(function)
    for watcher in _watchers:
        watcher(function)


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
    names = {instruction.argval for instruction in dis.get_instructions(function) if "GLOBAL" in instruction.opname}
    named = (function.__globals__.get(name) for name in names)
    return [kernel.py_func for kernel in named if isinstance(kernel, Dispatcher)]


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

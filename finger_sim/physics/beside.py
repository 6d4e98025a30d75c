"""A second process that compiles one kernel while this one compiles others: a first start takes half as long.

It only fills the cache, from which this process loads. Whatever becomes of it: what is not there is compiled here.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from importlib import import_module
from queue import SimpleQueue
from typing import Any

from numba.core.serialize import dumps

from . import compile as compiling
from . import progress

_START = "import sys; sys.path[:] = {!r}; from finger_sim.physics import beside; beside.main()"
_RARELY = (20_000, 50, 100)
"""When garbage is looked for: the default takes a tenth of the time to compile."""


@contextlib.contextmanager
def compiled_beside(kernel: Any, kinds: tuple[Any, ...]) -> Iterator[None]:
    """A block during which a second process compiles a kernel for arguments of these numba types, if that is missing.

    The block ends once it has.
    """
    process = _begun(kernel, kinds)
    if process is None:
        yield
        return
    told = SimpleQueue[bytes]()
    reader = threading.Thread(target=_pass_on, args=(process.stdout, told), daemon=True)
    reader.start()
    try:
        with progress.also_told(lambda: _names(told, wait=False)):
            yield
        for module, name in _names(told, wait=True):
            progress.is_told(module, name)
    finally:
        process.kill()
        process.wait()
        reader.join()
        for stream in (process.stdin, process.stdout):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()


def _pass_on(stream: Any, told: SimpleQueue[bytes]) -> None:
    """Its lines, and an empty one at its end."""
    for line in stream:
        told.put(line)
    told.put(b"")


def _names(told: SimpleQueue[bytes], wait: bool) -> Iterator[tuple[str, str]]:
    """Module and name of each function that was told of; wait: until the end."""
    while wait or not told.empty():
        line = told.get()
        if not line:
            told.put(line)
            return
        module, name = line.decode().split()
        yield module, name


def _begun(kernel: Any, kinds: tuple[Any, ...]) -> subprocess.Popen[bytes] | None:
    """None where it would be of no use, or cannot be had."""
    folder = compiling.cache_folder()
    if folder is None or kernel._cache.is_kept or len(os.sched_getaffinity(0)) < 2 or not sys.executable:
        return None
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", _START.format(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
    assert process.stdin is not None
    with contextlib.suppress(OSError):
        process.stdin.write(dumps((str(folder), kernel.__module__, kernel.__name__, kinds)))
        process.stdin.flush()
    return process


def main() -> None:
    """The second process: compiles what it reads of, and writes a line for each function that is compiled.

    It ends when nobody could write to it any more.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # which the first process gets, too
    folder, module, name, kinds = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_input, daemon=True).start()
    kernel = getattr(import_module(module), name)
    gc.set_threshold(*_RARELY)
    if str(compiling.cache_folder()) == folder:
        progress.tell_each(lambda function: print(function.__module__, function.__name__, flush=True))
        kernel.compile(kinds)


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(0)

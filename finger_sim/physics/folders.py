"""Folders for files that are trusted like code: ours alone, kept while they are used, removed when they are old."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

KEPT, UNUSED = 20, 30 * 24 * 3600.0
"""So many folders of kernels stay at most (30 MB each), and none that was not used for so long [s]."""
ATTEMPTS = 5
"""Times that a folder is made again which another process removes at the same moment."""
PATIENCE = 300.0
"""Longest wait for another process [s]: one that is stopped must not stop this one for ever."""
POLL = 0.05
"""Time between two looks at a lock [s]."""
IN_USE = "in-use"
"""Locked in each folder, shared, by every process that uses it."""
_NAME, _REMOVING = re.compile(r"[0-9a-f]{16}"), re.compile(r"\.[0-9a-f]{16}\.\d+")

_held: list[int] = []
"""File descriptors of the folders in use: locked until the process ends."""


class UnsafeError(OSError):
    """Others own a folder, or can write to it."""


def private(folder: Path, close: bool = False) -> None:
    """Sees to it that the folder is there, and ours alone (0700); it and folders above are made where missing.

    close: a folder of ours that others could write to is closed to them. Only where all that is trusted in it is
    checked by itself; anything else may be theirs already, and is refused.
    Raises UnsafeError when others own it or can change it, OSError when it cannot be made.
    """
    for place in reversed([folder, *folder.parents]):
        with contextlib.suppress(FileExistsError):
            if not os.path.lexists(place):
                place.mkdir(0o700)
    if _checked(folder, close) & 0o077:
        folder.chmod(0o700)


def _checked(folder: Path, close: bool = False) -> int:
    """The mode of a folder that nobody else can change. Raises UnsafeError, OSError when it is not there."""
    for seen in (os.lstat(folder), os.stat(folder)):  # a link to it is to be ours too
        if seen.st_uid != os.geteuid():
            raise UnsafeError(f"{folder} belongs to user {seen.st_uid}")
    above = os.stat(folder.parent).st_mode
    if above & stat.S_IWOTH and not above & stat.S_ISVTX:
        raise UnsafeError(f"anyone can replace {folder}")
    if seen.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not close:
        raise UnsafeError(f"others can write to {folder}")
    return seen.st_mode


def use(home: Path, name: str) -> Path:
    """The folder `name` in `home`, private and writable, in use until this process ends; old ones beside it go.

    Raises UnsafeError or OSError when it cannot be.
    """
    private(home, close=True)
    folder = home / name
    new = not folder.exists()
    for _ in range(ATTEMPTS):
        with contextlib.suppress(FileNotFoundError):  # removed meanwhile, as an old one
            private(folder)
            tempfile.TemporaryFile(dir=folder).close()
            descriptor = os.open(folder / IN_USE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            _held.append(descriptor)
            _lock(descriptor, fcntl.LOCK_SH)
            if os.path.samestat(os.fstat(descriptor), os.stat(folder / IN_USE)):
                os.utime(folder)
                if new:
                    prune(home, folder)
                return folder
    raise FileNotFoundError(f"{folder} is removed as often as it is made")


def read_only(home: Path, name: str) -> Path:
    """The folder `name` in `home` as it is, for where nothing can be written; in use until this process ends.

    Raises UnsafeError, OSError when it is not there.
    """
    folder = home / name
    _checked(home)
    _checked(folder)
    with contextlib.suppress(OSError):
        _held.append(os.open(folder / IN_USE, os.O_RDONLY | os.O_NOFOLLOW))
        _lock(_held[-1], fcntl.LOCK_SH)
    return folder


def prune(home: Path, mine: Path) -> None:
    """Remove folders of kernels that are long unused, or more than KEPT; never one that a process uses."""
    used: list[tuple[float, Path]] = []
    doomed: list[Path] = []
    with contextlib.suppress(OSError):
        for folder in home.iterdir():
            with contextlib.suppress(OSError):
                seen = folder.lstat()
                if stat.S_ISDIR(seen.st_mode) and folder != mine:
                    if _REMOVING.fullmatch(folder.name):
                        doomed.append(folder)
                    elif _NAME.fullmatch(folder.name):
                        used.append((seen.st_mtime, folder))
    for place, (last, folder) in enumerate(sorted(used, reverse=True), start=1):
        many = place >= KEPT and os.path.exists(folder / IN_USE)  # else nobody knows whether the folder is in use
        if many or time.time() - last > UNUSED:
            doomed.append(folder)
    for folder in doomed:
        with contextlib.suppress(OSError):
            _remove(folder)


def _remove(folder: Path) -> None:
    """Whole or not at all for others. Raises OSError when it is in use, or not ours."""
    descriptor = os.open(folder / IN_USE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not _REMOVING.fullmatch(folder.name):
            folder = folder.rename(folder.with_name(f".{folder.name}.{os.getpid()}"))
        shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def alone(file: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """A block that one process at a time goes through; `waiting` is called when another is in it.

    The lock goes with the process that holds it, however that ends. After PATIENCE the block is entered all the same,
    and at once where no lock can be made.
    """
    descriptor = None
    with contextlib.ExitStack() as end:
        with contextlib.suppress(OSError):
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            end.callback(os.close, descriptor)
        if descriptor is not None:
            _lock(descriptor, fcntl.LOCK_EX, waiting)
        yield


def _lock(descriptor: int, kind: int, waiting: Callable[[], None] = lambda: None) -> None:
    """Waits for a lock, for PATIENCE at most; on a file system without locks there is none."""
    until, told = time.monotonic() + PATIENCE, False
    while time.monotonic() < until:
        try:
            fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if not told:
                waiting()
                told = True
            time.sleep(POLL)
        except OSError:
            return

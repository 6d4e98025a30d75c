"""Compiled functions in files: nothing is loaded that is not, byte for byte, what was written.

A damaged file of machine code raises no error: it ends the process, or computes something else.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import tempfile
from collections.abc import Hashable
from pathlib import Path
from typing import Any

from numba.core.serialize import dumps

_DIGEST = hashlib.sha256().digest_size
_IN_NAME = 16
"""Hexadecimal digits of its digest in the name of a file: enough to tell the versions of a function apart."""


class DamagedError(Exception):
    """A file cannot be read, or is not what was written."""


class Kept:
    """The compiled versions of one function in a folder; numba asks for them and saves them by `load` and `save`.

    An index (.nbi) begins with the digest of the rest of it. It names the version of each key by the digest of its
    file (.nbc), whose name is made of that digest: two processes that write at once never give one name to two files.
    The worst that they do is to leave a version out of the index.
    """

    def __init__(self, folder: Path, name: str, stamp: str) -> None:
        """stamp: versions that were saved with another one are none."""
        self._folder, self._name, self._stamp = folder, name, stamp
        self._index = folder / f"{name}.nbi"

    @property
    def exists(self) -> bool:
        """Whether a version was saved, under whatever stamp."""
        return os.path.exists(self._index)  # no, also in a folder that is closed to us

    def load(self, key: Hashable) -> Any:
        """What was saved, None when nothing was. Raises DamagedError."""
        digest = self._versions().get(key)
        if digest is None:
            return None
        file = self._file(digest)
        content = _content(file)
        return None if content is None else _unpickled(file, content, digest)

    def save(self, key: Hashable, data: Any) -> None:
        """Raises OSError when it cannot be written; what was saved before stays then."""
        content = dumps(data)
        digest = hashlib.sha256(content).digest()
        _write(self._file(digest), content)
        versions = {}
        with contextlib.suppress(DamagedError):
            versions = self._versions()
        index = dumps((self._stamp, versions | {key: digest}))
        _write(self._index, hashlib.sha256(index).digest() + index)

    def _file(self, digest: bytes) -> Path:
        return self._folder / f"{self._name}.{digest.hex()[:_IN_NAME]}.nbc"

    def _versions(self) -> dict[Hashable, bytes]:
        """Digest of each version. Raises DamagedError."""
        content = _content(self._index)
        if content is None:
            return {}
        stamp, versions = _unpickled(self._index, content[_DIGEST:], content[:_DIGEST])
        return versions if stamp == self._stamp else {}


def remove_damaged(folder: Path) -> None:
    """Files of a folder that are not whole go, where they can; processes that use it go on with what they loaded.

    What an index named goes with it: nothing would name it any more.
    """
    damaged = [file for file in folder.glob("*.nb[ic]") if not _whole(file)]
    unnamed = [file for index in damaged if index.suffix == ".nbi" for file in folder.glob(f"{index.stem}.*.nbc")]
    for file in damaged + unnamed:
        with contextlib.suppress(OSError):
            file.unlink()


def _whole(file: Path) -> bool:
    try:
        content = _content(file) or b""
    except DamagedError:
        return False
    if file.suffix == ".nbi":
        return hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]
    return hashlib.sha256(content).hexdigest()[:_IN_NAME] == file.stem.rpartition(".")[2]


def _content(file: Path) -> bytes | None:
    """None without a file. Raises DamagedError."""
    try:
        return file.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise DamagedError(f"{file.name}: {error.strerror}") from error


def _unpickled(file: Path, content: bytes, digest: bytes) -> Any:
    """Raises DamagedError when the digest is another one, or the content means nothing here."""
    if hashlib.sha256(content).digest() != digest:
        raise DamagedError(f"{file.name} is not what was written")
    try:
        return pickle.loads(content)
    except Exception as error:  # anything may be raised for what another environment wrote
        raise DamagedError(f"{file.name}: {error}") from error


def _write(file: Path, content: bytes) -> None:
    """Whole or not at all, also for processes that read meanwhile. Raises OSError."""
    descriptor, part = tempfile.mkstemp(prefix=f"{file.name}.", dir=file.parent)
    try:
        with open(descriptor, "wb") as stream:
            stream.write(content)
        os.replace(part, file)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part)
        raise

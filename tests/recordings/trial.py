"""One recording with changed bytes: how it is made, and whether our readers take it as they must."""

from __future__ import annotations

import contextlib
import shutil
import time
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from .changes import Change, changed
from .content import START, Content, plain
from .damage import chunks, killed
from .formats import FORMATS, Format, Recording, write

COMMANDS_EACH = 24
"""Commands in a recording that is tried: few, as many recordings are."""
LATER = 250_000_000
"""Time from a recording to the one that is spliced into it [ns]."""
KILLED = {"db3 killed": Format("sqlite3", folder=False), "db3 killed in folder": Format("sqlite3", metadata=False)}
"""Recordings whose recorder was killed: most of them is in the log beside the database."""
TRIED: dict[str, Format] = FORMATS | KILLED


class Case(NamedTuple):
    """Changes of one file of a recording in a format, counted from 0; metadata.yaml is the last."""

    format: str
    file: int
    changes: tuple[Change, ...]


class Outcome(NamedTuple):
    """How a case went."""

    word: str
    """"whole", "warned", "unnoticed" (not what was put in, and nothing tells), "refused" or "failed"."""
    seconds: float = 0.0
    memory: int = 0
    """Most that it took beyond what the process had before [byte]."""
    reason: str = ""
    """Why it failed: the kind of failure, and all that is known."""


@dataclass
class _Ready:
    """A whole recording, ready to be changed, and another of the same format to splice into it."""

    recording: Recording
    files: list[Path]
    others: list[bytes]
    put: Counter[tuple[str, str, int, bytes]]
    spliced: set[tuple[str, str, int, bytes]]


class Trials:
    """Makes the recordings of cases, and tries our readers on them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._ready: dict[str, _Ready] = {}

    def ready(self, name: str) -> _Ready:
        if name not in self._ready:
            one, other = self._content(0), self._content(LATER)
            place = self.folder / f"whole{len(self._ready)}"
            recording = self._write(name, place / "one", one)
            files = self._files(recording)
            another = self._write(name, place / "other", other)
            self._ready[name] = _Ready(
                recording,
                files,
                [path.read_bytes() for path in self._files(another)],
                Counter(m.seen for m in one.put),
                {m.seen for m in other.put},
            )
        return self._ready[name]

    @staticmethod
    def _content(later: int) -> Content:
        put = [m for m in plain().put if m.log_time < START + COMMANDS_EACH * 10_000_000]
        return Content(tuple(m._replace(log_time=m.log_time + later, data=_other(m.data, later)) for m in put))

    @staticmethod
    def _write(name: str, folder: Path, content: Content) -> Recording:
        if name in KILLED:
            return killed(folder, TRIED[name], content, len(content.put) // 3)
        return write(TRIED[name], folder, content)

    @staticmethod
    def _files(recording: Recording) -> list[Path]:
        """The files of a recording that are changed: its own, a log beside them, and metadata.yaml."""
        logs = [path.with_name(f"{path.name}-wal") for path in recording.files]
        metadata = recording.path / "metadata.yaml"
        return [*recording.files, *(path for path in (*logs, metadata) if path.is_file())]

    def make(self, case: Case) -> tuple[_Ready, Path, bytes]:
        """The changed recording, and the bytes of the file that was changed."""
        ready = self.ready(case.format)
        number = case.file % len(ready.files)
        data = ready.files[number].read_bytes()
        for change in case.changes:
            data = changed(data, change, ready.others[number])
        root = ready.recording.path if ready.recording.path.is_dir() else ready.recording.path.parent
        place = self.folder / "changed"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        for path in root.iterdir():
            if path.is_file():
                shutil.copyfile(path, place / path.name)
        (place / ready.files[number].name).write_bytes(data)
        return ready, place if ready.recording.path.is_dir() else place / ready.recording.path.name, data

    def run(self, case: Case) -> Outcome:
        """Reads the changed recording in every way; AssertionError and all but FingerSimError is a failure."""
        from finger_sim.errors import FingerSimError

        ready, path, data = self.make(case)
        begin, memory = time.process_time(), _memory_from_here()
        try:
            try:
                word = self._read(case, ready, path, data)
            except FingerSimError as error:
                _assert_clear(error, path)
                word = "refused"
            self._use(path, whole=word == "whole" and ready.recording.format.covered)
        except AssertionError as error:
            return Outcome("failed", reason=f"{error}")
        except Exception as error:
            frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "finger_sim/" in frame.filename]
            where = f"{'/'.join(frames[-1].filename.rsplit('/', 3)[1:])}:{frames[-1].lineno}" if frames else "?"
            return Outcome("failed", reason=f"{type(error).__name__} at {where}: {str(error)[:200]}")
        return Outcome(word, time.process_time() - begin, _memory_peak() - memory)

    def _read(self, case: Case, ready: _Ready, path: Path, data: bytes) -> str:
        """All messages, and the commands of a replay, as they must be."""
        from finger_sim.bags.reader import BagReader, commands_of
        from finger_sim.errors import FingerSimError

        from .judges import assert_agrees, seen

        reader = BagReader(path)
        messages = list(reader)
        assert_agrees(reader, messages)
        with contextlib.suppress(FingerSimError):
            times = commands_of(reader).receipt_ns
            assert (times[1:] >= times[:-1]).all(), "times of receipt fall"
        read = Counter(seen(messages))
        known = {*ready.put, *(ready.spliced if any(change.kind == "splice" for change in case.changes) else ())}
        if allowed := _strange_allowed(case, ready, data):  # one byte may change the name or the type of a topic
            strange = [each for each in read if each[3] not in {data for *_, data in known}]
        else:
            strange = [each for each in read if each not in known]
        assert len(strange) <= allowed, f"strange messages: {len(strange)}, allowed {allowed}: {strange[0]}"
        if reader.warning or reader.notes:
            return "warned"
        if read == ready.put:
            return "whole"
        intact = ready.recording.format.folder and ready.recording.format.metadata and not _of_metadata(case, ready)
        missing = ready.put.total() - read.total()
        assert not (intact and missing > 0), f"silent loss: {missing} messages that metadata.yaml counts"
        return "unnoticed"

    def _use(self, path: Path, whole: bool) -> None:
        """What users do with it: a comparison with the same in another format, and `info`."""
        from finger_sim.bags.compare import compare
        from finger_sim.errors import FingerSimError
        from finger_sim.pictures.info import info

        with contextlib.suppress(FingerSimError):
            found = compare(path, self.ready("mcap bare").recording.path)
            assert not whole or found.equal, "compare: not equal though the same was read"
        with contextlib.suppress(FingerSimError):
            list(info(str(path)))


def _other(data: bytes, later: int) -> bytes:
    """Other bytes of the same length: a stamp that is later."""
    return data[:8] + later.to_bytes(4, "little") + data[12:] if later else data


def _of_metadata(case: Case, ready: _Ready) -> bool:
    return ready.files[case.file % len(ready.files)].name == "metadata.yaml"


def _strange_allowed(case: Case, ready: _Ready, data: bytes) -> int:
    """How many messages that were not put in may be read: none where a checksum covers them.

    Else as many as a change can hit: one that moves bytes hits what is behind it.
    """
    format = ready.recording.format
    if _of_metadata(case, ready):
        return 0
    if format.covered and (format.outside or not any(chunk.checksum == 0 for chunk in chunks(data))):
        return 0
    moved = any(change.kind in ("delete", "insert", "double", "splice") for change in case.changes)
    if moved or format.outside or format.storage == "sqlite3":
        return ready.put.total()
    return sum(2 + (change.length if change.kind == "zero" else 0) // 8 for change in case.changes)


def _assert_clear(error: Exception, path: Path) -> None:
    """A user can see which recording it is about."""
    text = str(error)
    assert str(path) in text, f"an error without the path: {text}"
    assert "Traceback" not in text
    assert len(text) < 4000, f"an error of {len(text)} letters: {text[:200]}"


def _memory_from_here() -> int:
    """What the process has [byte]; its peak begins anew."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return status("VmRSS")


def _memory_peak() -> int:
    return status("VmHWM")


def status(name: str) -> int:
    """A size from /proc [byte]; 0 where there is none."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(f"{name}:"):
                return int(line.split()[1]) << 10
    return 0

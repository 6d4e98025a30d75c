"""One recording with changed bytes: how it is made, and whether our readers take it as they must.

A trial runs in a process of its own, whose memory and time are bounded: one that hangs or takes too much ends there.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from .content import START, Content, plain
from .damage import MAGIC, chunks, killed, records
from .formats import CODECS, FORMATS, Format, Recording, write

COMMANDS_EACH = 24
"""Commands in a recording that is tried: few, as many recordings are."""
LATER = 250_000_000
"""Time from a recording to the one that is spliced into it [ns]."""
MOST_MEMORY = 2 << 30
"""What the process of a trial may take beyond what it has at its beginning [byte]."""
MOST_SECONDS, LONGEST_WAIT = 20, 120
"""Time on its core, and by the clock, after which a trial hangs [s]."""

BOMB = 1 << 29
"""Bytes that a compressed chunk turns out to have."""

KILLED = {"db3 killed": Format("sqlite3", folder=False), "db3 killed in folder": Format("sqlite3", metadata=False)}
"""Recordings whose recorder was killed: most of them is in the log beside the database."""
TRIED: dict[str, Format] = FORMATS | KILLED

KINDS = ("flip", "byte", "cut", "zero", "delete", "insert", "double", "number", "text", "splice")
NUMBERS = (0, 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63, 2**64 - 1)
"""What stands where a length or a count should be."""
TEXTS = (
    "", "null", "[]", "{}", "-1", "1e999", "9" * 5000, "2026-13-45", "!!python/object:os.system x", "*a", "&a [*a]",
    '"\\ud800"', "yes", "\x00", "[" * 3000, ".nan", "0x", "? a", "'", "../../etc/passwd", "recording_0.mcap", "zstd",
    "FILE", "MESSAGE", "sqlite3", "mcap",
)  # fmt: skip
"""What stands for a value in a metadata.yaml."""


class Change(NamedTuple):
    """One change of a file's bytes; `at`, `length` and `value` are taken as far as they fit."""

    kind: str
    at: int
    length: int
    value: int


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


def changed(data: bytes, change: Change, other: bytes) -> bytes:
    """The bytes after a change; `other` are those that are spliced in."""
    at = change.at % (len(data) + 1)
    length = 1 + change.length % max(1, len(data))
    head, rest = data[:at], data[at:]
    if change.kind == "number":
        places = marks(data)
        at, width = places[change.at % len(places)]
        number = NUMBERS[change.value % len(NUMBERS)] & ((1 << 8 * width) - 1)
        order = "big" if data.startswith(b"SQLite") else "little"
        return data[:at] + number.to_bytes(width, order) + data[at + width :]
    if change.kind == "bomb":
        return with_bomb(data, change.at)
    if change.kind == "text":
        lines = data.split(b"\n")
        line = lines[change.at % len(lines)]
        text = TEXTS[change.value % len(TEXTS)].encode(errors="surrogatepass")
        lines[change.at % len(lines)] = line.partition(b":")[0] + b": " + text if b":" in line else text
        return b"\n".join(lines)
    return {
        "flip": head + bytes([rest[0] ^ 1 << change.value % 8] if rest else []) + rest[1:],
        "byte": head + bytes([change.value] if rest else []) + rest[1:],
        "cut": head,
        "zero": head + bytes(len(rest[:length])) + rest[length:],
        "delete": head + rest[length:],
        "insert": head + bytes((change.value + 37 * i) % 256 for i in range(length)) + rest,
        "double": head + rest[:length] + rest,
        "splice": head + other[at:],
    }[change.kind]


def with_bomb(data: bytes, number: int) -> bytes:
    """An MCAP file one of whose chunks is of many zeros, and says that it has few bytes."""
    chunk = chunks(data)[number]
    name = data[chunk.begin + 41 : chunk.inside - 8]
    zeros = bytes(BOMB >> 3)
    body = b"".join([CODECS["zstd" if name == b"zstd" else "lz4"](zeros)] * 8)
    head = data[chunk.begin + 9 : chunk.inside - 8] + len(body).to_bytes(8, "little")
    record = b"\x06" + (len(head) + len(body)).to_bytes(8, "little") + head + body
    return data[: chunk.begin] + record + data[chunk.end :]


def marks(data: bytes) -> list[tuple[int, int]]:
    """Where lengths and counts stand in a file, and how many bytes they have."""
    found: list[tuple[int, int]] = []
    if data.startswith(MAGIC):
        found += [(record.begin + 1, 8) for record in records(data)]
        for chunk in chunks(data):
            found += [(chunk.begin + 25, 8), (chunk.begin + 33, 4), (chunk.begin + 37, 4), (chunk.inside - 8, 8)]
        found += [(record.begin + 9 + i, 4) for record in records(data) if record.opcode in (3, 4) for i in (2, 4, 8)]
    elif data.startswith(b"SQLite"):
        found += [(16, 2), (20, 1), *((place, 4) for place in (24, 28, 32, 36, 40, 44, 52, 56, 60))]
        for page in range(0, len(data), 4096):
            head = page or 100
            found += [(head + place, 2) for place in (1, 3, 5, 8, 10, 12, 14)] + [(head + 8, 4), (page + 4090, 4)]
    found += [(place, 4) for place in range(0, 36, 4)]
    return [(at, width) for at, width in found if at + width <= len(data)] or [(0, 0)]


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
    return _status("VmRSS")


def _memory_peak() -> int:
    return _status("VmHWM")


def _status(name: str) -> int:
    """A size from /proc [byte]; 0 where there is none."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(f"{name}:"):
                return int(line.split()[1]) << 10
    return 0


def _serve(connection: Connection) -> None:
    """Tries one case after another until there is no more."""
    with tempfile.TemporaryDirectory(prefix="recordings_") as folder:
        trials = Trials(Path(folder))
        trials.run(Case("mcap", 0, ()))
        warnings.simplefilter("error", RuntimeWarning)  # numpy would print that of numbers that are none
        limit = _status("VmSize") + MOST_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        while case := connection.recv():
            signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
            outcome = trials.run(case)
            signal.setitimer(signal.ITIMER_PROF, 0)
            connection.send(outcome)


class Court:
    """A process that tries cases. Where a case ends it, the next has a new one."""

    def __init__(self) -> None:
        self._process: multiprocessing.process.BaseProcess | None = None
        self._connection: Connection | None = None

    def __enter__(self) -> Court:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None and self._connection is not None:
            with contextlib.suppress(OSError):
                self._connection.send(None)
            self._process.join(5)
            self._process.kill()
            self._process.join()
        self._process = self._connection = None

    def judge(self, case: Case) -> Outcome:
        """How a case goes."""
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self._connection, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
        assert self._connection is not None
        try:
            self._connection.send(case)
            if not self._connection.poll(LONGEST_WAIT):
                self._process.kill()
            outcome: Outcome = self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            code = self._process.exitcode
            self._process = self._connection = None
            ends = {-signal.SIGPROF: "it hangs", -signal.SIGKILL: "it hangs"}
            return Outcome("failed", reason=ends.get(code or 0, f"its process ended with {code}"))
        return outcome


def smaller(case: Case) -> Iterator[Case]:
    """Cases that are simpler than one."""
    for i, change in enumerate(case.changes):
        before, after = case.changes[:i], case.changes[i + 1 :]
        if before or after:
            yield case._replace(changes=before + after)
        for length in {0, change.length // 2, change.length - 1} - {change.length, -1}:
            yield case._replace(changes=(*before, change._replace(length=length), *after))
        if change.value:
            yield case._replace(changes=(*before, change._replace(value=0), *after))


def smallest(case: Case, fails: Sequence[str], court: Court) -> Case:
    """The simplest case that fails with the same kind of failure."""
    found = next((each for each in smaller(case) if kind_of_failure(court.judge(each)) in fails), None)
    return case if found is None else smallest(found, fails, court)


def kind_of_failure(outcome: Outcome) -> str:
    """What failures have in common: the words before the details."""
    return outcome.reason.partition(": ")[0] if outcome.word == "failed" else ""

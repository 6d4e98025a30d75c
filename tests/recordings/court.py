"""A process that tries cases, whose memory and time are bounded: a case that takes too much ends it, not the tests."""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import signal
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

from .trial import Case, Outcome, Trials, status

MOST_MEMORY = 2 << 30
"""What the process of a trial may take beyond what it has at its beginning [byte]."""
MOST_SECONDS, LONGEST_WAIT = 20, 120
"""Time on its core, and by the clock, after which a trial hangs [s]."""


def _serve(connection: Connection) -> None:
    """Tries one case after another until there is no more."""
    with tempfile.TemporaryDirectory(prefix="recordings_") as folder:
        trials = Trials(Path(folder))
        trials.run(Case("mcap", 0, ()))
        warnings.simplefilter("error", RuntimeWarning)  # numpy would print that of numbers that are none
        limit = status("VmSize") + MOST_MEMORY
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

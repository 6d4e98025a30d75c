"""Changed bytes in recordings of every format: never a traceback, a hang, or memory without bound."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from recordings.fuzz import QUIET, cases_of
from recordings.trial import TRIED, Case, Court

CASES = 10
"""Of each format; `python -m tests.recordings.fuzz` tries thousands."""


@pytest.fixture(scope="module")
def court() -> Iterator[Court]:
    with Court() as court:
        yield court


@pytest.mark.parametrize("name", TRIED)
def test_unchanged_recordings_are_whole(name: str, court: Court) -> None:
    outcome = court.judge(Case(name, 0, ()))
    assert outcome.word == "whole", outcome.reason


@pytest.mark.parametrize("name", TRIED)
def test_changed_recordings_are_read_or_refused(name: str, court: Court) -> None:
    """Read whole, read with a warning, or refused by a clear error."""

    @settings(QUIET, max_examples=CASES)
    @given(cases_of(name))
    def each(case: Case) -> None:
        outcome = court.judge(case)
        assert outcome.word != "failed", outcome.reason

    each()

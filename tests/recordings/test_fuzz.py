"""Changed bytes in recordings of every format: never a traceback, a hang, or memory without bound."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given, seed, settings
from recordings.changes import TEXTS, Change
from recordings.court import Court
from recordings.formats import FORMATS
from recordings.fuzz import QUIET, cases_of
from recordings.trial import TRIED, Case

CASES = 10
"""Of each format; `python -m tests.recordings.fuzz` tries thousands."""

MOST_OF_A_CHUNK = 100 << 20
"""What a small recording may take to read [byte]."""

FOUND = [
    Case("db3 killed in folder", 0, (Change("byte", 4095, 0, 0x84),)),  # no UTF-8 in what sqlite3 says of it
    Case("db3 unknown type", 0, (Change("zero", 5074, 33, 0),)),  # a pose that is no turn is compared
    Case("mcap unchunked", 0, (Change("text", 10641, 0, 106),)),  # a pose that is beyond all numbers is compared
    Case("db3 zstd file", 1, (Change("flip", 4281, 0, 0),)),  # topics seem to be of another serialization
    Case("mcap zstd file bare", 0, (Change("zero", 481, 11, 0),)),  # a chunk loses its checksum
]
"""Rare ones among many thousands."""


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

    @seed(sorted(TRIED).index(name))
    @settings(QUIET, max_examples=CASES)
    @given(cases_of(name))
    def each(case: Case) -> None:
        outcome = court.judge(case)
        assert outcome.word != "failed", outcome.reason

    each()


@pytest.mark.parametrize("case", FOUND, ids=str)
def test_cases_that_once_failed(case: Case, court: Court) -> None:
    outcome = court.judge(case)
    assert outcome.word != "failed", outcome.reason


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_takes_no_more_memory_than_it_says(compression: str, court: Court) -> None:
    """It says 1 KiB and would be half a gigabyte."""
    outcome = court.judge(Case(f"mcap {compression}", 0, (Change("bomb", 2, 0, 0),)))
    assert outcome.word == "warned", outcome.reason
    assert outcome.memory < MOST_OF_A_CHUNK


@pytest.mark.parametrize("name", ["mcap split", "db3 zstd messages"])
def test_any_words_in_metadata(name: str, court: Court) -> None:
    """Each of some texts that are no value, at three places."""
    behind_the_others = FORMATS[name].files
    for number in range(len(TEXTS)):
        for place in range(3):
            change = Change("text", 7 * number + 13 * place, 0, number)
            outcome = court.judge(Case(name, behind_the_others, (change,)))
            assert outcome.word != "failed", f"{TEXTS[number][:20]!r}: {outcome.reason}"

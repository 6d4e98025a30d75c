"""Thousands of recordings with changed bytes: `python -m tests.recordings.fuzz --cases 20000` prints figures.

Each is read whole, read with a warning or a note, or refused with a clear error. Where no checksum covers the bytes
that changed, it may be read unnoticed. Anything else is a failure, and printed in its smallest form; the exit code is
then 1.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from .changes import KINDS, Change
from .court import Court, kind_of_failure, smallest
from .trial import TRIED, Case, Outcome

FARTHEST = 1 << 16
"""Beyond the longest of the files: places are taken modulo their length."""

changes = st.builds(
    Change,
    kind=st.sampled_from(KINDS),
    at=st.integers(0, FARTHEST),
    length=st.one_of(st.integers(0, 16), st.integers(0, 4096)),
    value=st.integers(0, 255),
)


def cases_of(format: str) -> st.SearchStrategy[Case]:
    """Cases of one format."""
    some = st.lists(changes, min_size=1, max_size=3).map(tuple)
    return st.builds(Case, format=st.just(format), file=st.integers(0, 3), changes=some)


QUIET = settings(database=None, deadline=None, suppress_health_check=list(HealthCheck), print_blob=False)


def run(count: int, number: int, court: Court) -> list[tuple[Case, Outcome]]:
    """That many cases and their outcomes, as many of each format."""
    tried: list[tuple[Case, Outcome]] = []
    for place, format in enumerate(sorted(TRIED)):

        @seed(number * len(TRIED) + place)
        @settings(QUIET, max_examples=-(-count // len(TRIED)), phases=[Phase.generate])
        @given(cases_of(format))
        def each(case: Case) -> None:
            tried.append((case, court.judge(case)))

        each()
    return tried


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    begin = time.monotonic()
    with Court() as court:
        tried = run(options.cases, options.seed, court)
        words = Counter((case.format, outcome.word) for case, outcome in tried)
        columns = ("whole", "warned", "unnoticed", "refused", "failed")
        print(f"{'format':30}", *(f"{column:>10}" for column in columns))
        for format in sorted(TRIED):
            print(f"{format:30}", *(f"{words[format, column]:10}" for column in columns))
        print(f"{'all':30}", *(f"{sum(words[each, column] for each in TRIED):10}" for column in columns))
        slowest = max(tried, key=lambda item: item[1].seconds)
        largest = max(tried, key=lambda item: item[1].memory)
        print(f"{len(tried)} cases in {time.monotonic() - begin:.0f} s")
        print(f"slowest: {slowest[1].seconds:.3f} s, {slowest[0]}")
        print(f"largest: {largest[1].memory / 2**20:.1f} MiB beyond what the process had, {largest[0]}")
        kinds: dict[str, list[tuple[Case, Outcome]]] = {}
        for case, outcome in tried:
            if outcome.word == "failed":
                kinds.setdefault(kind_of_failure(outcome), []).append((case, outcome))
        for kind, found in kinds.items():
            case = smallest(min((case for case, _ in found), key=lambda case: len(case.changes)), [kind], court)
            print(f"FAILED {len(found)} times: {kind}\n  {case}\n  {court.judge(case).reason}")
    return 1 if kinds else 0


if __name__ == "__main__":
    raise SystemExit(main())

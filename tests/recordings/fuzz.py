"""Thousands of recordings with changed bytes: `python -m tests.recordings.fuzz --cases 20000` prints figures.

Each is read whole, read with a warning, or refused with a clear error. Anything else is a failure, and printed in its
smallest form; the exit code is then 1.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from .trial import KINDS, TRIED, Case, Change, Court, Outcome, kind_of_failure, smallest

FARTHEST = 1 << 16
"""Beyond the longest of the files: places are taken modulo their length."""

changes = st.builds(
    Change,
    kind=st.sampled_from(KINDS),
    at=st.integers(0, FARTHEST),
    length=st.one_of(st.integers(0, 16), st.integers(0, 4096)),
    value=st.integers(0, 255),
)
cases = st.builds(
    Case,
    format=st.sampled_from(sorted(TRIED)),
    file=st.integers(0, 3),
    changes=st.lists(changes, min_size=1, max_size=3).map(tuple),
)

QUIET = settings(
    database=None, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True, print_blob=False
)


def run(count: int, number: int, court: Court) -> tuple[Counter[tuple[str, str]], list[tuple[Case, Outcome]]]:
    """Outcomes of that many cases by format and word, and the cases in the order in which they were tried."""
    words: Counter[tuple[str, str]] = Counter()
    tried: list[tuple[Case, Outcome]] = []

    @seed(number)
    @settings(QUIET, max_examples=count, derandomize=False, phases=[Phase.generate])
    @given(cases)
    def each(case: Case) -> None:
        outcome = court.judge(case)
        words[case.format, outcome.word] += 1
        tried.append((case, outcome))

    each()
    return words, tried


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    begin = time.monotonic()
    with Court() as court:
        words, tried = run(options.cases, options.seed, court)
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

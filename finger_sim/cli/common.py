"""What all verbs share: exit codes, how a verb is declared, and how its arguments are read."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

DONE, FAILED, MISTAKE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143
"""Exit codes: done, a part of it failed, a user's mistake, SIGINT, SIGTERM."""


def verb(
    verbs: Any,
    name: str,
    work: Callable[[argparse.Namespace], int] | None,
    what: str,
    example: str,
    usage: str | None = None,
    more: str = "",
) -> argparse.ArgumentParser:
    """A subcommand, with what it does, `more` on it, and an example in its help."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        usage=usage,
        help=what,
        description=f"{what[0].upper()}{what[1:]}.\n{more}".rstrip(),
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if work is not None:
        parser.set_defaults(verb=work)
    return parser


def positive(text: str) -> float:
    """A finite number > 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a finite number > 0")
    return value


def from_zero(text: str) -> float:
    """A finite number >= 0."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a finite number >= 0")
    return value


def count(text: str) -> int:
    """A whole number from 0 on."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 0 on")
    return int(text)


def one_or_more(text: str) -> int:
    """A whole number from 1 on."""
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 1 on")
    return int(text)


def priority(text: str) -> int:
    """A whole number from 0 to 99."""
    if not (text.isdecimal() and int(text) < 100):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 0 to 99")
    return int(text)


def assignment(text: str) -> tuple[str, str]:
    """COLUMN=VALUE: the column, and the value as it was written."""
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: COLUMN=VALUE")
    return name.strip(), value.strip()


def number_assignment(text: str) -> tuple[str, float]:
    """COLUMN=VALUE with a number."""
    name, value = assignment(text)
    try:
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{name}: got {value!r}, allowed: a number") from None

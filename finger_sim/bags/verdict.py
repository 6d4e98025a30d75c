"""What a comparison of two bags found, as a table and in words."""

from __future__ import annotations

from rich.table import Table

from ..console import table
from .comparison import Comparison, Difference, TopicComparison


def verdict(found: Comparison) -> list[Table | str]:
    """A table of what differs, what was compared and why not more, lags, and the verdict as the last line."""
    rows = table(
        "topic", "messages of A", "of B", "compared", "identical", "quantity", "rms", "max", "at [s]", "peak of A",
        "first difference",
    )  # fmt: skip
    for topic in found.topics:
        head = (found.label(topic), *map(str, topic.messages), str(topic.compared), "yes" if topic.identical else "no")
        first = topic.first or ""
        shown = [_numbers(difference) for difference in topic.differences] if topic.compared else []
        for numbers in shown or [("",) * 5]:
            rows.add_row(*head, *numbers, first)
            head, first = ("",) * 5, ""
    lags = [text for topic in found.topics for text in _lag(topic, found.label(topic))]
    return [rows, *_counts(found), *lags, *_left_out(found), _judgement(found)]


def _counts(found: Comparison) -> list[str]:
    """How many messages of how many were compared, where that is not all; topics with the same numbers in one line."""
    names: dict[str, list[str]] = {}
    for topic in found.topics:
        if topic.compared and sum(topic.outside):
            names.setdefault(_count(topic), []).append(found.label(topic))
    return [f"{', '.join(of_text)}: {text}" for text, of_text in names.items()]


def _count(topic: TopicComparison) -> str:
    reasons = [
        f"{count:,} of {one} {'begin before the first' if side == 0 else 'come after the last'} of {other}"
        for one, other, k in (("A", "B", 0), ("B", "A", 1))
        for side, count in enumerate((topic.before[k], topic.after[k]))
        if count
    ]
    return f"compared {topic.compared:,} of {topic.messages[0]:,} messages: {', '.join(reasons)}"


def _lag(topic: TopicComparison, label: str) -> list[str]:
    """How B lies in time, where the two are not the same."""
    lag = topic.lag
    if lag is None or lag.rms == 0.0:
        return []
    quantity = topic.differences[0]
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    size = f"{1e3 * abs(lag.seconds):.2f} ms{' or more' if lag.beyond else ''}"
    return [
        f"{label}: B lies {size} {'before' if lag.seconds < 0.0 else 'after'} A; with that lag taken out, "
        f"{quantity.quantity} differs by {lag.rest:.3g}{unit} (rms) instead of {lag.rms:.3g}{unit}"
    ]


def _left_out(found: Comparison) -> list[str]:
    """What was not compared, and why."""
    if not found.left_out:
        return []
    names: dict[str, list[str]] = {}
    for topic in found.left_out:
        names.setdefault(topic.reason, []).append(found.label(topic))
    texts = [f"{', '.join(of_reason)} ({reason})" for reason, of_reason in names.items()]
    return [f"left out: {'; '.join(texts)}; --all compares them too"]


def _judgement(found: Comparison) -> str:
    how = "bit by bit" if found.tolerance is None else f"within {found.tolerance:g}"
    if found.equal:
        return f"equal {how}"
    if not found.topics:
        return "not equal: nothing was compared"
    different = [topic for topic in found.topics if not topic.equal]
    text = f"not equal {how}: {', '.join(found.label(topic) for topic in different)}"
    if found.tolerance is None and any(sum(topic.outside) for topic in different):
        text += "; --tolerance X --overlap tells whether what they measure is within X"
    return text


def _numbers(difference: Difference) -> tuple[str, ...]:
    unit = "" if difference.unit == "1" else f" {difference.unit}"
    at = f"{difference.max_time:.6f}" if difference.max > 0.0 else ""
    return (
        difference.quantity,
        f"{difference.rms:.3g}{unit}",
        f"{difference.max:.3g}{unit}",
        at,
        f"{difference.peak:.3g}{unit}",
    )

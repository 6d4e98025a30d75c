"""When messages were received, as the node records it."""

from __future__ import annotations

import time

from finger_sim.ros import inbox


def test_receipts_never_fall(monkeypatch):
    """By the wall clock the second came a millisecond before the first: the middleware gave them in their order."""
    came = time.time_ns() - 10_000_000
    waiting = iter([(b"first", came), (b"second", came - 1_000_000), (b"third", came + 2_000_000), None])
    monkeypatch.setattr(inbox, "take", lambda _: next(waiting))
    subscription = object.__new__(inbox._Subscription)
    subscription.entity, subscription._looked = None, time.monotonic_ns() - 1_000_000_000
    taken = subscription.take()
    assert [data for data, _ in taken] == [b"first", b"second", b"third"]
    first, second, third = (received for _, received in taken)
    assert first <= second < third <= time.monotonic_ns()

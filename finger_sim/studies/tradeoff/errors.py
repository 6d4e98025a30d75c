"""What `finger_sim tradeoff` refuses."""

from __future__ import annotations

from ...errors import FingerSimError


class TradeoffError(FingerSimError):
    """A study that cannot be run as asked: the option or the key, the value and what is allowed."""

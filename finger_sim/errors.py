"""What finger_sim raises for a user's mistake: each error says where, what was found, and what is allowed."""

from __future__ import annotations

from reprlib import Repr

MOST_LETTERS = 600
"""Letters of a value that an error shows at most."""
_SHORT = Repr()
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist, _SHORT.maxtuple = 3, 12, 12, 12
_SHORT.maxstring, _SHORT.maxother, _SHORT.maxlong = 400, 200, 100


class FingerSimError(Exception):
    """Base of every error that finger_sim raises on purpose."""


class SceneError(FingerSimError):
    """A scene that cannot be used: the key path, the value found and the allowed range.

    source  : where it was found: file, and line and column where they are known
    excerpt : that line, and a caret below the place
    """

    def __init__(self, key: str, value: object, allowed: str, source: str | None = None, excerpt: str = "") -> None:
        self.key, self.value, self.allowed, self.source, self.excerpt = key, value, allowed, source, excerpt
        super().__init__(key, value, allowed, source, excerpt)

    def __str__(self) -> str:
        where = f"{self.source}: {self.key}" if self.source else self.key
        return f"{where}: got {short(self.value)}, allowed: {self.allowed}" + (self.excerpt and f"\n{self.excerpt}")


class MeshError(FingerSimError):
    """A mesh that cannot be simulated: what is wrong with it, by name and count."""


class BagError(FingerSimError):
    """A bag, topic or recording that cannot be read or written: the path and the reason."""


class MissingExtraError(FingerSimError):
    """An optional part is not installed: the extra to install."""

    def __init__(self, feature: str, extra: str) -> None:
        self.extra = extra
        super().__init__(f"{feature} needs the extra [{extra}]: pip install 'finger_sim[{extra}]'")


def short(value: object) -> str:
    """A value as Python writes it, not longer than a few lines whatever it is."""
    try:
        text = _SHORT.repr(value)
    except Exception:  # a whole number of thousands of digits, say, has no such text
        return f"<{type(value).__name__}>"
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS // 2]}...{text[-MOST_LETTERS // 2 :]}"

"""What finger_sim raises for a user's mistake: each error says where, what was found, and what is allowed."""

from __future__ import annotations


class FingerSimError(Exception):
    """Base of every error that finger_sim raises on purpose."""


class SceneError(FingerSimError):
    """A scene that cannot be used: the key path, the value found and the allowed range."""

    def __init__(self, key: str, value: object, allowed: str, source: str | None = None) -> None:
        self.key, self.value, self.allowed, self.source = key, value, allowed, source
        where = f"{source}: {key}" if source else key
        super().__init__(f"{where}: got {value!r}, allowed: {allowed}")


class MeshError(FingerSimError):
    """A mesh that cannot be simulated: what is wrong with it, by name and count."""


class BagError(FingerSimError):
    """A bag, topic or recording that cannot be read or written: the path and the reason."""


class MissingExtraError(FingerSimError):
    """An optional part is not installed: the extra to install."""

    def __init__(self, feature: str, extra: str) -> None:
        self.extra = extra
        super().__init__(f"{feature} needs the extra [{extra}]: pip install 'finger_sim[{extra}]'")

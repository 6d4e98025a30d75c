"""Opens the page in a browser of the desktop, where there is one."""

from __future__ import annotations

import os
import webbrowser

_DESKTOP = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def open_page(url: str) -> bool:
    """Whether a browser was told to open it. Without a desktop none is: one of a terminal would take that over."""
    if not any(os.environ.get(name) for name in _DESKTOP):
        return False
    try:
        return webbrowser.open(url)
    except (webbrowser.Error, OSError):
        return False

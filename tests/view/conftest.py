"""A browser for all tests of a file, and pages that must be free of errors when they end."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium; skips where there is none, in CI it fails. While it is there, no other event loop can run."""

    def without(reason: str) -> None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(reason)

    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        without("needs playwright: pip install 'finger_sim[test]'")
    from view.browser import CHROMIUM, launch

    if not Path(CHROMIUM).exists():
        without(f"needs {CHROMIUM}: apt-get install chromium")
    with sync_playwright() as playwright:
        found = launch(playwright)
        yield found
        found.close()


@pytest.fixture
def stub() -> Iterator[Any]:
    """A made-up server."""
    from view.stub import Stub

    made = Stub()
    yield made
    made.stop()


@pytest.fixture(scope="module")
def kept(browser: Any) -> Iterator[tuple[Any, Any]]:
    """A made-up server and a page of it, which takes a second or more to load."""
    from view.browser import Tab
    from view.stub import Stub

    made = Stub()
    tab = Tab(browser, made.url)
    yield made, tab
    tab.close()
    made.stop()


@pytest.fixture
def shared(kept: tuple[Any, Any]) -> Iterator[tuple[Any, Any]]:
    """The same, as at first: for tests that need no page of their own. It may have no error, nor ask anybody else."""
    made, tab = kept
    made.forget()
    tab.fresh()
    made.forget()  # what a hand that was just let go still sent
    made.tell({"type": "values", "values": made.values})
    tab.shown()
    yield made, tab
    assert not tab.errors
    assert asked([tab]) <= {"127.0.0.1"}


@pytest.fixture
def open_tab(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens pages; none may have an error or ask anybody but this machine."""
    from view.browser import Tab

    tabs: list[Tab] = []

    def open_one(url: str, **options: Any) -> Tab:
        tabs.append(Tab(browser, url, **options))
        return tabs[-1]

    yield open_one
    errors = [error for tab in tabs for error in tab.errors]
    for tab in tabs:
        tab.close()
    assert not errors
    assert asked(tabs) <= {"127.0.0.1"}


def asked(tabs: list[Any]) -> set[str | None]:
    """Whom pages asked for anything."""
    return {urlsplit(url).hostname for tab in tabs for url in tab.requests if not url.startswith("data:")}

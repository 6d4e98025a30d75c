"""What all tests share: which of them run in one process, and in which order."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent
WITHOUT_KERNELS = ("bags", "recordings", "scene", "truth")
"""Folders whose tests need no kernels of a step: they run while the first node compiles them."""
BROWSER = ("test_page", "test_film")
"""Files of `view` that draw in a browser. It takes a processor, and no other event loop runs in its process."""
MIDDLE = "test_p"
"""Files of `ros` before it take as long as those after it."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Those that talk over ROS begin first, as together they take the longest. Sets the marks `ros` and `browser`."""

    def folder(item: pytest.Item) -> str:
        return item.path.relative_to(ROOT).parts[0]

    for item in items:
        if folder(item) == "ros":
            item.add_marker("ros")
        elif folder(item) == "view" and item.path.name.startswith(BROWSER):
            item.add_marker("browser")
    items.sort(key=lambda item: (folder(item) != "ros", folder(item) not in WITHOUT_KERNELS))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """The tests of a file run in one process, so that what they share is made once.

    Those of the folder `ros` run in two, each half of its files in one: most of their time they wait, but three nodes
    at once with their recorders and clients would not hear each other on two cores.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.split("::")[0]
            place = config.rootpath / file
            return f"ros {place.name < MIDDLE}" if place.parent == ROOT / "ros" else file

    return ByFile(config, log)


@pytest.fixture(autouse=True)
def _a_broken_pipe_is_an_error():
    """As in any Python process: what a test of this process has left must not end it when a socket is closed."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


@pytest.fixture(autouse=True)
def _each_test_listens_for_itself(request):
    """A client that a module shares ends what the test subscribed to: it would hear a thousand messages a second."""
    yield
    if "client" in request.fixturenames:
        request.getfixturevalue("client").forget()

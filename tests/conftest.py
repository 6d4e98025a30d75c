"""What all tests share: which of them run in one process, and in which order."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parent
WITHOUT_KERNELS = ("bags", "scene")
"""Folders whose tests need no compiled kernels: they run while the first node compiles them."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Groups of `--dist loadgroup`.

    The tests of a file run in one process, so that what they share is made once. Those marked `ros` all run in the same
    one, and begin first: a node, its recorder and a client need a core to hear each other, and take the longest.
    """
    if not config.pluginmanager.hasplugin("xdist"):
        return

    unmarked = {str(item.path) for item in items if starts_nodes(item) and not item.get_closest_marker("ros")}
    if unmarked:
        raise pytest.UsageError(
            f"needs `pytestmark = pytest.mark.ros`, as it starts nodes: {', '.join(sorted(unmarked))}"
        )

    def place(item: pytest.Item) -> tuple[bool, bool]:
        return item.get_closest_marker("ros") is None, item.path.relative_to(ROOT).parts[0] not in WITHOUT_KERNELS

    items.sort(key=place)
    for item in items:
        group = "ros" if item.get_closest_marker("ros") else item.path.stem.removeprefix("test_")
        item.add_marker(pytest.mark.xdist_group(group))


def starts_nodes(item: pytest.Item) -> bool:
    return hasattr(getattr(item, "module", None), "NodeProcess")


@pytest.fixture(autouse=True)
def _each_test_listens_for_itself(request):
    """A client that a module shares ends what the test subscribed to: it would hear a thousand messages a second."""
    yield
    if "client" in request.fixturenames:
        request.getfixturevalue("client").forget()

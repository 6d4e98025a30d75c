"""What all tests share."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest
from xdist.scheduler import LoadScopeScheduling

TALKS = re.compile(r"^from (ros_helpers|domains) import|^from finger_sim import .*\bdemo$", re.MULTILINE)
"""In the text of a test file that talks over ROS."""


class ByFile(LoadScopeScheduling):
    """The tests of a file run in one process, so that what they share is made once.

    Those that talk over ROS all run in the same one: a node, its recorder and a client need a core to hear each other.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.split("::")[0]
        return "ros" if talks(file) else file


@cache
def talks(file: str) -> bool:
    """Whether the tests of a file of this folder talk over ROS."""
    return TALKS.search((Path(__file__).parents[1] / file).read_text()) is not None


def pytest_xdist_make_scheduler(config, log):
    return ByFile(config, log)


@pytest.fixture(autouse=True)
def _each_test_listens_for_itself(request):
    """A client that a module shares ends what the test subscribed to: it would hear a thousand messages a second."""
    yield
    if "client" in request.fixturenames:
        request.getfixturevalue("client").forget()

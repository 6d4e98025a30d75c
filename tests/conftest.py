"""What all tests share."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _each_test_listens_for_itself(request):
    """A client that a module shares ends what the test subscribed to: it would hear a thousand messages a second."""
    yield
    if "client" in request.fixturenames:
        request.getfixturevalue("client").forget()

"""Domains that a node of one's own gets: nobody else's."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest
from domains import DOMAINS

from finger_sim.ros import child
from finger_sim.ros.child import claim_domain, free_domain

ASKED = "import os; os.getpid = lambda: {}; from finger_sim.ros.child import free_domain; print(free_domain())"
"""A process that tries a certain domain first."""


def test_a_domain_is_given_once() -> None:
    """Not to this process again, nor to another; the domain of a test is its own too."""
    first, second, own = free_domain(), free_domain(), next(DOMAINS)
    assert len({first, second, own}) == 3
    for taken in (first, own):
        assert claim_domain(taken) is None
        command = [sys.executable, "-c", ASKED.format(taken - 1)]
        other = subprocess.run(command, check=True, capture_output=True, text=True)
        assert int(other.stdout) not in (first, second, own)


def test_a_domain_where_somebody_listens_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """A participant of DDS that claims nothing."""
    domain = free_domain()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * domain + 10))
        child._claims.pop().close()
        monkeypatch.setattr(os, "getpid", lambda: domain - 1)
        assert free_domain() != domain

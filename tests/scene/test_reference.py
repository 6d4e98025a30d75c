"""README's tables of parameters say what the code says."""

from __future__ import annotations

import re

import pytest
from processes import REPOSITORY

from finger_sim.ros.options import NodeOptions
from finger_sim.scene import Scene
from finger_sim.scene.reference import rows

README = (REPOSITORY / "README.md").read_text()


@pytest.mark.parametrize("part", [Scene, NodeOptions])
def test_readme_lists_every_parameter_with_its_facts(part: type) -> None:
    """Name, default, allowed values and *live* of each, in the code's order: no other rows, none left out."""
    wanted = list(rows(part))
    tables = re.findall(r"(?:^\|.*\n)+", README, re.MULTILINE)
    lines = next(text for text in tables if wanted[0] in text).splitlines()[2:]
    assert [line[: len(row)] for line, row in zip(lines, wanted, strict=True)] == wanted


def test_what_is_live_can_be_told_from_a_row() -> None:
    """By hand, of four parameters: a number, a choice, a value that may be null, one that needs a new start."""
    lines = {line.split("`")[1]: line for line in [*rows(Scene), *rows(NodeOptions)]}
    assert lines["plane.friction"] == "| `plane.friction` | 0.5 | 0 to 100 | *live* |"
    assert lines["passivity"] == "| `passivity` | observe | observe, control | *live* |"
    assert lines["solver.deadline"] == "| `solver.deadline` | none | 1e−6 to 10 s; null | *live* |"
    assert lines["record_directory"] == "| `record_directory` | . | text |  |"

"""The rows of the tables of parameters say what the code says; tests/docs has the tables themselves."""

from __future__ import annotations

from finger_sim.ros.options import NodeOptions
from finger_sim.scene import Scene
from finger_sim.scene.reference import rows


def test_what_is_live_can_be_told_from_a_row() -> None:
    """By hand, of four parameters: a number, a choice, a value that may be null, one that needs a new start."""
    lines = {line.split("`")[1]: line for line in [*rows(Scene), *rows(NodeOptions)]}
    assert lines["plane.friction"] == "| `plane.friction` | 0.5 | 0 to 100 | *live* |"
    assert lines["passivity"] == "| `passivity` | observe | observe, control | *live* |"
    assert lines["solver.deadline"] == "| `solver.deadline` | none | 1e−6 to 10 s; null | *live* |"
    assert lines["record_directory"] == "| `record_directory` | . | text |  |"

"""The verb with arguments that a user may get wrong, and the parts that may be missing."""

from __future__ import annotations

import importlib.util

import pytest
from cases import for_each

from finger_sim.cli import main


@for_each(
    "arguments, told",
    [
        (["--port", "http"], "a whole number from 0 to 65535"),
        (["--port", "65536"], "a whole number from 0 to 65535"),
        (["--port", "-1"], "a whole number from 0 to 65535"),
        (["--port"], "expected one argument"),
        (["--adress", "127.0.0.1"], "unrecognized arguments"),
        (["one", "two"], "unrecognized arguments"),
        (["--device"], "unrecognized arguments"),
    ],
)
def test_arguments_that_cannot_be_read(arguments, told, capsys) -> None:
    """argparse says which and what is allowed."""
    with pytest.raises(SystemExit) as ended:
        main(["view", *arguments])
    assert ended.value.code == 2
    assert told in capsys.readouterr().err


@for_each(
    "arguments, told",
    [
        (["press_slide", "--scene", "finger"], "--scene: goes not with BAG"),
        (["press_slide", "--join"], "--join: goes not with BAG"),
        (["press_slide", "--out", "x"], "--out: goes not with BAG"),
        (["press_slide", "--watch"], "--watch: goes not with BAG"),
        (["press_slide", "--node", "/finger"], "--node: goes not with BAG"),
        (["--join", "--scene", "finger"], "--scene: goes not with --join"),
        (["--join", "--out", "x"], "--out: goes not with --join"),
        (["--node", "/finger"], "--node: goes only with --join"),
        (["--join", "--node", "a b"], "the name of a node"),
        (["--join", "--node", "/"], "the name of a node"),
        (["--scene", "fingr"], "a shipped scene: beam_anisotropic"),
        (["--out", __file__], "cannot be made: File exists"),
        (["press_slid"], "no such bag"),
        (["--join", "--address", "300.1.1.1"], "--address: 300.1.1.1"),
        (["--join", "--address", "198.51.100.7"], "--address: 198.51.100.7 cannot be served"),
    ],
)
def test_arguments_that_mean_nothing(arguments, told, capsys) -> None:
    """Exit code 2 and one line that says which and what is allowed; no traceback."""
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install 'finger_sim[ros]'")
    assert main(["view", "--no-browser", *arguments]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert "Traceback" not in said


def test_a_domain_that_ros_refuses(monkeypatch, capsys) -> None:
    """It is named, and nothing is left running."""
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install 'finger_sim[ros]'")
    monkeypatch.setenv("ROS_DOMAIN_ID", "one")
    assert main(["view", "--join", "--no-browser", "--port", "0"]) == 2
    said = capsys.readouterr().err
    assert "ROS_DOMAIN_ID one: ROS refuses" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(("missing", "extra"), [("websockets", "[view]"), ("rclpy", "[ros]")])
def test_a_part_that_is_missing_is_named(missing, extra, monkeypatch, capsys) -> None:
    """With the command that installs it."""
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == missing else found(name, *rest)
    )
    assert main(["view", "--no-browser"]) == 2
    assert f"pip install 'finger_sim{extra}'" in capsys.readouterr().err

"""Parameters that were given and do not reach the node: it says which, where they are, and what its name is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import rclpy
import yaml
from domains import DOMAINS
from ros_helpers import NodeProcess, write_block

from finger_sim.ros.given import unreached

GENTLE = {"ros__parameters": {"force_scale": 0.1, "plane": {"friction": 0.25}}}


def params(path: Path, **sections: object) -> Path:
    path.write_text(yaml.safe_dump(sections))
    return path


class Finger:
    """A node of that name with a few parameters."""

    def __init__(self, name: str) -> None:
        self.name = name

    def get_fully_qualified_name(self) -> str:
        return self.name

    def has_parameter(self, name: str) -> bool:
        return name in ("force_scale", "plane.friction", "use_sim_time")


@pytest.mark.parametrize("namespace", ["", "/left"])
def test_a_file_is_said_to_reach_nothing_where_ros_hands_nothing_over(tmp_path: Path, namespace: str) -> None:
    """Names, nested names and patterns; rclpy itself is the judge."""
    domain = next(DOMAINS)
    names = (
        "finger",
        "/finger",
        "finger_node",
        "left/finger",
        "/**",
        "/*",
        "**",
        "/**/finger",
        "/*/finger",
        "/left/**",
    )
    files = [params(tmp_path / f"{k}.yaml", **{name: GENTLE}) for k, name in enumerate(names)]
    files += [params(tmp_path / f"nested_{k}.yaml", **{ns: {"finger": GENTLE}}) for k, ns in enumerate(("left", "/**"))]
    for file in files:
        arguments = ["--ros-args", "--params-file", str(file), "-r", f"__ns:={namespace or '/'}"]
        context = rclpy.Context()
        rclpy.init(args=arguments, context=context, domain_id=domain)
        node = rclpy.create_node(
            "finger", context=context, enable_rosout=False, start_parameter_services=False,
            automatically_declare_parameters_from_overrides=True,
        )  # fmt: skip
        handed, own = node.has_parameter("force_scale"), node.get_fully_qualified_name()
        node.destroy_node()
        rclpy.shutdown(context=context)
        assert own == f"{namespace}/finger"
        assert [text.split(" reaches nothing")[0] for text in unreached(arguments, Finger(own))] == (
            [] if handed else [str(file)]
        ), file.read_text()


def test_what_else_does_not_arrive(tmp_path: Path) -> None:
    """Values for another node, an empty file, a name that is not ours beside a pattern, and what is no ROS argument."""
    sim_time = {"ros__parameters": {"use_sim_time": True}}
    empty = params(tmp_path / "empty.yaml")
    partly = params(tmp_path / "partly.yaml", **{"/**": sim_time, "finger_node": GENTLE})
    several = params(tmp_path / "several.yaml", **{"/**": sim_time, "finger": GENTLE, "other": GENTLE})
    said = unreached(
        [
            "-p", "force_scale:=0.1", "--ros-args", "-p", "other:force_scale:=0.1", "-p", "force_scale:=0.1",
            "--param", "finger:plane.friction:=0.1", "--params-file", str(empty), "--params-file", str(partly),
            "--params-file", str(several), "--", "more",
        ],
        Finger("/finger"),
    )  # fmt: skip
    assert list(said) == [
        "-p other:force_scale:=0.1 reaches nothing: this node is /finger",
        f"{empty} gives no parameter",
        f"{partly}: force_scale, plane.friction of /finger_node does not reach this node, which is /finger",
        "-p force_scale:=0.1 more: not read; ROS takes arguments that come after --ros-args",
    ]


def test_the_node_says_so_when_it_starts(tmp_path: Path) -> None:
    """Of a node that was renamed: the file, the names in it, its own name; and which forces are to be expected."""
    file = params(tmp_path / "gentle.yaml", finger=GENTLE)
    arguments = ("--params-file", str(file), "-r", "__node:=hand", "-p", "coupling.force_limit:=3.0")
    with NodeProcess(tmp_path / "log", "-p", f"scene:={write_block(tmp_path)}", *arguments) as node:
        node.wait_for("device_wrench: force_scale 1, coupling.force_limit 3 N, coupling.torque_limit 0.5 N m")
        assert node.end() == 0
    assert "[WARN]" in node.output
    assert f"{file} reaches nothing: it is for /finger, this node is /hand; write /hand or /** there" in node.output


@pytest.mark.slow
def test_a_node_runs_where_nothing_can_be_written(tmp_path: Path) -> None:
    """ROS would end it for want of a log file. Its kernels come from where they are kept."""
    kept = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    nowhere = {"HOME": "/proc/none", "ROS_HOME": "", "ROS_LOG_DIR": "", "XDG_CACHE_HOME": kept}
    with NodeProcess(tmp_path / "log", "-p", f"scene:={write_block(tmp_path)}", changes=nowhere) as node:
        node.wait_for("ready after")
        assert node.end() == 0
    assert "warning: ROS writes no log file: /proc/none/.ros/log: No such file or directory" in node.output
    assert "Traceback" not in node.output

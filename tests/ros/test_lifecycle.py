"""A managed node: loaded when it is configured, stepping while it is active, and still again."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from ros_helpers import BLOCK_DT, Client, NodeProcess, write_block
from std_srvs.srv import SetBool, Trigger

from finger_sim.bags.reader import BagReader
from finger_sim.simulation.replay import run

PRESSED = -0.0003
"""Height at which the block is pressed in [m]."""


class Managed(Client):
    """A client that changes the node's state."""

    def change(self, transition: int) -> bool:
        """Whether the transition was made."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "/finger/change_state", request).success)

    def state(self) -> int:
        return int(self.call(GetState, "/finger/get_state", GetState.Request()).current_state.id)

    def press(self) -> None:
        self.command(PRESSED)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lifecycle")


@pytest.fixture(scope="module")
def node(folder: Path) -> Iterator[NodeProcess]:
    arguments = ("-p", f"scene:={write_block(folder)}", "-p", "lifecycle:=true", "-p", f"record:={folder / 'bag'}")
    with NodeProcess(folder / "log", *arguments) as node:
        yield node


@pytest.fixture(scope="module")
def managed(node: NodeProcess) -> Iterator[Managed]:
    with Managed(node.domain) as client:
        yield client


@pytest.mark.slow
def test_one_life(managed: Managed, node: NodeProcess, folder: Path) -> None:
    """Unconfigured, inactive, active and back, twice; and the end: what each state does."""
    wrenches: list[Any] = managed.collect(WrenchStamped, "device_wrench")
    poses: list[Any] = managed.collect(PoseStamped, "pose")

    assert managed.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert managed.report()[0].message == "unconfigured: nothing is loaded"
    assert "compiling" not in node.output
    assert managed.call(Trigger, "/finger/reset", Trigger.Request()).message == "not ready: loading"
    assert not managed.change(Transition.TRANSITION_ACTIVATE), "an answer where rclpy gives none"
    assert managed.state() == State.PRIMARY_STATE_UNCONFIGURED

    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert "ready after" in node.output
    assert managed.state() == State.PRIMARY_STATE_INACTIVE
    status, values = managed.report(managed.press)
    assert status.message == "inactive: no step is made"
    assert int(values["received commands"]) > 0
    assert not poses
    assert all(w.wrench.force.z == 0.0 for w in wrenches)
    refused = managed.call(SetBool, "/finger/record", SetBool.Request(data=True))
    assert refused.message == "the node is inactive: there is nothing to record"

    # Nothing of what came before moves it now.
    begun = time.monotonic()
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    managed.until(lambda: len(poses) > 5)
    assert poses[-1].pose.position.z == 0.01
    managed.until(lambda: wrenches[-1].wrench.force.z > 0.1, managed.press, BLOCK_DT)
    _, values = managed.report(managed.press)
    before = int(values["steps"])
    assert before > 0

    assert managed.change(Transition.TRANSITION_DEACTIVATE)
    active = time.monotonic() - begun
    managed.until(lambda: wrenches[-1].wrench.force.z == 0.0)
    status, values = managed.report()
    made = len(poses)
    assert (folder / "bag" / "metadata.yaml").is_file(), "its recording is whole"
    assert values["recording"] == "off"
    managed.report(managed.press)
    assert len(poses) == made
    assert wrenches[-1].wrench.force.z == 0.0

    # It goes on where it was; the time at rest counts neither as late nor as skipped.
    begun = time.monotonic()
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    managed.until(lambda: wrenches[-1].wrench.force.z > 0.1, managed.press, BLOCK_DT)
    _, values = managed.report(managed.press)
    active += time.monotonic() - begun
    assert int(values["steps"]) > before
    assert (int(values["steps"]) + int(values["overruns"]) - 2) * BLOCK_DT <= active

    assert managed.change(Transition.TRANSITION_DEACTIVATE)
    assert managed.change(Transition.TRANSITION_CLEANUP)
    assert managed.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    graph = managed.call(
        GetAvailableTransitions, "/finger/get_available_transitions", GetAvailableTransitions.Request()
    )
    assert {t.transition.label for t in graph.available_transitions} >= {"activate", "cleanup", "shutdown"}
    assert managed.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
    assert node.code() == 0, node.output
    assert "Traceback" not in node.output
    assert "cannot be taken" not in node.output


@pytest.mark.slow
def test_its_recording_can_be_replayed(node: NodeProcess, folder: Path, tmp_path: Path) -> None:
    """From the first activation to the end of it, and no longer."""
    steps = len(list(BagReader(folder / "bag").messages(["/pose"])))
    done = run(None, folder / "bag", tmp_path / "again")
    assert done.steps > 0
    assert steps > 5
    assert done.peak_force > 0.1


@pytest.mark.slow
def test_a_mesh_that_cannot_be_read_ends_the_configuration_and_the_node(tmp_path: Path) -> None:
    """With the reason, and an exit code."""
    scene = tmp_path / "broken.yaml"
    (tmp_path / "broken.vtu").write_text("no mesh")
    scene.write_text("mesh: {file: broken.vtu}\ndriven: bone\n")
    with (
        NodeProcess(tmp_path / "log", "-p", f"scene:={scene}", "-p", "lifecycle:=true") as node,
        Managed(node.domain) as client,
    ):
        assert not client.change(Transition.TRANSITION_CONFIGURE)
        assert node.code() == 1
    assert "configure failed: " in node.output
    assert "broken.vtu" in node.output
    assert "Traceback" not in node.output

"""`finger_sim view` on a real node, over ROS and a WebSocket: what is dragged is simulated, what is set is set."""

from __future__ import annotations

import http.client
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from domains import DOMAINS
from numpy.testing import assert_allclose
from ros_helpers import Client, NodeProcess, command, environment, write_block
from view.serving import Page, until

from finger_sim import Scene
from finger_sim.bags.reader import BagReader
from finger_sim.view.beside import page_beside

LEVEL = [0.0, 0.0, 0.0, 1.0]


class Viewer:
    """The verb in a process of its own."""

    killed = False

    def __init__(self, folder: Path, *arguments: str, domain: int | None = None) -> None:
        self.log = folder / "view.log"
        command = [sys.executable, "-m", "finger_sim", "view", "--no-browser", "--port", "0", *arguments]
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, text=True, cwd=folder,
                env=environment(next(DOMAINS) if domain is None else domain),
            )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        assert self.url, self.log.read_text()
        self.port = int(self.url.rpartition(":")[2].strip("/"))

    def node(self) -> int:
        """Process id of the node that it started."""
        return until(lambda: next(iter(children(self.process.pid, b"finger_sim.ros.node")), None))

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        code = self.process.wait(30)
        assert self.killed or code == 0, self.log.read_text()
        self.process.stdout.close()


def children(parent: int, word: bytes) -> list[int]:
    """Processes that one has started, with a word in their command line."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            ours = int((process / "stat").read_text().rpartition(")")[2].split()[1]) == parent
            if ours and word in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except (OSError, IndexError):
            continue
    return found


@pytest.fixture(scope="module")
def viewer(tmp_path_factory) -> Iterator[Viewer]:
    folder = tmp_path_factory.mktemp("view")
    scene = write_block(folder)
    with Viewer(folder, "--scene", str(scene), "--out", str(folder / "bags")) as found:
        yield found


@pytest.fixture
def page(viewer: Viewer) -> Iterator[Page]:
    """A page of a node that runs."""
    with Page(viewer.port) as found:
        runs(found)
        yield found


def runs(page: Page) -> None:
    """Until the node makes steps and shows them."""
    page.until(lambda: page.frames and state(page).get("phase") == "running", limit=200.0)


def state(page: Page) -> dict:
    """The newest status."""
    return next((each for each in reversed(page.said) if each["type"] == "status"), {})


def drag(page: Page, z: float) -> None:
    page.hold([0.0, 0.0, z, *LEVEL])


def test_what_is_dragged_is_simulated(viewer, page) -> None:
    """It follows, is pressed and pushes back; when the page has gone, the last pose holds."""
    topology = page.topologies[-1]
    assert (len(topology.rest), len(topology.tets), topology.known) == (12, 10, 3)
    with Page(viewer.port) as hand:
        hand.next("hello")
        hand.say("take")
        hand.until(lambda: [each for each in hand.said if each["type"] == "handle" and each["holder"]])
        hand.until(lambda: hand.frames and abs(hand.frames[-1].pose[2] - 0.012) < 1e-6, lambda: drag(hand, 0.012))
        assert_allclose(hand.frames[-1].force, 0.0, atol=1e-9)
        hand.until(lambda: hand.frames[-1].force[2] > 0.05, lambda: drag(hand, -0.0005))
        frame = hand.frames[-1]
        assert frame.flags & 7 == 7
        assert frame.contacts
        assert_allclose(np.sum([force for _, force, _ in frame.contacts], axis=0), frame.force, atol=1e-6)
        assert_allclose(frame.floats[33:36], [0.01, 0.005, 0.0], atol=2e-3)
        hand.until(lambda: abs(hand.frames[-1].floats[37] - 0.0005) < 1e-4, lambda: drag(hand, -0.0005))
        hand.until(lambda: hand.frames[-1].floats[29] > 0.05, lambda: drag(hand, -0.0005))  # of the device, ramped in
        _, normal, _, device, depth = hand.until(lambda: next(iter(hand.frames[-1].samples[-1:]), None))
        assert min(normal, device, depth) > 0.05
        hand.until(lambda: state(hand)["contact_nodes"], lambda: drag(hand, -0.0005))
    page.until(lambda: page.said[-1]["type"] == "handle" and page.said[-1]["holder"] is None)
    page.until(lambda: any("stale" in word["text"] for word in state(page)["words"]))
    assert abs(page.frames[-1].pose[2] + 0.0005) < 1e-5


def test_what_is_set_is_set_and_told(viewer, page) -> None:
    """To all pages; a value out of range, or one that is not live, is refused in words."""
    page.next("status")
    items = {
        each["name"]: each for message in page.said if message["type"] == "parameters" for each in message["items"]
    }
    assert items["plane.friction"]["live"] is True
    assert items["dt"]["live"] is False
    with Page(viewer.port) as other:
        other.next("status")
        page.say("set", name="plane.friction", value=0.125)
        assert other.next("values")["values"] == {"plane.friction": 0.125}
        page.until(lambda: abs(page.frames[-1].floats[36] - 0.125) < 1e-7)
    assert "plane.friction: got -1, allowed: a number in [0, 100]" in page.notice(
        "set", name="plane.friction", value=-1
    )
    assert "cannot be changed" in page.notice("set", name="dt", value=0.001)
    assert "no such parameter" in page.notice("set", name="nothing", value=0.001)
    page.say("set", name="plane.normal", value=[0, 0.1, 1])
    page.until(lambda: page.frames[-1].floats[17] < -0.01 and page.frames[-1].flags & 2)
    page.say("set", name="plane.normal", value=[0, 0, 1])
    page.until(lambda: abs(page.frames[-1].floats[17]) < 1e-9)


def test_the_yaml_is_the_scene_as_it_is(viewer, page, tmp_path: Path) -> None:
    """What was set is in it."""
    page.say("set", name="coupling.force_limit", value=4.5)
    page.until(lambda: any(each.get("values", {}).get("coupling.force_limit") == 4.5 for each in page.said))
    page.say("yaml")
    answer = page.next("yaml")
    assert answer["name"] == "block.yaml"
    file = tmp_path / "again.yaml"
    file.write_text(answer["text"])
    own = Scene.load(viewer.log.parent / "block.yaml")
    got = Scene.load(file)
    assert got.coupling.force_limit == 4.5
    assert (
        got.with_values({"coupling.force_limit": own.coupling.force_limit, "plane.friction": own.plane.friction}) == own
    )


def test_a_recording_is_made_and_fetched(viewer, page, tmp_path: Path) -> None:
    """It holds what was simulated."""
    page.say("record", on=True)
    assert "recording" in page.next("notice")["text"]
    page.until(lambda: state(page)["recording"]["on"] and state(page)["recording"]["messages"])
    assert "recording already" in page.notice("record", on=True)
    page.say("record", on=False)
    done = page.next("recorded")
    assert fetched(viewer, done, tmp_path)["/contact_wrench"] > 10
    assert (tmp_path / done["name"]).stat().st_size == done["bytes"]
    with Page(viewer.port) as later:
        assert later.next("hello")["recorded"][-1]["url"] == done["url"]
    assert "nothing is being recorded" in page.notice("record", on=False)


def fetched(viewer: Viewer, offered: dict, folder: Path) -> dict[str, int]:
    """Messages by topic in a recording that is offered; leaves it in the folder."""
    connection = http.client.HTTPConnection("127.0.0.1", viewer.port)
    connection.request("GET", offered["url"])
    answer = connection.getresponse()
    file = folder / offered["name"]
    file.write_bytes(answer.read())
    assert answer.status == 200
    return {topic.name: topic.count for topic in BagReader(file).topics}


def test_reset(viewer, page) -> None:
    """The node's service answers."""
    page.say("reset")
    assert "at rest at position" in page.next("notice")["text"]


def test_a_node_that_was_killed_comes_back(viewer, page, tmp_path: Path) -> None:
    """It is started again; the page gets another generation, and frames of it, and what was recorded until then."""
    generation, first = page.frames[-1].generation, viewer.node()
    page.say("record", on=True)
    page.until(lambda: state(page)["recording"]["on"])
    os.kill(first, signal.SIGKILL)
    assert fetched(viewer, page.next("recorded"), tmp_path)["/contact_wrench"] > 10
    page.until(lambda: any("ended with code -9" in each.get("text", "") for each in page.said))
    page.until(lambda: page.frames[-1].generation > generation, limit=200.0)
    assert viewer.node() != first
    runs(page)


def test_no_node_is_left_behind(tmp_path: Path) -> None:
    """Where the server is killed, its node ends, too."""
    with Viewer(tmp_path, "--scene", str(write_block(tmp_path))) as viewer:
        node = viewer.node()
        viewer.process.kill()
        viewer.process.wait(30)
        until(lambda: not Path(f"/proc/{node}").exists() or "Z" in state_of(node), period=0.05, limit=60.0)
        viewer.killed = True


def state_of(process: int) -> str:
    """As /proc tells it: Z is one that has ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


@pytest.mark.slow
def test_another_scene(viewer, page, tmp_path: Path) -> None:
    """The node is started with it, and what was being recorded can be fetched; one that is not offered is refused."""
    assert "scene: got '/etc/passwd'" in page.notice("scene", name="/etc/passwd")
    page.say("record", on=True)
    assert "recording" in page.next("notice")["text"]
    page.say("scene", name="finger")
    assert fetched(viewer, page.next("recorded"), tmp_path)["/mesh_topology"] == 1
    page.until(lambda: page.topologies[-1].rest.shape == (265, 3), limit=200.0)
    page.until(lambda: [each for each in page.said if each["type"] == "hello"][-1]["scene"] == "finger")
    page.until(lambda: len(page.frames[-1].positions) == 265 and state(page)["phase"] == "running", limit=200.0)
    assert sum(flag & 1 for flag in page.topologies[-1].flags) == 70


@pytest.fixture(scope="module")
def others(tmp_path_factory) -> Iterator[Others]:
    with Others(tmp_path_factory.mktemp("others")) as found:
        yield found


class Others:
    """A node of somebody else, /left/finger, in a domain of its own; it can be started anew."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.domain, self._scene = folder, next(DOMAINS), write_block(folder)

    def start(self) -> None:
        arguments = ("-p", f"scene:={self._scene}", "-r", "__ns:=/left", "-p", "world_frame:=table")
        self.node = NodeProcess(self.folder / f"node{time.monotonic()}.log", *arguments, domain=self.domain)

    def __enter__(self) -> Others:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        assert self.node.end() == 0

    def viewer(self, folder: Path, *arguments: str) -> Viewer:
        """A page that has joined it."""
        return Viewer(folder, "--join", "--node", "/left/finger", *arguments, domain=self.domain)


@pytest.mark.slow
def test_a_page_that_only_watches(others, tmp_path: Path) -> None:
    """It shows a plane that others move, and changes nothing; what another node reports is not taken for its own."""
    with others.viewer(tmp_path, "--watch") as viewer, Page(viewer.port) as page, Client(others.domain) as client:
        runs(page)
        assert page.said[0]["drive"] is False
        assert "only shows" in page.notice("set", name="plane.friction", value=0.3)
        assert "only shows" in page.notice("record", on=True)
        assert "only shows" in page.notice("scene", name="finger")
        assert "cannot be held" in page.notice("take")
        another = DiagnosticArray(status=[DiagnosticStatus(name="finger: simulation", message="of another")])
        pose = command(-0.002)
        pose.header.frame_id = "table"
        page.until(
            lambda: abs(page.frames[-1].floats[16] + 0.002) < 1e-9,
            lambda: (client.publish(pose, "/left/plane_pose"), client.publish(another, "/diagnostics")),
        )
        page.next("status")
        assert not any(each.get("message") == "of another" for each in page.said)


@pytest.mark.slow
def test_a_node_of_somebody_else(others, tmp_path: Path) -> None:
    """It is shown, driven; when it ends the page says so, and comes back with the next one."""
    with others.viewer(tmp_path) as viewer, Page(viewer.port) as page:
        for turn in (1, 2):
            page.until(lambda turn=turn: page.frames and page.frames[-1].generation == turn, limit=200.0)
            page.until(lambda: state(page)["phase"] == "running")
            page.say("take")
            page.until(lambda: page.frames[-1].pose[2] < 0.0096, lambda: drag(page, 0.0095))
            page.say("release")
            assert "somebody else runs" in page.notice("scene", name="finger")
            if turn == 1:
                assert others.node.end() == 0
                page.until(lambda: state(page)["phase"] == "gone")
                others.start()


@pytest.mark.slow
def test_a_page_beside_something(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It only looks, its address is said, it says where no node is heard, and ends with what it is beside."""
    domain = next(DOMAINS)
    with page_beside(domain, tmp_path / "log"):
        url = capsys.readouterr().err.partition("the page: ")[2].strip()
        port = int(url.rpartition(":")[2].strip("/"))
        with Page(port) as page:
            assert page.next("hello")["drive"] is False
            page.until(lambda: f"no node /finger is heard in ROS_DOMAIN_ID {domain}" in state(page).get("message", ""))
    with pytest.raises(ConnectionRefusedError):
        Page(port)


@pytest.mark.slow
def test_the_demo_on_a_page(tmp_path: Path) -> None:
    """It is shown live, by a page that only looks; the demo does its job as ever, and ends the page."""
    pytest.importorskip("matplotlib")
    command = [
        sys.executable,
        "-m",
        "finger_sim",
        "demo",
        "--view",
        "--duration",
        "2",
        "--rate",
        "100",
        "--out",
        "demo",
    ]
    with subprocess.Popen(
        command, cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment(0)
    ) as demo:
        assert demo.stderr is not None
        url = next(line for line in demo.stderr if line.startswith("the page: "))
        with Page(int(url.rpartition(":")[2].strip(" /\n"))) as page:
            runs(page)
            assert page.said[0]["drive"] is False
            page.until(lambda: page.frames[-1].flags & 1)
            page.until_closed(limit=60.0)
        out, err = demo.communicate(timeout=60)
    assert demo.returncode == 0, err
    assert "peak force" in out

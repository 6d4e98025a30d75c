"""The main job, start to finish: the real node, a bag played at it, a recording, a picture and a table."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bags.reader import Commands, read_commands
from ..console import gauge, say
from ..errors import FingerSimError, MissingExtraError, SceneError
from ..scene import Scene
from ..scene.fields import specs
from ..scene.resources import find_bag, find_scene
from ..view.beside import page_beside
from .child import END_TIMEOUT, free_domain, last_line, last_of, node_process
from .demo_verdict import DemoError as DemoError
from .demo_verdict import Outcome, sum_up
from .loop import StepCounts
from .options import NodeOptions

if TYPE_CHECKING:
    from .play import Played

SCENE = NodeOptions().scene
RATE = 1000.0
"""Steps a second [Hz]."""
FOLDER = "finger_sim_demo"
READY_TIMEOUT = 300.0
"""Longest time that a node may take to its first step [s]; compiling takes up to a minute."""
REPORT_TIMEOUT = 15.0
"""Longest time between two messages on /diagnostics of a living node [s]."""
FLOOR_TIME = 2.0
"""How long the bare loop is watched [s]; no longer than the commands."""
PRIORITY = NodeOptions().realtime_priority
"""Of the node's loop and of the bare one under SCHED_FIFO, where the system permits it."""


def run_demo(
    scene: str = SCENE,
    bag: str = "press_slide",
    out: str | Path | None = None,
    *,
    rate: float = RATE,
    priority: int = PRIORITY,
    duration: float | None = None,
    topic: str | None = None,
    options: Mapping[str, object] | None = None,
    page: bool = False,
) -> Outcome:
    """Measures a bare loop, starts the node, plays the commands of `bag` at it over ROS 2, records, draws, sums up.

    What cannot work is refused before anything is begun.

    out      : folder to make; FOLDER, or FOLDER_2 …, if left out
    rate     : steps a second, instead of the scene's dt [Hz]
    priority : of the loop under SCHED_FIFO, where that is permitted; 0: none
    duration : of the commands that are played [s]; all of them if left out
    options  : further parameters of the node
    page     : whether a page in the browser shows it
    Raises DemoError when the node or the recording fails, and other FingerSimErrors for what was asked for.
    """
    require_ros()
    if page:
        require_websockets()
    if importlib.util.find_spec("matplotlib") is None:
        raise MissingExtraError("drawing", "plot")
    loaded = _at_rate(Scene.load(scene), rate)
    mesh = loaded.load_mesh()
    loaded.driven_nodes(mesh)
    commands = read_commands(find_bag(bag), topic)
    folder = _make_folder(out)
    recording, log = folder / "recording", folder / "node.log"
    frame = commands.frame_id or "world"
    refused = _refusal(priority)
    if refused is not None:
        say(refused)
        priority = 0
    parameters = {
        "scene": str(find_scene(scene).resolve()),
        "dt": loaded.dt,
        "record": str(recording.resolve()),
        "world_frame": frame,
        "realtime_priority": priority,
        **(options or {}),
    }
    length = commands.duration if duration is None else min(duration, commands.duration)
    floor = bare_loop(loaded.dt, min(FLOOR_TIME, length), priority)
    played, code = _drive(parameters, commands, frame, duration, log, page)
    outcome = sum_up(recording, log, folder / "demo.png", played, loaded, len(mesh.tets), floor, priority)
    if code != 0:
        outcome.failures.insert(0, f"the node ended with code {code}: {last_line(log)}")
    return outcome


def bare_loop(dt: float, seconds: float, priority: int) -> StepCounts:
    """What the machine allows: the node's loop with steps that do nothing, in a process of its own as the node's.

    Steps that do nothing, not steps as long as the node's: of the two floors of late steps that is the lower one, and
    it needs no step time to be known before. Watched before the node starts, which would be in its way.
    Raises DemoError when it does not run.
    """
    say(f"watching a bare loop of {1.0 / dt:g} Hz")
    command = [sys.executable, "-m", "finger_sim.ros.loop", repr(dt), repr(seconds), str(priority)]
    ran = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
    )
    try:
        return StepCounts(**json.loads(ran.stdout))
    except (ValueError, TypeError):
        raise DemoError(f"the bare loop ended with code {ran.returncode}: {last_of(ran.stderr)}") from None


def _drive(
    parameters: Mapping[str, Any], commands: Commands, frame: str, duration: float | None, log: Path, page: bool
) -> tuple[Played, int]:
    """Commands to a fresh node that records; what was played, and the node's exit code."""
    from .play import play, ros_node

    domain = free_domain()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    say(f"starting the node (ROS_DOMAIN_ID {domain})")
    shown = page_beside(domain, log.with_name("page.log")) if page else nullcontext()
    with node_process(parameters, domain, log) as process, shown, ros_node("finger_sim_demo", domain) as me:
        reports = _Reports(me, process, log)
        reports.await_ready()

        def progress(done: float, total: float) -> None:
            reports.require_alive()
            meter(done, total)

        with gauge(f"playing {commands.topic} in real time") as meter:
            played = play(me, commands, frame_id=frame, duration=duration, progress=progress)
        reports.await_next()
        process.send_signal(signal.SIGINT)
        try:
            return played, process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            raise DemoError(f"the node did not end within {END_TIMEOUT:g} s of SIGINT; see {log}") from None


class _Reports:
    """What the node says on /diagnostics while it starts and runs."""

    def __init__(self, node: Any, process: subprocess.Popen[bytes], log: Path) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor

        self._process, self._log = process, log
        self._received: list[Any] = []
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._received.append, 10)

    def await_ready(self) -> None:
        """Until the node simulates; relays what it is doing. Raises DemoError when it does not get there."""
        doing, end = "", time.monotonic() + READY_TIMEOUT
        while time.monotonic() < end:
            for report in self._spin():
                if any(item.key == "steps" for item in report.status[0].values):
                    return
                if report.status[0].message != doing:
                    doing = report.status[0].message
                    say(f"the node is {doing}")
        raise DemoError(f"the node was not ready within {READY_TIMEOUT:g} s; see {self._log}")

    def await_next(self) -> None:
        """Until a report of the time up to now has come."""
        now = time.time_ns()
        end = time.monotonic() + REPORT_TIMEOUT
        while time.monotonic() < end:
            stamps = [report.header.stamp for report in self._spin()]
            if any(stamp.sec * 1_000_000_000 + stamp.nanosec > now for stamp in stamps):
                return
        raise DemoError(f"no report on /diagnostics for {REPORT_TIMEOUT:g} s; see {self._log}")

    def require_alive(self) -> None:
        """Raises DemoError when the node has ended."""
        code = self._process.poll()
        if code is not None:
            raise DemoError(f"the node ended with code {code}: {last_line(self._log)}; see {self._log}")

    def _spin(self) -> list[Any]:
        """Reports that came since the last call; waits for one for a moment."""
        self.require_alive()
        self._executor.spin_once(timeout_sec=0.1)
        received, self._received[:] = list(self._received), []
        return received


def _refusal(priority: int) -> str | None:
    """Why a thread of this user cannot have a priority of SCHED_FIFO; tried by one that ends at once."""
    from .loop import prefer_this_thread

    refusals: list[str | None] = []
    thread = threading.Thread(target=lambda: refusals.append(prefer_this_thread(priority)))
    thread.start()
    thread.join()
    return refusals[0]


def require_ros() -> None:
    """Raises MissingExtraError where rclpy is neither installed nor sourced."""
    if importlib.util.find_spec("rclpy") is None:
        raise MissingExtraError("no rclpy found: without a sourced ROS 2, this", "ros")


def require_websockets() -> None:
    """Raises MissingExtraError where the page cannot be served."""
    if importlib.util.find_spec("websockets") is None:
        raise MissingExtraError("the page", "view")


def _at_rate(scene: Scene, rate: float) -> Scene:
    """The scene with steps of 1 / rate. Raises SceneError for a rate that no scene may have."""
    dt = specs(Scene)["dt"]
    low, high = 1.0 / dt.high, 1.0 / dt.low
    if not low <= rate <= high:
        raise SceneError("rate", rate, f"a number in [{low:g}, {high:g}] Hz")
    return scene.with_values({"dt": 1.0 / rate})


def _make_folder(out: str | Path | None) -> Path:
    """A fresh folder: the one asked for, which must not hold anything yet, or the first free numbered one."""
    try:
        if out is not None:
            folder = Path(out)
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise FingerSimError(f"{folder}: is not empty; give another folder with --out, or remove it")
            return folder
        for number in range(1, 10_000):
            folder = Path(FOLDER if number == 1 else f"{FOLDER}_{number}")
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            return folder
    except OSError as error:
        raise FingerSimError(f"{error.filename or out}: cannot be made: {error.strerror}") from None
    raise FingerSimError(f"{FOLDER}_…: there are 10,000 already; remove some")

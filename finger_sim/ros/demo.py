"""The main job, start to finish: the real node, a bag played at it, a recording, a picture and a table."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from ..bags.reader import BagReader, Commands, read_commands
from ..console import gauge, say, table
from ..errors import BagError, FingerSimError, MissingExtraError, SceneError
from ..scene import Scene
from ..scene.fields import specs
from ..scene.resources import find_bag, find_scene

if TYPE_CHECKING:
    from ..pictures.report import Health, Recorded
    from .loop import Progress
    from .play import Played

SCENE = "finger_haptic"
RATE = 1000.0
"""Steps a second [Hz]."""
FOLDER = "finger_sim_demo"
READY_TIMEOUT = 300.0
"""Longest time that a node may take to its first step [s]; compiling takes up to a minute."""
PATIENCE = 5.0
"""Time after which a start that takes long is spoken of again [s]."""
REPORT_TIMEOUT = 15.0
"""Longest time between two messages on /diagnostics of a living node [s]."""
END_TIMEOUT = 15.0
"""Longest time that the node may take to close its bag and end [s]."""
FEWEST_HEARD = 0.5
"""Fraction of the commands that the node must hear; it skips those that newer ones overtake."""
REAL_TIME = 0.99
"""Real-time factor from which on a run counts as in real time."""
LATE = 0.005
"""Fraction of its steps by which the node may be late more often than a bare loop."""
FLOOR_TIME = 2.0
"""How long the bare loop is watched [s]; no longer than the commands."""
PRIORITY = 20
"""Of the node's loop and of the bare one under SCHED_FIFO, where the system permits it."""


class DemoError(FingerSimError):
    """A part of the demo did not do its job."""


@dataclass
class Outcome:
    """What a demo left behind, and what went wrong in it."""

    bag: Path
    picture: Path
    log: Path
    played: Played
    heard: int
    """Commands in the recording."""
    messages: int
    """Recorded, all topics."""
    rate: float
    """Steps a second while the commands were played [Hz]."""
    dt: float
    """[s]"""
    tets: int
    recorded: Recorded
    health: Health
    floor: Progress
    """Of a bare loop, right before; see `bare_loop`."""
    priority: int
    """Of both loops' threads under SCHED_FIFO; 0: as any other thread."""
    failures: list[str] = field(default_factory=list)

    @property
    def real_time_factor(self) -> float:
        """Simulated time / wall time while the commands were played."""
        return self.rate * self.dt

    @property
    def late(self) -> float:
        """Late steps of the node, of its steps while the commands were played."""
        return self.health.late / max(self.health.steps, 1)

    @property
    def late_above_floor(self) -> float:
        """`late`, less that of the bare loop."""
        return self.late - self.floor.late_fraction

    @property
    def notes(self) -> list[str]:
        """What a user should know about a run that did its job."""
        out = []
        if self.real_time_factor < REAL_TIME:
            out.append(
                f"slower than real time: the machine is busy or too slow for {1.0 / self.dt:g} Hz; "
                f"try --rate {0.5 / self.dt:g}"
            )
        if self.late_above_floor > LATE:
            out.append(
                f"{100 * self.late_above_floor:.2f} % more steps were late than of a bare loop, "
                f"wanted: at most {100 * LATE:g} %"
            )
        return out

    def table(self) -> Table:
        """What was reached, and what each number means."""
        played, health, floor = self.played, self.health, self.floor
        peak = int(np.argmax(self.recorded.force))
        force, when = self.recorded.force[peak], self.recorded.wrench_time[peak]
        out = table()
        rows = (
            ("rate reached", f"{self.rate:.1f} Hz", f"steps a second, of {1.0 / self.dt:g} asked for"),
            ("real-time factor", f"{self.real_time_factor:.4f}",
             f"simulated time / wall time; wanted: at least {REAL_TIME:g}"),
            ("late steps", f"{100 * self.late:.2f} %",
             f"{health.late} of {health.steps}, not done when the next was due"),
            ("late steps of a bare loop", f"{100 * floor.late_fraction:.2f} %",
             f"{floor.late} of {floor.steps} that do nothing, right before; real-time factor "
             f"{floor.real_time_factor(self.dt):.4f}"),
            ("late steps above it", f"{100 * self.late_above_floor:.2f} %", f"wanted: at most {100 * LATE:g} %"),
            ("priority of both loops", str(self.priority),
             "SCHED_FIFO" if self.priority else "none: as any other thread"),
            ("step time median", f"{1e3 * health.step_median:.3f} ms",
             f"to simulate and send a step, of {1e3 * self.dt:g} ms"),
            ("step time p99", f"{1e3 * health.step_p99:.3f} ms", "99 of 100 steps took less"),
            ("overruns", str(health.overruns), f"steps skipped, of {health.steps + health.overruns}"),
            ("peak force", f"{force:.3f} N",
             f"of the plane on the finger, at {when:.2f} s" if force > 0.0 else "the finger touched nothing"),
            ("most tetrahedra at a limit", f"{health.limited_tets} of {self.tets}", "in one step"),
            ("max strain/limit", f"{health.max_strain_ratio:.3f}", "1: exactly at the limit"),
            ("max penetration", f"{1e3 * health.max_penetration:.4f} mm", "of the skin into the plane"),
            ("solver status", health.status, f"set in {health.troubled} of {health.steps} steps"
             if health.troubled else "in every step"),
            ("commands", f"{self.heard} of {played.sent}",
             f"heard, sent {1e3 * played.late_p99:.2f} ms late (p99)"),
            ("messages recorded", str(self.messages), "on all topics, numbered"),
            ("bag", str(self.bag), ""),
            ("picture", str(self.picture), ""),
            ("log of the node", str(self.log), ""),
        )  # fmt: skip
        for row in rows:
            out.add_row(*row)
        return out


def run_demo(
    scene: str = SCENE,
    bag: str = "press_slide",
    out: str | Path | None = None,
    *,
    rate: float = RATE,
    priority: int = PRIORITY,
    duration: float | None = None,
    topic: str | None = None,
) -> Outcome:
    """Measures a bare loop, starts the node, plays the commands of `bag` at it over ROS 2, records, draws, sums up.

    What cannot work is refused before anything is begun.

    out      : folder to make; FOLDER, or FOLDER_2 …, if left out
    rate     : steps a second, instead of the scene's dt [Hz]
    priority : of the loop under SCHED_FIFO, where that is permitted; 0: none
    duration : of the commands that are played [s]; all of them if left out
    Raises DemoError when the node or the recording fails, and other FingerSimErrors for what was asked for.
    """
    require_ros()
    if importlib.util.find_spec("matplotlib") is None:
        raise MissingExtraError("drawing", "plot")
    loaded = _at_rate(Scene.load(scene), rate)
    mesh = loaded.load_mesh()
    loaded.driven_nodes(mesh)
    commands = read_commands(find_bag(bag), topic)
    folder = _make_folder(out)
    recording, log = folder / "recording", folder / "node.log"
    frame = commands.frame_id or "world"
    if priority and not _permits(priority):
        say(f"real-time priority {priority} is not permitted here: the loops run as any other thread")
        priority = 0
    parameters = {
        "scene": str(find_scene(scene).resolve()),
        "dt": loaded.dt,
        "record": str(recording.resolve()),
        "world_frame": frame,
        "realtime_priority": priority,
    }
    length = commands.duration if duration is None else min(duration, commands.duration)
    floor = bare_loop(loaded.dt, min(FLOOR_TIME, length), priority)
    played, code = _drive(parameters, commands, frame, duration, log)
    outcome = sum_up(recording, log, folder / "demo.png", played, loaded, len(mesh.tets), floor, priority)
    if code != 0:
        outcome.failures.insert(0, f"the node ended with code {code}: {_last_line(log)}")
    return outcome


def bare_loop(dt: float, seconds: float, priority: int) -> Progress:
    """What the machine allows: the node's loop with steps that do nothing, in a process of its own as the node's.

    Steps that do nothing, not steps as long as the node's: of the two floors of late steps that is the lower one, and
    it needs no step time to be known before. Watched before the node starts, which would be in its way.
    Raises DemoError when it does not run.
    """
    from .loop import Progress

    say(f"watching a bare loop of {1.0 / dt:g} Hz")
    command = [sys.executable, "-m", "finger_sim.ros.loop", repr(dt), repr(seconds), str(priority)]
    ran = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, start_new_session=True)
    try:
        return Progress(**json.loads(ran.stdout))
    except (ValueError, TypeError):
        raise DemoError(f"the bare loop ended with code {ran.returncode}: {_last(ran.stderr)}") from None


def _drive(
    parameters: Mapping[str, Any], commands: Commands, frame: str, duration: float | None, log: Path
) -> tuple[Played, int]:
    """Commands to a fresh node that records; what was played, and the node's exit code."""
    from .play import play, ros_node

    domain = _free_domain()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    say(f"starting the node (ROS_DOMAIN_ID {domain})")
    with _node_process(parameters, domain, log) as process, ros_node("finger_sim_demo", domain) as me:
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


def sum_up(
    recording: Path, log: Path, picture: Path, played: Played, scene: Scene, tets: int, floor: Progress, priority: int
) -> Outcome:
    """Reads the recording, draws, and checks that nothing is missing."""
    from ..pictures.plots import draw
    from ..pictures.report import read_health, read_recording

    say("reading the recording")
    try:
        reader = BagReader(recording)
        recorded = read_recording(recording, scene.plane)
        health = read_health(recording, recorded.start, recorded.start + round(1e9 * played.duration))
    except BagError as error:
        raise DemoError(f"the recording is of no use: {error}; see {log}") from None
    counts = {topic.name: topic.count for topic in reader.topics}
    during = recorded.wrench_time[(recorded.wrench_time >= 0.0) & (recorded.wrench_time <= played.duration)]
    outcome = Outcome(
        bag=recording,
        picture=picture,
        log=log,
        played=played,
        heard=counts.get("/command_pose", 0),
        messages=reader.message_count,
        rate=_rate(during),
        dt=scene.dt,
        tets=tets,
        recorded=recorded,
        health=health,
        floor=floor,
        priority=priority,
    )
    outcome.failures += [f"{t.name}: {t.lost} messages lost in recording" for t in reader.topics if t.lost]
    if reader.warning:
        outcome.failures.append(f"the bag is not whole: {reader.warning}")
    if health.dropped:
        outcome.failures.append(f"{health.dropped} messages not recorded: disk or processor too slow")
    if len(during) < 2:
        outcome.failures.append("no contact_wrench was recorded while commands came in")
    if health.refused:
        outcome.failures.append(f"the node refused {health.refused} commands; see {log}")
    if outcome.heard < FEWEST_HEARD * played.sent:
        outcome.failures.append(f"the node heard {outcome.heard} of {played.sent} commands")
    say("drawing")
    draw(recorded, picture)
    if not picture.is_file() or picture.stat().st_size == 0:
        outcome.failures.append(f"{picture} was not written")
    return outcome


def _rate(times: Any) -> float:
    """Events a second of their times (n,) [s]; 0 for fewer than two."""
    return float((len(times) - 1) / (times[-1] - times[0])) if len(times) > 1 else 0.0


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
        doing, begin = "", time.monotonic()
        due = begin + PATIENCE
        while (now := time.monotonic()) < begin + READY_TIMEOUT:
            for report in self._spin():
                if any(item.key == "steps" for item in report.status[0].values):
                    return
                if report.status[0].message != doing:
                    doing = report.status[0].message
                    say(f"the node is {doing}")
            if now >= due:
                due += PATIENCE
                say(f"the node is {doing or 'loading'} ({now - begin:.0f} s)")
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
            raise DemoError(f"the node ended with code {code}: {_last_line(self._log)}; see {self._log}")

    def _spin(self) -> list[Any]:
        """Reports that came since the last call; waits for one for a moment."""
        self.require_alive()
        self._executor.spin_once(timeout_sec=0.1)
        received, self._received[:] = list(self._received), []
        return received


@contextmanager
def _node_process(parameters: Mapping[str, Any], domain: int, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The node, its output in `log`; ended with the block, by force if it must be."""
    assigned = [f"{name}:={json.dumps(value)}" for name, value in parameters.items()]
    arguments = [text for assignment in assigned for text in ("-p", assignment)]
    command = [sys.executable, "-m", "finger_sim.ros.node", "--ros-args", *arguments]
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _permits(priority: int) -> bool:
    """Whether a thread of this user may have a priority of SCHED_FIFO; tried by one that ends at once."""
    from .loop import prefer_this_thread

    refusals: list[OSError] = []

    def attempt() -> None:
        try:
            prefer_this_thread(priority)
        except OSError as error:
            refusals.append(error)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return not refusals


def require_ros() -> None:
    """Raises MissingExtraError where rclpy is neither installed nor sourced."""
    if importlib.util.find_spec("rclpy") is None:
        raise MissingExtraError("no rclpy found: without a sourced ROS 2, this", "ros")


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


def _free_domain() -> int:
    """A ROS domain, 1 to 101, in which no process of this machine takes part."""
    first = os.getpid() % 101
    for domain in ((first + i) % 101 + 1 for i in range(101)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10))  # where its first participant listens
            except OSError:
                continue
            return domain
    raise DemoError("all ROS domains of this machine are in use")


def _last_line(log: Path) -> str:
    """The last thing that the node said."""
    return _last(log.read_text(errors="replace"))


def _last(text: str) -> str:
    """Its last line that is not empty."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"

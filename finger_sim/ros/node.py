"""The ROS 2 node `finger`: commands in, wrenches and the deformed finger out, in real time.

Run it with `ros2 run finger_sim finger_node` or `python3 -m finger_sim.ros.node`. Two threads share the work: the
main one serves ROS and reports, the loop makes the steps and sends what they bring. A process of its own writes bags.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from ..bags import cdr
from ..bags.changes import EVENTS, RESET, RESET_QOS
from ..bags.origin import block_text, machine, origin_of
from ..bags.template import Template
from ..errors import FingerSimError, SceneError
from ..plain import printing
from ..scene import Pose, Scene
from ..simulation.simulator import Changed
from . import parameters, rclpy_private
from .bag_paths import bag_path, free_name
from .bag_pipe import Standby
from .device import device_from, told
from .device_in import DeviceIn
from .diagnostics import Reporter
from .given import unreached
from .graph_watch import GraphWatch
from .inbox import Command, Inbox
from .loop import StepCounts, Triggers, keep_in_memory, prefer_receivers, prefer_this_thread
from .messages import time_of
from .options import NodeOptions
from .outputs import Outputs
from .process import flush, logged, process_age, set_up
from .recorder import RecordedTopic, Recorder
from .rosout import Rosout
from .scenery import Scenery
from .stepper import Stepper
from .ticker import Ticker
from .transforms import Lookup

if TYPE_CHECKING:
    from .lifecycle import Lifecycle

ANSWER_TIMEOUT = 2.0
"""How long a service waits for the loop [s]."""
REPORT_PERIOD = 1.0
"""Time between two messages on /diagnostics [s]."""

WAITING_COMMANDS = 1000
"""Commands that may wait for their steps in mode triggered; when more come, the oldest are dropped and counted."""

NOTHING_YET = StepCounts(0, 0, 0, 0.0, 0.0)
"""How far a loop is that has not begun."""


class FingerNode(Node):  # type: ignore[misc]
    """Wires topics, services and parameters to the loop. Raises FingerSimError for parameters of no use.

    given : the arguments of its process, as rclpy.init took them
    """

    def __init__(self, given: Sequence[str]) -> None:
        super().__init__("finger")
        log = self.get_logger()
        overrides = rclpy_private.overrides(self)
        options = parameters.options_from(overrides)
        scene = Scene.load(options.scene)
        scene = parameters.scene_from(scene, overrides)
        device = device_from(options.device, overrides)
        parameters.declare(self, parameters.node_parameters(options))
        parameters.declare(self, parameters.device_parameters(device))
        parameters.declare(self, scene.parameters())
        parameters.require_known(overrides, self, scene, options.scene)
        self._bags = bag_path("record_directory", options.record_directory)
        if options.record and os.path.lexists(bag_path("record", options.record)):
            raise SceneError("record", options.record, "a path that does not exist yet")
        self.add_pre_set_parameters_callback(lambda given: parameters.widen(given, self))

        self._standby = Standby()
        self._standby.prepare()
        self._progress = "loading"
        self._device = device
        self._outputs = Outputs(self, options, device)
        self._stepper = Stepper(scene, self._outputs, log)
        self._processors = parameters.processors(options.cpu_affinity)
        frames = Lookup(self, options.world_frame) if options.transform_commands else None
        commands = DeviceIn(device, options.world_frame, self._stepper.rendering.record.clutched)
        self._inbox = Inbox(self, self._outputs, lambda: self._stepper.scene.plane is not None, commands, frames)
        self._resets = RecordedTopic(str(self.resolve_service_name(f"~/{RESET}")), cdr.EMPTY, RESET_QOS)
        self._rosout = Rosout(self, self._outputs)
        self._beginning = threading.Lock()
        """Held while a recording begins: no option changes once it has said what they are, before it takes changes."""
        self._recorded_from = NOTHING_YET
        self._early: deque[Command] = deque(maxlen=WAITING_COMMANDS)
        parts = (self._stepper, self._outputs, self._inbox)
        triggers = Triggers[Command](WAITING_COMMANDS) if options.mode == "triggered" else None
        self._loop = Ticker(scene.dt, self._prepare, parts, self._take_all, triggers, self.get_clock(), log)
        self.add_on_set_parameters_callback(self._on_set)
        graph = GraphWatch(self, self._inbox.subscriptions)
        self._scenery = Scenery(self._outputs, self._loop.shown)
        name = self.get_fully_qualified_name()
        self._reporter = Reporter(name, self._loop, self._stepper, self._outputs, self._inbox, graph)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/record", self._on_record)
        self._lifecycle: Lifecycle | None = None
        if options.lifecycle:
            from .lifecycle import Lifecycle, Transitions

            self._loop.rest()
            does = (self._configure, self._activate, self._deactivate, self._clean_up, lambda: self._over.set())
            self._lifecycle = Lifecycle(self, Transitions(*does))
        for text in (*parameters.unused_qualities(overrides, self), *unreached(given, self)):
            log.warning(text)
        log.info(parameters.forces(options, scene))
        if device is not None:
            log.info(told(options.device, device))

    def run(self, stop: threading.Event) -> int:
        """Serves until `stop` is set or the loop fails; the exit code."""
        self._over = stop
        executor = EventsExecutor()
        executor.add_node(self)
        if self._lifecycle is None:
            self._begin()
        due = time.monotonic() + REPORT_PERIOD
        while not stop.is_set() and rclpy.ok() and self._loop.error is None:
            with self._inbox.early:
                if not self._loop.ready:
                    self._early.extend(self._take())
            self._serve(executor, min(0.1, max(0.0, due - time.monotonic())))
            self._rosout.record()
            if time.monotonic() >= due:
                self._report()
                due = max(due + REPORT_PERIOD, time.monotonic())
        executor.remove_node(self)
        return self._close()

    def _begin(self) -> None:
        """Loads what is simulated, and steps it unless it is to rest."""
        self._loop.start()
        self._scenery.start()

    def _configure(self) -> None:
        """Loads what is simulated. Nobody is answered meanwhile; diagnostics tell how far it is."""
        if not self._loop.alive:
            self._begin()
        due = time.monotonic()
        while not self._loop.ready:
            if self._over.wait(0.1) or self._loop.error is not None:
                raise FingerSimError(f"{self._loop.error or 'it was asked to'}: the node ends")
            if time.monotonic() >= due:
                self._report()
                due += REPORT_PERIOD

    def _activate(self) -> None:
        path = self._outputs.options.record
        if path and self._outputs.recorder is None:
            self._record(bag_path("record", path))
        self._ask(self._loop.call(self._loop.go_on))

    def _deactivate(self) -> None:
        """The next recording begins with the next steps: a replay knows of no rest."""
        self._ask(self._loop.call(self._loop.rest))
        recorder = self._outputs.recorder
        if recorder is not None and recorder.active:
            self._end_recording(recorder)

    def _clean_up(self) -> None:
        """What is loaded stays: no parameter that it was made of can change."""
        self._ask(self._loop.call(self._reset))

    def _serve(self, executor: Any, timeout: float) -> None:
        """Answers what comes within `timeout` [s]. What rclpy cannot take, such as a negative /clock, ends nothing."""
        try:
            executor.spin_once(timeout_sec=timeout)
        except (KeyboardInterrupt, ExternalShutdownException):
            raise
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            self.get_logger().error(f"a message or request cannot be taken: {text}", throttle_duration_sec=10.0)

    def _close(self) -> int:
        if self._lifecycle is not None:
            self._lifecycle.end()
        self._scenery.stop()
        stopped = self._loop.stop(timeout=0.5 if self._loop.ready else 0.1)
        recorder = self._outputs.recorder
        if recorder is not None and recorder.active:
            self._end_recording(recorder)
        self._standby.end()
        error = self._loop.error
        if error is not None:
            self.get_logger().fatal(" ".join(f"{type(error).__name__}: {error}".split()))
        if not stopped:
            # A compiler or a step that does not come back cannot be unwound: leave it where it is.
            flush()
            os._exit(int(error is not None))
        self._loop.release()
        return int(error is not None)

    def _prepare(self) -> None:
        """The loop thread's way to its first step."""
        self._stepper.prepare(self._on_progress, self._loop.compile)
        self._loop.load(self._on_progress)
        if self._outputs.options.record and self._lifecycle is None:
            self._record(bag_path("record", self._outputs.options.record))
        if self._outputs.options.lock_memory:
            refused = keep_in_memory()
            self.get_logger().info(refused or "all memory is locked")
        priority = self._place_this_thread(self._outputs.options.realtime_priority)
        # A full collection would look at every object numba made: 150 ms in which no step can begin.
        gc.collect()
        gc.freeze()
        scene, options = self._stepper.scene, self._outputs.options
        pace = f"at {1.0 / scene.dt:g} Hz" if options.mode == "free" else "one step for each command"
        self.get_logger().info(
            f"ready after {process_age():.1f} s: {options.scene}, {len(self._stepper.sim.mesh.tets)} tets, {pace}, "
            + (f"real-time priority {priority}" if priority else "no real-time priority")
        )

    def _place_this_thread(self, priority: int) -> int:
        """On the processors asked for, and with the priority, where that is permitted; the one it has.

        The middleware's threads that receive have one less.
        """
        if self._processors:
            os.sched_setaffinity(0, self._processors)
        refused = prefer_this_thread(priority)
        if refused is not None:
            self.get_logger().info(refused)
            return 0
        prefer_receivers(max(0, priority - 1))
        return priority

    def _on_progress(self, text: str) -> None:
        self._progress = text
        self.get_logger().info(text)

    def _report(self) -> None:
        if self._outputs.recorder is not None:
            self._outputs.recorder.check()
        self._standby.prepare()
        report = self._reporter.report(time_of(self.get_clock()), self._progress)
        self._outputs.send("/diagnostics", serialize_message(report))

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Those that an executor serves; of the others the loop takes what comes."""
        for subscription in super().subscriptions:
            if subscription not in (*self._inbox.subscriptions, self._rosout.entity):
                yield subscription

    def _take_all(self, now: int | None) -> list[Command]:
        """What came in by a steady time [ns], or till now, and before the loop was ready."""
        early = [self._early.popleft() for _ in range(len(self._early))]
        return early + self._take(now)

    def _take(self, now: int | None = None) -> list[Command]:
        """What came in by a steady time [ns], or till now."""
        commands = self._inbox.commands(now)
        if commands:
            self._stepper.newest = commands[-1]
        plane = self._inbox.plane(now)
        if plane is not None:
            self._stepper.plane = plane
        return commands

    def _on_set(self, given: list[Any]) -> SetParametersResult:
        try:
            changes, options = parameters.live_changes(given, self._stepper.scene, self._outputs.options)
            event = parameters.event(self.get_fully_qualified_name(), given)
            if changes or self._loop.ready:
                self._require_ready()
                changed = self._stepper.sim.changed(changes) if changes else None
                self._ask(self._loop.call(lambda: self._change(changed, options, event)))
            else:
                with self._beginning:
                    self._change(None, options, event)
        except FingerSimError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _change(self, changed: Changed | None, options: NodeOptions, event: Template) -> None:
        """Takes new values, between two steps where there are some, and records from when on they hold."""
        if changed is not None:
            self._stepper.apply(changed, options)
        else:
            self._outputs.options = options
        self._outputs.record(EVENTS, event.fill(time_of(self.get_clock())))

    def _reset(self) -> Pose:
        """Back to rest at the last command, which is recorded."""
        pose = self._stepper.reset()
        self._outputs.record(self._resets.name, cdr.empty())
        return pose

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            pose = self._ask(self._loop.call(self._reset))
            response.success = True
            response.message = f"at rest at position {pose.position}, orientation {pose.orientation}"
        except FingerSimError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        recorder = self._outputs.recorder
        if recorder is not None:
            recorder.check()
        recording = recorder is not None and recorder.active
        try:
            if request.data and recorder and recording:
                raise FingerSimError(f"recording already: {recorder.path}")
            if not request.data and not recording:
                why = f": {recorder.summary()}" if recorder and recorder.error else ""
                raise FingerSimError(f"nothing is being recorded{why}")
            self._require_ready()
            if self._loop.resting:
                raise FingerSimError("the node is inactive: there is nothing to record")
            if request.data:
                recorder = self._record(free_name(self._bags))
                response.success, response.message = True, f"recording {recorder.path}"
            elif recorder is not None:
                self._end_recording(recorder)
                response.success, response.message = recorder.error is None, recorder.summary()
        except FingerSimError as error:
            response.success, response.message = False, str(error)
        return response

    def _record(self, path: Path) -> Recorder:
        with self._beginning:
            options, scene, sim = self._outputs.options, self._stepper.scene, self._stepper.sim
            sources = (self._outputs, self._inbox, self._rosout)
            topics = [topic for source in sources for topic in source.recorded_topics()] + [self._resets]
            said = {} if self._device is None else {"device_settings": self._device.to_dict()}
            origin = origin_of("node", scene, sim.mesh, dataclasses.asdict(options) | said, machine())
            bag = {
                "compression": options.record_compression,
                "split_bytes": 1e6 * options.record_split_size or math.inf,
                "split_seconds": options.record_split_time or math.inf,
                "origin": origin.words(),
            }
            failed = self.get_logger().error
            recorder = Recorder(path, topics, options.record_queue, self._standby.pipe(), bag, failed)
            self._recorded_from = self._loop.progress
            now, standing = time_of(self.get_clock()), self._inbox.standing()
            self._outputs.start_recording(recorder, sim.plane_pose, now, standing)
        self._loop.call(lambda: None)  # from now on the loop records
        self.get_logger().info(f"recording {recorder.path}")
        return recorder

    def _end_recording(self, recorder: Recorder) -> None:
        """With what has been logged by now, and what rate was reached in it."""
        self._rosout.record()
        recorder.close(origin={"reached": block_text(self._loop.progress.since(self._recorded_from))})
        self.get_logger().info(f"recorded {recorder.summary()}")

    def _require_ready(self) -> None:
        """Raises FingerSimError."""
        if not self._loop.ready:
            raise FingerSimError(f"not ready: {self._progress}")

    def _ask(self, answer: Future[Any]) -> Any:
        """What the loop answers. Raises FingerSimError when it does not."""
        try:
            return answer.result(ANSWER_TIMEOUT if self._loop.ready else 0.0)
        except (TimeoutError, CancelledError):
            answer.cancel()
            reason = "the loop is stalled" if self._loop.ready else f"not ready: {self._progress}"
            raise FingerSimError(reason) from None


def main(args: list[str] | None = None) -> int:
    """Runs the node until SIGINT or SIGTERM; 0 after a clean end, 1 after an error."""
    return printing("finger_node", lambda: _main(args))


def _main(args: list[str] | None) -> int:
    stop = threading.Event()
    set_up()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        rclpy_private.require()
        rclpy.init(args=logged(args), signal_handler_options=SignalHandlerOptions.NO)
        node = FingerNode(sys.argv[1:] if args is None else args)
    except (FingerSimError, ParameterException, RuntimeError) as error:
        print(f"finger_node: {error}", file=sys.stderr)
        return 1
    try:
        return node.run(stop)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())

"""The node's report on /diagnostics: one status, its level the worst of what it says."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..bags.layout import status_name
from ..haptics.budget import claimed
from ..haptics.passivity import stable_stiffness
from ..simulation.touch import Imprint
from .accounts import DOUBTFUL, Window
from .graph_watch import GraphWatch
from .inbox import Inbox
from .loop import StepCounts
from .outputs import Outputs
from .stepper import Stepper
from .ticker import Ticker

STALL = 0.5
"""Time without a step after which the loop counts as stalled [s]."""
SLOW_COMMANDS = 100.0
"""Rate of commands [Hz] below which a device feels that its hand is followed late."""


class Reporter:
    """Makes a DiagnosticArray of the time since the last one; called from one thread.

    node : its full name
    """

    def __init__(
        self, node: str, loop: Ticker, stepper: Stepper, outputs: Outputs, inbox: Inbox, graph: GraphWatch
    ) -> None:
        self._name = status_name(node)
        self._loop, self._stepper, self._outputs, self._inbox = loop, stepper, outputs, inbox
        self._graph = graph
        self._before: StepCounts | None = None
        self._reported = 0.0
        self._refused = self._dropped = 0

    def report(self, stamp: int, starting: str) -> DiagnosticArray:
        """The report at `stamp` [ns]; `starting` says what goes on until the loop is ready."""
        problems: list[tuple[int, str]] = []
        values: dict[str, str] = {}
        if self._loop.resting and (self._loop.ready or not self._loop.alive):
            problems.append((0, "inactive: no step is made" if self._loop.ready else "unconfigured: nothing is loaded"))
        elif self._loop.ready:
            self._steps(values, problems)
        else:
            problems.append((1, f"starting: {starting}"))
        if self._loop.error is not None:
            problems.append((2, f"the loop ended: {self._loop.error}"))
        self._commands(values, problems)
        self._recording(values, problems)
        problems += [(1, text) for text in self._graph.problems()]
        level = max((level for level, _ in problems), default=0)
        status = DiagnosticStatus(
            level=bytes([level]),
            name=self._name,
            hardware_id="finger_sim",
            message="; ".join(text for _, text in problems) or "ok",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp.sec, array.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        return array

    def _steps(self, values: dict[str, str], problems: list[tuple[int, str]]) -> None:
        loop, period, options = self._loop, self._stepper.scene.dt, self._outputs.options
        now, progress = time.monotonic(), loop.progress
        before = self._before or StepCounts(0, 0, 0, progress.begin, progress.begin)
        wall = max(now - max(self._reported or progress.begin, self._loop.resumed), 1e-9)
        self._before, self._reported = progress, now
        window, imprint = self._between_steps()
        steps = progress.steps - before.steps
        factor = steps * period / wall
        overall = progress.steps * period / max(now - progress.begin, 1e-9)
        median, p99 = loop.step_time.percentiles(50, 99)
        late_median, late_p99 = loop.lateness.percentiles(50, 99)
        delay_median, delay_p99 = self._stepper.delay.percentiles(50, 99)
        transport = self._stepper.transport.percentiles(50)[0]
        port = self._stepper.port
        behind = self._following(values, problems) if options.mode == "free" else 0.0
        stiffness = stable_stiffness(options.device_damping, period, delay_p99 + 2.0 * transport + behind)
        values.update(
            {
                "mode": options.mode,
                "real-time factor": f"{factor:.4f}",
                "real-time factor since start": f"{overall:.4f}",
                "rate [Hz]": f"{steps / wall:.1f}",
                "step time p50 [ms]": f"{median * 1e3:.3f}",
                "step time p99 [ms]": f"{p99 * 1e3:.3f}",
                "lateness p50 [ms]": f"{late_median * 1e3:.3f}",
                "lateness p99 [ms]": f"{late_p99 * 1e3:.3f}",
                "steps": str(progress.steps),
                "late steps": str(progress.late),
                "overruns": str(progress.overruns),
                "iterations": str(window.iterations),
                "residual": f"{window.residual:.3g}",
                "active rows": str(window.limit_rows),
                "limited tets": str(window.limited_tets),
                "locked tets": str(window.locked_tets),
                "contacts": str(window.contacts),
                "steps asleep": str(window.asleep),
                "mesh messages": str(self._outputs.mesh_messages),
                "max strain/limit": f"{window.max_strain_ratio:.4f}",
                "penetration [mm]": f"{window.max_penetration * 1e3:.5f}",
                "status": (window.status.name if window.status else None) or "OK",
                "steps with status": str(window.troubled),
                "loop delay p50 [ms]": f"{delay_median * 1e3:.3f}",
                "loop delay p99 [ms]": f"{delay_p99 * 1e3:.3f}",
                "command transport p50 [ms]": f"{transport * 1e3:.3f}",
                "stable stiffness at that delay [N/m]": f"{stiffness:.0f}",
                "energy to the device [J]": f"{port.energy:.4g}",
                "leaked [J]": f"{port.leaked:.4g}",
                "dissipated [J]": f"{port.dissipated:.4g}",
                "passivity factor": f"{port.factor:.3f}",
            }
        )
        if imprint is not None:
            self._touch(values, imprint)
        self._rung(values, problems)
        free = options.mode == "free"
        newest = self._stepper.newest
        waiting = newest.received if newest and newest.received > progress.last else now
        quiet = now - (progress.last if free else waiting)
        if quiet > max(STALL, 5 * period):
            problems.append((2, f"the loop is stalled: no step for {quiet:.1f} s"))
        elif free and factor < 0.99:
            problems.append((1, f"slower than real time: factor {factor:.3f}"))
        if progress.overruns > before.overruns:
            what = "steps skipped" if free else "commands dropped: they come faster than steps are made"
            problems.append((1, f"{progress.overruns - before.overruns} {what}"))
        if window.doubtful:
            problems.append((1, f"{(window.status & DOUBTFUL).name} in {window.doubtful} of {window.steps} steps"))

    def _between_steps(self) -> tuple[Window, Imprint | None]:
        """The steps since the last report, and what tells how the finger touches the plane; less of a stalled loop."""
        snapshot = self._loop.reported
        if not snapshot.take(STALL):
            return Window(), None
        return snapshot.window(), snapshot.imprint(self._stepper.sim)

    def _touch(self, values: dict[str, str], imprint: Imprint) -> None:
        """How the finger touches the plane right now."""
        touch = imprint.touch()
        centre = touch.centre
        values["contact area [mm^2]"] = f"{touch.area * 1e6:.3f}"
        values["centre of pressure [mm]"] = " ".join(f"{x * 1e3:.3f}" for x in centre) if centre else "none"
        values["slipping contacts [%]"] = f"{100.0 * touch.slipping:.1f}"

    def _following(self, values: dict[str, str], problems: list[tuple[int, str]]) -> float:
        """How commands come and are followed; by how much the bone is behind them [s]."""
        follower, following = self._stepper.sim.follower, self._stepper.scene.coupling.following
        cadence, mode, delay = follower.cadence, follower.mode(following), follower.delay(following)
        values["following"] = mode if mode == following else f"{following}: {mode}"
        values["following delay [ms]"] = f"{1e3 * delay:.1f}"
        if cadence is None or not cadence.known:
            return delay
        rate = 1.0 / cadence.interval
        values["command rate [Hz]"] = f"{rate:.1f}"
        values["command jitter [ms]"] = f"{1e3 * cadence.jitter:.2f}"
        if rate < SLOW_COMMANDS and not self._stepper.rendering.stale and self._outputs.heard("device_wrench"):
            how = {"linear": f"followed {1e3 * delay:.0f} ms late", "predict": "predicted"}.get(
                mode, "held: each jumps"
            )
            problems.append((1, f"a device is fed {rate:.0f} commands a second, {how}; send {SLOW_COMMANDS:g} or more"))
        return delay

    def _rung(self, values: dict[str, str], problems: list[tuple[int, str]]) -> None:
        budget, rungs, scene = self._stepper.budget, self._stepper.rungs, self._stepper.scene
        if budget is None or budget.rung >= len(rungs):  # a parameter is being set at this moment
            return
        number, name = budget.rung, rungs[budget.rung].name
        values["budget [ms]"] = f"{1e3 * budget.seconds:g}"
        values["accuracy"] = f"{number} of {len(rungs) - 1}: {name}"
        values["accuracy changes"] = str(budget.moves)
        if number > 0:
            error = claimed(scene, self._stepper.sim.mesh).get(name)
            text = "not measured for this scene" if error is None else f"{error:.2g} of the peak force (rms)"
            problems.append((1, f"less accurate to hold {1e3 * budget.seconds:g} ms: {name}, error {text}"))

    def _commands(self, values: dict[str, str], problems: list[tuple[int, str]]) -> None:
        command, received, refused, reason = self._stepper.newest, *self._inbox.counts()
        age = f"{time.monotonic() - command.received:.3f}" if command else "no command yet"
        values["command age [s]"] = age
        values["received commands"] = str(received)
        values["refused commands"] = str(refused)
        if refused:
            values["last refusal"] = reason
        rendering = self._stepper.rendering
        if self._inbox.device.active:
            values["clutch"] = "open" if rendering.clutched else "closed"
        if rendering.stale and not rendering.clutched and not self._loop.resting:
            problems.append((1, "command is stale: holding the pose"))
        if refused > self._refused:
            problems.append((1, f"{refused - self._refused} commands refused: {reason}"))
        self._refused = refused

    def _recording(self, values: dict[str, str], problems: list[tuple[int, str]]) -> None:
        recorder = self._outputs.recorder
        values["recording"] = str(recorder.path) if recorder and recorder.active else "off"
        values["recorded messages"] = str(recorder.written if recorder else 0)
        values["dropped records"] = str(dropped := recorder.dropped if recorder else 0)
        if recorder and recorder.error:
            problems.append((2, f"recording stopped: {recorder.error}"))
        if dropped > self._dropped:
            problems.append((1, f"{dropped - self._dropped} records dropped: disk or processor too slow"))
        self._dropped = dropped

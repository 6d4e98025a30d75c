"""What viewers are sent: the deformed mesh, the device's wrench, the coloured surface, and frames, made in a thread.

The loop only copies what is shown, between two steps (snapshot.py).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from .outputs import Outputs
from .snapshot import Shown

TF_RATE = 100.0
"""Of messages on /tf [Hz]: recorded, and broadcast where tf2_ros is installed."""
PATIENCE = 0.5
"""How long it may take to end [s]."""
_IDLE = 0.1
"""Time between two looks at whether anything is to be shown [s]."""


class Scenery:
    """Shows what is due, from `start` to `stop`.

    ask : for a Shown of the present, whole or not; None before the first step, and where the loop does not answer
    """

    def __init__(self, outputs: Outputs, ask: Callable[[bool], Shown | None]) -> None:
        self._outputs, self._ask = outputs, ask
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scenery", daemon=True)
        self._due = {"mesh": 0.0, "marker": 0.0, "tf": 0.0}

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ends it."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(PATIENCE)

    def _run(self) -> None:
        while not self._stop.is_set():
            now = time.monotonic()
            due = [name for name, wanted in self._wanted().items() if wanted and now >= self._due[name]]
            if due:
                self._show(due)
            waits = [self._due[name] - time.monotonic() for name, wanted in self._wanted().items() if wanted]
            self._stop.wait(min(max(min(waits, default=_IDLE), 0.0), _IDLE))

    def _wanted(self) -> dict[str, float]:
        """Rate of each [Hz]; 0 where nobody is to see it."""
        out, options = self._outputs, self._outputs.options
        return {
            "mesh": options.mesh_rate if self._mesh_is_wanted() or out.heard("device_wrench_throttle") else 0.0,
            "marker": options.marker_rate if out.heard("mesh_marker") else 0.0,
            "tf": TF_RATE if out.recording or out.broadcasts else 0.0,
        }

    def _mesh_is_wanted(self) -> bool:
        return self._outputs.recording or self._outputs.heard("mesh_points")

    def _show(self, due: list[str]) -> None:
        shown = self._ask(due != ["tf"])
        rates, now = self._wanted(), time.monotonic()
        for name in due:
            period = 1.0 / rates[name] if rates[name] > 0.0 else 0.0
            self._due[name] = _next_due(self._due[name], now, period)
        if shown is None:
            return
        out = self._outputs
        if "mesh" in due:  # the wrench first: who takes a mesh then has the wrench of its step
            if out.heard("device_wrench_throttle"):
                out.throttled(shown)
            if self._mesh_is_wanted():
                out.mesh(shown)
        if "marker" in due:
            out.marker(shown)
        if "tf" in due:
            out.frames(shown)


def _next_due(due: float, now: float, period: float) -> float:
    """The next time on the grid of `due`, or one period from now when that has passed too."""
    return due + period if due + period > now else now + period

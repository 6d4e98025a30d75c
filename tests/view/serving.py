"""A server of pages in a thread of the test, a source that shows what the test wants, and a page without a browser."""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from view.decoder import DecodedFrame, DecodedTopology, decode_frame, decode_topology, kind_of
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from finger_sim.errors import FingerSimError
from finger_sim.view.files import Recordings
from finger_sim.view.guard import Guard
from finger_sim.view.hub import Hub
from finger_sim.view.protocol import Picture, Topology
from finger_sim.view.samples import Samples
from finger_sim.view.server import serve

TIMEOUT = 20.0


def until(condition: Callable[[], Any], period: float = 0.005, limit: float = TIMEOUT) -> Any:
    """The condition's value once it is true."""
    end = time.monotonic() + limit
    while not (value := condition()):
        assert time.monotonic() < end, "the condition did not come true"
        time.sleep(period)
    return value


class Still:
    """A source with a picture as often as it is asked for one, or none while it is still."""

    def __init__(self, nodes: int = 5, drive: bool = True, kind: str = "node") -> None:
        self.kind, self.drive = kind, drive
        self.samples = Samples()
        self.nodes, self.still = nodes, False
        self.poses: list[tuple[float, ...]] = []
        self.done: list[Any] = []
        self.listened: list[bool] = []
        self.made = 0
        self.refuse = ""
        self.hub: Hub | None = None

    async def run(self, hub: Hub) -> None:
        self.hub = hub
        self.begin()
        await asyncio.Event().wait()

    def begin(self) -> None:
        assert self.hub is not None
        rest = np.random.default_rng(0).random((self.nodes, 3))
        self.hub.begin(Topology(rest, np.array([[0, 1, 2]], np.int32)))

    def hello(self) -> Mapping[str, Any]:
        return {"title": "still", "scenes": ["a", "b"], "scene": "a"}

    def parameters(self) -> list[dict[str, Any]]:
        return [{"name": "plane.friction", "value": 0.5}]

    def status(self) -> Mapping[str, Any]:
        return {"phase": "running", "message": "", "rate": float("nan")}

    def listen(self, on: bool) -> None:
        self.listened.append(on)

    def look(self) -> Picture | None:
        if self.still:
            return None
        self.made += 1
        picture = Picture(float(self.made), np.zeros((self.nodes, 3), np.float32), np.zeros(self.nodes, np.float32))
        self.samples.add(float(self.made), 1.0, 0.0, 0.0, 0.0)
        return picture

    def pose(self, numbers: tuple[float, ...]) -> None:
        self.poses.append(numbers)

    async def do(self, order: Any, hub: Hub) -> Mapping[str, Any] | None:
        if self.refuse:
            raise FingerSimError(self.refuse)
        self.done.append(order)
        return {"text": "a: 1\n", "name": "a.yaml"} if order.type == "yaml" else None

    def position(self) -> Mapping[str, Any] | None:
        return None


class Served:
    """A server of a source for the time of a `with` block; guard: of another address than it is served at."""

    def __init__(self, source: Any, guard: Guard | None = None, recordings: Recordings | None = None) -> None:
        self.source, self.guard = source, guard or Guard("127.0.0.1")
        self.recordings = recordings or Recordings()
        self.port = 0
        self.error: BaseException | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        async def work() -> None:
            self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()

            def ready(url: str) -> None:
                self.port = int(url.rpartition(":")[2].partition("/")[0])
                self._ready.set()

            await serve(self.source, self.guard, self.recordings, "127.0.0.1", 0, ready, self._stop)

        try:
            asyncio.run(work())
        except BaseException as error:
            self.error = error
        self._ready.set()

    def __enter__(self) -> Served:
        self._thread.start()
        self._ready.wait(TIMEOUT)
        assert self.error is None, self.error
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(TIMEOUT)
        assert not self._thread.is_alive()
        assert self.error is None, self.error

    def call(self, work: Callable[[], Any]) -> None:
        """Does something in the server's thread."""
        done = threading.Event()
        self._loop.call_soon_threadsafe(lambda: (work(), done.set()))
        assert done.wait(TIMEOUT)

    def page(self, **options: Any) -> Page:
        return Page(self.port, **options)


class Page:
    """A client that draws each frame at once, unless `draws` is turned off."""

    def __init__(self, port: int, query: str = "", draws: bool = True, **options: Any) -> None:
        self._stack = contextlib.ExitStack()
        url = f"ws://127.0.0.1:{port}/ws{query}"
        self.socket = self._stack.enter_context(connect(url, compression=None, max_size=None, **options))
        self.draws = draws
        self.said: list[dict[str, Any]] = []
        self.topologies: list[DecodedTopology] = []
        self.frames: list[DecodedFrame] = []
        self.order: list[str] = []

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        with contextlib.suppress(Exception):
            self._stack.close()

    def say(self, type: str, **fields: Any) -> None:
        self.socket.send(json.dumps({"type": type} | fields))

    def hold(self, pose: Sequence[float]) -> None:
        """Sends the finger to a position and x y z w."""
        seq = self.frames[-1].seq if self.frames else 0
        self.socket.send(struct.pack("<2I7d", 2, seq, *pose))

    def take(self, timeout: float = 0.01) -> None:
        """Takes one message, if one comes."""
        try:
            data = self.socket.recv(timeout)
        except TimeoutError:
            return
        if isinstance(data, str):
            self.said.append(json.loads(data))
            self.order.append(self.said[-1]["type"])
        elif kind_of(data) == 1:
            self.topologies.append(decode_topology(data))
            self.order.append("topology")
        else:
            self.frames.append(decode_frame(data))
            self.order.append("frame")
            if self.draws:
                self.socket.send(struct.pack("<2I", 1, self.frames[-1].seq))

    def until(self, condition: Callable[[], Any], repeat: Callable[[], None] = lambda: None, limit: float = TIMEOUT):
        """Takes what comes until the condition is true; its value."""
        end = time.monotonic() + limit
        while not (value := condition()):
            assert time.monotonic() < end, f"the condition did not come true; heard {self.order[-20:]}"
            repeat()
            self.take()
        return value

    def until_closed(self, limit: float = TIMEOUT) -> None:
        """Takes what comes until the server has ended the connection."""
        end = time.monotonic() + limit
        try:
            while time.monotonic() < end:
                self.take()
        except ConnectionClosed:
            return
        raise AssertionError("the connection stays open")

    def next(self, type: str) -> dict[str, Any]:
        """The first message of a type that comes from now on."""
        first = len(self.said)
        return self.until(lambda: next((each for each in self.said[first:] if each["type"] == type), None))

    def notice(self, type: str, **fields: Any) -> str:
        """What the server says to an order that it refuses."""
        self.say(type, **fields)
        return str(self.next("notice")["text"])

    def refusal(self, pose: Sequence[float]) -> str:
        """What the server says to a pose that it refuses."""
        self.hold(pose)
        return str(self.next("notice")["text"])

"""The pages that are open: each gets the newest frame once it has drawn the one before, and one holds the finger."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ..errors import FingerSimError
from ..plain import plain
from .connection import CROWDED, Connection, Peer
from .orders import Order, OrderError, read_drawn, read_order
from .protocol import VERSION, Frame, Picture, Topology, pack_topology

MOST_CLIENTS = 32
AHEAD = 2
"""Frames that may be on their way to a client, drawn by it or not."""
DEFAULT_HZ = 30.0
STATUS_PERIOD = 0.5
"""Time between two messages with the status [s]."""
PING_PERIOD, SILENCE = 5.0, 20.0
"""Time between two questions whether a client is there, and after which one that says nothing has gone [s]."""
SHORTEST_WAIT, LONGEST_WAIT = 2e-3, 16e-3
"""Between two looks for a picture that is due [s]."""


class Past(Protocol):
    """Samples of what was before."""

    def since(self, seen: int, time: float) -> tuple[bytes, int]:
        """Those after number `seen`, as messages hold them, relative to `time` [s]; and the number of the newest."""


class Source(Protocol):
    """What there is to show, and who does what pages ask for.

    kind    : node, or bag: a recording
    drive   : whether pages may hold the finger and change what is simulated
    samples : forces of the last seconds
    """

    @property
    def kind(self) -> str: ...

    @property
    def drive(self) -> bool: ...

    @property
    def samples(self) -> Past: ...

    async def run(self, hub: Hub) -> None:
        """Until it is cancelled: tells the hub what there is."""

    def hello(self) -> Mapping[str, Any]:
        """title, scenes, scene; of a bag its name and duration; of a node what was recorded and can be fetched."""

    def parameters(self) -> list[dict[str, Any]]:
        """Descriptions of all parameters."""

    def status(self) -> Mapping[str, Any]:
        """How it is."""

    def listen(self, on: bool) -> None:
        """Whether there is any page to show pictures to."""

    def look(self) -> Picture | None:
        """The newest picture where it is another than the one of the last call."""

    def pose(self, numbers: Sequence[float]) -> None:
        """Sends the finger there: position [m] and x y z w. Raises FingerSimError for what is no pose."""

    async def do(self, order: Order, hub: Hub) -> Mapping[str, Any] | None:
        """Follows an order; what to answer. Raises FingerSimError where that cannot be."""

    def position(self) -> Mapping[str, Any] | None:
        """Where a recording is; None for a node."""


class Client(Peer):
    """A page that is open."""

    def __init__(self, hub: Hub, connection: Connection, number: int) -> None:
        self.connection, self.number = connection, number
        self.period, self.due = 1.0 / DEFAULT_HZ, 0.0
        self.seen = -1
        """Number of the newest sample that it was sent; -1: none."""
        self.drawn_last = -1
        """seq of the newest frame that it was sent."""
        self._hub = hub
        self._sent: deque[int] = deque()

    def on_text(self, text: str) -> None:
        """An order came."""
        self._hub.obey(self, text)

    def on_bytes(self, data: bytes) -> None:
        """It has drawn a frame, and maybe sends the finger somewhere."""
        self._hub.follow(self, data)

    def on_closed(self) -> None:
        """It has gone."""
        self._hub.leave(self)

    def ready(self, now: float, tick: float) -> bool:
        """Whether it wants a frame at this time, and has drawn what it got; tick: time between two looks [s]."""
        return len(self._sent) < AHEAD and now >= self.due - 0.5 * tick and self.connection.waiting < CROWDED

    def draw(self, frame: Frame, samples: Past, now: float) -> None:
        """Sends a frame."""
        rows, newest = samples.since(self.seen, frame.picture.time)
        self.connection.send_binary(frame.message(rows, restart=self.seen < 0))
        self.seen, self.drawn_last = newest, frame.seq
        self._sent.append(frame.seq)
        self.due = max(self.due + self.period, now)

    def acknowledge(self, seq: int) -> None:
        """It has drawn that frame."""
        while self._sent and self._sent[0] <= seq:
            self._sent.popleft()

    def tell(self, kind: str, said: Mapping[str, Any], needed: bool = True) -> None:
        """Sends a JSON message."""
        self.connection.send_text(_text(kind, said), needed)

    def notice(self, level: str, text: str) -> None:
        """Something to be read by whoever sits before it."""
        self.tell("notice", {"level": level, "text": text}, needed=False)


class Hub:
    """All that pages share; of one asyncio loop.

    source : what is shown
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        self.holder: int | None = None
        self.generation = 0
        self._clients: dict[int, Client] = {}
        self._numbers = 0
        self._topology: bytes | None = None
        self._frame: Frame | None = None
        self._seq = 0
        self._position: Mapping[str, Any] | None = None
        self._somebody = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._orders: dict[str, Callable[[Client, Order], None]] = {
            "frames": self._frames,
            "take": lambda client, _: self._take(client),
            "release": lambda client, _: self._release(client),
        }

    async def run(self) -> None:
        """Until it is cancelled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self.source.run(self))
            group.create_task(self._draw())
            group.create_task(self._tell())

    def welcome(self, connection: Connection) -> Client | None:
        """A page that has been opened is told all that there is; None: there are too many."""
        if len(self._clients) >= MOST_CLIENTS:
            return None
        self._numbers += 1
        client = self._clients[self._numbers] = Client(self, connection, self._numbers)
        self._greet(client)
        if self._topology is not None:
            connection.send_binary(self._topology)
        client.tell("parameters", {"items": self.source.parameters()})
        client.tell("status", self.source.status())
        client.tell("handle", {"holder": self.holder})
        position = self.source.position()
        if position is not None:
            client.tell("position", position)
        if len(self._clients) == 1:
            self.source.listen(True)
            self._somebody.set()
        return client

    def leave(self, client: Client) -> None:
        """A page has gone; it holds nothing any more."""
        if self._clients.pop(client.number, None) is None:
            return
        if self.holder == client.number:
            self._hold(None)
        if not self._clients:
            self.source.listen(False)
            self._somebody.clear()

    def close(self) -> None:
        """Says farewell to all."""
        for client in list(self._clients.values()):
            client.connection.close()

    def begin(self, topology: Topology) -> None:
        """From now on pictures are of another mesh."""
        self.generation += 1
        self._topology = pack_topology(self.generation, topology)
        self._frame = None
        for client in self._clients.values():
            client.seen = client.drawn_last = -1
            self._greet(client)
            client.connection.send_binary(self._topology)
        self.tell("parameters", {"items": self.source.parameters()})

    def tell(self, kind: str, said: Mapping[str, Any], needed: bool = True) -> None:
        """Sends a JSON message to all."""
        text = _text(kind, said)
        for client in list(self._clients.values()):
            client.connection.send_text(text, needed)

    def notice(self, level: str, text: str) -> None:
        """Something to be read by all."""
        self.tell("notice", {"level": level, "text": text}, needed=False)

    def samples_anew(self) -> None:
        """All samples that were sent are of no use any more."""
        for client in self._clients.values():
            client.seen = -1

    def obey(self, client: Client, text: str) -> None:
        """Follows a message of a page, or tells it why not. No message ends anything."""
        try:
            order = read_order(text)
            known = self._orders.get(order.type)
            if known is not None:
                known(client, order)
            else:
                task = asyncio.get_running_loop().create_task(self._do(client, order))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        except FingerSimError as error:
            client.notice("warn", str(error))

    def follow(self, client: Client, data: bytes) -> None:
        """Takes what a page says as often as it draws, or tells it why not."""
        try:
            seq, pose = read_drawn(data)
            client.acknowledge(seq)
            if pose is not None:
                if self.holder != client.number:
                    raise OrderError("pose: only the page that holds the finger may send it")
                self.source.pose(pose)
        except FingerSimError as error:
            client.notice("warn", str(error))

    async def _do(self, client: Client, order: Order) -> None:
        """What takes the source some time."""
        try:
            answer = await self.source.do(order, self)
        except FingerSimError as error:
            client.notice("warn", str(error))
            return
        except Exception as error:  # whatever it is, it ends nothing
            client.notice("error", f"{order.type}: {type(error).__name__}: {error}")
            return
        if answer is not None:
            client.tell(order.type, answer)

    def _frames(self, client: Client, order: Order) -> None:
        client.period = 1.0 / float(order.said["hz"])
        client.due = 0.0

    def _take(self, client: Client) -> None:
        if not self.source.drive:
            raise OrderError("the finger cannot be held here: this page only shows it")
        if self.holder not in (None, client.number):
            client.notice("info", f"the finger is held by page {self.holder}")
        else:
            self.holder = client.number
        self._hold(self.holder)

    def _release(self, client: Client) -> None:
        self._hold(None if self.holder == client.number else self.holder)

    def _hold(self, holder: int | None) -> None:
        self.holder = holder
        self.tell("handle", {"holder": holder})

    def _greet(self, client: Client) -> None:
        source = self.source
        said = {"version": VERSION, "source": source.kind, "client": client.number, "drive": source.drive}
        client.tell("hello", said | dict(source.hello()))

    async def _draw(self) -> None:
        """Looks for pictures as often as the fastest page wants them, and sends each to whoever is ready for it."""
        loop = asyncio.get_running_loop()
        while True:
            await self._somebody.wait()
            tick = min((client.period for client in self._clients.values()), default=1.0 / DEFAULT_HZ)
            begin = loop.time()
            wait = SHORTEST_WAIT
            while not self._look(tick) and loop.time() < begin + tick:
                await asyncio.sleep(wait)
                wait = min(2.0 * wait, LONGEST_WAIT)
            # The next picture is due one period after this one came: so both keep in step.
            await asyncio.sleep(max(tick - SHORTEST_WAIT, SHORTEST_WAIT))

    def _look(self, tick: float) -> bool:
        """Sends the newest picture; whether it was a new one."""
        picture = self.source.look()
        if picture is not None:
            self._seq += 1
            self._frame = Frame(self.generation, self._seq, picture)
        frame = self._frame
        if frame is not None:
            now = asyncio.get_running_loop().time()
            for client in list(self._clients.values()):
                if client.drawn_last < frame.seq and client.ready(now, tick):
                    client.draw(frame, self.source.samples, now)
        position = self.source.position()
        if position is not None and position != self._position:
            self._position = position
            self.tell("position", position, needed=False)
        return picture is not None

    async def _tell(self) -> None:
        """The status, and whether pages are still there."""
        loop = asyncio.get_running_loop()
        asked = loop.time()
        while True:
            await asyncio.sleep(STATUS_PERIOD)
            if self._clients:
                self.tell("status", self.source.status(), needed=False)
            if loop.time() > asked + PING_PERIOD:
                asked = loop.time()
                for client in list(self._clients.values()):
                    if client.connection.heard < asked - SILENCE:
                        client.connection.abort()
                    else:
                        client.connection.ping()


def _text(kind: str, said: Mapping[str, Any]) -> str:
    return json.dumps({"type": kind} | plain(dict(said)), separators=(",", ":"), allow_nan=False)

"""One connection of a browser: a file over HTTP, or messages over a WebSocket once it asks for that.

websockets' protocol objects read and write bytes; here is what they leave to their user: the socket, the refusals, and
that a reader which has stopped reading costs neither memory nor time.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from email.utils import formatdate
from http import HTTPStatus
from typing import IO, Any, Protocol
from urllib.parse import unquote, urlsplit

from websockets.datastructures import Headers
from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.server import ServerProtocol

from .files import RECORDINGS, Recordings, page_file
from .guard import HEADERS, Guard
from .orders import MOST_BYTES

REQUEST_TIMEOUT = 10.0
"""Within this a request must have come [s]."""
MOST_WAITING = 1_000_000
"""Bytes that may wait for a reader; one that lets more come together has stopped reading and is let go."""
FAREWELL = 2.0
"""For so long what a page still sends is read and dropped once it has been told why it is let go [s]."""
CROWDED = 256_000
"""Waiting bytes from which on what is not needed is not sent."""

_LOG = logging.getLogger("finger_sim.view.websockets")
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False


class Peer(Protocol):
    """Who gets what comes over a WebSocket."""

    def on_text(self, text: str) -> None:
        """A message came."""

    def on_bytes(self, data: bytes) -> None:
        """A message came that is no text."""

    def on_closed(self) -> None:
        """The connection has ended."""


class Connection(asyncio.Protocol):
    """Answers one request.

    welcome : makes a Peer of a connection that has become a WebSocket; None: there are too many
    heard   : time of the loop at which the last byte came
    """

    def __init__(self, guard: Guard, recordings: Recordings, welcome: Callable[[Connection], Peer | None]) -> None:
        self._guard, self._recordings, self._welcome = guard, recordings, welcome
        self._socket = ServerProtocol(max_size=MOST_BYTES, logger=_LOG)
        self._transport: Any = None
        self._peer: Peer | None = None
        self._parts: list[bytes] = []
        self._is_text = True
        self._task: asyncio.Task[None] | None = None
        self._ends = False
        self.heard = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begins."""
        loop = asyncio.get_running_loop()
        self._transport, self.heard = transport, loop.time()
        self._timer = loop.call_later(REQUEST_TIMEOUT, self.abort)

    def data_received(self, data: bytes) -> None:
        """Bytes came."""
        self.heard = asyncio.get_running_loop().time()
        self._socket.receive_data(data)
        self._serve()

    def eof_received(self) -> bool:
        """No more bytes will come."""
        self._socket.receive_eof()
        self._serve()
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """It has ended."""
        self._timer.cancel()
        if self._task is not None:
            self._task.cancel()
        peer, self._peer = self._peer, None
        if peer is not None:
            peer.on_closed()

    @property
    def waiting(self) -> int:
        """Bytes that wait for the reader."""
        return int(self._transport.get_write_buffer_size())

    def send_text(self, text: str, needed: bool = False) -> None:
        """Sends a message; one that is not needed is left out where much is waiting."""
        if self._socket.state is State.OPEN and (needed or self.waiting < CROWDED):
            self._socket.send_text(text.encode())
            self._write()

    def send_binary(self, data: bytes) -> None:
        """Sends a message."""
        if self._socket.state is State.OPEN:
            self._socket.send_binary(data)
            self._write()

    def ping(self) -> None:
        """Asks whether the other side is there."""
        if self._socket.state is State.OPEN:
            self._socket.send_ping(b"")
            self._write()

    def close(self, code: int = CloseCode.GOING_AWAY) -> None:
        """Says farewell; what still waits is sent."""
        if self._socket.state is State.OPEN:
            self._socket.send_close(code)
            self._write()
        self._transport.close()

    def abort(self) -> None:
        """Ends it at once."""
        self._transport.abort()

    def _serve(self) -> None:
        for event in self._socket.events_received():
            if isinstance(event, Request):
                self._timer.cancel()
                self._answer(event)
            elif isinstance(event, Frame):
                self._take(event)
        self._write()
        if self._socket.close_expected() and self._task is None:
            self._end()

    def _write(self) -> None:
        for data in self._socket.data_to_send():
            if data:
                self._transport.write(data)
            elif self._task is None:
                self._end()
        if self._peer is not None and self.waiting > MOST_WAITING:
            self.abort()

    def _end(self) -> None:
        """Nothing is sent after what waits. What a page still sends is read: else a reset overtakes the reason."""
        if self._peer is None:
            self._transport.close()
        elif not self._ends:
            self._ends = True
            self._transport.write_eof()
            self._timer = asyncio.get_running_loop().call_later(FAREWELL, self.abort)

    def _take(self, frame: Frame) -> None:
        """A frame of a message."""
        peer = self._peer
        if peer is None or frame.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            return
        if frame.opcode is not Opcode.CONT:
            self._is_text = frame.opcode is Opcode.TEXT
        self._parts.append(bytes(frame.data))
        if not frame.fin:
            return
        data, self._parts = b"".join(self._parts), []
        if not self._is_text:
            peer.on_bytes(data)
            return
        try:
            text = data.decode()
        except UnicodeDecodeError:
            self._socket.fail(CloseCode.INVALID_DATA, "no UTF-8")
            return
        peer.on_text(text)

    def _answer(self, request: Request) -> None:
        """A file, a WebSocket, or a refusal."""
        try:
            url = urlsplit(request.path)
        except ValueError:
            return self._refuse(HTTPStatus.BAD_REQUEST, "no path")
        refusal = self._guard.refusal(request.headers.get_all("Host"), request.headers.get_all("Origin"))
        if refusal is not None:
            return self._refuse(HTTPStatus.FORBIDDEN, refusal)
        if getattr(request, "method", "GET") != "GET":
            return self._refuse(HTTPStatus.METHOD_NOT_ALLOWED, "only GET is served")
        own = url.path in ("/", "/index.html", "/ws") or url.path.startswith(RECORDINGS)
        lacks = self._guard.lacks_token(url.query) if own else None
        if lacks is not None:
            return self._refuse(HTTPStatus.FORBIDDEN, lacks)
        if url.path == "/ws":
            return self._upgrade(request)
        if url.path.startswith(RECORDINGS):
            self._task = asyncio.create_task(self._send_recording(unquote(url.path.removeprefix(RECORDINGS))))
            return None
        found = page_file(url.path)
        if found is not None:
            return self._respond(HTTPStatus.OK, *found)
        missing = "the page is not built" if url.path == "/" else "no such file"
        return self._refuse(HTTPStatus.NOT_FOUND, missing)

    def _upgrade(self, request: Request) -> None:
        response = self._socket.accept(request)
        for name, value in HEADERS:
            response.headers[name] = value
        self._socket.send_response(response)
        self._write()
        if response.status_code != HTTPStatus.SWITCHING_PROTOCOLS:
            return
        self._peer = self._welcome(self)
        if self._peer is None:
            self._socket.send_close(CloseCode.TRY_AGAIN_LATER, "too many pages are open")

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self._respond(status, f"finger_sim: {text}\n".encode(), "text/plain; charset=utf-8")

    def _respond(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        headers = _headers(kind, len(body))
        self._socket.send_response(Response(status.value, status.phrase, headers, body))

    async def _send_recording(self, name: str) -> None:
        """Sends a file of any size; the socket is written to by the system, not through memory."""
        loop = asyncio.get_running_loop()
        file: IO[bytes] | None = await loop.run_in_executor(None, self._recordings.open, name)
        try:
            if file is None:
                self._task = None
                self._refuse(HTTPStatus.NOT_FOUND, "no such recording")
                self._write()
                return
            headers = _headers("application/octet-stream", file.seek(0, 2))
            headers["Content-Disposition"] = f'attachment; filename="{name}"'
            file.seek(0)
            self._transport.write(Response(200, "OK", headers, b"").serialize())
            await loop.sendfile(self._transport, file)
        except (OSError, RuntimeError):
            pass  # the browser has gone, or closed a download
        finally:
            if file is not None:
                file.close()
            self._transport.close()


def _headers(kind: str, length: int) -> Headers:
    return Headers(
        [
            ("Date", formatdate(usegmt=True)),
            ("Connection", "close"),
            ("Content-Type", kind),
            ("Content-Length", str(length)),
            *HEADERS,
        ]
    )

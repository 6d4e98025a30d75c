"""The server of the page: one asyncio loop with its socket, its pages and its source."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import signal
from collections.abc import Callable

from ..errors import FingerSimError
from .connection import Connection
from .files import Recordings
from .guard import Guard
from .hub import Hub, Source

PORT = 8470
ADDRESS = "127.0.0.1"


async def serve(
    source: Source,
    guard: Guard,
    recordings: Recordings,
    address: str = ADDRESS,
    port: int = PORT,
    ready: Callable[[str], object] = lambda url: None,
    stop: asyncio.Event | None = None,
) -> None:
    """Serves until SIGINT, SIGTERM or `stop`.

    ready : is called with the page's address once it can be opened
    Raises FingerSimError where the address cannot be had, and what ends the source.
    """
    loop = asyncio.get_running_loop()
    stop = stop or asyncio.Event()
    hub = Hub(source)
    try:
        server = await loop.create_server(lambda: Connection(guard, recordings, hub.welcome), address, port)
    except OSError as error:
        raise FingerSimError(_unserved(address, port, error)) from None
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(RuntimeError, ValueError):  # not the main thread: whoever runs it has a `stop`
            loop.add_signal_handler(number, stop.set)
    work = asyncio.create_task(hub.run())
    try:
        ready(page_url(address, server.sockets[0].getsockname()[1], guard))
        ended = asyncio.create_task(stop.wait())
        await asyncio.wait({work, ended}, return_when=asyncio.FIRST_COMPLETED)
        ended.cancel()
    finally:
        hub.close()
        server.close()
        work.cancel()
        try:
            await work
        except asyncio.CancelledError:
            pass
        except BaseExceptionGroup as group:
            raise group.exceptions[0] from None


def page_url(address: str, port: int, guard: Guard) -> str:
    """Where the page is."""
    host = "127.0.0.1" if address in ("0.0.0.0", "::") else address
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/{guard.query}"


def _unserved(address: str, port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"--port: {port} of {address} is in use; give another one, or 0 for any that is free"
    if error.errno == errno.EACCES:
        return f"--port: {port} may not be used by you; give one from 1024 on"
    return f"--address: {address} cannot be served: {error.strerror or error}"

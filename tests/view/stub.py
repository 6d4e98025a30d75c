"""A server for tests of the page: it speaks the protocol, and makes up its finger, which is flat where it is pressed.

It shares no code with finger_sim.view. `cd tests && python -m view.stub` serves one to look at.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import math
import struct
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

import finger_sim
from finger_sim import Scene
from finger_sim.scene.mesh import TetMesh

BUNDLE = Path(finger_sim.__file__).parent / "view" / "bundle"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}
FRICTION = 0.5
REST = [0.0, 0.0, 0.0095, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
"""A pose with the pad 2 mm above the plane."""
MARKS = {"bone": 1, "nail": 2, "pad": 4, "base": 8}


def rotated(q: Any, v: Any) -> Any:
    """Vectors turned by a quaternion xyzw."""
    t = 2.0 * np.cross(q[:3], v)
    return v + q[3] * t + np.cross(q[:3], t)


@functools.cache
def shipped() -> tuple[Scene, TetMesh]:
    """What the made-up finger is made of."""
    scene = Scene.load("finger_haptic")
    return scene, scene.load_mesh()


class Finger:
    """A finger that is flat where it would be in the plane, and a force that grows with the depth."""

    def __init__(self) -> None:
        scene, mesh = shipped()
        self.rest, self.triangles, self.tets, self.axes = mesh.points, mesh.surface, mesh.tets, mesh.axes
        self.marks = np.zeros(len(self.rest), np.uint8)
        for name, mark in MARKS.items():
            self.marks[mesh.node_sets[name]] |= mark
        self.skin = np.unique(self.triangles)
        assert scene.limits is not None
        self.limits = np.array([scene.limits.stretch, scene.limits.compress], np.float32).T
        self.reset()

    def reset(self) -> None:
        self.command = list(REST)
        self.height, self.friction, self.coupled = 0.0, FRICTION, False
        self.tilt = [0.0, 0.0, 0.0, 1.0]
        self.pull = np.zeros(3)

    def move(self, dt: float, before: Any) -> None:
        """The skin sticks to the plane until it is dragged by 0.6 mm."""
        shift = np.array(self.command[:3]) - before[:3]
        normal = rotated(np.array(self.tilt), np.array([0.0, 0.0, 1.0]))
        self.pull = (self.pull - (shift - normal * (shift @ normal))) * (1.0 if self.depths().max() > 0.0 else 0.0)
        size = float(np.linalg.norm(self.pull))
        if size > 6e-4:
            self.pull *= 6e-4 / size

    def depths(self) -> Any:
        """How far each node at rest is below the plane [m]."""
        q = np.array(self.command[3:])
        places = rotated(q, self.rest) + np.array(self.command[:3])
        return -(places - np.array([0.0, 0.0, self.height])) @ rotated(np.array(self.tilt), np.array([0.0, 0.0, 1.0]))

    def topology(self) -> bytes:
        n, f, t = len(self.rest), len(self.triangles), len(self.tets)
        parts = [
            struct.pack("<8I", 1, 1, n, f, t, 3, 0, 0),
            self.rest.astype("<f4").tobytes(),
            self.triangles.astype("<u4").tobytes(),
            self.tets.astype("<u4").tobytes(),
            self.marks.tobytes() + bytes(-n % 4),
            self.axes.astype("<f4").tobytes(),
            self.limits.astype("<f4").tobytes(),
        ]
        return b"".join(parts)

    def frame(self, seq: int, at: float, since: float) -> bytes:
        """A frame of a time [s], with samples of the time since the one before."""
        normal = rotated(np.array(self.tilt), np.array([0.0, 0.0, 1.0]))
        depths = self.depths()
        deep = np.maximum(depths, 0.0)
        pose = np.array(self.command)
        if self.coupled:
            pose[:3] += normal * (0.4 * deep.max())
        places = rotated(pose[3:], self.rest) + pose[:3]
        near = np.exp(-((np.minimum(depths, 0.0) / 0.004) ** 2)) * (self.marks & 1 == 0)
        pulled = float(deep.max() > 0.0) * near[:, None] * self.pull
        places = places + pulled + normal[None] * (deep + 0.25 * deep.max() * near * (depths < 0.0))[:, None]
        out = 0.8 * deep.max() * (near * np.exp(-(((depths + 0.003) / 0.002) ** 2)))
        side = rotated(pose[3:], np.array([0.0, 0.0, 1.0]))
        places += side * (np.sign(self.rest[:, 2]) * out)[:, None]
        strain = np.clip(128.0 * deep.max() / 0.0016 * near**2, 0.0, 255.0).astype(np.uint8)
        touching = [node for node in self.skin if deep[node] > 0.0]
        forces = np.zeros((len(touching), 3))
        slips = np.linalg.norm(self.pull) > 5.9e-4
        for k, node in enumerate(touching):
            push = 250.0 * deep[node] ** 1.1 * (1 + 300 * deep[node])
            forces[k] = push * (normal + self.friction * self.pull / 6e-4)
        total = forces.sum(axis=0) if len(touching) else np.zeros(3)
        weights = forces @ normal if len(touching) else np.zeros(0)
        centre = (weights[:, None] * places[touching]).sum(axis=0) / weights.sum() if len(touching) else [math.nan] * 3
        arms = places[touching] - pose[:3]
        torque = np.cross(arms, forces).sum(axis=0) if len(touching) else np.zeros(3)
        across = float(np.linalg.norm(total - normal * (total @ normal)))
        force = float(total @ normal)
        device = float(np.linalg.norm(total))
        depth = float(deep.max())
        flags = 1 | 2 | 4 | (8 if self.coupled else 0)
        head = struct.pack("<4Id4I", 2, 1, seq, len(places), at, len(touching), 4, 0, flags)
        numbers = [*pose, *self.command, 0.0, 0.0, self.height, *self.tilt, *total, *torque, *total, *torque, *centre]
        head += struct.pack(f"<{len(numbers) + 2}f", *numbers, self.friction, depth)
        parts = [
            head + bytes(256 - len(head)),
            places.astype("<f4").tobytes(),
            strain.tobytes() + bytes(-len(places) % 4),
        ]
        for k, node in enumerate(touching):
            stuck = deep[node] > 0.55 * depth
            parts.append(struct.pack("<I3fI", node, *forces[k], int(slips or (across > 0.3 * force and not stuck))))
        for k in range(4):
            parts.append(struct.pack("<5f", -since * (3 - k) / 4, force, across, device, 1e3 * depth))
        return b"".join(parts)


ITEMS: list[dict[str, Any]] = []


def item(name: str, value: Any, low: float | None, high: float | None, unit: str, doc: str, **more: Any) -> None:
    kind = "vector" if isinstance(value, list) else "bool" if isinstance(value, bool) else "number"
    ITEMS.append(
        {
            "name": name,
            "group": name.rpartition(".")[0] or "node",
            "value": value,
            "kind": kind,
            "low": low,
            "high": high,
        }
        | {"unit": unit, "choices": [], "doc": doc, "live": True, "log": False}
        | more
    )


item("limits.stiffness", 100.0, 1e-3, 1e9, "", "Stiffness of a violated limit", log=True, optional=True)
item("limits.viscosity", 8.0, 0.0, 1000.0, "", "Viscosity of limits that hold")
item("plane.point", [0.0, 0.0, 0.0], -1e4, 1e4, "m", "A point of the plane, world")
item("plane.normal", [0.0, 0.0, 1.0], None, None, "", "Outward normal, world; any length but zero")
item("plane.friction", FRICTION, 0.0, 100.0, "", "Coulomb friction coefficient μ")
item("solver.tolerance", 1e-3, 1e-12, 0.5, "", "Stop when no force is off by more than this fraction", log=True)
item("solver.level", "lagged", None, None, "", "What is linearised when", kind="choice", choices=["standard", "lagged"])
item("solver.budget_ms", None, 1e-3, 1e4, "ms", "Time a step may take; null: none", optional=True)
item("coupling.stiffness", 1000.0, 1e-3, 1e7, "N/m", "Of the virtual coupling", log=True)
item("coupling.max_speed", 2.0, 1e-6, 1e4, "m/s", "A command that moves faster is followed at this speed", log=True)
item("force_scale", 1.0, 0.0, 100.0, "", "What the clamped device_wrench is multiplied by")
item("lock_memory", False, None, None, "", "Whether all memory stays in RAM", live=False)


class Stub:
    """The server, in a thread of its own. What pages said is in `said`, by type."""

    def __init__(self, source: str = "node", port: int = 0) -> None:
        self.source, self.port = source, port
        self.finger = Finger()
        self.said: dict[str, list[dict[str, Any]]] = {}
        self.origins: list[str | None] = []
        self.holder: int | None = None
        self.recorded: list[dict[str, Any]] = []
        self.time, self.playing, self.speed, self.duration = 0.0, False, 1.0, 6.0
        self.forget()
        self._clients: dict[int, ServerConnection] = {}
        self._acked: dict[int, int] = {}
        self._sent: dict[int, int] = {}
        self._number = 0
        self._recording = False
        self._ready = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def forget(self) -> None:
        """The finger is as at first, and nothing was said."""
        self.finger.reset()
        self.phase, self.message, self.mute = "running", "ok", False
        self.script: Callable[[float], list[float]] | None = None
        self.values = {entry["name"]: entry["value"] for entry in ITEMS}
        self.said.clear()

    def start(self) -> None:
        self._ready.clear()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        assert self._ready.wait(10.0)

    def stop(self) -> None:
        if self._loop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(10.0)
        self._clients.clear()
        self.holder = None

    def tell(self, message: dict[str, Any]) -> None:
        """To all pages, from any thread."""
        assert self._loop is not None
        asyncio.run_coroutine_threadsafe(self._tell(message), self._loop).result(5.0)

    @property
    def pages(self) -> list[int]:
        """Those that are open, by their numbers."""
        return list(self._clients)

    @property
    def poses(self) -> list[list[float]]:
        return [said["position"] for said in self.said.get("pose", [])]

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        async with serve(self._client, "127.0.0.1", self.port, process_request=self._request, max_size=65536) as server:
            self.port = server.sockets[0].getsockname()[1]
            tasks = [asyncio.create_task(self._frames()), asyncio.create_task(self._states())]
            self._ready.set()
            await self._end.wait()
            for task in tasks:
                task.cancel()

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        path = request.path.partition("?")[0]
        if path == "/ws":
            self.origins.append(request.headers.get("Origin"))
            return None
        if path.startswith("/recordings/"):
            return Response(HTTPStatus.OK, "OK", Headers({"Content-Length": "4"}), b"bag\n")
        file = BUNDLE / ("index.html" if path == "/" else path.lstrip("/"))
        if not file.is_file() or file.parent != BUNDLE:
            return Response(HTTPStatus.NOT_FOUND, "Not Found", Headers({"Content-Length": "0"}), b"")
        body = file.read_bytes()
        headers = Headers(
            {"Content-Type": KINDS[file.suffix], "Content-Length": str(len(body)), "Content-Security-Policy": POLICY}
        )
        return Response(HTTPStatus.OK, "OK", headers, body)

    def hello(self, client: int) -> dict[str, Any]:
        """What a page is told first."""
        bag = {"bag": {"name": "press_slide", "duration": self.duration}} if self.source == "bag" else {}
        return {
            "type": "hello", "version": 2, "source": self.source, "title": "finger_haptic", "client": client,
            "drive": self.source == "node", "scenes": ["finger", "finger_coupled", "finger_haptic"],
            "scene": "finger_haptic", "recorded": self.recorded, **bag,
        }  # fmt: skip

    async def _client(self, connection: ServerConnection) -> None:
        self._number += 1
        me = self._number
        with contextlib.suppress(ConnectionClosed):
            await connection.send(json.dumps(self.hello(me)))
            await connection.send(self.finger.topology())
            items = [entry | {"value": self.values[entry["name"]]} for entry in ITEMS]
            await connection.send(json.dumps({"type": "parameters", "items": items}))
            await connection.send(json.dumps(self._status()))
            await connection.send(json.dumps({"type": "handle", "holder": self.holder}))
            if self.source == "bag":
                await connection.send(json.dumps(self._position()))
            self._clients[me], self._acked[me], self._sent[me] = connection, 0, 0
            async for data in connection:
                if isinstance(data, str):
                    await self._heard(me, json.loads(data))
                else:
                    self._drawn(me, data)
        self._clients.pop(me, None)
        if self.holder == me:
            self.holder = None
            await self._tell({"type": "handle", "holder": None})

    async def _heard(self, me: int, message: dict[str, Any]) -> None:
        kind = message["type"]
        self.said.setdefault(kind, []).append(message | {"client": me})
        if kind == "take" and self.holder is None:
            self.holder = me
        elif kind == "release" and self.holder == me:
            self.holder = None
        elif kind == "reset":
            self.finger.reset()
        elif kind == "seek":
            self.time = message["time"]
        elif kind == "play":
            self.playing, self.speed = message["on"], message["speed"]
        elif kind == "record":
            self._recording = message["on"]
            if not self._recording:
                self.recorded.append({"name": "press.mcap", "url": "/recordings/press.mcap", "bytes": 4})
                await self._tell({"type": "recorded"} | self.recorded[-1])
        elif kind == "yaml":
            await self._tell({"type": "yaml", "text": "mesh: {file: finger.vtu}\n", "name": "finger_haptic"})
        elif kind == "set":
            await self._set(message["name"], message["value"])
        if kind in ("take", "release"):
            await self._tell({"type": "handle", "holder": self.holder})
        if kind in ("play", "seek"):
            await self._tell(self._position())

    def _drawn(self, me: int, data: bytes) -> None:
        """A page has drawn a frame, and maybe sends the finger somewhere."""
        kind, self._acked[me] = struct.unpack_from("<2I", data)
        assert (kind, len(data)) in ((1, 8), (2, 64))
        if kind == 2:
            pose = list(struct.unpack_from("<7d", data, 8))
            self.said.setdefault("pose", []).append({"position": pose[:3], "orientation": pose[3:], "client": me})
            if self.holder == me:
                before, self.finger.command = np.array(self.finger.command), pose
                self.finger.move(0.0, before)

    async def _set(self, name: str, value: Any) -> None:
        if name == "plane.friction" and value > 100.0:
            await self._tell({"type": "notice", "level": "warn", "text": "plane.friction: 0 to 100 is allowed"})
            return
        self.values[name] = value
        if name == "plane.friction":
            self.finger.friction = value
        elif name == "plane.point":
            self.finger.height = value[2]
        elif name == "plane.normal":
            n = np.array(value) / np.linalg.norm(value)
            q = np.array([-n[1], n[0], 0.0, 1.0 + n[2]])
            self.finger.tilt = list(q / np.linalg.norm(q))
        await self._tell({"type": "values", "values": {name: value}})

    def _position(self) -> dict[str, Any]:
        return {"type": "position", "time": self.time, "playing": self.playing, "speed": self.speed}

    def _status(self) -> dict[str, Any]:
        deep = self.finger.depths().max() > 0.0
        words = [{"code": "LIMIT_EXCEEDED", "text": "a strain is beyond 1.5 times its limit", "level": "warn"}]
        known = self.source == "node"
        return {
            "type": "status", "rate": 1000.0 if known else None, "real_time_factor": 1.0 if known else None,
            "late": 12 if known else None, "late_percent": 0.02 if known else None, "overruns": 0 if known else None,
            "step_ms": {"p50": 0.42, "p99": 0.61} if known else None, "limited": 143 if deep else 0,
            "locked": 3 if deep else 0, "tets": 900, "contact_nodes": 20, "contact_area": 61.5e-6 if deep else 0.0,
            "penetration": 1e-6, "words": words if deep else [],
            "command": {"age": 0.01, "rate": 60.0, "delay": 0.02, "mode": "linear"} if known else None,
            "accuracy": None, "level_errors": {"standard": "0.01 % rms", "lagged": "0.02 % rms"},
            "recording": {"on": self._recording, "name": "press", "messages": 1200, "dropped": 0},
            "phase": self.phase, "message": self.message,
        }  # fmt: skip

    async def _tell(self, message: dict[str, Any]) -> None:
        for connection in list(self._clients.values()):
            with contextlib.suppress(ConnectionClosed):
                await connection.send(json.dumps(message))

    async def _states(self) -> None:
        while True:
            await asyncio.sleep(0.5)
            if not self.mute:
                await self._tell(self._status())

    async def _frames(self) -> None:
        began, last, sent = time.monotonic(), 0.0, 0.0
        for seq in range(1, 2**31):
            await asyncio.sleep(1 / 30)
            now = time.monotonic() - began
            if self.playing:
                self.time = (self.time + (now - last) * self.speed) % self.duration
                await self._tell(self._position())
            if self.source == "bag":
                self._act(self.time)
            elif self.script is not None:
                before = np.array(self.finger.command)
                self.finger.command = self.script(now)
                self.finger.move(now - last, before)
            last = now
            ready = [me for me in self._clients if self._acked[me] >= self._sent[me]]
            if self.phase != "running" or self.mute or not ready:
                continue
            data = self.finger.frame(seq, self.time if self.source == "bag" else now, now - sent)
            sent = now
            for me in ready:
                self._sent[me] = seq
                with contextlib.suppress(ConnectionClosed, KeyError):
                    await self._clients[me].send(data)

    def _act(self, at: float) -> None:
        """Of a recording: a press that slides."""
        before = np.array(self.finger.command)
        self.finger.command = press(at)
        self.finger.move(0.0, before)


def press(at: float) -> list[float]:
    """Down 2 mm into the plane in a second, across and back, and up."""
    down = min(max((at - 0.5) / 1.0, 0.0), 1.0) * min(max((5.5 - at) / 0.8, 0.0), 1.0)
    x = 0.008 * math.sin(math.pi * max(at - 1.8, 0.0) / 1.6) if at < 5.0 else 0.0
    return [0.0, x, REST[2] - 0.0041 * down, *REST[3:]]


if __name__ == "__main__":
    import sys

    stub = Stub(sys.argv[1] if len(sys.argv) > 1 else "node", 8471)
    if stub.source == "node":
        stub.script = lambda now: press(now % 6.0)
    print(stub.url, flush=True)
    threading.Event().wait()

"""The node that a page shows: one of its own, which it starts and ends, or one that somebody else runs."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import FingerSimError, SceneError
from ..ros.child import end_node, free_domain, last_of, start_node
from ..scene import Scene
from ..scene.resources import find_scene, shipped_names

NODE = "/finger"
"""Full name of the node that is started."""


class OwnNode:
    """A node in a process of its own, in a ROS domain of its own.

    scene  : name of what it simulates, one of `scenes`
    domain : where it is
    """

    def __init__(self, scene: str, out: Path, options: Mapping[str, Any] | None = None) -> None:
        """Raises SceneError for a scene that cannot be used."""
        self.name = NODE
        self.scene = scene
        self._files = {name: find_scene(name) for name in shipped_names()["scenes"]}
        self._files[scene] = find_scene(scene).resolve()
        self._check(scene)
        self._out, self._options = out, dict(options or {})
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.domain = free_domain()
        self._log: Path | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def scenes(self) -> list[str]:
        """Names of what it may simulate."""
        return list(self._files)

    def start(self) -> None:
        """Starts it."""
        parameters = {
            "scene": str(self._files[self.scene].resolve()),
            "record_directory": str(self._out.resolve()),
            **self._options,
        }
        if self._log is None:
            self._log = Path(tempfile.mkdtemp(prefix="finger_sim_view_")) / "node.log"
        self._process = start_node(parameters, self.domain, self._log)

    def choose(self, scene: str) -> None:
        """Names what is simulated after the next start. Raises SceneError."""
        if scene not in self._files:
            raise SceneError("scene", scene, ", ".join(self._files))
        self._check(scene)
        self.scene = scene

    def end(self) -> None:
        """Ends it; may take some seconds."""
        if self._process is not None:
            end_node(self._process)

    @property
    def ended(self) -> str | None:
        """How it ended by itself, and its last words; None while it runs."""
        code = None if self._process is None else self._process.poll()
        return None if code is None else f"the node ended with code {code}: {last_of(self.said)}"

    @property
    def said(self) -> str:
        """Its log."""
        return "" if self._log is None else self._log.read_text(errors="replace")

    def close(self) -> None:
        """Ends it and takes its log away."""
        self.end()
        if self._log is not None:
            self._log.unlink(missing_ok=True)
            self._log.parent.rmdir()

    def _check(self, scene: str) -> None:
        """Raises FingerSimError where the node could not start with it."""
        loaded = Scene.load(self._files[scene])
        loaded.driven_nodes(loaded.load_mesh())


class OthersNode:
    """A node that somebody else runs, in the environment's domain or another."""

    scenes: tuple[str, ...] = ()
    scene = ""
    ended: str | None = None

    def __init__(self, name: str, domain: int | None = None) -> None:
        """Raises FingerSimError for what is no name of a node."""
        full = name if name.startswith("/") else f"/{name}"
        parts = full.split("/")[1:]
        if not all(part.isascii() and part.isidentifier() for part in parts):
            raise FingerSimError(f"--node: got {name!r}, allowed: the name of a node, as /finger or /left/finger")
        self.name, self.domain = full, domain

    def start(self) -> None:
        """Somebody else does."""

    def end(self) -> None:
        """Somebody else does."""

    def close(self) -> None:
        """Nothing is left behind."""

    def choose(self, scene: str) -> None:
        """Raises FingerSimError: it is not ours."""
        raise FingerSimError("the scene cannot be changed: this page has joined a node that somebody else runs")


Session = OwnNode | OthersNode

"""A recording as the page needs it: any moment of it, with the scene that was simulated then."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..bags.changes import changes_in
from ..bags.origin import read_origin, recorded_scene
from ..errors import BagError, FingerSimError
from ..physics.rotations import matrix, normalised
from ..scene import Scene
from .forces import split
from .picture import Ground, Painter, plane_frame
from .protocol import SAMPLE, Picture
from .raw import Cloud
from .samples import KEPT
from .shape import with_scene
from .tape import Meter, Series, Tape


class Recording:
    """What a bag of the node, or of `run`, holds. Times count from its first message [s].

    topology : the mesh, with what the recorded scene knows of it
    options  : the node's own parameters at its beginning
    changes  : live values of the scene and the node, by name, as ROS has them
    notes    : what of it cannot be read or is not known, and why
    """

    def __init__(self, path: str | Path, progress: Meter = lambda done, total: None) -> None:
        """Reads it. Raises BagError where there is nothing to show."""
        self.tape = Tape(path, progress)
        self.name, self.duration, self.notes = self.tape.reader.path.name, self.tape.duration, self.tape.notes
        self.options: dict[str, Any] = {}
        self._scenes = self._recorded_scene()
        self.changes = self._recorded_changes()
        heard = self.tape.mesh
        self.topology = with_scene(heard, self._scenes[0]) if self._scenes else heard
        self._painter = Painter(self.topology.rest)
        self._sample_times, self._samples = self._sample()

    def cloud_at(self, time: float) -> int:
        """Number of the cloud that is shown at a time."""
        return max(bisect_right(self.tape.cloud_times, time) - 1, 0)

    def picture(self, k: int, follows: bool) -> Picture:
        """Picture of cloud k; follows: the last one was of the cloud before."""
        if not follows and k > 0:
            self._paint(k - 1)  # slip is seen from one cloud to the next
        return self._paint(k)

    def ground(self, time: float) -> Ground:
        """The plane then, and its friction."""
        scene, moved = self.scene_at(time), self.tape.planes.at(time)
        if scene is None or scene.plane is None:
            return Ground(moved)
        return Ground(moved or plane_frame(scene.plane), scene.plane.friction, scene.solver.tolerance)

    def scene_at(self, time: float) -> Scene | None:
        """The scene with what was changed by then; None where it is not known."""
        if not self._scenes:
            return None
        made = self.changed_by(time)
        while len(self._scenes) <= made:
            self._scenes.append(_changed(self._scenes[-1], self.changes.values[len(self._scenes) - 1]))
        return self._scenes[made]

    def changed_by(self, time: float) -> int:
        """Changes made by then."""
        return bisect_right(self.changes.times, time)

    def since(self, seen: int, time: float) -> tuple[bytes, int]:
        """Samples after number `seen`, as messages hold them, up to `time` [s]; and the number of the newest."""
        newest = int(self._sample_times.searchsorted(time, side="right")) - 1
        first = max(seen + 1, newest + 1 - KEPT, 0)
        rows = self._samples[first : newest + 1].copy()
        rows["time"] = self._sample_times[first : newest + 1] - time
        return rows.tobytes(), newest

    def _paint(self, k: int) -> Picture:
        at = self.tape.cloud_times[k]
        return self._painter.paint(Cloud(round(1e9 * at), self.tape.points[k]), at, self.ground(at))

    def _recorded_scene(self) -> list[Scene]:
        """The scene at the beginning; empty where it is not known."""
        try:
            origin = read_origin(self.tape.reader)
            self.options = dict(origin.options) if origin is not None else {}
            return [recorded_scene(self.tape.reader, origin)]
        except BagError as error:
            self.notes.append(f"plane, friction, tetrahedra and axes are not known: {error}")
            return []

    def _recorded_changes(self) -> Series:
        changes, left_out = changes_in(self.tape.reader)
        self.notes += left_out
        out = Series()
        for change in changes:
            out.add(1e-9 * (change.time - self.tape.start), {**change.scene, **change.options})
        return out

    def _sample(self) -> tuple[Floats, NDArray[np.void]]:
        """Times of all samples, and the samples: of contact_wrench, or of the clouds where that is missing."""
        tape = self.tape
        pictures = [self._paint(k) for k in range(len(tape.cloud_times))]
        self._painter.forget()
        times = np.array(tape.contact.times or tape.cloud_times)
        rows = np.zeros(len(times), SAMPLE)
        rows["depth"] = 1e3 * np.interp(times, tape.cloud_times, [picture.depth for picture in pictures])
        if tape.device.times:
            strength = [float(np.linalg.norm(wrench[:3])) for _, wrench in tape.device.values]
            rows["device"] = np.interp(times, tape.device.times, strength)
        for k, time in enumerate(times.tolist()):
            near = pictures[self.cloud_at(time)]
            normal = self.ground(time).normal
            rows["normal"][k], rows["tangential"][k] = split(self._force(k, near), normal)
        return times, rows

    def _force(self, k: int, near: Picture) -> list[float]:
        """Contact force of sample k, world axes; near: the picture at its time."""
        if not self.tape.contact.times:
            return list((near.wrench or [0.0] * 6)[:3])
        frame, wrench = self.tape.contact.values[k]
        if frame == self.options.get("finger_frame", "finger") and near.pose is not None:
            turned: list[float] = (matrix(normalised(near.pose[3:])) @ wrench[:3]).tolist()
            return turned
        return list(wrench[:3])


def _changed(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene after one change; as it was where the change is refused."""
    own = {name: value for name, value in values.items() if "." in name}
    try:
        return scene.with_values(own) if own else scene
    except FingerSimError:
        return scene

"""What the node does around the simulation: its own parameters, typed and range-checked as a scene's are.

`python -m finger_sim.ros.options` prints the facts of all parameters as rows of the tables of docs/scenes.md. It needs
no ROS.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Literal, get_args

from ..bags.layout import WRENCH_FRAMES
from ..bags.reader import Compression
from ..plain import printing
from ..scene import Scene
from ..scene.fields import field
from ..scene.reference import rows


@dataclasses.dataclass(frozen=True)
class NodeOptions:
    """What the node does around the simulation."""

    scene: str = field("text", "Scene file, or the name of a shipped scene", default="finger_haptic")
    device: str = field("text", "Device file, or the name of a shipped one; empty: none", default="")
    world_frame: str = field(
        "text", "Frame of commands and of the mesh; a command in another is refused", default="world"
    )
    transform_commands: bool = field(
        "bool", "Whether poses in other frames are transformed to world_frame, not refused; needs tf2", default=False
    )
    finger_frame: str = field("text", "Name of the finger frame", default="finger")
    wrench_frame: Literal["world_aligned", "finger", "world"] = field(
        "choice",
        "Axes and point of reference of contact_wrench",
        default="world_aligned",
        choices=WRENCH_FRAMES,
    )
    command_timeout: float = field(
        "float",
        "A command received longer ago is stale: the pose is held, device_wrench is zero",
        default=0.1,
        unit="s",
        low=1e-3,
        high=3600.0,
        live=True,
    )
    mesh_rate: float = field(
        "float", "Rate of mesh_points; 0: off", default=60.0, unit="Hz", low=0.0, high=1000.0, live=True
    )
    marker_rate: float = field(
        "float", "Rate of mesh_marker; 0: off", default=10.0, unit="Hz", low=0.0, high=60.0, live=True
    )
    marker_color: str = field(
        "choice",
        "What the colour of mesh_marker shows",
        default="strain",
        choices=("strain", "pressure"),
        live=True,
    )
    marker_pressure: float = field(
        "float",
        "Contact pressure shown in the last colour of mesh_marker",
        default=20e3,
        unit="Pa",
        low=1.0,
        high=1e9,
        live=True,
    )
    mode: Literal["free", "triggered"] = field(
        "choice",
        "free: steps at the rate 1/dt follow the newest command; triggered: one step for each command, with its stamp",
        default="free",
        choices=("free", "triggered"),
    )
    lifecycle: bool = field(
        "bool",
        "Whether the node waits until it is configured and activated (lifecycle_msgs); false: it begins by itself",
        default=False,
    )
    cpu_affinity: str = field(
        "text", "Processors that the loop's thread may run on, as in 1 or 0,2-3; empty: any", default=""
    )
    realtime_priority: int = field(
        "int",
        "Priority of the loop's thread under SCHED_FIFO, where the system permits it; those that receive commands get "
        "one less; 0: as any other thread",
        default=20,
        low=0,
        high=99,
    )
    lock_memory: bool = field(
        "bool", "Whether all memory of the node stays in RAM (mlockall), where the system permits it", default=False
    )
    force_scale: float = field(
        "float",
        "What the clamped device_wrench is multiplied by; the clamps hold after it too",
        default=1.0,
        low=0.0,
        high=100.0,
        live=True,
    )
    force_ramp: float = field(
        "float",
        "Time in which device_wrench comes in when commands start or resume",
        default=0.2,
        unit="s",
        low=0.0,
        high=60.0,
        live=True,
    )
    passivity: Literal["observe", "control"] = field(
        "choice",
        "observe: the energy that leaks to the device is reported; control: and held by scaling device_wrench down",
        default="observe",
        choices=("observe", "control"),
        live=True,
    )
    device_damping: float = field(
        "float",
        "Damping b of the device, for the stable stiffness b / (T/2 + delay) in diagnostics",
        default=0.8,
        unit="N s/m",
        low=0.0,
        high=1e3,
        live=True,
    )
    record: str = field(
        "text", "Path of a bag to record from the start of the node to its end; empty: none", default=""
    )
    record_directory: str = field("text", "Folder in which ~/record makes its bags", default=".")
    record_compression: Compression = field(
        "choice",
        "Compression of a bag; as with record_split_…, a change holds from the next recording on",
        default="zstd",
        choices=get_args(Compression),
        live=True,
    )
    record_split_size: float = field(
        "float",
        "Size at which a recording goes on in a new file; 0: never",
        default=0.0,
        unit="MB",
        low=0.0,
        high=1e6,
        live=True,
    )
    record_split_time: float = field(
        "float",
        "Time after which a recording goes on in a new file; 0: never",
        default=0.0,
        unit="s",
        low=0.0,
        high=1e6,
        live=True,
    )
    record_queue: int = field(
        "int",
        "Messages that may wait to be written; more are dropped and counted",
        default=20_000,
        low=1,
        high=1_000_000,
    )


def main() -> int:
    """Prints the facts of all parameters."""
    for part in (Scene, NodeOptions):
        print(*rows(part), "", sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(printing("finger_sim.ros.options", main))

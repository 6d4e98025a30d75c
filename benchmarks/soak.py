"""The node under fire for minutes: what it holds on to, what it refused, how it ended.

Meanwhile: commands at 1 kHz with bursts of 500, commands of no use, live parameters set right and wrong, recordings
on and off, readers that come and go, one of which is paused while it reads, and a viewer of the mesh.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from node_memory import resident
from node_process import environment, running_node

from finger_sim.plain import printing

READER = """
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
rclpy.init()
node = rclpy.create_node("reader")
for topic, kind in (("device_wrench", WrenchStamped), ("contact_wrench", WrenchStamped), ("pose", PoseStamped)):
    node.create_subscription(kind, topic, lambda _: None, 1000)
rclpy.spin(node)
"""
SETTINGS = (
    ("plane.friction", 0.3), ("plane.friction", 0.6), ("force_scale", 0.9), ("force_scale", 1.0),
    ("solver.tolerance", 1e-4), ("solver.tolerance", 1e-3), ("plane.friction", -1.0), ("no.such.parameter", 1),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_coupled")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--warm-up", type=float, default=2.0, help="[min] before the first size that counts")
    args = parser.parse_args()
    os.environ.update(environment())
    with (
        tempfile.TemporaryDirectory() as folder,
        running_node({"scene": args.scene, "record_directory": folder}) as (node, _),
    ):
        log: list[str] = []
        reading = threading.Thread(target=lambda: log.extend(node.stderr), daemon=True)
        reading.start()
        soak(node.pid, args, Path(folder))
        begin = time.monotonic()
        node.send_signal(signal.SIGINT)
        code = node.wait(timeout=30)
        took = time.monotonic() - begin
        reading.join()
    print(f"exit code {code} in {took:.2f} s; {len(log)} lines of log")
    print("".join(line for line in log if "Traceback" in line or "[WARN]" in line or "[ERROR]" in line), end="")


class Load:
    """All that is done to the node, from one process."""

    def __init__(self, folder: Path) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from rcl_interfaces.srv import SetParameters
        from sensor_msgs.msg import PointCloud2
        from std_srvs.srv import SetBool
        from visualization_msgs.msg import Marker

        rclpy.init()
        self.node = rclpy.create_node("soak")
        self.values: dict[str, str] = {}
        self.sent = self.bad = self.sets = self.clouds = 0
        self.folder = folder
        self.readers: list[subprocess.Popen[bytes]] = []
        self.publisher = self.node.create_publisher(PoseStamped, "command_pose", 1000)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._report, 10)
        self.node.create_subscription(PointCloud2, "mesh_points", self._cloud, 1)
        self.node.create_subscription(Marker, "mesh_marker", lambda _: None, 1)
        self.parameters = self.node.create_client(SetParameters, "/finger/set_parameters")
        self.record = self.node.create_client(SetBool, "/finger/record")
        for client in (self.parameters, self.record):
            if not client.wait_for_service(30.0):
                raise SystemExit(f"no {client.srv_name}")
        self.answer: Any = None
        self.asked: Any = None
        self.recording = False

    def _report(self, message: Any) -> None:
        self.values = {item.key: item.value for item in message.status[0].values}

    def _cloud(self, _: Any) -> None:
        self.clouds += 1

    def command(self, seconds: float) -> None:
        """Two strokes a second of 2 mm into the plane, slid along it."""
        self._publish(0.001 * math.cos(2 * math.pi * seconds), 0.005 * math.sin(math.pi * seconds), "world")
        self.sent += 1

    def no_command(self) -> None:
        """Of another frame, or not finite."""
        self._publish(*random.choice(((math.nan, 0.0, "world"), (0.0, 1e9, "world"), (0.0, 0.0, "map"))))
        self.bad += 1

    def _publish(self, z: float, x: float, frame: str) -> None:
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.pose.position.x, message.pose.position.z = x, z
        message.pose.orientation.x = message.pose.orientation.w = math.sqrt(0.5)
        self.publisher.publish(message)

    def set(self, name: str, value: float) -> None:
        """Unless the last answer is still to come."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        if self.answer is None or self.answer.done():
            request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
            self.answer = self.parameters.call_async(request)
            self.sets += 1

    def turn_recording(self) -> None:
        """On or off; what was recorded is deleted."""
        from std_srvs.srv import SetBool

        if self.asked is not None and not self.asked.done():
            return
        if not self.recording:
            for path in self.folder.iterdir():
                shutil.rmtree(path)
        self.recording = not self.recording
        self.asked = self.record.call_async(SetBool.Request(data=self.recording))

    def turn_readers(self) -> None:
        """One comes, one is paused, one goes that was paused."""
        if len(self.readers) > 1:
            self.end(self.readers.pop(0))
        if self.readers:
            self.readers[0].send_signal(signal.SIGSTOP)
        self.readers.append(subprocess.Popen([sys.executable, "-c", READER], stderr=subprocess.DEVNULL))

    @staticmethod
    def end(reader: subprocess.Popen[bytes]) -> None:
        reader.send_signal(signal.SIGCONT)
        reader.terminate()
        reader.wait()


def soak(pid: int, args: argparse.Namespace, folder: Path) -> None:
    """Runs the load and prints a line every half minute."""
    import rclpy

    load = Load(folder)
    begin = time.monotonic()
    end = begin + 60.0 * args.minutes
    settings = itertools.cycle(SETTINGS)
    every = {
        "burst": (10.0, lambda: [load.command(time.monotonic() - begin) for _ in range(500)]),
        "bad": (0.05, load.no_command),
        "set": (0.1, lambda: load.set(*next(settings))),
        "record": (5.0, load.turn_recording),
        "readers": (15.0, load.turn_readers),
        "sample": (30.0, lambda: sample(pid, load, begin, sizes, args.warm_up)),
    }
    due = {name: begin + period for name, (period, _) in every.items()}
    sizes: list[int] = []
    print(f"{'min':>6} {'RSS MB':>8} {'threads':>8} {'fds':>5} {'shm kB':>8} {'steps':>9} {'late':>7} {'skipped':>8} "
          f"{'refused':>8} {'bad':>7} {'sets':>6} {'clouds':>7}")  # fmt: skip
    tick = begin
    while (now := time.monotonic()) < end:
        tick = max(tick + 1e-3, now - 0.1)
        load.command(now - begin)
        for name, (period, action) in every.items():
            if now >= due[name]:
                due[name] = max(due[name] + period, now)
                action()
        rclpy.spin_once(load.node, timeout_sec=0.0)
        time.sleep(max(0.0, tick - time.monotonic()))
    if load.recording:
        load.turn_recording()
    for reader in load.readers:
        load.end(reader)
    drift = 100.0 * (sizes[-1] / sizes[0] - 1.0)
    most = 100.0 * (max(sizes) / sizes[0] - 1.0)
    print(f"RSS after warm-up {sizes[0] / 1e6:.1f} MB, end {sizes[-1] / 1e6:.1f} MB ({drift:+.1f} %), "
          f"most {max(sizes) / 1e6:.1f} MB ({most:+.1f} %)")  # fmt: skip
    print(f"commands sent {load.sent}, of no use {load.bad}, refused {load.values.get('refused commands')}")
    load.node.destroy_node()
    rclpy.shutdown()


def sample(pid: int, load: Load, begin: float, sizes: list[int], warm_up: float) -> None:
    """One line; a size counts after the warm-up."""
    minutes = (time.monotonic() - begin) / 60.0
    size = resident(pid)
    if minutes >= warm_up:
        sizes.append(size)
    process = Path(f"/proc/{pid}")
    threads, fds = (len(list((process / what).iterdir())) for what in ("task", "fd"))
    shared = sum(path.stat().st_blocks * 512 for path in Path("/dev/shm").glob("*fastrtps*"))
    keys = ("steps", "late steps", "overruns", "refused commands")
    steps, late, skipped, refused = (load.values.get(key, "?") for key in keys)
    print(
        f"{minutes:>6.1f} {size / 1e6:>8.1f} {threads:>8} {fds:>5} {shared / 1e3:>8.0f} {steps:>9} {late:>7} "
        f"{skipped:>8} {refused:>8} {load.bad:>7} {load.sets:>6} {load.clouds:>7}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(printing("soak", main))

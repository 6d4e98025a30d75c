"""What each feature of a scene costs, and that a missing one costs nothing: step time by ablation, and work counted.

All variants run in turn in one process on one processor: a step of `finger_haptic` in free air, pressed 2 mm, and slid,
ratios of medians to those of the whole scene. With --node then the node, asleep so that its messages are all it does,
with and without a subscriber of the mesh and a recording: processor time a step.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from finger_sim import Scene
from finger_sim.console import gauge
from finger_sim.physics.work import WORK
from finger_sim.pictures.surfaces import new_figure, save
from finger_sim.plain import printing
from finger_sim.studies.bench import passes
from finger_sim.studies.bench.scenes import PHASES, Ours, press_and_slide, touch_height
from finger_sim.studies.shared import pinned

AWAKE = {"solver.sleep": False, "solver.settle": False}
FREE = [None] * 3
VARIANTS: dict[str, dict[str, Any]] = {
    "whole scene": {},
    "one limited axis (e2)": {"limits.stretch": [None, 1.25, None], "limits.compress": [None, 0.75, None]},
    "one side (compression)": {"limits.stretch": FREE},
    "limits never reached": {"limits.stretch": [9.0] * 3, "limits.compress": [0.001] * 3},
    "limits off": {"limits": None},
    "friction 0": {"plane.friction": 0.0},
    "plane far below": {"plane.point": [0, 0, -1.0]},
    "plane off": {"plane": None},
    "limits and plane off": {"limits": None, "plane": None},
    "settling on": {"solver.settle": True},
    "sleep on": {"solver.settle": True, "solver.sleep": True},
}
"""Name: what is changed in the scene."""
UNUSED = {
    "limits off": ("limits looked at", "limit rows", "singular value decompositions"),
    "limits never reached": ("limit rows",),
    "friction 0": ("friction corrections",),
    "plane far below": ("nodes looked at for contact", "contact rows"),
    "plane off": ("nodes looked at for contact", "contact rows"),
    "limits and plane off": ("limits looked at", "limit rows", "nodes looked at for contact", "contact rows"),
}
"""Counters of Simulator.work that a variant is to leave at, or next to, nothing."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_haptic")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--plot", type=Path, help="draw it as a PNG")
    parser.add_argument("--node", action="store_true", help="measure the node's messages and recording too")
    args = parser.parse_args()
    whole = Scene.load(args.scene).with_values(AWAKE)
    motion = press_and_slide(touch_height(whole), whole.dt)
    runners = {name: Ours(whole.with_values(values), motion) for name, values in VARIANTS.items()}
    with pinned(None), gauge("ablation") as meter:
        records = passes.interleaved(runners, args.repeats, meter)
    medians = {
        name: np.array([np.median(record.seconds[:, motion.phase == k]) for k in range(len(PHASES))])
        for name, record in records.items()
    }
    print(f"{args.scene}: median step [µs], and of the whole scene's; {args.repeats} repetitions in turn")
    print(f"{'':>24}" + "".join(f"{phase:>17}" for phase in PHASES) + "   not entered (count a step)")
    for name, times in medians.items():
        ratios = times / medians["whole scene"]
        work, steps = runners[name].simulator.work, len(motion.poses)
        unused = ", ".join(f"{counter} {work[counter] / steps:.3g}" for counter in UNUSED.get(name, ()))
        print(f"{name:>24}" + "".join(f"{1e6 * t:>9.1f} ({r:.3f})" for t, r in zip(times, ratios, strict=True)), unused)
    print()
    print(f"{'work a step':>24}" + "".join(f"{name:>29}" for name in WORK[:3]))
    for name, runner in runners.items():
        print(f"{name:>24}" + "".join(f"{runner.simulator.work[w] / len(motion.poses):>29.3f}" for w in WORK[:3]))
    asleep(whole)
    if args.node:
        node(args.scene, 3)
    if args.plot:
        draw(medians, args.plot)
        print(args.plot)


def asleep(whole: Scene) -> None:
    """A finger at rest under an unchanged command: awake, and asleep."""
    motion = press_and_slide(touch_height(whole), whole.dt, 0.01)
    for phase, poses in (("in free air", motion.poses[:1]), ("pressed 2 mm", motion.poses[: -len(motion.poses) // 99])):
        held = (*poses, *([poses[-1]] * 2000))
        runners = {
            name: Ours(whole.with_values(values), motion.__class__(motion.start, held, np.zeros(len(held), np.int64)))
            for name, values in (("awake", {}), ("asleep", {"solver.settle": True, "solver.sleep": True}))
        }
        records = passes.interleaved(runners, 3, lambda done, total: None)
        awake, sleeping = (1e6 * float(np.median(record.seconds[:, -1000:])) for record in records.values())
        print(f"at rest {phase}: {awake:.1f} µs awake, {sleeping:.2f} µs asleep: {100 * sleeping / awake:.1f} %")


def node(scene: str, repeats: int) -> None:
    """Processor time a step of the node, by who listens and whether it records; point clouds made."""
    spent: dict[tuple[bool, bool], list[float]] = {}
    made: dict[tuple[bool, bool], float] = {}
    for _, listens, records in itertools.product(range(repeats), (False, True), (False, True)):
        one, clouds = cost_of_messages(scene, listens, records)
        spent.setdefault((listens, records), []).append(one)
        made[listens, records] = clouds
    print("\nnode, asleep: processor time a step [µs], median of", repeats)
    for (listens, records), times in spent.items():
        what = f"{'a' if listens else 'no'} mesh subscriber, {'' if records else 'not '}recording"
        print(f"{what:>36}: {1e6 * np.median(times):.0f}   point clouds a second {made[listens, records]:.0f}")


def cost_of_messages(scene: str, listens: bool, records: bool, seconds: float = 5.0) -> tuple[float, float]:
    """Processor time a step [s] and point clouds a second, over so many seconds."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from node_process import DOMAIN, cpu_seconds, running_node
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import PointCloud2

    reports: list[tuple[float, float, dict[str, str]]] = []
    with tempfile.TemporaryDirectory() as folder:
        parameters = {"scene": scene} | ({"record": f"{folder}/bag"} if records else {})
        with running_node(parameters) as (process, _):
            context = rclpy.Context()
            rclpy.init(context=context, domain_id=int(DOMAIN))
            client = rclpy.create_node("ablation", context=context, enable_rosout=False)
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(client)

            def heard(message: DiagnosticArray) -> None:
                values = {item.key: item.value for item in message.status[0].values}
                reports.append((time.monotonic(), cpu_seconds(process.pid), values))

            client.create_subscription(DiagnosticArray, "/diagnostics", heard, 10)
            if listens:
                client.create_subscription(PointCloud2, "mesh_points", lambda message: None, 10)
            end = time.monotonic() + seconds + 2.0
            while time.monotonic() < end:
                executor.spin_once(timeout_sec=0.1)
            executor.shutdown()
            client.destroy_node()
            rclpy.shutdown(context=context)
    (begin, before, first), (stop, after, last) = reports[1], reports[-1]
    steps = int(last["steps"]) - int(first["steps"])
    clouds = int(last["mesh messages"]) - int(first["mesh messages"])
    return (after - before) / steps, clouds / (stop - begin)


def draw(medians: dict[str, np.ndarray], path: Path) -> None:
    """Bars of each variant, by phase."""
    figure = new_figure(8.6, 4.6)
    axes = figure.add_axes((0.24, 0.13, 0.74, 0.82))
    colors = ("#9aa5b1", "#0b5394", "#d1730f")
    for k, phase in enumerate(PHASES):
        y = np.arange(len(medians)) + 0.27 * (k - 1)
        axes.barh(y, [1e6 * times[k] for times in medians.values()], 0.25, color=colors[k], label=phase)
    axes.set_yticks(range(len(medians)), list(medians))
    axes.invert_yaxis()
    axes.set_xlabel("median step [µs]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="center right")
    save(figure, path)


if __name__ == "__main__":
    sys.exit(printing("ablation", main))

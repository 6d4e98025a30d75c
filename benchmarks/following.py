"""What a device feels of commands that come less often than steps, and unevenly; and a picture of it.

A hand in free air (loops at up to 0.3 m/s) and one that presses, with commands of so many a second, each late by up to
so much of an interval, and with --hiccups now and then held up; in one half of the runs the hand was sampled late, in
the other its pose was only late on its way. The worse of both counts. Beside it the same path with a command for every
step.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from finger_sim import Pose, Scene, Simulator
from finger_sim.physics.rotations import matrix
from finger_sim.plain import printing

RATES = (20.0, 30.0, 66.0, 125.0, 250.0, 500.0, 1000.0)
JITTERS = (0.0, 0.2, 0.5)
MODES = ("hold", "linear", "predict", "auto")
SECONDS = 3.0
BEGIN = 0.3
"""Part of a second that a path takes to set off."""
CLEAR = 0.1
"""Height of the free hand [m]."""
HICCUP = 6e-3
"""For so long nothing comes [s], with --hiccups,"""
BETWEEN = (0.15, 0.4)
"""and from one such time to the next it takes between these [s]."""
DEPTH = 3e-3
"""Of the press [m]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="finger_coupled", help="scene to follow with (default: %(default)s)")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES, metavar="HZ", help="commands a second")
    parser.add_argument("--modes", nargs="+", default=MODES, choices=MODES, help="of coupling.following")
    parser.add_argument("--hiccups", action="store_true", help=f"every {BETWEEN[0]:g} to {BETWEEN[1]:g} s nothing "
                        f"comes for {1e3 * HICCUP:g} ms, then all at once")  # fmt: skip
    parser.add_argument("--plot", type=Path, metavar="PNG", help="picture to make")
    args = parser.parse_args()
    study = Study(Scene.load(args.scene), args.hiccups)
    smooth = {name: study.run(name, "auto", 1000.0, 0.0, 0)[0] for name in ("free", "press")}
    peaks = {name: largest(device) for name, (device, _) in smooth.items()}
    rises = {name: largest_change(device) for name, (device, _) in smooth.items()}
    print(
        f"A command for every step: in free air {peaks['free']:.3f} N at most, {rises['free']:.4f} N a millisecond; "
        f"pressed {peaks['press']:.3f} N, {rises['press']:.4f} N.\n"
    )
    print(
        "| Hz | jitter | mode | delay | free air: peak beyond | change in 1 ms | pressed: change in 1 ms, of the smooth"
    )
    print("| error: as it is, without the delay |\n|---|---|---|---|---|---|---|---|")
    for rate in args.rates:
        for jitter in JITTERS:
            for mode in args.modes:
                free = [study.run("free", mode, rate, jitter, late) for late in (0, 1)]
                press = [study.run("press", mode, rate, jitter, late) for late in (0, 1)]
                beyond = max(largest(device) - peaks["free"] for (device, _), _ in free)
                change = max(largest_change(device) for (device, _), _ in free)
                pressed = max(largest_change(device) for (device, _), _ in press)
                now, shifted = (
                    max(error(contact, smooth["press"][1], late) for (_, contact), late in shifts)
                    for shifts in ([(forces, 0) for forces, _ in press], press)
                )
                delay = max(delay for _, delay in free)
                print(
                    f"| {rate:g} | {jitter:.0%} | {mode} | {delay} ms | {max(beyond, 0.0):.3f} N | {change:.3f} N "
                    f"| {pressed:.3f} N, {pressed / rises['press']:.1f} | {now:.1%}, {shifted:.1%} |",
                    flush=True,
                )
    if args.plot:
        draw(study, args.plot)
        print(args.plot)


class Study:
    """One scene, followed in many ways."""

    def __init__(self, scene: Scene, hiccups: bool) -> None:
        self._simulator, self._hiccups = Simulator(scene), hiccups
        self._turn = scene.initial_pose.orientation
        self._touch = -float((self._simulator.mesh.points @ matrix(self._turn).T)[:, 2].min())

    def hand(self, name: str, t: float) -> Pose:
        """Where the hand is at a time [s]."""
        part = 1.0 - np.exp(-((t / BEGIN) ** 2))
        if name == "press":
            down = 0.5 * DEPTH * (1.0 - np.cos(2.0 * np.pi * t))
            return Pose((0.01 * part * np.sin(np.pi * t), 0.0, self._touch + 2e-4 - down), self._turn)
        x, y, z = (a * part * np.sin(2.0 * np.pi * f * t) for a, f in ((0.04, 0.9), (0.025, 1.3), (0.01, 1.1)))
        return Pose((x, y, CLEAR + z), self._turn)

    def run(
        self, name: str, mode: str, rate: float, jitter: float, late: int
    ) -> tuple[tuple[np.ndarray, np.ndarray], int]:
        """Forces (n, 3) on the device and of the plane [N], and the delay of the bone behind the hand [ms].

        late: whether poses are late on their way, not the hand's sampling.
        """
        simulator = self._simulator
        simulator.apply({"coupling.following": mode})
        random = np.random.default_rng(1)
        sampled = np.arange(int(SECONDS * rate)) / rate
        received = sampled + jitter / rate * random.random(len(sampled)) * (sampled > 0.0)
        if self._hiccups and rate * jitter > 0.0:
            at = 0.1
            while at < SECONDS:
                received[(received >= at) & (received < at + HICCUP)] = at + HICCUP
                at += random.uniform(*BETWEEN)
        waiting = [(r, self.hand(name, s if late else r)) for s, r in zip(sampled, received, strict=True)]
        simulator.reset(waiting[0][1])
        device, contact, path = [], [], []
        for k in range(int((SECONDS - 0.2) * 1000)):
            now = 1e-3 * k
            while waiting and waiting[0][0] <= now + 1e-12:
                at, pose = waiting.pop(0)
                simulator.hear(pose, at)
            out = simulator.step(now=now)
            device.append(out.device_wrench[:3])
            contact.append(out.contact_wrench[:3])
            path.append(out.pose.position)
        return (np.array(device), np.array(contact)), self._delay(name, np.array(path))

    def _delay(self, name: str, path: np.ndarray) -> int:
        """By how much a path is best shifted to lie on the hand's."""
        longest, begin = 150, 500
        true = np.array([self.hand(name, max(1e-3 * k, 0.0)).position for k in range(len(path))])
        off = [np.abs(path[begin:] - true[begin - lag : len(true) - lag]).sum() for lag in range(longest)]
        return int(np.argmin(off))


def largest(forces: np.ndarray) -> float:
    """[N]"""
    return float(np.linalg.norm(forces, axis=1).max())


def largest_change(forces: np.ndarray) -> float:
    """From one step to the next [N]."""
    return float(np.linalg.norm(np.diff(forces, axis=0), axis=1).max())


def error(contact: np.ndarray, smooth: np.ndarray, late: int) -> float:
    """Of the contact force, rms as a part of the largest of the smooth path; `late` by so many steps."""
    n = len(contact)
    apart = contact[late:] - smooth[: n - late]
    return float(np.sqrt((apart**2).sum(axis=1).mean()) / np.linalg.norm(smooth, axis=1).max())


def draw(study: Study, out: Path) -> None:
    """Three modes side by side: a hand in free air at 28 Hz, and a press at 66 Hz."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    style = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with plt.rc_context(style):
        figure, rows = plt.subplots(2, 3, figsize=(9.6, 4.4), sharex="row", sharey="row", layout="constrained")
        for axes, (name, rate, what) in zip(
            rows, (("free", 28.0, "free air"), ("press", 66.0, "pressed")), strict=True
        ):
            smooth = study.run(name, "auto", 1000.0, 0.0, 0)[0][0]
            for ax, mode in zip(axes, ("hold", "linear", "predict"), strict=True):
                (device, _), delay = study.run(name, mode, rate, 0.2, 0)
                time = 1e-3 * np.arange(len(device))
                axis = 2 if name == "press" else 0
                ax.plot(time, device[:, axis], color="#d1730f", linewidth=0.8, label="uneven commands, jitter 20 %")
                ax.plot(time, smooth[:, axis], color="#0b5394", linewidth=1.1, label="a command for every step")
                ax.set_title(f"{mode}: {delay} ms late, at most {largest_change(device):.2f} N in 1 ms", fontsize=9)
                ax.set_xlim(0.6, 1.6)
            axes[0].set_ylabel(f"device force [N]\n{what}, {rate:g} Hz")
        rows[0][1].legend(frameon=False, fontsize=8, loc="upper right")
        for ax in rows[1]:
            ax.set_xlabel("time [s]")
        figure.savefig(out, dpi=150)


if __name__ == "__main__":
    sys.exit(printing("following", main))

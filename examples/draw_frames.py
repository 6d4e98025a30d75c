"""Draws the picture of docs/frames.md from a press of finger_coupled: config/pictures/frames_and_signs.png.

Prints the wrenches that it shows, in each wrench_frame. Nothing in it is drawn by hand: mesh, frames and forces are
what the simulator gives.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from finger_sim import Pose, Scene, Simulator, StepResult
from finger_sim.bags.layout import WRENCH_FRAMES, express_wrench
from finger_sim.physics.rotations import matrix
from finger_sim.pictures.surfaces import new_figure, save
from finger_sim.plain import printing
from finger_sim.scene import place

FLAT = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""The pad over the table: the finger's x and y are the world's x and z, its z comes to the eye."""
AT, START, DEPTH, SPEED = -0.030, 0.010, 0.0015, 0.02
"""Commanded x [m]; heights at which the command starts and stays [m]; its speed [m/s]."""
PER_NEWTON = 2.6
"""Length of an arrow [mm/N]."""
HEIGHT = 41.0
"""What is seen [mm]."""
AXES = {"x": "#c0392b", "y": "#2e8b57", "z": "#2962a8"}
CONTACT, DEVICE, COMMAND, GREY = "#0b5394", "#d1730f", "#8a5a00", "0.35"
SKIN = LinearSegmentedColormap.from_list("skin", ["#c9a48f", "#f3ddd0"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("config/pictures/frames_and_signs.png"))
    out = parser.parse_args().out
    sim = Simulator(Scene.load("finger_coupled"))
    command = Pose((AT, 0.0, START), FLAT)
    sim.reset(command)
    while command.position[2] > DEPTH:
        command = Pose((AT, 0.0, max(DEPTH, command.position[2] - SPEED * sim.scene.dt)), FLAT)
        sim.step(command)
    for _ in range(500):
        result = sim.step(command)
    tell(command, result)
    print(draw(sim, command, result, out))


def tell(command: Pose, result: StepResult) -> None:
    print(f"commanded {millimetres(command)} mm, simulated {millimetres(result.pose)} mm")
    for frame in WRENCH_FRAMES:
        print(f"contact_wrench, {frame:13} {numbers(express_wrench(result.contact_wrench, result.pose, frame))}")
    print(f"device_wrench                 {numbers(result.device_wrench)}")


def millimetres(pose: Pose) -> str:
    return " ".join(f"{1e3 * value:.2f}" for value in pose.position)


def numbers(wrench: Any) -> str:
    force, torque = np.round(wrench[:3], 2) + 0.0, np.round(1e3 * wrench[3:], 1) + 0.0
    return f"force {force} N, torque {torque} N mm"


def draw(sim: Simulator, command: Pose, result: StepResult, path: Path) -> Path:
    """Writes the picture: the whole finger with its frames, and the tip with the virtual coupling."""
    figure = new_figure(10.0, 3.6)
    whole, tip = figure.add_axes((0.0, 0.0, 0.575, 0.92)), figure.add_axes((0.6, 0.0, 0.4, 0.92))
    for axes, title, left in ((whole, "frames and contact_wrench", -62.0), (tip, "under a virtual coupling", -53.0)):
        right = left + HEIGHT * axes.get_position().width * 10.0 / (axes.get_position().height * 3.6)
        axes.set(xlim=(left, right), ylim=(-17.0, HEIGHT - 17.0), aspect="equal")
        axes.set_title(title, fontsize=11)
        axes.set_axis_off()
        ground(axes, left, right)
        body(axes, sim)
        force(axes, CONTACT, centre_of_pressure(sim), result.contact_wrench, pivot="tip")
    frame(whole, Pose(), 9.0, {"x": (9.6, -0.8), "z": (-0.8, 9.6), "y": (-3.6, 1.2)})
    frame(whole, result.pose, 11.0, {"x": (12.0, -0.9), "y": (-0.8, 11.8), "z": (-3.6, 1.2)})
    note(whole, (-30.0, 20.5), "finger: x to the tip, y up to the nail, z towards you", GREY, "center")
    note(whole, (-13.0, -3.8), "world, origin on the plane", GREY)
    contact = "contact_wrench:\nforce of the plane on the finger,\ntorque about the finger's origin"
    note(whole, (-27.0, -8.6), contact, CONTACT, top=True)

    outline(tip, sim, command)
    coupling(tip, command, result)
    force(tip, DEVICE, 1e3 * np.array(command.position), result.device_wrench)
    above = 1e3 * command.position[2] + PER_NEWTON * result.device_wrench[2] + 1.2
    device = "device_wrench: what the hand feels,\ntorque about the commanded origin"
    note(tip, (-30.0, above), device, DEVICE, "center")
    note(tip, (-27.0, -10.8), "contact_wrench", CONTACT, top=True)
    return save(figure, path)


def flat(points: Any) -> Any:
    """Points (…, 3) [m] in the picture [mm]: the world's x and z, seen along its y."""
    return 1e3 * np.asarray(points)[..., [0, 2]]


def ground(axes: Axes, left: float, right: float) -> None:
    axes.fill_between([left, right], -1.2, 0.0, color="#e4e8ec", linewidth=0)
    axes.plot([left, right], [0.0, 0.0], color="#8d99a6", linewidth=1.2)


def body(axes: Axes, sim: Simulator) -> None:
    """The side of the deformed surface that is seen, shaded."""
    x, faces = sim.positions, sim.mesh.surface
    normals = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    light = np.zeros_like(x)
    np.add.at(light, faces.ravel(), np.repeat(normals, 3, axis=0))
    light /= np.linalg.norm(light, axis=1, keepdims=True) + 1e-30
    brightness = light @ np.array([0.15, -0.75, 0.65])
    style: Any = {"triangles": faces[normals[:, 1] < 0.0], "cmap": SKIN, "vmin": -0.3, "vmax": 1.0}
    across, up = flat(x).T
    axes.tripcolor(across, up, brightness, shading="gouraud", **style)


def outline(axes: Axes, sim: Simulator, command: Pose) -> None:
    """The silhouette of the undeformed finger where it is commanded."""
    from scipy.spatial import ConvexHull

    rest = flat(place(sim.mesh.points, command))
    hull = rest[ConvexHull(rest).vertices]
    axes.plot(*np.vstack([hull, hull[:1]]).T, color=COMMAND, linewidth=1.1, linestyle=(0, (4, 3)))


def coupling(axes: Axes, command: Pose, result: StepResult) -> None:
    """Both frames' origins, and the spring between them."""
    low, high = flat(command.position), flat(result.pose.position)
    aside = low[0] - 9.0
    for point, name, colour, face in ((high, "simulated", GREY, GREY), (low, "commanded", COMMAND, "white")):
        axes.plot([aside - 1.5, point[0]], [point[1]] * 2, color=colour, linewidth=0.8)
        axes.plot(*point, "o", color=colour, markerfacecolor=face, markersize=6, zorder=5)
        note(axes, (aside - 2.2, point[1] - 1.1), name, colour, "right")
    turns = np.linspace(0.0, 1.0, 13)
    zigzag = aside + 0.9 * np.array([0, *([1, -1] * 5), 1, 0])
    axes.plot(zigzag, low[1] + turns * (high[1] - low[1]), color=GREY, linewidth=1.1)


def frame(axes: Axes, pose: Pose, length: float, labels: dict[str, tuple[float, float]]) -> None:
    """The axes of a pose as arrows, or as a dot or cross towards the eye or from it."""
    origin, turn = flat(pose.position), matrix(pose.orientation)
    for letter, axis in zip("xyz", turn.T, strict=True):
        arrow, colour = length * axis[[0, 2]], AXES[letter]
        if abs(axis[1]) > 0.9:
            axes.plot(*origin, "o", color=colour, markerfacecolor="white", markersize=9, zorder=6)
            axes.plot(*origin, "." if axis[1] < 0.0 else "x", color=colour, markersize=4.5, zorder=7)
        else:
            arrow_from(axes, origin, arrow, colour, 1.8)
        x, y = origin + np.array(labels[letter])
        axes.text(x, y, letter, color=colour, fontsize=11, fontweight="bold")


def force(axes: Axes, colour: str, at: Any, wrench: Any, pivot: str = "tail") -> None:
    """The force of a wrench at a point [mm]."""
    point = at if len(at) == 2 else at[[0, 2]]
    arrow = PER_NEWTON * wrench[[0, 2]]
    arrow_from(axes, point - arrow if pivot == "tip" else point, arrow, colour, 3.0)


def arrow_from(axes: Axes, start: Any, arrow: Any, colour: str, width: float) -> None:
    style: Any = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    style["mutation_scale"] = 8 + 3 * width
    axes.annotate("", xy=tuple(start + arrow), xytext=tuple(start), arrowprops=style, zorder=6)


def centre_of_pressure(sim: Simulator) -> Any:
    """Where on the plane the contact force acts [mm]."""
    up = sim.contact_forces[:, 2]
    return np.array([1e3 * float(up @ sim.positions[:, 0] / up.sum()), 0.0])


def note(axes: Axes, at: Any, text: str, colour: str, side: Any = "left", top: bool = False) -> None:
    x, y = at
    axes.text(x, y, text, color=colour, fontsize=9.5, ha=side, va="top" if top else "bottom", linespacing=1.25)


if __name__ == "__main__":
    sys.exit(printing("draw_frames", main))

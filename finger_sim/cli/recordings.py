"""Verbs about what is recorded or read: import, info, compare."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..bags.imports.formats import FORMATS, TIME_UNITS
from .common import DONE, FAILED, assignment, from_zero, number_assignment, positive, verb


def add_import(verbs: Any) -> None:
    parser = verb(
        verbs,
        "import",
        _import,
        "a bag of commands of a recording: CSV, TUM, EuRoC/ASL, KITTI, another topic, /tf, a ROS 1 bag",
        "finger_sim import hand.csv -o hand --columns t=time x=px y=py z=pz --scale 0.001 --rotate 'x=-y y=x z=z'",
    )
    add = parser.add_argument
    add(
        "recording",
        type=Path,
        metavar="RECORDING",
        help="text file of poses, rosbag2 folder, .mcap, .db3 or ROS 1 .bag",
    )
    add("-o", "--out", type=Path, required=True, metavar="BAG", help="bag to make")
    add("--topic", default="command_pose", help="topic in the bag (default: %(default)s)")
    add("--frame-id", default="world", metavar="FRAME", help="frame of the commands (default: %(default)s)")
    add(
        "--plane",
        type=float,
        default=0.0,
        metavar="Z",
        help="height of the plane that depth is told of [m] (default: 0)",
    )
    _add_reading(parser)
    _add_changes(parser)


def _add_reading(parser: argparse.ArgumentParser) -> None:
    looks = "; ".join(f"{name}: {look}" for name, look in FORMATS.items())
    text = parser.add_argument_group("text files")
    text.add_argument("--format", choices=FORMATS, help=f"what it is, where its content does not tell. {looks}")
    text.add_argument(
        "--columns", type=assignment, nargs="+", action="extend", default=[], metavar="OURS=THEIRS",
        help="which column is t x y z qx qy qz qw, by its name or its number from 1 on",
    )  # fmt: skip
    text.add_argument("--time-unit", choices=TIME_UNITS, help="of t (default: as the header says, else seconds)")
    text.add_argument("--times", type=Path, metavar="FILE", help="of KITTI poses: one time a line [s]")
    text.add_argument(
        "--where", type=assignment, action="append", default=[], metavar="COLUMN=TEXT",
        help="only rows with that cell; may be repeated",
    )  # fmt: skip
    text.add_argument(
        "--concatenate", metavar="COLUMN",
        help="column that numbers repeats in which t starts anew: play them one after another",
    )  # fmt: skip
    bags = parser.add_argument_group("bags")
    bags.add_argument("--from-topic", metavar="TOPIC", help="topic to read, where several hold poses")
    bags.add_argument(
        "--tf", nargs=2, metavar=("PARENT", "CHILD"), help="pose of frame CHILD in frame PARENT, of /tf and /tf_static"
    )
    bags.add_argument(
        "--clock", choices=("header", "receipt"),
        help="times of header stamps or of receipt (default: header stamps where they run, else receipt)",
    )  # fmt: skip


def _add_changes(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("changes, in this order").add_argument
    add("--scale", type=positive, metavar="X", help="multiply lengths: 0.001 for millimetres")
    add(
        "--rotate", metavar="TURN",
        help="turn positions and orientations from the device's axes to ours: 'x=-y y=x z=z' where our x is the "
        "device's -y, or the quaternion 'x y z w' of the device's base in our world: p' = R p, q' = R q",
    )  # fmt: skip
    add(
        "--tool", metavar="TURN",
        help="turn orientations only, as the finger sits on what was tracked: 'x=z y=-x z=-y' where the finger's x is "
        "the tool's z, or the quaternion 'x y z w' of the finger in the tool's frame: q' = q T",
    )  # fmt: skip
    add(
        "--set", type=number_assignment, action="append", default=[], metavar="COLUMN=VALUE",
        help="one value for every pose, recorded or not; may be repeated",
    )  # fmt: skip
    add(
        "--offset", type=number_assignment, action="append", default=[], metavar="COLUMN=VALUE",
        help="add to a column; may be repeated",
    )  # fmt: skip
    add("--resample", type=positive, metavar="HZ", help="that many poses a second: lines between positions, slerp")


def _import(options: argparse.Namespace) -> int:
    from ..bags.course import doubts, rows
    from ..bags.imports.poses import Changes, import_poses
    from ..bags.imports.recorded import Reading
    from ..console import console, say, table

    reading = Reading(
        format=options.format, columns=dict(options.columns), time_unit=options.time_unit, where=dict(options.where),
        concatenate=options.concatenate, times=options.times, from_topic=options.from_topic,
        tf=tuple(options.tf) if options.tf else None, clock=options.clock,
    )  # fmt: skip
    changes = Changes(
        scale=options.scale, rotate=options.rotate, tool=options.tool, constants=dict(options.set),
        offset=dict(options.offset), resample=options.resample,
    )  # fmt: skip
    made = import_poses(
        options.recording, options.out, topic=options.topic, frame_id=options.frame_id, reading=reading,
        changes=changes, plane=options.plane,
    )  # fmt: skip
    found = made.figures
    facts = table()
    facts.add_row("read as", made.format)
    for note in made.notes:
        facts.add_row("assumed", note)
    for name, text in rows(found).items():
        facts.add_row(name, text)
    if made.repeats > 1:
        facts.add_row("repeats", f"{made.repeats}, one after another")
    console().print(f"{made.path}: {found.poses} poses on {made.topic} in frame {made.frame_id!r}", facts, sep="\n")
    for warning in (*made.warnings, *doubts(found)):
        say(f"finger_sim: warning: {warning}")
    return DONE


def add_info(verbs: Any) -> None:
    info = verb(verbs, "info", _info, "what a scene, a bag or a mesh holds", "finger_sim info press_slide")
    info.add_argument("what", metavar="SCENE|BAG|MESH", help="file, folder, or name of a shipped one")
    info.add_argument(
        "--press",
        choices=("flat", "side", "tip"),
        nargs="?",
        const="flat",
        metavar="HOW",
        help="of a scene also its stiffness against force, k(F), pressed flat (default), side or tip; takes seconds",
    )


def _info(options: argparse.Namespace) -> int:
    from ..console import show
    from ..pictures.info import info

    for title, table in info(options.what):
        show(title, table, "")
    if options.press is not None:
        _show_stiffness(options.what, options.press)
    return DONE


def _show_stiffness(name: str, direction: str) -> None:
    from ..console import say, show
    from ..errors import FingerSimError
    from ..fit.stiffness import press_curve, stiffness_table
    from ..scene import Scene
    from ..scene.resources import scene_named

    path = scene_named(name)
    if path is None or path.name == "metadata.yaml":
        raise FingerSimError(f"--press: {name} is no scene, allowed: with a scene")
    show(f"pressed {direction}, at rest", stiffness_table(*press_curve(Scene.load(path), direction, say)), "")


def add_compare(verbs: Any) -> None:
    compare = verb(
        verbs,
        "compare",
        _compare,
        "how two bags differ; exit code 0: equal, 1: not, 2: a mistake",
        "finger_sim compare before after --topic contact_wrench --tolerance 0.01 --overlap",
    )
    add = compare.add_argument
    add("a", metavar="A", help="bag")
    add("b", metavar="B", help="bag to compare with it, at the same log times")
    add(
        "--topic",
        action="append",
        help="topic to compare; may be repeated (default: all that measure something)",
    )
    add("--all", action="store_true", help="compare also what only a live node writes, and what only one bag has")
    add(
        "--tolerance",
        type=from_zero,
        metavar="X",
        help="largest difference of wrenches, poses, clouds and meshes that is equal, in N, N·m, m, rad; "
        "messages of other types must have the same bytes (default: all the same, bit by bit)",
    )
    add("--overlap", action="store_true", help="with --tolerance: count only times that both bags hold")
    add("--json", action="store_true", help="JSON instead of a table")


def _compare(options: argparse.Namespace) -> int:
    import json

    from ..bags.compare import compare
    from ..bags.verdict import verdict
    from ..console import say, show
    from ..scene.resources import find_bag

    found = compare(
        find_bag(options.a), find_bag(options.b),
        topics=options.topic, tolerance=options.tolerance, overlap=options.overlap, everything=options.all,
    )  # fmt: skip
    for warning in found.warnings:
        say(f"finger_sim: warning: {warning}")
    if options.json:
        print(json.dumps(found.as_plain(), indent=2, allow_nan=False))
    else:
        show(*verdict(found))
    return DONE if found.equal else FAILED

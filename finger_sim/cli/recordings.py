"""Verbs about what is recorded or read: import, info, compare."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .common import DONE, FAILED, assignment, from_zero, number_assignment, verb


def add_import(verbs: Any) -> None:
    csv = verb(
        verbs,
        "import",
        _import,
        "a bag of a CSV of poses: columns t x y z qx qy qz qw, SI units",
        "finger_sim import strokes.csv -o strokes --set z=0.005 --where rep=3",
    )
    add = csv.add_argument
    add("poses", type=Path, metavar="POSES.csv", help="text with a line of column names; t is needed")
    add("-o", "--out", type=Path, required=True, metavar="BAG", help="bag to make")
    add("--topic", default="command_pose", help="topic in the bag (default: %(default)s)")
    add("--frame-id", default="world", metavar="FRAME", help="frame of the poses (default: %(default)s)")
    add(
        "--set",
        type=number_assignment,
        action="append",
        default=[],
        metavar="COLUMN=VALUE",
        help="one value for every row, present in the file or not; may be repeated",
    )
    add(
        "--offset",
        type=number_assignment,
        action="append",
        default=[],
        metavar="COLUMN=VALUE",
        help="add to a column; may be repeated",
    )
    add(
        "--where",
        type=assignment,
        action="append",
        default=[],
        metavar="COLUMN=TEXT",
        help="only rows with that cell; may be repeated",
    )
    add(
        "--concatenate",
        metavar="COLUMN",
        help="column that numbers repeats in which t starts anew: play them one after another",
    )


def _import(options: argparse.Namespace) -> int:
    from ..bags.imports import import_csv

    made = import_csv(
        options.poses, options.out, topic=options.topic, frame_id=options.frame_id,
        constants=dict(options.set), offset=dict(options.offset), where=dict(options.where),
        concatenate=options.concatenate,
    )  # fmt: skip
    missing = f"; not in the file: {', '.join(made.defaulted)}" if made.defaulted else ""
    print(
        f"{made.path}: {made.poses} poses on {made.topic}, {made.duration:.3f} s at {made.rate:.4g} Hz, "
        f"{made.repeats} repeats, {made.gaps} gaps (longest {made.longest_gap:.3g} s), "
        f"{made.repeated_stamps} repeated stamps, {made.sign_flips} sign flips{missing}"
    )
    return DONE


def add_info(verbs: Any) -> None:
    info = verb(verbs, "info", _info, "what a scene, a bag or a mesh holds", "finger_sim info press_slide")
    info.add_argument("what", metavar="SCENE|BAG|MESH", help="file, folder, or name of a shipped one")


def _info(options: argparse.Namespace) -> int:
    from ..console import show
    from ..pictures.info import info

    for title, table in info(options.what):
        show(title, table, "")
    return DONE


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
        "other topics do not count then (default: all the same, bit by bit)",
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

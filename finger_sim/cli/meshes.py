"""The verb that makes meshes, and makes meshes of others' files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .common import DONE, positive, verb


def add_mesh(verbs: Any) -> None:
    mesh = verb(verbs, "mesh", None, "make a mesh of a finger, a beam or a file", "finger_sim mesh beam -o beam.vtu")
    kinds = mesh.add_subparsers(title="kinds", metavar="finger|solid-finger|beam|convert", required=True)
    finger = verb(
        kinds,
        "finger",
        _mesh,
        "a finger without the inside of its bones (needs the extra [mesh])",
        "finger_sim mesh finger -o fine.vtu --tets 2000",
    )
    finger.add_argument("--tets", type=int, metavar="N", help="about so many tetrahedra (default: 900)")
    finger.add_argument("--distal", action="store_true", help="the last 28 mm alone: the fingertip")
    solid = verb(
        kinds,
        "solid-finger",
        _mesh,
        "a finger with nodes in its bones, as the paper's pictures have it (needs the extra [mesh])",
        "finger_sim mesh solid-finger -o solid.vtu --tets 347",
    )
    solid.add_argument("--tets", type=int, metavar="N", help="about so many tetrahedra (default: 347)")
    beam = verb(
        kinds,
        "beam",
        _mesh,
        "a box of bricks, five tetrahedra each",
        "finger_sim mesh beam -o beam.vtu --size 1 0.2 0.2 --cells 10 2 2",
    )
    beam.add_argument("--size", type=float, nargs=3, metavar=("X", "Y", "Z"), help="edges [m] (default: 1 0.2 0.2)")
    beam.add_argument("--cells", type=int, nargs=3, metavar=("X", "Y", "Z"), help="bricks (default: 10 2 2)")
    convert = verb(
        kinds,
        "convert",
        _convert,
        "a .vtu of a mesh in another format or unit, with its node sets",
        "finger_sim mesh convert hand.msh -o hand.vtu --scale 0.001",
        more="Scenes read meshes of other formats as they are; convert what is not in metres.",
    )
    convert.add_argument("file", type=Path, metavar="FILE", help="mesh of tetrahedra")
    convert.add_argument(
        "--scale",
        type=positive,
        default=1.0,
        metavar="FACTOR",
        help="of lengths; 0.001 for millimetres (default: 1)",
    )
    for kind, name in ((finger, "finger"), (solid, "solid-finger"), (beam, "beam"), (convert, "convert")):
        kind.set_defaults(kind=name)
        kind.add_argument("-o", "--out", type=Path, required=True, metavar="FILE.vtu", help="file to make")
        kind.add_argument("--force", action="store_true", help="overwrite the file")


def _mesh(options: argparse.Namespace) -> int:
    from ..scene.meshing import write_mesh

    _require_absent(options)
    given = {name: getattr(options, name, None) for name in ("tets", "distal", "size", "cells")}
    asked = {name: value for name, value in given.items() if value is not None}
    write_mesh(options.kind, options.out, **asked)
    return _shown(options.out)


def _convert(options: argparse.Namespace) -> int:
    from ..console import say
    from ..scene.mesh import TetMesh

    _require_absent(options)
    mesh = TetMesh.load(options.file, options.scale)
    mesh.save(options.out)
    for note in mesh.notes:
        say(f"finger_sim: warning: {note}")
    return _shown(options.out)


def _require_absent(options: argparse.Namespace) -> None:
    from ..bags.reader import require_absent

    if not options.force:
        require_absent(options.out)


def _shown(file: Path) -> int:
    """Tells what a file that was made holds."""
    from ..console import show
    from ..pictures.info import info

    for title, table in info(str(file)):
        show(title, table)
    return DONE

"""The verb that makes a scene of measurements: fit."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from .common import DONE, from_zero, one_or_more, verb

FORMAT = """\
Data are CSV files whose header names each column and its unit, as
  time [s], depth [mm], normal [N], tangential [N], along [mm], area [mm^2]
with a line `# direction: flat` (side, tip) above, or bags of poses and a wrench.
Depth counts from first touch on. See docs/fit.md.
"""


def add_fit(verbs: Any) -> None:
    parser = verb(
        verbs,
        "fit",
        _fit,
        "a scene's tissue from force and depth that were measured: values with confidence intervals",
        "finger_sim fit finger_haptic --data examples/presses.csv -o mine.yaml\n"
        '  finger_sim fit finger_haptic --target "1 N at 1.5 mm, k = b + mF with m = 2/mm" -o mine.yaml',
        more=FORMAT,
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", help="scene to begin with: what is not fitted stays")
    add("--data", type=Path, action="append", default=[], metavar="FILE", help="CSV file or bag; may be repeated")
    add("--target", metavar="TEXT", help='a curve instead of data: "1 N at 1.5 mm, k = b + mF with m = 2/mm"')
    add("-o", "--out", type=Path, required=True, metavar="SCENE", help="scene to write")
    add(
        "--fit",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="young, stretch, compress (of all axes), stretch.e1 (of one), stretch.e13 (of two, the same), stiffness, "
        "damping, friction, time.1 and share.1 (of the first term of material.relaxation), touch (an error of each "
        "first touch); default: young and each limit of the scene",
    )
    add("--direction", choices=("flat", "side", "tip"), help="of data that do not say, and of a target")
    add(
        "--bound", type=_pair, action="append", default=[], metavar="NAME=LOW:HIGH",
        help="between what it is sought, as the scene has the value; may be repeated",
    )  # fmt: skip
    add(
        "--prior", type=_pair, action="append", default=[], metavar="NAME=VALUE:FACTOR",
        help="what it is believed to be, within a factor (one standard deviation; of a limit: of its room, of a "
        "share: of it over its rest); may be repeated (default: the scene's value within a factor of 3)",
    )  # fmt: skip
    add(
        "--floor",
        type=from_zero,
        default=0.0,
        metavar="N",
        help="error of weak forces [N] (default: 0.4 %% of the largest)",
    )
    add(
        "--in-time",
        action="store_true",
        help="follow presses in time, not at rest: slower (always with damping, with what relaxes, and with limits "
        "other than tensor)",
    )
    add(
        "--carry",
        action="append",
        default=[],
        metavar="MESH",
        help="state the fit on another mesh too; may be repeated",
    )
    add("--starts", type=one_or_more, default=6, metavar="N", help="starts of the search (default: %(default)s)")
    add("--work", type=Path, metavar="DIR", help="folder for table, picture and finished runs (default: OUT_fit)")
    add("--workers", type=one_or_more, metavar="N", help="own processes (default: one for each processor)")
    add("--scheduler", metavar="ADDRESS", help="a Dask scheduler instead, tcp://HOST:PORT; see tradeoff --help")


def _pair(text: str) -> tuple[str, tuple[float, float]]:
    name, _, pair = text.partition("=")
    try:
        first, second = (float(part) for part in pair.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: NAME=NUMBER:NUMBER") from None
    return name.strip(), (first, second)


def _fit(options: argparse.Namespace) -> int:
    from ..console import gauge, say, show
    from ..fit.fitting import Options, asked, fit, read
    from ..fit.picture import draw
    from ..fit.press import FitError
    from ..fit.report import sentences, tables, write
    from ..fit.runs import runner
    from ..pictures.surfaces import new_figure, save
    from ..studies.bench.report import require_writable

    if options.out.suffix not in (".yaml", ".yml"):
        raise FitError(f"-o: got {options.out}, allowed: a file that ends in .yaml")
    new_figure(1.0, 1.0)  # a missing matplotlib shows before anything long
    what = Options(
        options.scene, options.data, options.target, options.fit, options.direction, dict(options.bound),
        dict(options.prior), options.starts, options.floor, options.carry, options.in_time,
    )  # fmt: skip
    scene, presses, notes = read(what)
    asked(what, scene, presses)
    require_writable(options.out, "-o")
    for note in notes:
        say(f"finger_sim: warning: {note}")
    work = options.work or options.out.with_name(f"{options.out.stem}_fit")
    with (
        gauge(f"fitting {options.scene}") as meter,
        runner(work / "runs", options.workers, options.scheduler, meter) as run,
    ):
        done = fit(what, run, say)
        made = run.made, run.found
    for title, rows in tables(done):
        show(*([title] if title else []), rows, "")
    for sentence in sentences(done)[len(done.notes) :]:
        say(f"finger_sim: note: {sentence}")
    written = write(done, options.out, work, shlex.join(["finger_sim", *options.given]))
    written.append(save(draw(done), work / "fit.png"))
    say(f"finger_sim: {made[0]} presses simulated, {made[1]} found in {work / 'runs'}")
    show(*(str(path) for path in written))
    return DONE

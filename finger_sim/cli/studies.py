"""Verbs that measure: bench, figures, stress, tradeoff."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from ..errors import FingerSimError
from .common import DONE, FAILED, count, one_or_more, positive, verb


def add_bench(verbs: Any) -> None:
    bench = verb(
        verbs,
        "bench",
        _bench,
        "times a step, beside its errors, MuJoCo and Drake (needs the extra [peers] for these two)",
        "finger_sim bench --sizes 350 2000 --repeats 5 --json bench.json --plot bench.png",
    )
    add = bench.add_argument
    add("--quick", action="store_true", help="350 tetrahedra, one repetition, no start-up: half a minute")
    add("--sizes", type=int, nargs="+", metavar="N", help="tetrahedra (default: 350 900 2000 4000)")
    add("--repeats", type=int, metavar="N", help="repetitions after a warm-up (default: 3)")
    add("--steps", type=positive, metavar="SHARE", help="share of the steps to run, the way down apart (default: 1)")
    add("--cpu", type=int, metavar="K", help="processor to run on (default: the last allowed one)")
    add("--peers", action=argparse.BooleanOptionalAction, help="run MuJoCo and Drake (default: where installed)")
    add("--startup", action=argparse.BooleanOptionalAction, help="time cold and cached starts (default: yes)")
    add("--json", type=Path, metavar="FILE", help="write everything as JSON")
    add("--plot", type=Path, metavar="FILE.png", help="draw step times")


def _bench(options: argparse.Namespace) -> int:
    import dataclasses

    from ..console import show
    from ..studies.bench.bench import QUICK, Options, bench
    from ..studies.bench.report import NOTES, PICTURES, draw, require_writable, sections, write_json

    asked = {
        "sizes": tuple(options.sizes) if options.sizes else None,
        "repeats": options.repeats,
        "scale": options.steps,
        "cpu": options.cpu,
        "peers": options.peers,
        "startup": options.startup,
    }
    given = {name: value for name, value in asked.items() if value is not None}
    what = dataclasses.replace(QUICK if options.quick else Options(), **given)
    if options.json:
        require_writable(options.json, "--json")
    if options.plot:
        require_writable(options.plot, "--plot", PICTURES)
    report = bench(what)
    report.machine["command"] = shlex.join(["finger_sim", *options.given])
    for title, rows in sections(report):
        show(title, rows, "")
    for note in NOTES:
        show(note)
    if options.json:
        write_json(report, options.json)
    if options.plot:
        draw(report, options.plot)
    return DONE


def add_figures(verbs: Any) -> None:
    figures = verb(
        verbs,
        "figures",
        _figures,
        "the paper's experiments, and laws of fingertips, measured and drawn: a PNG and a JSON each",
        "finger_sim figures --only beams standing --out figures",
    )
    names = ("beams", "finger", "standing", "isotropy", "locking", "speed", "relaxation", "fingertip")
    figures.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=f"of: {', '.join(names)}")
    figures.add_argument(
        "--out",
        type=Path,
        default=Path("figures"),
        metavar="DIR",
        help="folder for what is made (default: %(default)s)",
    )


def _figures(options: argparse.Namespace) -> int:
    from ..console import show, table
    from ..studies.paper.figures import FIGURES, figures

    for made in figures(options.only or list(FIGURES), options.out):
        rows = table(made.said_by, "we measure", "", "why")
        for finding in made.findings:
            verdict = {True: "agrees", False: "differs", None: ""}[finding.agrees]
            rows.add_row(finding.paper, finding.measured, verdict, finding.reason)
        show(f"{made.name}: {made.picture}, {made.data}", rows, "")
    return DONE


def add_stress(verbs: Any) -> None:
    stress = verb(
        verbs,
        "stress",
        _stress,
        "extreme and random scenes and motions: none may end in NaN, a crash, or wrong without a word",
        "finger_sim stress --cases 1000 --seed 7 --minutes 10 --out failed",
    )
    add = stress.add_argument
    add("--cases", type=count, default=200, metavar="N", help="random cases, after the directed (default: %(default)s)")
    add("--seed", type=count, default=0, metavar="S", help="of the random cases (default: %(default)s)")
    add("--minutes", type=positive, metavar="M", help="begin no further case after that (default: run them all)")
    add("--long", action="store_true", help="a million steps of press and slide too: some minutes")
    add(
        "--out",
        type=Path,
        default=Path("stress_failed"),
        metavar="DIR",
        help="folder for what repeats a case that failed (default: %(default)s)",
    )
    add("--plot", type=Path, metavar="FILE.png", help="draw how the cases ended")


def _stress(options: argparse.Namespace) -> int:
    from ..console import gauge, say, show
    from ..studies.stress.stress import Options, failures, stress, summary

    what = Options(options.cases, options.seed, options.minutes, options.long, options.out)
    if options.plot:
        from ..studies.bench.report import PICTURES, require_writable

        require_writable(options.plot, "--plot", PICTURES)
    with gauge(f"stress: {what.cases} random cases of seed {what.seed}, and the directed ones") as meter:
        report = stress(what, meter)
    show(summary(report))
    if options.plot:
        from ..studies.stress.stress import draw

        draw(report, options.plot)
    if report.left_out:
        say(f"finger_sim: {report.left_out} cases left out: out of time")
    if not report.failed:
        return DONE
    show("", failures(report))
    for folder in report.written:
        say(f"finger_sim: to see it again: {folder}")
    return FAILED


def add_tradeoff(verbs: Any) -> None:
    tradeoff = verb(
        verbs,
        "tradeoff",
        _tradeoff,
        "what settings cost and what they give up, against converged runs (needs the extra [tradeoff])",
        "finger_sim tradeoff finger_haptic --bag press_side --out side\n"
        "  finger_sim tradeoff --for-rate 1000 --scene finger_haptic",
    )
    add = tradeoff.add_argument
    add("scenes", nargs="*", metavar="SCENE", help="scenes to study (default: finger_haptic)")
    add("--scene", action="append", default=[], metavar="SCENE", help="the same; may be repeated")
    add(
        "--bag",
        action="append",
        default=[],
        metavar="BAG",
        help="commands; may be repeated (default: 0.5 s of a slide)",
    )
    add("--duration", type=positive, metavar="S", help="seconds of the commands (default: all)")
    add(
        "--grid",
        type=Path,
        metavar="FILE",
        help="YAML of what to change: `base`: {KEY: VALUE} in all points, `sweeps`: {KEY: [VALUE, …]} one at a time, "
        "`product`: {KEY: [VALUE, …]} all combinations, `points`: [{KEY: VALUE, …}, …]; keys are dotted",
    )
    add(
        "--reference",
        metavar="MESH",
        help="the finger that is meant, with patches, which errors of a mesh are against: a shipped finger "
        "(default: finger_4000)",
    )
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="a Dask scheduler, tcp://HOST:PORT (default: own processes here); "
        "plain TCP with pickles: whoever reaches it runs code here and there, so only in a network that you trust",
    )
    add("--workers", type=one_or_more, metavar="N", help="own processes (default: one for each processor)")
    add(
        "--for-rate",
        type=positive,
        metavar="HZ",
        help="instead of the study: find the most accurate mesh and settings that hold HZ here, and write them as a "
        "scene",
    )
    add(
        "--out",
        type=Path,
        default=Path("tradeoff"),
        metavar="DIR",
        help="folder for table, pictures and finished runs, which are not made again (default: %(default)s)",
    )


def _tradeoff(options: argparse.Namespace) -> int:
    if options.for_rate is not None:
        return _for_rate(options)
    from ..console import say, show
    from ..studies.tradeoff.grid import DEFAULT, MEANT, Grid
    from ..studies.tradeoff.table import summary
    from ..studies.tradeoff.tradeoff import SCENES, Options, tradeoff

    what = Options(
        scenes=[*options.scenes, *options.scene] or SCENES,
        bags=options.bag or [None],
        grid=Grid.load(options.grid) if options.grid else DEFAULT,
        meant=options.reference or MEANT,
        duration=options.duration,
        scheduler=options.scheduler,
        workers=options.workers,
        out=options.out,
    )
    report = tradeoff(what)
    show(summary(report.rows))
    show("", *(str(path) for path in (report.table, *report.pictures)))
    for failure in report.failed:
        say(f"finger_sim: not run: {failure}")
    return FAILED if report.failed else DONE


def _for_rate(options: argparse.Namespace) -> int:
    from ..console import gauge, say, show
    from ..studies.tradeoff.grid import MEANT
    from ..studies.tradeoff.rate import for_rate, tried, words
    from ..studies.tradeoff.tradeoff import checked_finger

    for name in ("grid", "scheduler", "workers"):
        if getattr(options, name) is not None:
            raise FingerSimError(f"--{name}: not allowed with --for-rate")
    scenes = [*options.scenes, *options.scene] or ["finger_haptic"]
    if len(scenes) > 1 or len(options.bag) > 1:
        raise FingerSimError("--for-rate: allowed with one scene and one bag")
    bag = options.bag[0] if options.bag else None
    mesh = checked_finger(options.reference or MEANT, "--reference")
    with gauge(f"{scenes[0]}: settings that hold {options.for_rate:g} Hz on this machine") as meter:
        found = for_rate(scenes[0], options.for_rate, bag, options.duration, options.out, meter, mesh)
    show(tried(found))
    if found.scene is None:
        say(f"finger_sim: nothing holds {options.for_rate:g} Hz here; the nearest: {words(found.best)}")
        return FAILED
    show("", str(found.scene))
    return DONE

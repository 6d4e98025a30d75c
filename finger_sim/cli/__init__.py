"""`finger_sim <verb>`: reads the command line; each verb's work lives elsewhere, imported when asked for."""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

from ..errors import FingerSimError

DONE, FAILED, MISTAKE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143
"""Exit codes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one verb. 0: the job was done, 1: a part of it failed, 2: a user's mistake, 130: interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    own = given.index("--ros-args") if given[:1] == ["node"] and "--ros-args" in given else len(given)
    try:
        options = _parser().parse_args(given[:own], argparse.Namespace(given=given, ros=given[own:]))
        verb: Callable[[argparse.Namespace], int] = options.verb
        return verb(options)
    except FingerSimError as error:
        print(f"finger_sim: error: {' '.join(str(error).split())}", file=sys.stderr)
        return MISTAKE
    except KeyboardInterrupt:
        print("finger_sim: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED


def _terminated(*_: object) -> NoReturn:
    """SIGTERM unwinds the stack, so that a node that was started ends too."""
    raise SystemExit(TERMINATED)


def _demo(options: argparse.Namespace) -> int:
    from ..console import console, say
    from ..ros.demo import DemoError, run_demo

    signal.signal(signal.SIGTERM, _terminated)
    try:
        outcome = run_demo(
            options.scene, options.bag, options.out,
            rate=options.rate, priority=options.priority, duration=options.duration, topic=options.topic,
        )  # fmt: skip
    except DemoError as error:
        say(f"finger_sim: the demo failed: {error}")
        return FAILED
    console().print(outcome.table())
    for shortfall in outcome.shortfalls:
        say(f"finger_sim: not held by this machine: {shortfall}")
    for advice in outcome.advice:
        say(f"finger_sim: advice: {advice}")
    for failure in outcome.failures:
        say(f"finger_sim: the demo failed: {failure}")
    failed = outcome.failures or (options.strict and outcome.shortfalls)
    return FAILED if failed else DONE


def _run(options: argparse.Namespace) -> int:
    from ..bags.reader import BagReader, commands_of, plane_poses_of, require_absent
    from ..console import console, gauge, say, table
    from ..scene import Scene
    from ..scene.resources import find_bag, find_scene
    from ..simulation.replay import run
    from ..simulation.simulator import Simulator

    scene, bag = Scene.load(options.scene), find_bag(options.bag)
    out = options.out or Path(f"{bag.stem}_{find_scene(options.scene).stem}")
    require_absent(out)
    reader = BagReader(bag)  # a mistake shows before kernels compile
    plane_poses_of(reader, commands_of(reader, options.topic), options.plane_topic)
    simulator = Simulator(scene, progress=say)
    with gauge(f"simulating {bag}") as meter:
        plane, mode = options.plane_topic, options.mode
        done = run(scene, bag, out, options.topic, meter, simulator=simulator, plane_topic=plane, mode=mode)
    if done.warning:
        say(f"finger_sim: warning: {done.warning}")
    plane = f"{done.plane_poses} poses on {done.plane_topic}, {done.plane_refused} refused"
    moved = [("plane", plane)] if done.plane_topic else []
    status = ", ".join(f"{name} in {steps} steps" for name, steps in done.status.items())
    rows = table()
    for row in (
        ("commands", f"{done.commands} on {done.topic}, {done.refused} refused"),
        *moved,
        ("simulated", f"{done.duration:.3f} s in {done.steps} steps"),
        ("real-time factor", f"{done.real_time_factor:.2f}"),
        ("step time", f"median {1e3 * done.step_median:.3f} ms, p99 {1e3 * done.step_p99:.3f} ms"),
        ("peak force", f"{done.peak_force:.4g} N at {done.peak_force_time:.3f} s"),
        ("most tetrahedra at a limit", str(done.limited_tets)),
        ("max strain/limit", f"{done.max_strain_ratio:.3f}"),
        ("max penetration", f"{1e3 * done.max_penetration:.4f} mm"),
        ("solver status", status or "OK"),
        ("bag", str(done.out)),
    ):
        rows.add_row(*row)
    console().print(rows)
    return DONE


def _play(options: argparse.Namespace) -> int:
    from ..bags.reader import read_commands
    from ..console import gauge
    from ..ros.demo import require_ros
    from ..scene.resources import find_bag

    commands = read_commands(find_bag(options.bag), options.topic)
    require_ros()
    from ..ros.play import play, ros_node

    with ros_node("finger_sim_play") as node, gauge(f"playing {commands.topic}") as meter:
        played = play(
            node, commands, topic=options.to, frame_id=options.frame_id, speed=options.speed,
            duration=options.duration, timeout=options.timeout, progress=meter,
        )  # fmt: skip
    print(
        f"{played.sent} commands on {played.topic} in {played.duration / options.speed:.3f} s, "
        f"late by {1e3 * played.late_median:.3f} ms (median), {1e3 * played.late_p99:.3f} ms (p99), "
        f"{1e3 * played.late_max:.3f} ms (most)"
    )
    return DONE


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


def _info(options: argparse.Namespace) -> int:
    from ..console import console
    from ..pictures.info import info

    for title, table in info(options.what):
        console().print(title, table, "", sep="\n")
    return DONE


def _compare(options: argparse.Namespace) -> int:
    import json

    from ..bags.compare import compare, verdict
    from ..console import console, say
    from ..scene.resources import find_bag

    found = compare(
        find_bag(options.a), find_bag(options.b),
        topics=options.topic, tolerance=options.tolerance, overlap=options.overlap,
    )  # fmt: skip
    for warning in found.warnings:
        say(f"finger_sim: warning: {warning}")
    if options.json:
        print(json.dumps(found.as_plain(), indent=2, allow_nan=False))
    else:
        console().print(*verdict(found), sep="\n")
    return DONE if found.equal else FAILED


def _mesh(options: argparse.Namespace) -> int:
    from ..bags.reader import require_absent
    from ..console import console
    from ..pictures.info import info
    from ..scene.meshing import write_mesh

    if not options.force:
        require_absent(options.out)
    given = {name: getattr(options, name, None) for name in ("tets", "size", "cells")}
    asked = {name: value for name, value in given.items() if value is not None}
    write_mesh(options.kind, options.out, **asked)
    for title, table in info(str(options.out)):
        console().print(title, table, sep="\n")
    return DONE


def _node(options: argparse.Namespace) -> int:
    from ..ros.demo import require_ros

    require_ros()
    from ..ros.node import main as run_node

    return run_node(options.ros)


def _bench(options: argparse.Namespace) -> int:
    import dataclasses

    from ..console import console
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
        console().print(title, rows, "", sep="\n")
    for note in NOTES:
        console().print(note, soft_wrap=True)
    if options.json:
        write_json(report, options.json)
    if options.plot:
        draw(report, options.plot)
    return DONE


def _figures(options: argparse.Namespace) -> int:
    from ..console import console, table
    from ..studies.paper.figures import FIGURES, figures

    for made in figures(options.only or list(FIGURES), options.out):
        rows = table("the paper says", "we measure", "", "why")
        for finding in made.findings:
            verdict = {True: "agrees", False: "differs", None: ""}[finding.agrees]
            rows.add_row(finding.paper, finding.measured, verdict, finding.reason)
        console().print(f"{made.name}: {made.picture}, {made.data}", rows, "", sep="\n")
    return DONE


def _stress(options: argparse.Namespace) -> int:
    from ..console import console, gauge, say
    from ..studies.stress.stress import Options, failures, stress, summary

    what = Options(options.cases, options.seed, options.minutes, options.long, options.out)
    if options.plot:
        from ..studies.bench.report import PICTURES, require_writable

        require_writable(options.plot, "--plot", PICTURES)
    with gauge(f"stress: {what.cases} random cases of seed {what.seed}, and the directed ones") as meter:
        report = stress(what, meter)
    console().print(summary(report))
    if options.plot:
        from ..studies.stress.picture import draw

        draw(report, options.plot)
    if report.left_out:
        say(f"finger_sim: {report.left_out} cases left out: out of time")
    if not report.failed:
        return DONE
    console().print("", failures(report), sep="\n")
    for folder in report.written:
        say(f"finger_sim: to see it again: {folder}")
    return FAILED


def _tradeoff(options: argparse.Namespace) -> int:
    if options.for_rate is not None:
        return _for_rate(options)
    from ..console import console, say
    from ..studies.tradeoff.grid import DEFAULT, Grid
    from ..studies.tradeoff.report import summary
    from ..studies.tradeoff.tradeoff import SCENES, Options, tradeoff

    what = Options(
        scenes=[*options.scenes, *options.scene] or SCENES,
        bags=options.bag or [None],
        grid=Grid.load(options.grid) if options.grid else DEFAULT,
        duration=options.duration,
        scheduler=options.scheduler,
        workers=options.workers,
        out=options.out,
    )
    report = tradeoff(what)
    console().print(summary(report.rows))
    console().print("", *(str(path) for path in (report.table, *report.pictures)), sep="\n")
    for failure in report.failed:
        say(f"finger_sim: not run: {failure}")
    return FAILED if report.failed else DONE


def _for_rate(options: argparse.Namespace) -> int:
    from ..console import console, gauge, say
    from ..studies.tradeoff.rate import for_rate
    from ..studies.tradeoff.report import tried, words

    for name in ("grid", "scheduler", "workers"):
        if getattr(options, name) is not None:
            raise FingerSimError(f"--{name}: not allowed with --for-rate")
    scenes = [*options.scenes, *options.scene] or ["finger_haptic"]
    if len(scenes) > 1 or len(options.bag) > 1:
        raise FingerSimError("--for-rate: allowed with one scene and one bag")
    bag = options.bag[0] if options.bag else None
    with gauge(f"{scenes[0]}: settings that hold {options.for_rate:g} Hz on this machine") as meter:
        found = for_rate(scenes[0], options.for_rate, bag, options.duration, options.out, meter)
    console().print(tried(found))
    if found.scene is None:
        say(f"finger_sim: nothing holds {options.for_rate:g} Hz here; the nearest: {words(found.best)}")
        return FAILED
    console().print("", str(found.scene), sep="\n")
    return DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="finger_sim",
        description="A soft finger for haptic loops. SCENE and BAG are files, or names of shipped ones.",
        epilog="example: finger_sim demo",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"finger_sim {_version()}")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)

    _add_demo(verbs)
    _add_run(verbs)
    _add_play(verbs)
    _add_import(verbs)
    info = _verb(verbs, "info", _info, "what a scene, a bag or a mesh holds", "finger_sim info press_slide")
    info.add_argument("what", metavar="SCENE|BAG|MESH", help="file, folder, or name of a shipped one")
    _add_compare(verbs)
    _add_mesh(verbs)
    _add_bench(verbs)
    _add_figures(verbs)
    _add_stress(verbs)
    _add_tradeoff(verbs)
    _verb(
        verbs,
        "node",
        _node,
        "the ROS 2 node in the foreground, as finger_node of `ros2 run`",
        "finger_sim node --ros-args -p scene:=finger -p record:=touch -r command_pose:=/device/pose",
        usage="finger_sim node [-h] [--ros-args …]",
    )
    return parser


def _add_demo(verbs: Any) -> None:
    demo = _verb(
        verbs,
        "demo",
        _demo,
        "the main job: node, commands over ROS 2, recording, picture, table",
        "finger_sim demo --duration 3 --out first_touch",
    )
    add = demo.add_argument
    add("--scene", default="finger_haptic", help="scene to simulate (default: %(default)s)")
    add("--bag", default="press_slide", help="bag of commands (default: %(default)s)")
    add("--topic", help="topic of the commands in the bag")
    add(
        "--rate",
        type=_positive,
        default=1000.0,
        metavar="HZ",
        help="steps a second, instead of the scene's dt (default: %(default)g)",
    )
    add(
        "--priority",
        type=_priority,
        default=20,
        metavar="N",
        help="of the loop's thread under SCHED_FIFO, 1 to 99, where permitted; 0: none (default: %(default)s)",
    )
    add("--duration", type=_positive, metavar="S", help="seconds of the bag (default: all)")
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="new folder for bag, picture and log (default: finger_sim_demo, finger_sim_demo_2 …)",
    )
    add("--strict", action="store_true", help="exit code 1 also where this machine did not hold the rate")


def _add_run(verbs: Any) -> None:
    run = _verb(
        verbs,
        "run",
        _run,
        "a bag through the simulator, without ROS, bit-identical every time",
        "finger_sim run finger --bag press_flat -o pressed",
    )
    add = run.add_argument
    add("scene", metavar="SCENE", help="scene to simulate")
    add("--bag", required=True, metavar="IN", help="bag of commands")
    add("-o", "--out", type=Path, metavar="OUT", help="bag to make (default: IN_SCENE, here)")
    add("--topic", help="topic of the commands in the bag")
    add("--mode", choices=("free", "triggered"), default="free", help="triggered: one step for each command")
    add("--plane-topic", help="topic of the plane's poses in the bag (default: plane_pose, if it is there)")


def _add_play(verbs: Any) -> None:
    play = _verb(
        verbs,
        "play",
        _play,
        "a bag's commands onto a ROS 2 topic in real time",
        "finger_sim play press_slide --to /finger/command_pose",
    )
    add = play.add_argument
    add("bag", metavar="BAG", help="bag of commands")
    add("--topic", help="topic of the commands in the bag")
    add("--to", default="command_pose", metavar="TOPIC", help="topic to send on (default: %(default)s)")
    add("--frame-id", metavar="FRAME", help="frame_id to send (default: the recorded one)")
    add("--speed", type=_positive, default=1.0, metavar="FACTOR", help="2: twice as fast as recorded")
    add("--duration", type=_positive, metavar="S", help="seconds of the bag (default: all)")
    add(
        "--timeout",
        type=_positive,
        default=10.0,
        metavar="S",
        help="how long to wait for a subscriber (default: %(default)g)",
    )


def _add_import(verbs: Any) -> None:
    csv = _verb(
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
        type=_number,
        action="append",
        default=[],
        metavar="COLUMN=VALUE",
        help="one value for every row, present in the file or not; may be repeated",
    )
    add(
        "--offset",
        type=_number,
        action="append",
        default=[],
        metavar="COLUMN=VALUE",
        help="add to a column; may be repeated",
    )
    add(
        "--where",
        type=_text,
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


def _add_compare(verbs: Any) -> None:
    compare = _verb(
        verbs,
        "compare",
        _compare,
        "how two bags differ; exit code 0: equal, 1: not, 2: a mistake",
        "finger_sim compare before after --topic contact_wrench --tolerance 0.01 --overlap",
    )
    add = compare.add_argument
    add("a", metavar="A", help="bag")
    add("b", metavar="B", help="bag to compare with it, at the same log times")
    add("--topic", action="append", help="topic to compare; may be repeated (default: all of either)")
    add(
        "--tolerance",
        type=_tolerance,
        metavar="X",
        help="largest difference of wrenches, poses, clouds and meshes that is equal, in N, N·m, m, rad; "
        "other topics do not count then (default: all the same, bit by bit)",
    )
    add("--overlap", action="store_true", help="with --tolerance: count only times that both bags hold")
    add("--json", action="store_true", help="JSON instead of a table")


def _add_mesh(verbs: Any) -> None:
    mesh = _verb(verbs, "mesh", None, "make a mesh of a finger or a beam", "finger_sim mesh beam -o beam.vtu")
    kinds = mesh.add_subparsers(title="kinds", metavar="finger|beam", required=True)
    finger = _verb(
        kinds,
        "finger",
        _mesh,
        "a finger with its bones (needs the extra [mesh])",
        "finger_sim mesh finger -o fine.vtu --tets 2000",
    )
    finger.add_argument("--tets", type=int, metavar="N", help="about so many tetrahedra (default: 347)")
    beam = _verb(
        kinds,
        "beam",
        _mesh,
        "a box of bricks, five tetrahedra each",
        "finger_sim mesh beam -o beam.vtu --size 1 0.2 0.2 --cells 10 2 2",
    )
    beam.add_argument("--size", type=float, nargs=3, metavar=("X", "Y", "Z"), help="edges [m] (default: 1 0.2 0.2)")
    beam.add_argument("--cells", type=int, nargs=3, metavar=("X", "Y", "Z"), help="bricks (default: 10 2 2)")
    for kind, name in ((finger, "finger"), (beam, "beam")):
        kind.set_defaults(kind=name)
        kind.add_argument("-o", "--out", type=Path, required=True, metavar="FILE.vtu", help="file to make")
        kind.add_argument("--force", action="store_true", help="overwrite the file")


def _add_bench(verbs: Any) -> None:
    bench = _verb(
        verbs,
        "bench",
        _bench,
        "times a step, beside its errors, MuJoCo and Drake (needs the extra [peers] for these two)",
        "finger_sim bench --sizes 350 2000 --repeats 5 --json bench.json --plot bench.png",
    )
    add = bench.add_argument
    add("--quick", action="store_true", help="350 tetrahedra, one repetition, no start-up: half a minute")
    add("--sizes", type=int, nargs="+", metavar="N", help="tetrahedra (default: 350 2000 10000)")
    add("--repeats", type=int, metavar="N", help="repetitions after a warm-up (default: 3)")
    add("--steps", type=_positive, metavar="SHARE", help="share of the steps to run, the way down apart (default: 1)")
    add("--cpu", type=int, metavar="K", help="processor to run on (default: the last allowed one)")
    add("--peers", action=argparse.BooleanOptionalAction, help="run MuJoCo and Drake (default: where installed)")
    add("--startup", action=argparse.BooleanOptionalAction, help="time cold and cached starts (default: yes)")
    add("--json", type=Path, metavar="FILE", help="write everything as JSON")
    add("--plot", type=Path, metavar="FILE.png", help="draw step times")


def _add_figures(verbs: Any) -> None:
    figures = _verb(
        verbs,
        "figures",
        _figures,
        "the paper's experiments, measured and drawn: a PNG and a JSON each",
        "finger_sim figures --only beams standing --out figures",
    )
    names = ("beams", "finger", "standing", "isotropy", "locking", "speed")
    figures.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=f"of: {', '.join(names)}")
    figures.add_argument(
        "--out",
        type=Path,
        default=Path("figures"),
        metavar="DIR",
        help="folder for what is made (default: %(default)s)",
    )


def _add_stress(verbs: Any) -> None:
    stress = _verb(
        verbs,
        "stress",
        _stress,
        "extreme and random scenes and motions: none may end in NaN, a crash, or wrong without a word",
        "finger_sim stress --cases 1000 --seed 7 --minutes 10 --out failed",
    )
    add = stress.add_argument
    add(
        "--cases", type=_count, default=200, metavar="N", help="random cases, after the directed (default: %(default)s)"
    )
    add("--seed", type=_count, default=0, metavar="S", help="of the random cases (default: %(default)s)")
    add("--minutes", type=_positive, metavar="M", help="begin no further case after that (default: run them all)")
    add("--long", action="store_true", help="a million steps of press and slide too: some minutes")
    add(
        "--out",
        type=Path,
        default=Path("stress_failed"),
        metavar="DIR",
        help="folder for what repeats a case that failed (default: %(default)s)",
    )
    add("--plot", type=Path, metavar="FILE.png", help="draw how the cases ended")


def _add_tradeoff(verbs: Any) -> None:
    tradeoff = _verb(
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
    add("--duration", type=_positive, metavar="S", help="seconds of the commands (default: all)")
    add(
        "--grid",
        type=Path,
        metavar="FILE",
        help="YAML of what to change: `base`: {KEY: VALUE} in all points, `sweeps`: {KEY: [VALUE, …]} one at a time, "
        "`product`: {KEY: [VALUE, …]} all combinations, `points`: [{KEY: VALUE, …}, …]; keys are dotted",
    )
    add("--scheduler", metavar="ADDRESS", help="a Dask scheduler, tcp://HOST:PORT (default: own processes here)")
    add("--workers", type=_one_or_more, metavar="N", help="own processes (default: one for each processor)")
    add(
        "--for-rate",
        type=_positive,
        metavar="HZ",
        help="instead of the study: find the most accurate settings that hold HZ here, and write them as a scene",
    )
    add(
        "--out",
        type=Path,
        default=Path("tradeoff"),
        metavar="DIR",
        help="folder for table, pictures and finished runs, which are not made again (default: %(default)s)",
    )


def _verb(
    verbs: Any,
    name: str,
    work: Callable[[argparse.Namespace], int] | None,
    what: str,
    example: str,
    usage: str | None = None,
) -> argparse.ArgumentParser:
    """A subcommand, with what it does and an example in its help."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        usage=usage,
        help=what,
        description=f"{what[0].upper()}{what[1:]}.",
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if work is not None:
        parser.set_defaults(verb=work)
    return parser


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a finite number > 0")
    return value


def _tolerance(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a finite number >= 0")
    return value


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 0 on")
    return int(text)


def _one_or_more(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 1 on")
    return int(text)


def _priority(text: str) -> int:
    if not (text.isdecimal() and int(text) < 100):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 0 to 99")
    return int(text)


def _text(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: COLUMN=VALUE")
    return name.strip(), value.strip()


def _number(text: str) -> tuple[str, float]:
    name, value = _text(text)
    try:
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{name}: got {value!r}, allowed: a number") from None


def _version() -> str:
    try:
        return version("finger_sim")
    except PackageNotFoundError:
        return "of a checkout that is not installed"


if __name__ == "__main__":
    sys.exit(main())

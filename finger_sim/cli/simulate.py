"""Verbs that simulate or feed a simulation: demo, run, play, node, params."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..ros.options import NodeOptions
from .common import DONE, FAILED, from_zero, positive, priority, verb

if TYPE_CHECKING:
    from ..simulation.summary import Summary


def add_demo(verbs: Any) -> None:
    demo = verb(
        verbs,
        "demo",
        _demo,
        "the main job: node, commands over ROS 2, recording, picture, table",
        "finger_sim demo --duration 3 --out first_touch",
        more="Node and commands meet in a ROS domain of their own: a free one, on this machine\n"
        "only. ROS_DOMAIN_ID is not looked at, and no other node is met or disturbed.",
    )
    add = demo.add_argument
    add("--scene", default="finger_haptic", help="scene to simulate (default: %(default)s)")
    add("--bag", default="press_slide", help="bag of commands (default: %(default)s)")
    add("--topic", help="topic of the commands in the bag")
    add(
        "--rate",
        type=positive,
        default=1000.0,
        metavar="HZ",
        help="steps a second, instead of the scene's dt (default: %(default)g)",
    )
    add(
        "--priority",
        type=priority,
        default=20,
        metavar="N",
        help="of the loop's thread under SCHED_FIFO, 1 to 99, where permitted; 0: none (default: %(default)s)",
    )
    add("--duration", type=positive, metavar="S", help="seconds of the bag (default: all)")
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="new folder for bag, picture and log (default: finger_sim_demo, finger_sim_demo_2 …)",
    )
    add("--view", action="store_true", help="show it live on a page in the browser")
    add("--strict", action="store_true", help="exit code 1 also where this machine did not hold the rate")


def _demo(options: argparse.Namespace) -> int:
    from ..console import say, show
    from ..ros.demo import DemoError, run_demo

    try:
        outcome = run_demo(
            options.scene, options.bag, options.out,
            rate=options.rate, priority=options.priority, duration=options.duration, topic=options.topic,
            page=options.view,
        )  # fmt: skip
    except DemoError as error:
        say(f"finger_sim: the demo failed: {error}")
        return FAILED
    show(outcome.table())
    for shortfall in outcome.shortfalls:
        say(f"finger_sim: not held by this machine: {shortfall}")
    for advice in outcome.advice:
        say(f"finger_sim: advice: {advice}")
    for failure in outcome.failures:
        say(f"finger_sim: the demo failed: {failure}")
    failed = outcome.failures or (options.strict and outcome.shortfalls)
    return FAILED if failed else DONE


ALLOW_GAPS = "take also what has gaps of more than ten minutes between two messages"


def add_run(verbs: Any) -> None:
    run = verb(
        verbs,
        "run",
        _run,
        "a bag through the simulator, without ROS, bit-identical every time",
        "finger_sim run finger --bag press_flat -o pressed",
    )
    add = run.add_argument
    add(
        "scene",
        metavar="SCENE",
        nargs="?",
        help="scene to simulate (default: what IN was recorded with, and all that was changed live)",
    )
    add("--bag", required=True, metavar="IN", help="bag of commands")
    add("-o", "--out", type=Path, metavar="OUT", help="bag to make (default: IN_SCENE or IN_again, here)")
    add("--topic", help="topic of the commands in the bag")
    add(
        "--mode",
        choices=("free", "triggered", "recorded"),
        help="free: steps on a clock; triggered: one for each command; recorded: those that the node made, late and "
        "skipped ones too (default: as IN was made; with SCENE: free)",
    )
    add("--plane-topic", help="topic of the plane's poses in the bag (default: plane_pose, if it is there)")
    add(
        "--start",
        type=from_zero,
        default=0.0,
        metavar="S",
        help="seconds from the first command on to leave out; the newest command by then places the finger at rest "
        "there, and the newest pose of the plane holds (default: none)",
    )
    add(
        "--duration",
        type=positive,
        metavar="S",
        help="seconds of the bag from there on: the last step follows the last command or pose of the plane in them "
        "(default: to the end)",
    )
    add("--allow-gaps", action="store_true", help=ALLOW_GAPS)


SET_DOWN = "put on the plane above, from there in 0.1 s"
"""What is said of a finger whose first command is inside the plane."""


def _run(options: argparse.Namespace) -> int:
    from ..bags.reader import require_absent
    from ..console import gauge, say, show, table
    from ..scene import Scene
    from ..scene.resources import find_bag, find_scene
    from ..simulation.replay import Replay, Selection
    from ..simulation.simulator import Simulator

    scene = None if options.scene is None else Scene.load(options.scene)
    bag, name = find_bag(options.bag), "again" if options.scene is None else find_scene(options.scene).stem
    out = options.out or Path(f"{bag.stem}_{name}")
    require_absent(out)
    selection = Selection(
        options.topic, options.plane_topic, options.mode, options.start, options.duration, options.allow_gaps
    )
    replay = Replay(scene, bag, selection)  # a mistake shows before kernels compile
    for warning in replay.warnings:
        say(f"finger_sim: warning: {warning}")
    simulator = Simulator(replay.scene, progress=say)
    for note in simulator.mesh.notes:
        say(f"finger_sim: warning: {replay.scene.mesh.file}: {note}")
    try:
        with gauge(f"simulating {bag}") as meter:
            done = replay.run(out, meter, simulator=simulator)
    finally:
        if replay.remains:
            say(f"finger_sim: {replay.remains}")
    if done.warning:
        say(f"finger_sim: warning: {done.warning}")
    plane = f"{done.plane_poses} poses on {done.plane_topic}, {_refused(done.plane_refused, done.plane_refusal)}"
    moved = [("plane", plane)] if done.plane_topic else []
    status = ", ".join(f"{name} in {steps} steps" for name, steps in done.status.items())
    rows = table()
    for row in (
        ("commands", f"{done.commands} on {done.topic}, {_refused(done.refused, done.refusal)}"),
        *moved,
        *_recorded(done),
        *([("start", f"{1e3 * done.set_down_by:.2f} mm inside the plane: {SET_DOWN}")] if done.set_down_by else []),
        ("simulated", f"{done.duration:.3f} s in {done.steps} steps"),
        *([("passed over", f"{done.passed_over:.3f} s at rest, in long gaps")] if done.passed_over else []),
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
    show(rows)
    return DONE


def _refused(count: int, first: str | None) -> str:
    """How many messages were, and why the first."""
    return f"{count} refused" + (f"; {first}" if count and first else "")


def _recorded(done: Summary) -> list[tuple[str, str]]:
    """What a run took of what its bag was recorded with, and what not."""
    if done.differences is None:
        return []
    if done.as_recorded:
        rows = [("scene", f"as recorded, {done.live_changes} live changes made again")]
    else:
        rows = [("scene", "as given, " + ("other than" if done.differences else "the same as") + " the recorded one")]
    rows += [("differs", difference) for difference in done.differences]
    if done.left_out:
        rows.append(("left out", f"{done.left_out} live changes of the recording, as a scene was given"))
    if done.resets:
        rows.append(("resets", f"{done.resets} of the recording, made again"))
    return rows


def add_play(verbs: Any) -> None:
    play = verb(
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
    add("--speed", type=positive, default=1.0, metavar="FACTOR", help="2: twice as fast as recorded")
    add(
        "--start",
        type=from_zero,
        default=0.0,
        metavar="S",
        help="seconds from the first command on to leave out; the newest command by then is sent first (default: none)",
    )
    add("--duration", type=positive, metavar="S", help="seconds of the bag from there on (default: to the end)")
    add("--allow-gaps", action="store_true", help=ALLOW_GAPS)
    add(
        "--timeout",
        type=positive,
        default=10.0,
        metavar="S",
        help="how long to wait for a subscriber (default: %(default)g)",
    )


def _play(options: argparse.Namespace) -> int:
    from ..bags.gaps import require_allowed, told
    from ..bags.reader import read_commands
    from ..console import gauge, say
    from ..ros.demo import require_ros
    from ..scene.resources import find_bag

    path = find_bag(options.bag)
    recorded = read_commands(path, options.topic, allow_gaps=True)
    commands = recorded.window(options.start, options.duration)
    if not options.allow_gaps:
        require_allowed(path, commands.gaps, (recorded.start, commands.start))
    if commands.gaps:
        say(f"finger_sim: warning: {path}: {told(commands.gaps)}: nothing is sent for so long")
    if commands.refused:
        say(f"finger_sim: warning: {path}: {_refused(commands.refused, commands.refusal)}: not sent")
    require_ros()
    from ..ros.play import play, ros_node

    with ros_node("finger_sim_play") as node, gauge(f"playing {commands.topic}") as meter:
        played = play(
            node, commands, topic=options.to, frame_id=options.frame_id, speed=options.speed,
            timeout=options.timeout, progress=meter,
        )  # fmt: skip
    print(
        f"{played.sent} commands on {played.topic} in {played.duration / options.speed:.3f} s, "
        f"late by {1e3 * played.late_median:.3f} ms (median), {1e3 * played.late_p99:.3f} ms (p99), "
        f"{1e3 * played.late_max:.3f} ms (most)"
    )
    return DONE


def add_node(verbs: Any) -> None:
    verb(
        verbs,
        "node",
        _node,
        "the ROS 2 node in the foreground, as finger_node of `ros2 run`",
        "finger_sim node --ros-args -p scene:=finger -p record:=touch -r command_pose:=/device/pose",
        more="Its loop gets priority 20 of SCHED_FIFO where the system permits it, none with\n"
        "-p realtime_priority:=0. Its log says which it has, and how to permit it.",
        usage="finger_sim node [-h] [--ros-args …]",
    )


def _node(options: argparse.Namespace) -> int:
    from ..ros.demo import require_ros

    require_ros()
    from ..ros.node import main as run_node

    return run_node(options.ros)


def add_params(verbs: Any) -> None:
    params = verb(
        verbs,
        "params",
        _params,
        "all parameters of the node for a scene, as a commented file for --params-file",
        "finger_sim params finger_coupled > finger.yaml\n  finger_sim node --ros-args --params-file finger.yaml",
    )
    params.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        default=NodeOptions.scene,
        help="whose values stand in the file (default: %(default)s)",
    )


def _params(options: argparse.Namespace) -> int:
    from ..ros.params_file import params_file

    print(params_file(options.scene), end="")
    return DONE

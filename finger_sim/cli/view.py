"""The verb view: a page that shows a node or a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .common import DONE, verb

if TYPE_CHECKING:
    from ..view.hub import Source


def add_view(verbs: Any) -> None:
    view = verb(
        verbs,
        "view",
        _view,
        "a page in the browser: see the finger, hold it, play a recording",
        "finger_sim view --scene finger_coupled",
        more="Without BAG it starts the node in a free ROS domain, or joins one that runs (--join, in\n"
        "the domain of ROS_DOMAIN_ID). Ctrl-C ends the page, and the node that it started.",
    )
    add = view.add_argument
    add("bag", metavar="BAG", nargs="?", help="recording to play; needs no ROS")
    add("--scene", help="scene to simulate (default: finger_haptic)")
    add("--join", action="store_true", help="show a node that runs already")
    add("--node", metavar="NAME", help="of the node to join, with its namespace (default: /finger)")
    add("--watch", action="store_true", help="only show: the page neither holds the finger nor changes anything")
    add("--port", type=_port, default=8470, metavar="N", help="0: any free one (default: %(default)s)")
    add("--address", default="127.0.0.1", metavar="IP", help="to serve at; any but this machine's own needs a token")
    add("--no-browser", action="store_true", help="do not open the page")
    add("--out", type=Path, metavar="DIR", help="folder for recordings (default: here)")


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: a whole number from 0 to 65535")
    return int(text)


def _view(options: argparse.Namespace) -> int:
    import asyncio

    from ..console import say
    from ..ros.demo import require_websockets

    _refuse_what_does_not_fit(options)
    require_websockets()
    from ..view.browser import open_page
    from ..view.files import Recordings
    from ..view.guard import Guard
    from ..view.server import serve

    guard, recordings = Guard(options.address), Recordings()
    source = _source(options, guard, recordings)

    def ready(url: str) -> None:
        print(url, flush=True)
        if guard.token is not None:
            say("whoever knows this address, and reaches it, holds the finger; it is sent unencrypted")
        if not options.no_browser and not open_page(url):
            say("open this address in a browser")

    asyncio.run(serve(source, guard, recordings, options.address, options.port, ready))
    return DONE


def _source(options: argparse.Namespace, guard: Any, recordings: Any) -> Source:
    from ..console import say

    if options.bag is not None:
        from ..console import gauge
        from ..scene.resources import find_bag
        from ..view.playback import Playback
        from ..view.recording import Recording

        path = find_bag(options.bag)
        with gauge(f"reading {path}") as meter:
            recording = Recording(path, meter)
        for note in recording.notes:
            say(f"finger_sim: warning: {path}: {note}")
        return Playback(recording)
    from ..ros.demo import require_ros

    require_ros()
    from ..view.live import LiveSource
    from ..view.session import NODE, OthersNode, OwnNode, Session

    session: Session
    if options.join:
        session = OthersNode(options.node or NODE)
        say(f"joining {session.name}")
    else:
        session = OwnNode(options.scene or "finger_haptic", _folder(options.out or Path()))
        say(f"starting the node (ROS_DOMAIN_ID {session.domain})")
    return LiveSource(session, guard, recordings, options.watch)


def _folder(out: Path) -> Path:
    """Makes the folder where there is none. Raises FingerSimError where it cannot be had."""
    from ..errors import FingerSimError

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FingerSimError(f"--out: {out}: cannot be made: {error.strerror}") from None
    return out


def _refuse_what_does_not_fit(options: argparse.Namespace) -> None:
    """Raises FingerSimError for options that mean nothing together."""
    from ..errors import FingerSimError

    given = {
        "--scene": options.scene, "--join": options.join, "--node": options.node, "--watch": options.watch,
        "--out": options.out,
    }  # fmt: skip
    pairs = [
        ("BAG", options.bag, tuple(given)),
        ("--join", options.join, ("--scene", "--out")),
    ]
    for name, value, others in pairs:
        for other in others:
            if value and given[other]:
                raise FingerSimError(f"{other}: goes not with {name}")
    if options.node and not options.join:
        raise FingerSimError("--node: goes only with --join")

"""`finger_sim <verb>`: reads the command line; each verb's work lives elsewhere, imported when asked for."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version

from ..errors import FingerSimError
from ..plain import printing
from . import fit, meshes, recordings, simulate, studies, view
from .common import INTERRUPTED, MISTAKE
from .signals import Terminated, unwinding


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one verb. 0: the job was done, 1: a part of it failed, 2: a user's mistake, 130: interrupted.

    Output that cannot be written, as on a full disk, is a part that failed; a reader that has gone, as `head` does,
    and streams that are closed change nothing.
    Raises SystemExit with 143 on SIGTERM, once what the verb had begun is finished or removed.
    """
    return printing("finger_sim", lambda: _main(arguments))


def _main(arguments: Sequence[str] | None) -> int:
    given = list(sys.argv[1:] if arguments is None else arguments)
    own = given.index("--ros-args") if given[:1] == ["node"] and "--ros-args" in given else len(given)
    try:
        options = _parser().parse_args(given[:own], argparse.Namespace(given=given, ros=given[own:]))
        verb: Callable[[argparse.Namespace], int] = options.verb
        with unwinding():
            return verb(options)
    except FingerSimError as error:
        print(f"finger_sim: error: {error}", file=sys.stderr)
        return MISTAKE
    except Terminated:
        print("finger_sim: terminated", file=sys.stderr)
        raise
    except KeyboardInterrupt:
        print("finger_sim: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="finger_sim",
        description="A soft finger for haptic loops. SCENE and BAG are files, or names of shipped ones.",
        epilog="example: finger_sim demo",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"finger_sim {_version()}")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)

    simulate.add_demo(verbs)
    simulate.add_run(verbs)
    simulate.add_play(verbs)
    view.add_view(verbs)
    recordings.add_import(verbs)
    recordings.add_info(verbs)
    recordings.add_compare(verbs)
    meshes.add_mesh(verbs)
    fit.add_fit(verbs)
    studies.add_bench(verbs)
    studies.add_figures(verbs)
    studies.add_stress(verbs)
    studies.add_tradeoff(verbs)
    simulate.add_node(verbs)
    simulate.add_params(verbs)
    return parser


def _version() -> str:
    try:
        return version("finger_sim")
    except PackageNotFoundError:
        return "of a checkout that is not installed"


if __name__ == "__main__":
    sys.exit(main())

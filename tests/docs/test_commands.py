"""Blocks of README and docs/ that are marked as runnable run, in the order of their page, in a folder of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from docs.markdown import PAGES, ROOT_TEXTS, Block, blocks, marks
from domains import DOMAINS
from processes import REPOSITORY

TIMEOUT = 300.0
"""How long a block may take [s]: a few seconds, but for the first one that compiles kernels on a busy machine."""
SLOW_TIMEOUT = 1500.0
"""The same of a slow one: minutes, and more where two others have the processors."""
TEXTS = [*ROOT_TEXTS, *PAGES]
IN_CHECKOUT = ("examples", "benchmarks", "tests", "config", "pyproject.toml")
"""What commands name from the root of the checkout. Not the package, which would be imported without its data."""


def pages(slow: bool) -> list[Path]:
    return [path for path in TEXTS if any(block.slow == slow for block in blocks(path))]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder in which the checkout's files are found and nothing of it is written."""
    for name in IN_CHECKOUT:
        (tmp_path / name).symlink_to(REPOSITORY / name)
    return tmp_path


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_every_mark_stands_before_a_block(path: Path) -> None:
    """A mistyped mark, or one with a line between it and its block, would be passed over without a word."""
    assert len(blocks(path)) == marks(path)


IN_ALL_RUNS = ("README.md", "CONTRIBUTING.md", "api.md")
"""Pages whose blocks run in every run of the tests; those of others in the slow one."""


def test_pages_have_blocks_that_run() -> None:
    """The marks are found at all."""
    assert len(pages(slow=False)) >= 5


@pytest.mark.timeout(2 * TIMEOUT)
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[] if path.name in IN_ALL_RUNS else pytest.mark.slow) for path in pages(slow=False)],
    ids=lambda path: path.name,
)
def test_commands_run(path: Path, checkout: Path) -> None:
    """Those of a page one after the other: later ones may use what earlier ones made."""
    for block in blocks(path):
        if not block.slow:
            run(block, checkout)


@pytest.mark.slow
@pytest.mark.timeout(3 * SLOW_TIMEOUT)
@pytest.mark.parametrize("path", pages(slow=True), ids=lambda path: path.name)
def test_slow_commands_run(path: Path, checkout: Path) -> None:
    """Those of a page that take minutes."""
    for block in blocks(path):
        if block.slow:
            run(block, checkout)


def run(block: Block, folder: Path) -> None:
    """Runs a block as a user does in an activated environment, in a ROS domain of its own."""
    program = [sys.executable, "-c"] if block.language == "python" else ["bash", "-euo", "pipefail", "-c"]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    changes = {"PATH": path, "PYTHONPATH": str(REPOSITORY), "ROS_DOMAIN_ID": str(next(DOMAINS))}
    with (folder / "said").open("w+") as said:
        process = subprocess.Popen(
            [*program, block.code],
            cwd=folder,
            env=os.environ | changes,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            if block.until:
                interrupt_once_said(process, folder / "said", block.until)
            process.wait(SLOW_TIMEOUT if block.slow else TIMEOUT)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    text = (folder / "said").read_text(encoding="utf-8", errors="replace")
    if block.fails:
        assert process.returncode != 0, text
        assert block.fails in text, text
    else:
        assert process.returncode == 0, f"{block.code}\n{text}"


def interrupt_once_said(process: subprocess.Popen[bytes], said: Path, text: str) -> None:
    """Ctrl-C once it has printed the text."""
    end = time.monotonic() + TIMEOUT
    while text not in said.read_text(encoding="utf-8", errors="replace"):
        assert process.poll() is None, said.read_text(encoding="utf-8", errors="replace")
        assert time.monotonic() < end, said.read_text(encoding="utf-8", errors="replace")
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)

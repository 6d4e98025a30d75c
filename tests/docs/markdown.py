"""Markdown as the tests of the documentation look at it: links, anchors, and blocks that are to be run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from processes import REPOSITORY

DOCS = REPOSITORY / "docs"
PAGES = sorted(DOCS.glob("*.md"))
ROOT_TEXTS = [REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]

_FENCE = re.compile(r"^([ \t]*)(`{3,})(\w*).*?\n(.*?)^\1\2[ \t]*$", re.MULTILINE | re.DOTALL)
_MARKED = re.compile(
    r"^<!-- run(?P<slow> slow)?(?:(?P<kind> until| fails): (?P<text>.+?))? -->\n"
    r"```(?P<language>\w+)\n(?P<code>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)


class Block(NamedTuple):
    """A block that is marked to be run.

    `<!-- run -->` right before it: it is run, and its exit code is 0. `run slow`: among the tests marked slow.
    `run until: TEXT`: it is interrupted once it has printed that. `run fails: TEXT`: it prints that, and fails.
    """

    language: str
    code: str
    slow: bool
    until: str
    fails: str


def blocks(path: Path) -> list[Block]:
    """The marked blocks of a page, in their order."""
    found = []
    for match in _MARKED.finditer(path.read_text(encoding="utf-8")):
        kind, text = (match["kind"] or "").strip(), match["text"] or ""
        until, fails = text if kind == "until" else "", text if kind == "fails" else ""
        found.append(Block(match["language"], match["code"], match["slow"] is not None, until, fails))
    return found


def marks(path: Path) -> int:
    """How many comments begin with `run`: as many as `blocks` finds, or one of them is mistyped."""
    return len(re.findall(r"^\s*<!--\s*run", path.read_text(encoding="utf-8"), re.MULTILINE))


def prose(path: Path) -> str:
    """A text without its blocks of code."""
    return _FENCE.sub("", path.read_text(encoding="utf-8"))


def links(path: Path) -> list[str]:
    """Targets of all links and pictures of a text."""
    return re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", prose(path)))


def anchors(path: Path) -> set[str]:
    """What `#…` of a link to this text may name: its headings, as GitHub and MkDocs write them."""
    names = set()
    for heading in re.findall(r"^#+ +(.+?) *$", prose(path), re.MULTILINE):
        plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        names.add(re.sub(r"[ ]", "-", re.sub(r"[^\w\- ]", "", plain.lower())))
    return names

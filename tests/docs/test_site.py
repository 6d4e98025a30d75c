"""The site builds without a warning, has all pages and tables, and loads nothing from another host."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from docs.markdown import PAGES
from processes import REPOSITORY

from finger_sim.ros.options import NodeOptions
from finger_sim.scene import Scene
from finger_sim.scene.reference import dotted

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mkdocs") is None or importlib.util.find_spec("mkdocstrings") is None,
    reason="needs the extra [docs]; .ci/run builds the site with it",
)

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "object": "data"}
"""What a browser loads by itself, by tag; of <link> all but those that only name a place."""
NAMES_ONLY = {"canonical", "prev", "next", "alternate"}


class Loads(HTMLParser):
    """What a page loads, its text and its pictures."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "link" and not set((given.get("rel") or "").split()) & NAMES_ONLY:
            self.loads.append(given.get("href") or "")
        elif tag in LOADED and given.get(LOADED[tag]):
            self.loads.append(given[LOADED[tag]] or "")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as CI builds it."""
    folder = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=REPOSITORY,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def page(site: Path, name: str) -> str:
    return (site / name / "index.html" if name != "index" else site / "index.html").read_text(encoding="utf-8")


def test_every_page_is_built_and_in_the_navigation(site: Path) -> None:
    """Of the files in docs/, also one that only another branch has."""
    for path in PAGES:
        html = page(site, path.stem)
        assert "<h1" in html, path.name
        assert path.stem == "index" or f'href="{path.stem}/"' in page(site, "index"), path.name


def test_nothing_is_loaded_from_another_host(site: Path) -> None:
    """Fonts, scripts, styles and pictures lie in the site itself; all of them are there."""
    for html in site.rglob("*.html"):
        for link in Loads(html.read_text(encoding="utf-8")).loads:
            assert not re.match(r"(?:\w+:)?//", link), f"{html}: {link}"
            if html.name != "404.html" and not link.startswith("data:"):
                assert (html.parent / link.partition("?")[0].partition("#")[0]).exists(), f"{html}: {link}"
    for css in site.rglob("*.css"):
        text = css.read_text(encoding="utf-8")
        assert not re.search(r"(?:url\(|@import)\s*[\"']?(?:\w+:)?//", text), css


def test_every_parameter_is_in_the_built_tables(site: Path) -> None:
    """The tables are made of the fields when the site is built."""
    html = page(site, "scenes")
    for part in (Scene, NodeOptions):
        for name, _, _ in dotted(part):
            assert f"<td><code>{name}</code></td>" in html, name


def test_equations_are_drawn_without_scripts(site: Path) -> None:
    """As MathML, none of which is left as text."""
    html = page(site, "model")
    assert html.count("<math ") > 10
    assert "\\frac" not in html
    assert "```" not in html

"""README and the pages of docs/: links lead somewhere, pictures exist, and parameters are told as the code has them."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from docs.markdown import DOCS, PAGES, ROOT_TEXTS, anchors, links, prose
from processes import REPOSITORY

from finger_sim.ros.options import NodeOptions
from finger_sim.scene import Scene
from finger_sim.scene.reference import dotted, rows

README = REPOSITORY / "README.md"
TEXTS = [*ROOT_TEXTS, *PAGES, REPOSITORY / "benchmarks" / "README.md", REPOSITORY / "bags" / "README.md"]


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    """docs/hooks.py, as MkDocs loads it."""
    spec = importlib.util.spec_from_file_location("documentation_hooks", DOCS / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_links_lead_somewhere(path: Path) -> None:
    """To a file that exists, and to a heading that it has; pictures are links too."""
    for link in links(path):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        target, _, anchor = link.partition("#")
        file = (path.parent / target).resolve() if target else path
        assert file.exists(), link
        if anchor:
            assert anchor in anchors(file), link


def test_readme_is_short_and_has_its_test_command() -> None:
    """CI reads the line after the marker's fence; the command installs what tests need, and runs them."""
    lines = README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 160
    fence, command = lines[lines.index("<!-- test command -->") + 1 :][:2]
    assert fence == "```sh"
    assert command.startswith("python3 -m venv .venv && .venv/bin/pip install -q -e '.[")
    assert command.endswith(" .venv/bin/python -m pytest")
    named = set(re.findall(r"\w+", command.split("'")[1]))
    assert {"ros", "mesh", "test"} <= named


def test_readme_links_every_page() -> None:
    """No page of the navigation is only found by who builds the site; the changes are at the root."""
    navigation = yaml.safe_load(re.sub(r"!!python/name:\S+", "''", (REPOSITORY / "mkdocs.yml").read_text()))["nav"]
    pages = {f"docs/{page}" for entry in navigation for page in entry.values()}
    at_root = {"docs/changes.md": "CHANGELOG.md", "docs/contributing.md": "CONTRIBUTING.md"}
    assert {at_root.get(page, page) for page in pages} <= {link.partition("#")[0] for link in links(README)}


@pytest.mark.parametrize("part", [Scene, NodeOptions])
def test_tables_list_every_parameter_with_its_facts(part: type, hooks: ModuleType) -> None:
    """Name, default, allowed values, *live* and meaning of each, in the code's order: no other rows, none left out."""
    name = {Scene: "scene", NodeOptions: "node"}[part]
    page = hooks.with_tables((DOCS / "scenes.md").read_text(encoding="utf-8"))
    wanted = list(rows(part))
    lines = next(text for text in re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE) if wanted[0] in text).splitlines()
    assert f"<!-- parameters: {name} -->" not in page
    assert [line[: len(row)] for line, row in zip(lines[2:], wanted, strict=True)] == wanted
    for line, (_, spec, _) in zip(lines[2:], dotted(part), strict=True):
        assert line.count("|") == 6, "a cell breaks the table"
        assert line.lower().endswith(f" {spec.doc} |".lower())


def test_parameters_that_texts_name_exist() -> None:
    """`solver.…` and the like in running text are keys; one that was renamed is found here."""
    keys = {name for name, _, _ in dotted(Scene)}
    blocks = {key.rpartition(".")[0] for key in keys} - {""}
    for path in (README, *PAGES):
        for name in re.findall(r"`([a-z_]+(?:\.[a-z_]+)+)(?::[^`]*)?`", prose(path)):
            if name.rpartition(".")[0] in blocks:
                assert name in keys | blocks, f"{path.name}: {name}"


def test_files_that_texts_name_exist() -> None:
    """Of the checkout: `python benchmarks/….py`, `pytest tests/…`, `examples/….py`, and modules of the package."""
    for path in (README, *PAGES, REPOSITORY / "CONTRIBUTING.md", REPOSITORY / "benchmarks" / "README.md"):
        text = path.read_text(encoding="utf-8")
        for name in re.findall(r"\b(?:benchmarks|examples|tests|config)/[\w/]+\.(?:py|yaml|png|vtu)\b", text):
            assert (REPOSITORY / name).exists(), f"{path.name}: {name}"
        for name in re.findall(r"`((?:scene|physics|simulation|haptics|bags|ros|pictures|cli)/\w+\.py)`", text):
            assert (REPOSITORY / "finger_sim" / name).exists(), f"{path.name}: {name}"
        for name in re.findall(r"python -m (finger_sim[\w.]*)", text):
            assert importlib.util.find_spec(name) is not None, f"{path.name}: {name}"


def test_versions_and_names_agree() -> None:
    """pyproject.toml, package.xml and CITATION.cff are of one version and one licence."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    assert f"<version>{project['version']}</version>" in (REPOSITORY / "package.xml").read_text()
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert citation["cff-version"] == "1.2.0"


def test_no_build_is_kept() -> None:
    """The built site is no part of the repository."""
    done = subprocess.run(["git", "ls-files", "site"], cwd=REPOSITORY, capture_output=True, text=True)
    assert done.stdout == ""

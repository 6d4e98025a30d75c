"""What MkDocs does beyond Markdown when it builds these pages: `hooks` in mkdocs.yml.

Tables of parameters come from the fields, equations become MathML, pictures come from config/pictures, and texts at the
root of the repository (CHANGELOG.md) become pages. The tables are made without MkDocs, so that a test can look at them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from finger_sim.ros.device import Clutch, CommandInput, DeviceFrame, DeviceOutput
from finger_sim.ros.options import NodeOptions
from finger_sim.scene import Scene
from finger_sim.scene.reference import dotted, rows

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
PICTURES = "../config/pictures/"
"""How pages name the folder of pictures, so that links also work where Markdown is read as it lies here."""
VIEW = "view.md"
"""A page that comes after the first one, where it exists."""
PARTS = {
    "scene": Scene, "node": NodeOptions, "command_input": CommandInput, "device_frame": DeviceFrame, "clutch": Clutch,
    "device_output": DeviceOutput,
}  # fmt: skip
"""What the tables of parameters tell of."""


def parameter_table(part: type) -> str:
    """The Markdown table of all parameters of a part, as its fields have them."""
    head = ["| parameter | default | allowed | | meaning |", "|---|---|---|---|---|"]
    meanings = [spec.doc for _, spec, _ in dotted(part)]
    lines = [f"{row} {text[:1].upper()}{text[1:]} |" for row, text in zip(rows(part), meanings, strict=True)]
    return "\n".join(head + lines)


def with_tables(markdown: str) -> str:
    """A page with `<!-- parameters: scene -->` and those of other PARTS replaced."""
    return re.sub(r"<!-- parameters: (\w+) -->", lambda m: parameter_table(PARTS[m[1]]), markdown)


def with_texts(markdown: str) -> str:
    """A page with `<!-- text: CHANGELOG.md -->` replaced by that file, its links as seen from docs/."""

    def text(match: re.Match[str]) -> str:
        return (ROOT / match[1]).read_text(encoding="utf-8").replace("](docs/", "](")

    return re.sub(r"<!-- text: ([\w.]+) -->", text, markdown)


def with_equations(markdown: str) -> str:
    """A page with each line of its ```math blocks as MathML, which browsers draw by themselves."""
    from latex2mathml.converter import convert

    def block(match: re.Match[str]) -> str:
        lines = [convert(line, display="block") for line in match[1].strip().splitlines()]
        return f'<div class="math">{"".join(lines)}</div>'

    return re.sub(r"^```math\n(.*?)^```$", block, markdown, flags=re.MULTILINE | re.DOTALL)


def with_units_held(markdown: str) -> str:
    """A page in whose tables no line breaks between a number and its unit."""
    unit = re.compile(r"(?<=\d) (?=(?:µs|ms|s|N|mm|Hz|%)(?![\w/·]))")
    return re.sub(r"^\|.*$", lambda line: unit.sub("\u00a0", line[0]), markdown, flags=re.MULTILINE)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Puts the page of the view after the first one, where it exists."""
    nav: list[Any] = config.nav or []
    if (Path(config.docs_dir) / VIEW).is_file() and not any(VIEW in entry.values() for entry in nav):
        nav.insert(1, {"See it in the page": VIEW})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pictures, which other tools write to config/pictures."""
    from mkdocs.structure.files import File

    for path in sorted((ROOT / "config" / "pictures").glob("*.png")):
        files.append(File.generated(config, f"pictures/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """All that is replaced in a page."""
    text = with_equations(with_units_held(with_tables(with_texts(markdown))))
    return text.replace(f"]({PICTURES}", "](pictures/")

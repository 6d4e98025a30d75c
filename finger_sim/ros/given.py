"""Parameters that the command line gives and that do not reach the node.

ROS hands a node what a params file, or `-p NODE:NAME:=VALUE`, says under the node's own name, or under a pattern that
fits it, and drops the rest without a word.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

VALUES = "ros__parameters"
"""What stands between a node's name and its parameters in a params file."""


def unreached(arguments: Sequence[str], node: Any) -> Iterator[str]:
    """What to say of parameters in the arguments of a node's process, its own name left out, that do not reach it."""
    own = str(node.get_fully_qualified_name())
    stray = []
    words = iter(arguments)
    ros = False
    for word in words:
        if word == "--ros-args":
            ros = True
        elif not ros:
            stray.append(word)
        elif word == "--":
            ros = False
        elif word == "--params-file":
            yield from _of_file(Path(next(words, "")), own, node)
        elif word in ("-p", "--param"):
            rule = next(words, "")
            name, colon, _ = rule.partition(":=")[0].rpartition(":")
            if colon and not _fits(name, own):
                yield f"-p {rule} reaches nothing: this node is {own}"
    if stray:
        yield f"{' '.join(stray)}: not read; ROS takes arguments that come after --ros-args"


def _of_file(file: Path, own: str, node: Any) -> Iterator[str]:
    """What to say of a params file."""
    try:
        sections = dict(_sections(yaml.safe_load(file.read_text(encoding="utf-8"))))
    except (OSError, ValueError, yaml.YAMLError):
        return  # what ROS itself cannot read ends the node
    fitting = [name for name in sections if _fits(name, own)]
    if not any(sections.values()):
        yield f"{file} gives no parameter"
    elif not any(sections[name] for name in fitting):
        others = ", ".join(sections)
        yield f"{file} reaches nothing: it is for {others}, this node is {own}; write {own} or /** there"
    elif all("*" in name for name in fitting):
        reached = {value for name in fitting for value in sections[name]}
        for name, values in sections.items():
            missed = [value for value in values if node.has_parameter(value) and value not in reached]
            if name not in fitting and missed:
                yield f"{file}: {', '.join(missed)} of {name} does not reach this node, which is {own}"


def _sections(content: Any, namespace: str = "") -> Iterator[tuple[str, list[str]]]:
    """The names of nodes in a params file, and of the parameters under each."""
    if not isinstance(content, Mapping):
        return
    for key, value in content.items():
        if key == VALUES:
            yield namespace, list(_names(value))
        else:
            yield from _sections(value, f"{namespace}/{str(key).strip('/')}")


def _names(values: Any, block: str = "") -> Iterator[str]:
    """Dotted names of parameters."""
    for key, value in values.items() if isinstance(values, Mapping) else ():
        if isinstance(value, Mapping):
            yield from _names(value, f"{block}{key}.")
        else:
            yield f"{block}{key}"


def _fits(name: str, own: str) -> bool:
    """Whether a name or pattern of a params file is that of a node: * stands for one part of a name, ** for any."""
    parts = [{"**": r"(/\w+)*", "*": r"/\w+"}.get(part, f"/{re.escape(part)}") for part in name.strip("/").split("/")]
    return re.fullmatch("".join(parts), own) is not None

"""The source files that a result depends on: found by following imports, so that none can be forgotten in a list."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

_FROM = re.compile(r"^[ \t]*from[ \t]+(\.*)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|.*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+(.*)", re.MULTILINE)
_FOR_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t]+.*\n|\n)+", re.MULTILINE)
_NAME = re.compile(r"[\w.]+")


def imported(package: Path, starts: Iterable[Path]) -> list[Path]:
    """The files of `package` (its folder) that run when `starts`, files of it, are imported; `starts` among them.

    Imports inside functions count, those under TYPE_CHECKING do not; but where a package hands out names when they are
    asked for, its imports under TYPE_CHECKING tell where they come from. Any other module that is imported by a string
    is not found. A parser would take half a second of every start: imports are found by how they look, and a line of a
    docstring that looks like one only adds a file. Raises OSError when a file cannot be read.
    """
    found, waiting = set[Path](), list(starts)
    followed = set[tuple[str, ...]]()
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            targets = _targets(package, file) - followed
            followed |= targets
            waiting += (found_at for target in targets for found_at in _files(package.parent, target))
    return sorted(found)


def digest(package: Path, files: Iterable[Path]) -> str:
    """Hash over what is in the files and their places in the package: equal wherever the package lies."""
    whole = hashlib.sha256()
    for file in files:
        content = file.read_bytes()
        whole.update(f"{file.relative_to(package).as_posix()} {len(content)}\n".encode() + content)
    return whole.hexdigest()


def _targets(package: Path, file: Path) -> set[tuple[str, ...]]:
    """Names in the package that `file` imports, and of the packages around them, which run too."""
    text = _FOR_TYPES.sub("", file.read_text(encoding="utf-8"))
    inside = file.parent.relative_to(package.parent).parts
    targets = {tuple(name.split(".")) for names in _IMPORT.findall(text) for name in _NAME.findall(names)}
    for dots, module, names in _FROM.findall(text):
        around = inside[: len(inside) + 1 - len(dots)] if dots else ()
        within = (*around, *filter(None, module.split(".")))
        targets |= {(*within, name) for name in _NAME.findall(names)}
    return {target[:depth] for target in targets if target[0] == package.name for depth in range(1, len(target) + 1)}


def _files(root: Path, target: tuple[str, ...]) -> Iterator[Path]:
    """The file of a dotted name, where it is that of a module; or the one that a package hands the name out from."""
    place = root.joinpath(*target)
    modules = [file for file in (place / "__init__.py", place.with_suffix(".py")) if file.is_file()]
    yield from modules
    door = place.parent / "__init__.py"
    if not modules and door.is_file() and "def __getattr__" in (text := door.read_text(encoding="utf-8")):
        for block in _FOR_TYPES.findall(text):
            for dots, module, names in _FROM.findall(block):
                if dots == "." and target[-1] in _NAME.findall(names):
                    yield door.parent.joinpath(*module.split(".")).with_suffix(".py")

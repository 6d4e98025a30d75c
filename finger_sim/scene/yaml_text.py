"""YAML as people mean it, and where in the file a mistake is.

1e-3 is a number, 2020-01-01 a text, a key given twice an error. Anchors, aliases and merge keys `<<` work. Whatever a
file holds is read, or refused with its name, the line and the column, and a caret under the place.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from ..errors import SceneError, short
from .fields import UNKNOWN_KEY


class BrokenYamlError(SceneError):
    """A file that cannot be read as YAML: where, and what is wrong there."""

    def __str__(self) -> str:
        return f"{self.source}: {self.value}" + (self.excerpt and f"\n{self.excerpt}")


class YamlText:
    """What a YAML file holds, as `data`. Raises BrokenYamlError when it cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        loader = _Loader(path, _text(path))
        try:
            self._root: yaml.Node | None = loader.get_single_node()
            self.data: Any = None if self._root is None else loader.construct_document(self._root)
        except yaml.MarkedYAMLError as error:
            raise _broken(path, _words(error), error.problem_mark or error.context_mark) from None
        except RecursionError:
            raise _broken(path, "too many blocks within blocks", loader.get_mark()) from None

    def located(self, error: SceneError) -> SceneError:
        """The same error about a value of this file, with file, line and column as far as its key is found in it."""
        mark = self._mark_of(error.key, at_key=error.allowed.startswith(UNKNOWN_KEY))
        return SceneError(error.key, error.value, error.allowed, _source(self.path, mark), _excerpt(mark))

    def _mark_of(self, key: str, at_key: bool) -> yaml.Mark | None:
        """Where the value of a dotted key begins, or its key; else the innermost block around it that there is."""
        node, mark = self._root, None if self._root is None else self._root.start_mark
        while node is not None and key:
            found = _within(node, key)
            if found is None:
                break
            name, node, key = found
            mark = name.start_mark if at_key and not key else node.start_mark
        return mark


def _within(node: yaml.Node, key: str) -> tuple[yaml.Node, yaml.Node, str] | None:
    """The key in a block that the dotted `key` begins with, its value, and the rest of `key`; None if there is none."""
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            rest = key.removeprefix(str(name.value))
            if rest != key and rest[:1] in ("", ".", "["):
                return name, value, rest.removeprefix(".")
    elif isinstance(node, yaml.SequenceNode):
        index = re.match(r"\[(e?)(\d+)\]\.?", key)  # the first is [0], of an axis [e1]
        if index is not None and 0 <= (at := int(index[2]) - len(index[1])) < len(node.value):
            return node.value[at], node.value[at], key[index.end() :]
    return None


MERGE = "tag:yaml.org,2002:merge"


class _Loader(yaml.SafeLoader):
    """SafeLoader without its pitfalls: raises yaml.MarkedYAMLError, BrokenYamlError or RecursionError, nothing else."""

    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._merging: set[yaml.Node] = set()
        try:
            super().__init__(text)
        except yaml.reader.ReaderError as error:
            what = f"the character {error.character:#04x}, which YAML does not allow"
            raise _broken(path, what, _mark(text, error.position)) from None

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _broken(self._path, "a list or a block as a key", key.start_mark)
            if key.value in seen:
                raise _broken(self._path, f"{key.value} is given twice", key.start_mark, key.value)
            seen.add(key.value)
            if key.tag != MERGE:
                key.tag = self.DEFAULT_SCALAR_TAG  # a key is the text that is written, also where it is 1 or on
        return node

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Put the keys of the blocks that `<<` names behind the block's own; of a key's values the first counts."""
        if node in self._merging:
            raise _broken(self._path, "a block that is merged into itself", node.start_mark)
        self._merging.add(node)
        pairs = {key.value: (key, value) for key, value in node.value if key.tag != MERGE}
        for blocks in (value for key, value in node.value if key.tag == MERGE):
            for block in blocks.value if isinstance(blocks, yaml.SequenceNode) else [blocks]:
                if not isinstance(block, yaml.MappingNode):
                    raise _broken(self._path, "<< takes a block, or a list of blocks", block.start_mark)
                self.flatten_mapping(block)
                pairs = {key.value: (key, value) for key, value in block.value} | pairs
        node.value = list(pairs.values())
        self._merging.remove(node)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, TypeError, LookupError, AttributeError, OverflowError):
            kind = str(node.tag).rpartition(":")[2]
            raise _broken(self._path, f"{short(node.value)} cannot be read as {kind}", node.start_mark) from None


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)


def _text(path: Path) -> str:
    """The text of a file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BrokenYamlError("scene", f"cannot be read: {error.strerror}", "a YAML file", str(path)) from None
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        so_far = data[: error.start].decode()
        mark = _mark(so_far + data[error.start :].decode(errors="replace"), len(so_far))
        raise _broken(path, f"{data[error.start]:#04x}, a byte that is no UTF-8 text", mark) from None


def _mark(text: str, index: int) -> yaml.Mark:
    """The mark of a place in a text."""
    line, begin = text.count("\n", 0, index), text.rfind("\n", 0, index) + 1
    return yaml.Mark("", index, line, index - begin, text + "\0", index)


def _words(error: yaml.MarkedYAMLError) -> str:
    """What is wrong, and in which block."""
    words = " ".join(str(error.problem or error.context).split())
    if error.problem and error.context and error.context_mark is not None:
        words += f" ({' '.join(error.context.split())} that begins in line {error.context_mark.line + 1})"
    return words


def _broken(path: Path, problem: str, mark: yaml.Mark | None, key: str = "scene") -> BrokenYamlError:
    problem = f"not well-formed YAML: {problem}"
    return BrokenYamlError(key, problem, "well-formed YAML", _source(path, mark), _excerpt(mark))


def _source(path: Path, mark: yaml.Mark | None) -> str:
    return str(path) if mark is None else f"{path}, line {mark.line + 1}, column {mark.column + 1}"


def _excerpt(mark: yaml.Mark | None) -> str:
    """The line of a mark, and below it a caret under the place; a blank for what a terminal would not show as one."""
    snippet = None if mark is None else mark.get_snippet(indent=4, max_length=100)
    return "".join(c if c.isprintable() or c == "\n" else " " for c in snippet or "")

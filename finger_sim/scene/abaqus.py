"""Abaqus input files (.inp), as Abaqus/CAE, CalculiX and gmsh write them: nodes, solid elements, node and element sets.

meshio's reader forgets nodes that come in a second block, leaves sets that name sets empty, and refuses a file for one
element type that it does not know. Here whatever is no node, element, set, part or instance is passed over.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import MeshError
from .mesh_contents import Contents

SOLIDS = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 13: "pyramid13", 15: "wedge15",
          20: "hexahedron20", 27: "hexahedron27"}  # fmt: skip
"""Kinds of solid elements by how many nodes they have."""
LONGEST_RANGE = 10_000_000
"""Members that one row of a set may generate: more than meshes here have nodes."""
DEEPEST = 8
"""Files that may include each other, one within the other."""

# C3D4, C3D10MH, DC3D4 …: letters before and after are of the physics.
_SOLID = re.compile(r"A?D?C3D(\d+)")


class _Block(NamedTuple):
    """A keyword, its parameters, and the rows of data below it, each with the place where it stands."""

    keyword: str
    given: dict[str, str]
    rows: list[tuple[str, list[str]]]
    place: str


class _Body:
    """What has numbers of its own: the file, a part, or an instance of one."""

    def __init__(self) -> None:
        self.points: dict[int, list[float]] = {}
        self.elements: dict[int, tuple[str, list[int], str]] = {}  # type, nodes, place
        self.node_sets: dict[str, list[tuple[int, str]]] = {}  # number and place
        self.element_sets: dict[str, list[int]] = {}

    def placed(self, rows: Iterable[tuple[str, list[str]]]) -> _Body:
        """A copy where an instance puts it: moved by the first row, then turned about the axis of the second."""
        out = _Body()
        x = np.array(list(self.points.values())).reshape(-1, 3)
        for place, row in rows:
            numbers = _numbers(row, place)
            if len(numbers) >= 7:
                start, axis = np.array(numbers[:3]), np.subtract(numbers[3:6], numbers[:3])
                length = float(np.linalg.norm(axis))
                if not 0.0 < length < np.inf or not np.isfinite(numbers).all():
                    raise MeshError(f"{place}: got {', '.join(row)}, allowed: two points of an axis, and an angle")
                x = start + Rotation.from_rotvec(np.radians(numbers[6]) / length * axis).apply(x - start)
            else:
                x = x + np.array((numbers + [0.0, 0.0, 0.0])[:3])
        out.points = dict(zip(self.points, x.tolist(), strict=True))
        out.elements = dict(self.elements)
        out.node_sets = {name: list(nodes) for name, nodes in self.node_sets.items()}
        out.element_sets = {name: list(elements) for name, elements in self.element_sets.items()}
        return out


class _Reader:
    """Bodies of a file, by the name of their part or instance; "" is the file itself, or its assembly."""

    def __init__(self) -> None:
        self.parts: dict[str, _Body] = {}
        self.instances: dict[str, _Body] = {}
        self.root = self.body = _Body()
        self._names: dict[str, str] = {}  # of sets, as they were first written

    def take(self, block: _Block) -> None:
        """One block of the file, in their order."""
        match block.keyword:
            case "PART":
                self.body = self.parts[_name(block, "NAME")] = _Body()
            case "INSTANCE":
                part = self.parts.get(_folded(block.given.get("PART", "")), _Body())
                self.body = self.instances[_name(block, "NAME")] = part.placed(block.rows)
            case "END PART" | "END INSTANCE":
                self.body = self.root
            case "NODE":
                self._nodes(block)
            case "ELEMENT":
                self._elements(block)
            case "SYSTEM" if block.rows:
                raise MeshError(f"{block.place}: *SYSTEM: nodes in axes of their own are not read")
            case "NSET":
                self._node_set(block)
            case "ELSET":
                self._element_set(block)

    def contents(self) -> Contents:
        """All bodies together; parts that instances were made of are not among them."""
        bodies = [*(self.instances or self.parts).values(), self.root]
        points: list[list[float]] = []
        solids: dict[str, list[list[int]]] = {}
        others: Counter[str] = Counter()
        sets: dict[str, list[int]] = {}
        named = {name for body in bodies for name in body.node_sets}
        for body in bodies:
            index = {number: len(points) + k for k, number in enumerate(body.points)}
            points += body.points.values()
            for number, (kind, nodes, place) in body.elements.items():
                if kind in SOLIDS.values():
                    solids.setdefault(kind, []).append(_found(nodes, index, f"element {number}", place))
                else:
                    others[kind] += 1
            for name, numbered in body.node_sets.items():
                into = sets.setdefault(self._names[name], [])
                for node, place in numbered:
                    into += _found([node], index, f"node set {self._names[name]!r}", place)
            for name, elements in body.element_sets.items():
                if name in named:
                    continue  # the nodes are named themselves
                used = {node for e in elements if e in body.elements for node in body.elements[e][1]}
                sets.setdefault(self._names[name], []).extend(index[node] for node in used if node in index)
        return Contents(
            np.array(points, dtype=np.float64).reshape(-1, 3),
            [(kind, np.array(cells, dtype=np.int64)) for kind, cells in solids.items()],
            dict(others),
            {name: np.array(nodes, dtype=np.int64) for name, nodes in sets.items()},
        )

    def _nodes(self, block: _Block) -> None:
        if block.given.get("SYSTEM", "R").upper() != "R":
            raise MeshError(f"{block.place}: *NODE, SYSTEM={block.given['SYSTEM']}: only rectangular axes are read")
        numbers = []
        for place, row in block.rows:
            number, *x = _numbers(row, place)
            numbers.append((int(number), place))
            self.body.points[int(number)] = (x + [0.0, 0.0, 0.0])[:3]
        if "NSET" in block.given:
            self.body.node_sets.setdefault(self._set_name(block, "NSET"), []).extend(numbers)

    def _elements(self, block: _Block) -> None:
        written = block.given.get("TYPE", "").upper()
        solid = _SOLID.match(written)
        nodes_each = int(solid[1]) if solid else None
        kind = SOLIDS.get(nodes_each or 0, written or "untyped")
        numbers = []
        for place, row in _joined(block.rows, nodes_each):
            if solid is None and not all(word.isdecimal() for word in row):
                continue  # of other instances' nodes, "Part-1-1.7": never a solid
            number, *nodes = (int(word) for word in _numbers(row, place))
            if nodes_each is not None and len(nodes) != nodes_each:
                raise MeshError(
                    f"{place}: element {number} of type {written} has {len(nodes)} nodes instead of {nodes_each}; "
                    "the file was cut off, or is damaged"
                )
            numbers.append(number)
            self.body.elements[number] = kind, nodes, place
        if "ELSET" in block.given:
            self.body.element_sets.setdefault(self._set_name(block, "ELSET"), []).extend(numbers)

    def _node_set(self, block: _Block) -> None:
        name = self._set_name(block, "NSET")
        self._body_of(block).node_sets.setdefault(name, [])
        for place, body, item in self._items(block):
            of_item = [(item, place)] if isinstance(item, int) else body.node_sets.get(item, [])
            body.node_sets.setdefault(name, []).extend(of_item)
        if "ELSET" in block.given:
            body = self._body_of(block)
            elements = body.element_sets.get(_folded(block.given["ELSET"]), [])
            nodes = {node for element in elements if element in body.elements for node in body.elements[element][1]}
            body.node_sets[name] += [(node, block.place) for node in nodes]

    def _element_set(self, block: _Block) -> None:
        name = self._set_name(block, "ELSET")
        for _, body, item in self._items(block):
            of_item = [item] if isinstance(item, int) else body.element_sets.get(item, [])
            body.element_sets.setdefault(name, []).extend(of_item)

    def _items(self, block: _Block) -> Iterator[tuple[str, _Body, int | str]]:
        """Members of a set with the body they are of: numbers, ranges written out, and names of other sets."""
        for place, row in block.rows:
            words = [word.strip('"') for word in row if word]
            if "GENERATE" in block.given:
                yield from ((place, self._body_of(block), number) for number in _range(words, place))
                continue
            for word in words:
                of, dot, rest = word.partition(".")
                qualified = bool(dot) and _folded(of) in self.instances
                body, item = (self.instances[_folded(of)], rest) if qualified else (self._body_of(block), word)
                yield place, body, int(item) if item.isdecimal() else _folded(item)

    def _body_of(self, block: _Block) -> _Body:
        """The body that a set is of: of the instance that it names, else of what it stands in."""
        return self.instances.get(_folded(block.given.get("INSTANCE", "")), self.body)

    def _set_name(self, block: _Block, parameter: str) -> str:
        name = _name(block, parameter)
        self._names.setdefault(name, block.given[parameter].strip('" '))
        return name


def read_abaqus(path: Path) -> Contents:
    """What an input file holds. Raises MeshError naming the line that cannot be understood."""
    reader = _Reader()
    for block in _blocks(_lines(path, 0)):
        reader.take(block)
    return reader.contents()


def _lines(path: Path, depth: int) -> Iterator[tuple[str, str]]:
    """Lines that are no comments, with their places, those of included files in between."""
    file = f"{path.name}, " if depth else ""
    with path.open(encoding="utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, start=1):
            text, place = line.strip(), f"{file}line {number}"
            if text.upper().startswith("*INCLUDE"):
                included = path.parent / text.partition("=")[2].strip().strip('"')
                if depth == DEEPEST or not included.is_file():
                    raise MeshError(f"{place}: includes {included}, which is no file, or includes this one")
                yield from _lines(included, depth + 1)
            elif text and not text.startswith("**"):
                yield place, text


def _blocks(lines: Iterator[tuple[str, str]]) -> Iterator[_Block]:
    """Keywords with what belongs to them."""
    block = None
    for place, text in lines:
        words = [word.strip() for word in text.split(",")]
        if text.startswith("*"):
            if block is not None:
                yield block
            block = _Block(" ".join(words[0][1:].upper().split()), {}, [], place)
            words = words[1:]
        elif block is None:
            raise MeshError(f"{place}: a keyword such as *NODE must stand before anything else")
        elif not block.rows and "" in block.given and text[0].isalpha():
            del block.given[""]  # the keyword's line ended with a comma: it goes on in this one
        else:
            block.rows.append((place, words))
            continue
        for word in words:
            key, _, value = word.partition("=")
            block.given[key.strip().upper()] = value.strip()
    if block is not None:
        yield block


def _joined(rows: list[tuple[str, list[str]]], nodes_each: int | None) -> Iterator[tuple[str, list[str]]]:
    """Rows of elements that were broken into lines: a line goes on after a comma, or until all nodes are there."""
    held: list[str] = []
    start = ""
    for place, row in rows:
        start = start if held else place
        ends_open = row[-1] == ""
        held += [word for word in row if word]
        if len(held) > nodes_each if nodes_each is not None else not ends_open:
            yield start, held
            held = []
    if held:
        yield start, held


def _range(words: list[str], place: str) -> range:
    """First, last and step, 1 where it is left out."""
    numbers = [int(word) for word in words if word.isdecimal()]
    if len(numbers) == len(words) in (2, 3) and numbers[2:] != [0]:
        found = range(numbers[0], numbers[1] + 1, *numbers[2:])
        if 0 < len(found) <= LONGEST_RANGE:
            return found
    raise MeshError(f"{place}: got {', '.join(words)}, allowed: first, last and step of a range that holds something")


def _numbers(words: list[str], place: str) -> list[float]:
    try:
        return [float(word) for word in words if word]
    except ValueError:
        with contextlib.suppress(ValueError):
            return [float(word.upper().replace("D", "E")) for word in words if word]  # 1.5D-3, as Fortran writes it
        raise MeshError(f"{place}: got {', '.join(words)[:60]!r}, allowed: numbers") from None


def _found(numbers: list[int], index: dict[int, int], who: str, place: str) -> list[int]:
    """Where nodes are in the mesh. Raises MeshError for a number that no node has."""
    try:
        return [index[number] for number in numbers]
    except KeyError as error:
        raise MeshError(f"{place}: {who} names node {error.args[0]}, which the file does not have") from None


def _name(block: _Block, parameter: str) -> str:
    """The name that a block gives itself, as names are compared: without case. Raises MeshError where it has none."""
    if not block.given.get(parameter):
        raise MeshError(f"{block.place}: *{block.keyword} without {parameter}=…")
    return _folded(block.given[parameter])


def _folded(name: str) -> str:
    return name.strip('" ').casefold()

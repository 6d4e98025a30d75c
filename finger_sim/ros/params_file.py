"""All parameters of the node as a commented file that `--params-file` takes: made of the fields. It needs no ROS."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from textwrap import wrap
from typing import Any

from ..scene import Parameter, Scene
from ..scene.fields import specs
from ..scene.reference import allowed_of, default_of, dotted
from ..scene.resources import shipped
from ..scene.ros_values import to_ros
from .options import NodeOptions

WIDTH = 110
"""Of a line of comment."""
HEAD = """\
# Parameters of the node `finger` for the scene {scene}.
#
#     finger_sim node --ros-args --params-file THIS_FILE
#
# Values stand as they are without this file: change some, and leave others out. Those marked live may change while the
# node runs (ros2 param set). What is null in a scene is .inf here. /** reaches the node whatever its name and
# namespace; /left/finger reaches that one only.
/**:
  ros__parameters:
"""


def params_file(scene: str) -> str:
    """The file for a scene, which is found as the node finds it. Raises SceneError."""
    loaded = Scene.load(scene)
    options = dataclasses.replace(NodeOptions(), scene=scene)
    own = [Parameter(name, getattr(options, name), spec) for name, spec in specs(NodeOptions).items()]
    parts = (
        ("the node", own, NodeOptions),
        ("the scene; blocks that it leaves out have no parameters", list(loaded.parameters()), Scene),
    )
    out = [HEAD.format(scene=scene)]
    for title, parameters, part in parts:
        out += [f"    # ---- of {title}\n", *(f"{line}\n" for line in _lines(parameters, part))]
    return "".join(out)


def _lines(parameters: Iterable[Parameter], part: type) -> Iterator[str]:
    """Each parameter under its block, after what it means and may be."""
    defaults = {name: default for name, _, default in dotted(part)}
    above: list[str] = []
    for parameter in parameters:
        *blocks, name = parameter.name.split(".")
        shared = next((k for k, (a, b) in enumerate(zip(above, blocks, strict=False)) if a != b), len(blocks))
        for depth in range(min(shared, len(above)), len(blocks)):
            yield f"{'  ' * (depth + 2)}{blocks[depth]}:"
        above = blocks
        indent = "  " * (len(blocks) + 2)
        spec = parameter.spec
        default = defaults[parameter.name]
        facts = [allowed_of(spec), "needed" if default is dataclasses.MISSING else f"default {default_of(default)}"]
        facts += ["live"] if spec.live else []
        for text in (f"{spec.doc}.", "; ".join(facts).replace("−", "-")):
            yield from (f"{indent}# {line}" for line in wrap(text, WIDTH - len(indent), break_long_words=False))
        yield f"{indent}{name}: {_value(parameter)}"


def _value(parameter: Parameter) -> str:
    """As ROS reads it: each number of the type that the parameter has."""
    value = to_ros(parameter.value, parameter.spec)
    if parameter.name == "mesh.file" and value:
        value = _mesh(Path(value))
    return f"[{', '.join(map(_scalar, value))}]" if isinstance(value, list) else _scalar(value)


def _scalar(value: Any) -> str:
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, float) and math.isinf(value):
        return ".inf" if value > 0.0 else "-.inf"
    return repr(value)


def _mesh(path: Path) -> str:
    """A shipped mesh by its name, which holds on any machine."""
    config = shipped("config").resolve()
    return str(path.relative_to(config) if path.is_relative_to(config) else path)

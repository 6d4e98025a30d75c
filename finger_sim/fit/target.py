"""A target curve instead of data: "1 N at 1.5 mm, k = b + mF with m = 2/mm"."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np

from ..scene import Scene
from ..scene.mesh import TetMesh
from .press import TARGET, FitError, Press, orientation_of, touch_height

ALLOWED = 'points as "1 N at 1.5 mm", stiffness as "k = b + mF with m = 2/mm" and "b = 0.2 N/mm", apart by commas'
FORCES = (0.2, 5.0)
"""Normal forces over which k = b + mF is asked for [N]."""
SAMPLES = 24
_NUMBER = r"([-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)"
_POINT = re.compile(rf"^{_NUMBER}\s*(N|mN)\s+at\s+{_NUMBER}\s*(mm|m|um|µm)$")
_LAW = re.compile(r"^k\s*=\s*b\s*\+\s*m\s*\*?\s*F(?:\s+with\s+(.*))?$")
_VALUE = re.compile(rf"^(b|m)\s*=\s*{_NUMBER}\s*(N/mm|N/m|/mm|/m|1/mm|1/m)$")
_SI = {"N": 1.0, "mN": 1e-3, "mm": 1e-3, "m": 1.0, "um": 1e-6, "µm": 1e-6}
_STIFF = {"N/mm": 1e3, "N/m": 1.0, "/mm": 1e3, "1/mm": 1e3, "/m": 1.0, "1/m": 1.0}


def target_press(text: str, scene: Scene, mesh: TetMesh, direction: str = "flat") -> Press:
    """The press that a target asks for, at rest.

    k = b + m F, k the tangent stiffness dF/dd, is F = (b/m)(exp(m d) − 1). It takes as many of b, m and points as
    make it one curve. Points alone are taken as they are. Raises FitError naming what cannot be read.
    """
    points, said, law = _read(text)
    turn = orientation_of(direction)
    touch = touch_height(scene, mesh, turn)
    if law:
        b, m = _constants(text, points, said)
        force = np.geomspace(FORCES[0] / 4.0, FORCES[1], SAMPLES)
        depth = np.log1p(force * m / b) / m
    else:
        force, depth = np.array([f for f, _ in points]), np.array([d for _, d in points])
    order = np.argsort(depth)
    count = len(order)
    position = np.stack([np.zeros(count), np.zeros(count), touch - depth[order]], axis=1)
    return Press(
        TARGET,
        direction,
        np.arange(count, dtype=np.float64),
        position,
        np.tile(turn, (count, 1)),
        touch,
        force[order],
    )


def _read(text: str) -> tuple[list[tuple[float, float]], dict[str, float], bool]:
    """Points (N, m), b [N/m] and m [1/m] where they are given, and whether stiffness is asked for."""
    points: list[tuple[float, float]] = []
    said: dict[str, float] = {}
    law = False
    for part in (piece.strip() for piece in re.split(r",| and ", text)):
        found = _LAW.match(part)
        if found:
            law, part = True, (found[1] or "").strip()
            if not part:
                continue
        point, value = _POINT.match(part), _VALUE.match(part)
        if point:
            points.append((float(point[1]) * _SI[point[2]], float(point[3]) * _SI[point[4]]))
        elif value and ("N" in value[3]) == (value[1] == "b"):
            said[value[1]] = float(value[2]) * _STIFF[value[3]]
        else:
            raise FitError(f"--target: got {part!r}, allowed: {ALLOWED}")
    if not points and not said:
        raise FitError(f"--target: got {text!r}, allowed: {ALLOWED}")
    for force, depth in points:
        if not (force > 0.0 and depth > 0.0):
            raise FitError(f"--target: got {force:g} N at {1e3 * depth:g} mm, allowed: both above 0")
    for name, number in said.items():
        if not number > 0.0:
            raise FitError(f"--target: {name}: got {number:g}, allowed: above 0")
    return points, said, law or bool(said)


def _constants(text: str, points: list[tuple[float, float]], said: dict[str, float]) -> tuple[float, float]:
    """b [N/m] and m [1/m] of the curve."""
    if len(said) == 2 and not points:
        return said["b"], said["m"]
    if len(said) == 1 and len(points) == 1:
        force, depth = points[0]
        if "m" in said:
            return said["m"] * force / math.expm1(said["m"] * depth), said["m"]
        b = said["b"]
        if force <= b * depth:
            raise FitError(f"--target: b = {1e-3 * b:g} N/mm is not below {1e-3 * force / depth:g} N/mm of the point")
        return b, _root(lambda m: b * math.expm1(m * depth) / m - force)
    if not said and len(points) == 2:
        (f1, d1), (f2, d2) = sorted(points, key=lambda point: point[1])
        if f2 / f1 <= d2 / d1:
            raise FitError("--target: force does not grow faster than depth from one point to the other")
        m = _root(lambda m: math.expm1(m * d2) / math.expm1(m * d1) - f2 / f1)
        return m * f1 / math.expm1(m * d1), m
    found = f"{len(points)} points, {', '.join(said) or 'neither b nor m'}"
    raise FitError(
        f"--target: got {found}, allowed with k = b + mF: b and m, or one of them and a point, or two points"
    )


def _root(function: Callable[[float], float]) -> float:
    """m [1/m] of a rising function that is below 0 at first."""
    from scipy.optimize import brentq

    return float(brentq(function, 1e-3, 2e4))

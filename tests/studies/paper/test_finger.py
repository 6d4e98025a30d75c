"""Figure 3, the pressed finger: presses and tangents against closed forms, the numbers pinned on faster presses."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import polar

from finger_sim import Scene
from finger_sim.studies.paper import finger as figure
from finger_sim.studies.paper import locking, speed
from finger_sim.studies.paper.figures import plain
from finger_sim.studies.paper.presses import (
    BODIES,
    DIRECTIONS,
    MATERIALS,
    Body,
    Way,
    press,
    reached_axes,
    scene_of,
    tangent_stiffness,
    tilted,
)

SIZE, YOUNG, FLOOR = (0.02, 0.01, 0.01), 5e4, 0.0099
WITHOUT_LIMITS = {"limits.stretch": [None] * 3, "limits.compress": [None] * 3}
UPRIGHT_BLOCK = Way((0.0, 0.0, 0.0, 1.0), 1e-3, 0.5e-3, 0.4e-3)


def block(**changes) -> Scene:
    """A block of 10 tetrahedra on a frictionless table, its upper side driven; ν is 0."""
    return Scene.from_dict({
        "mesh": {"beam": {"size": list(SIZE), "cells": [2, 1, 1]}},
        "driven": {"box": [[-1, -1, FLOOR], [1, 1, 1]]},
        "material": {"young": YOUNG, "poisson": 0.0},
        "plane": {"friction": 0.0, "stiffness": None},
    } | changes)  # fmt: skip


def ways(body: str, speeds: tuple[float, float, float]) -> Body:
    """A body of the study, pressed flat, on its side and on its tip at other speeds, just beyond the pictured depth."""
    given = zip(BODIES[body].ways.items(), speeds, strict=True)
    beyond = {"paper": 1.02, "stiff": 1.02, "pulp": 2.0}[body]
    return replace(
        BODIES[body],
        ways={d: replace(w, speed=v, deepest=min(w.deepest, beyond * w.shown)) for (d, w), v in given},
    )


@pytest.fixture(scope="module")
def pulp() -> figure.Result:
    """The body of the pictures, two to four times as fast."""
    return figure.measure(lambda done, total: None, {"pulp": ways("pulp", (2e-3, 2e-3, 2e-3))}, finer=False)


@pytest.fixture(scope="module")
def result(pulp: figure.Result) -> figure.Result:
    """The study: the other bodies too."""
    bodies = {"paper": ways("paper", (1e-2, 1e-2, 2e-3)), "stiff": ways("stiff", (2e-3, 2e-3, 2e-3))}
    others = figure.measure(lambda done, total: None, bodies, finer=False)
    return replace(others, presses=pulp.presses | others.presses)


@pytest.mark.parametrize(("gravity", "within"), [(0.0, 1e-5), (9.81, 2e-3)])
def test_a_block_is_pressed_by_its_closed_form(gravity: float, within: float) -> None:
    """ν 0, no friction: F = E A d/h at any depth, counted from the touch of the block as its weight stretches it.

    Its weight stretches the block by ρ g h²/2E, not evenly: the table meets one node after the other.
    """
    stiffness = YOUNG * SIZE[0] * SIZE[1] / SIZE[2]
    material = {"young": YOUNG, "poisson": 0.0, "damping": {"stiffness": 0.0}}
    pressed = press(block(material=material, gravity=[0.0, 0.0, -gravity]), UPRIGHT_BLOCK, enough=1e9)
    window = 10 * UPRIGHT_BLOCK.speed * 1e-3
    before, after = pressed.depth < -window, pressed.depth > window
    assert gravity == 0.0 or 1000.0 * gravity * SIZE[2] ** 2 / (2.0 * YOUNG) * stiffness > 4.0 * within
    np.testing.assert_allclose(pressed.force[before], 0.0, atol=1e-9)
    np.testing.assert_allclose(pressed.force[after], stiffness * pressed.depth[after], atol=within)
    assert pressed.tangent(0.2) == pytest.approx(stiffness, rel=2e-3)
    assert pressed.depth_at(0.3) == pytest.approx(0.3 / stiffness, abs=within / stiffness)
    assert np.isnan(pressed.first_limit)


def test_a_press_ends_where_it_is_told() -> None:
    """At the way's end, or with enough force but not above the pictured depth; never sampled beyond one window."""
    down = 10 * UPRIGHT_BLOCK.speed * 1e-3
    for enough, end in ((1e9, UPRIGHT_BLOCK.deepest), (1e-3, UPRIGHT_BLOCK.shown), (0.45, 0.45e-3)):
        last = press(block(), UPRIGHT_BLOCK, enough).depth[-1]
        assert end - 1e-9 <= last <= end + 1.01 * down


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
def test_the_tangent_of_a_power_law(power: float) -> None:
    """F = c dⁿ has the tangent n F/d; noise of a percent of the force does not matter."""
    depth = np.linspace(0.0, 2e-3, 400)
    force = 4.0 * (depth / 2e-3) ** power
    for at in (0.2, 1.5):
        exact = power * at / (2e-3 * (at / 4.0) ** (1.0 / power))
        assert tangent_stiffness(depth, force, at) == pytest.approx(exact, rel=0.01)
        noisy = force * (1.0 + 0.01 * np.random.default_rng(1).standard_normal(400))
        assert tangent_stiffness(depth, noisy, at) == pytest.approx(exact, rel=0.08)


def test_no_tangent_without_points_enough() -> None:
    """Of too coarse a curve, or at its very end, there is none."""
    depth = np.linspace(0.0, 1.0, 100)
    assert np.isnan(tangent_stiffness(depth[::20], depth[::20], 0.5))
    assert np.isnan(tangent_stiffness(depth, depth, 0.9))
    assert tangent_stiffness(depth, depth, 0.7) == pytest.approx(1.0)


def test_figures_keep_the_papers_mesh_and_element(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever mesh, element and modulus the shipped scenes are tuned to: in presses, locking and speed."""
    load = Scene.load

    def tuned(name: str) -> Scene:
        changes = {"material.young": 2.1e4, "material.volumetric": "patch", "mesh.file": "meshes/finger.vtu"}
        return load(name) if name == "finger_paper" else load(name).with_values(changes)

    def scenes() -> list[Scene]:
        contenders = speed.CONTENDERS.values()
        return [
            *(scene_of((body, "flat", "anisotropic")) for body in BODIES),
            *(locking.scene_of(name, "newton") for name in ("none", "tensor")),
            *(Scene.load(who.scene).with_values(who.values) for who in contenders),
        ]

    before = scenes()
    assert {Path(scene.mesh.file or "").name for scene in before} == {"finger_paper.vtu"}
    assert {scene.material.volumetric for scene in before} == {"element"}
    assert {scene.material.young for scene in before} == {1.4e4, 2e6}
    monkeypatch.setattr(Scene, "load", staticmethod(tuned))
    assert scenes() == before


@pytest.mark.parametrize(("axis", "stretch"), [(0, 0.95), (1, 1.25), (2, 1.02), (0, 1.05), (1, 0.75), (2, 0.98)])
def test_the_axis_of_a_reached_limit(axis: int, stretch: float) -> None:
    """A finger stretched to the limit of one axis and turned: every tetrahedron at its limit counts for that axis."""
    scene = Scene.load("finger")
    mesh = scene.load_mesh()
    stretches = np.full(3, 1.001)
    stretches[axis] = stretch
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    strain = np.where(np.arange(len(mesh.tets)) % 2 == 0, 1.0, 0.5)
    expected = np.zeros(3)
    expected[axis] = len(mesh.tets) / 2
    np.testing.assert_array_equal(reached_axes(mesh, mesh.points * stretches @ turn.T, strain, scene), expected)


def test_directions_put_their_axis_upright() -> None:
    """Flat e2 is up, on the side e3 but for 8 degrees, on the tip e1 is down; a tilt lowers the tip."""
    from finger_sim.physics.rotations import matrix

    ways = {d: matrix(way.orientation) for d, way in BODIES["pulp"].ways.items()}
    np.testing.assert_allclose(ways["flat"][:, 1], [0.0, 0.0, 1.0], atol=1e-12)
    assert ways["side"][2, 2] == pytest.approx(np.cos(np.radians(8.0)))
    np.testing.assert_allclose(ways["tip"][:, 0], [0.0, 0.0, -1.0], atol=1e-12)
    assert matrix(tilted((0.0, 0.0, 0.0, 1.0), 20.0))[2, 0] == pytest.approx(-np.sin(np.radians(20.0)))


@pytest.mark.slow
def test_until_a_limit_is_reached_both_materials_are_the_same(result: figure.Result) -> None:
    """The held finger bends on the same curve; with no limit of either reached, the projection plays no part."""
    for direction in DIRECTIONS:
        anisotropic, isotropic = (result.presses["paper", direction, material] for material in MATERIALS)
        first = int(np.argmax(anisotropic.limited_tets > 0))
        assert first > 10
        np.testing.assert_allclose(anisotropic.force[:first], isotropic.force[:first], rtol=1e-4, atol=1e-5)
        assert anisotropic.force_at(anisotropic.way.shown) > 1.01 * isotropic.force_at(anisotropic.way.shown)


def test_the_table_carries_the_bone_and_the_weight() -> None:
    """Flat on soft tissue without limits: force = weight of the free nodes + what the tissue pushes the bone up with,
    by the corotational law σ = 2 μ E + λ tr(E) I, E = U − I, from scipy's polar decomposition."""
    way = replace(BODIES["pulp"].ways["flat"], deepest=0.55e-3, shown=0.5e-3)
    scene = scene_of(("pulp", "flat", "anisotropic")).with_values(WITHOUT_LIMITS)
    pressed, mesh, material = press(scene, way, enough=1e9), scene.load_mesh(), scene.material
    lame_mu = material.young / (2.0 * (1.0 + material.poisson))
    lame_lambda = 2.0 * lame_mu * material.poisson / (1.0 - 2.0 * material.poisson)
    up, mass = np.zeros(len(mesh.points)), np.zeros(len(mesh.points))
    for tet, volume in zip(mesh.tets, mesh.volumes, strict=True):
        inverse = np.linalg.inv((mesh.points[tet[:3]] - mesh.points[tet[3]]).T)
        R, U = polar((pressed.points[tet[:3]] - pressed.points[tet[3]]).T @ inverse)
        E = U - np.eye(3)
        P = R @ (2.0 * lame_mu * E + lame_lambda * np.trace(E) * np.eye(3))
        gradients = np.vstack([inverse, -inverse.sum(axis=0)])
        up[tet] -= volume * (P @ gradients.T)[2]
        mass[tet] += 0.25 * material.density * volume
    bone = np.isin(np.arange(len(up)), scene.driven_nodes(mesh))
    end = pressed.depth[pressed.at_shown] + 4.5 * way.speed * scene.dt
    weight = 9.81 * mass[~bone].sum()
    assert pressed.force_at(end) == pytest.approx(weight + up[bone].sum(), rel=0.02)


def test_without_limits_the_materials_are_one() -> None:
    """Nothing but the limits differs between them."""
    way = replace(BODIES["pulp"].ways["tip"], speed=4e-3, deepest=0.6e-3, shown=0.5e-3)
    curves = [press(scene_of(("pulp", "tip", m)).with_values(WITHOUT_LIMITS), way, enough=1e9) for m in MATERIALS]
    np.testing.assert_array_equal(curves[0].force, curves[1].force)
    assert curves[0].force[-1] > 0.01


@pytest.mark.parametrize(
    ("direction", "ratio", "anisotropic", "isotropic"),
    [("flat", 1.74, 1.706, 1.823), ("side", 39.0, 0.373, 1.373), ("tip", 18.5, 0.834, 1.679)],
)
def test_alike_flat_and_far_stiffer_on_the_side_and_tip(
    pulp: figure.Result, direction: str, ratio: float, anisotropic: float, isotropic: float
) -> None:
    """On its bone: ratio of the forces at the pictured depth, and depth at 1.5 N [mm]."""
    assert figure.force_ratio(pulp, "pulp", direction) == pytest.approx(ratio, rel=0.06)
    for material, depth in zip(MATERIALS, (anisotropic, isotropic), strict=True):
        pressed = pulp.presses["pulp", direction, material]
        assert 1e3 * pressed.depth_at(1.5) == pytest.approx(depth, rel=0.02)
        assert pressed.penetration < 1e-4


@pytest.mark.parametrize(
    ("direction", "material", "light", "firm"),
    [
        ("flat", "anisotropic", 616.0, 3430.0),
        ("flat", "isotropic", 426.0, 6900.0),
        ("side", "isotropic", 401.0, 6860.0),
        ("side", "anisotropic", None, 9220.0),
        ("tip", "anisotropic", None, 2890.0),
        ("tip", "isotropic", None, 3190.0),
    ],
)
def test_tangent_stiffness(
    pulp: figure.Result, direction: str, material: str, light: float | None, firm: float
) -> None:
    """At 0.2 and 1.5 N [N/m]; where the faster press has too few points, none is claimed."""
    pressed = pulp.presses["pulp", direction, material]
    assert pressed.tangent(1.5) == pytest.approx(firm, rel=0.04)
    assert pressed.tangent(0.2) == pytest.approx(light or np.nan, rel=0.02, nan_ok=True)


def test_the_side_is_stiff_from_the_first() -> None:
    """Its tangent at 0.2 N, from a slow press [N/m]: half of that at 1.5 N, where flat it is a sixth."""
    way = replace(BODIES["pulp"].ways["side"], deepest=0.22e-3, shown=0.2e-3)
    pressed = press(scene_of(("pulp", "side", "anisotropic")), way, enough=1e9)
    assert pressed.tangent(0.2) == pytest.approx(4690.0, rel=0.04)


def mostly(reached: np.ndarray, axis: int) -> bool:
    return bool(np.argmax(reached) == axis and reached[axis] > 0.6 * reached.sum())


def test_which_limits_hold(pulp: figure.Result) -> None:
    """Pressed flat or on the side the 2 % across hold most tetrahedra, on the tip the 5 % along the finger."""
    for direction, axis in (("flat", 2), ("side", 2), ("tip", 0)):
        assert mostly(pulp.presses["pulp", direction, "anisotropic"].reached, axis), direction


@pytest.mark.slow
def test_which_limits_hold_a_finger_held_at_its_cut_end(result: figure.Result) -> None:
    """The 5 % of its bending; its limits are rigid."""
    assert mostly(result.presses["paper", "flat", "anisotropic"].reached, 0)
    for direction in DIRECTIONS:
        assert result.presses["paper", direction, "anisotropic"].strain_ratio.max() < 1.01


@pytest.mark.slow
def test_findings(result: figure.Result) -> None:
    """What agrees with the paper does; held at its cut end the finger bends, and hardly tells the materials apart."""
    findings = figure.findings(result)
    assert [finding.agrees for finding in findings] == [True, True, True, True, False, True]
    assert all(finding.reason for finding in findings if not finding.agrees)
    for direction, ratio in (("flat", 1.03), ("side", 1.55), ("tip", 1.42)):
        assert figure.force_ratio(result, "paper", direction) == pytest.approx(ratio, rel=0.06)
    for direction, ratio in (("flat", 1.23), ("side", 42.5), ("tip", 17.4)):
        assert figure.force_ratio(result, "stiff", direction) == pytest.approx(ratio, rel=0.06)


@pytest.mark.slow
def test_the_numbers_are_json(result: figure.Result) -> None:
    """Every body, direction and material; the curves on one grid of depths."""
    numbers = plain(figure.numbers(result))
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    for body in BODIES:
        for direction in DIRECTIONS:
            given = numbers["bodies"][body][direction]
            forces = [given[material]["force_n"] for material in MATERIALS]
            assert len(given["depth_m"]) == len(forces[0]) == len(forces[1]) == len(given["force_ratio"])
            assert None not in forces[0] + forces[1]


def test_finer_steps_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the speed in steps half as long: points four times as dense on the same curve; the meter ends full."""
    way = replace(BODIES["pulp"].ways["flat"], speed=4e-3, deepest=0.9e-3, shown=0.8e-3)
    monkeypatch.setattr(figure, "DIRECTIONS", {"flat": ""})
    told: list[tuple[float, float]] = []
    body = replace(BODIES["pulp"], ways={"flat": way})
    result = figure.measure(lambda done, total: told.append((done, total)), {"pulp": body})
    for key, finer in result.finer.items():
        assert np.diff(result.presses[key].depth)[0] == pytest.approx(4.0 * np.diff(finer.depth)[0])
    for change in figure.numbers(result)["change_in_steps_half_as_long"]["flat"].values():
        assert 0.0 < change["force"] < 0.03
    assert told[-1][0] == told[-1][1] == 10.0
    assert all(a[0] <= b[0] for a, b in pairwise(told))


def test_the_picture(pulp: figure.Result) -> None:
    """Six bodies to one scale, six plots with units, the limit on the colour bar; no text on another.

    The presses of one body stand for those of the others.
    """
    pytest.importorskip("matplotlib")
    presses = {(body, *way): press for body in BODIES for (_, *way), press in pulp.presses.items()}
    picture = figure.draw(replace(pulp, presses=presses))
    bodies = [axes for axes in picture.axes if axes.name == "3d"]
    assert len(bodies) == 6
    spans = [np.ptp(limits) for axes in bodies for limits in (axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d())]
    assert spans == pytest.approx([spans[0]] * 18)
    plots = [axes for axes in picture.axes if axes.get_xlabel() == "depth [mm]"]
    assert len(plots) == 6
    assert {axes.get_ylabel() for axes in picture.axes} >= {"normal force [N]", "strain / limit"}
    picture.canvas.draw()
    boxes = [text.get_window_extent() for text in picture.texts]
    boxes += [axes.xaxis.label.get_window_extent() for axes in plots]
    boxes += [axes.get_legend().get_window_extent() for axes in plots]
    for k, box in enumerate(boxes):
        assert box.x0 >= 0.0
        assert box.x1 <= picture.bbox.x1
        assert not any(box.overlaps(other) for other in boxes[:k])

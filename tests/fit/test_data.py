"""Measured presses as they are read: units, what is refused and how it is named, what is doubtful and told."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from cases import for_each
from fit.block import LEVEL, block

from finger_sim.bags import cdr
from finger_sim.bags.reader import BagWriter
from finger_sim.fit.bag_data import read_bag
from finger_sim.fit.checks import checked
from finger_sim.fit.csv_data import read_csv
from finger_sim.fit.press import FitError
from finger_sim.fit.target import target_press

SCENE = block()
MESH = SCENE.load_mesh()
HEAD = "# orientation of the block: level\n"
N = 60


def text(depth: np.ndarray, normal: np.ndarray, time: np.ndarray | None = None, head: str = "") -> str:
    time = np.linspace(0.0, 1.0, len(depth)) if time is None else time
    head = head or "time [s],depth [mm],normal [N],qx,qy,qz,qw"
    rows = [
        f"{t!r},{d!r},{f!r},0,0,0,1" for t, d, f in zip(time.tolist(), depth.tolist(), normal.tolist(), strict=True)
    ]
    return "\n".join([head, *rows]) + "\n"


def good() -> tuple[np.ndarray, np.ndarray]:
    """Down to 1.5 mm and up again [mm]; an exponential force [N]."""
    depth = -0.3 + 1.8 * np.sin(np.linspace(0.0, math.pi, N))
    return depth, np.where(depth > 0.0, 0.2 * np.expm1(2.0 * np.maximum(depth, 0.0)), 0.0)


def presses(tmp_path: Path, content: str, direction: str | None = None) -> list:
    path = tmp_path / "press.csv"
    path.write_text(content, encoding="utf-8")
    return read_csv(path, SCENE, MESH, direction)


def notes(tmp_path: Path, content: str) -> str:
    return "; ".join(checked(presses(tmp_path, content), SCENE, MESH)[1])


@for_each(
    "head, factors",
    [
        ("time [s],depth [mm],normal [N],qx,qy,qz,qw", (1.0, 1e-3, 1.0)),
        ("t (ms); depth_um; Fz [mN]; qx;qy;qz;qw", (1e-3, 1e-6, 1e-3)),
        ("Time [s],indentation [m],force [gf],qx,qy,qz,qw", (1.0, 1.0, 9.80665e-3)),
    ],
)
def test_units_are_those_of_the_header(tmp_path, head, factors):
    """SI whatever the header says; depth is how far below first touch the bone is."""
    depth, force = good()
    content = text(depth, force, head=head)
    if ";" in head:
        content = content.replace(",", ";")
    (press,) = presses(tmp_path, content)
    np.testing.assert_allclose(press.time, factors[0] * np.linspace(0.0, 1.0, N), rtol=1e-12)
    np.testing.assert_allclose(press.depth, factors[1] * depth, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(press.normal, factors[2] * force, rtol=1e-12)
    assert press.direction == "pose"


def test_several_presses_in_a_file(tmp_path):
    """A column tells them apart, and another one how each was pressed; the comment is for those that do not say."""
    rows = [
        f"{label},{how},{0.1 * k},{0.1 * k},{0.2 * k}" for label, how in (("a", "flat"), ("b", "tip")) for k in range(9)
    ]
    found = presses(tmp_path, "\n".join(["press,direction,time [s],depth [mm],normal [N]", *rows]))
    assert [(press.name, press.direction) for press in found] == [("press:a", "flat"), ("press:b", "tip")]
    plain = "\n".join(
        ["# direction: side", "time [s],depth [mm],normal [N]", *(row.split(",", 2)[2] for row in rows[:9])]
    )
    assert presses(tmp_path, plain)[0].direction == "side"


@for_each(
    "change, words",
    [
        (lambda s: s.replace("depth [mm]", "depth"), ":1: column depth: it has no unit, allowed: depth [m|cm|mm"),
        (lambda s: s.replace("depth [mm]", "depth [N]"), "column depth: got 'N'"),
        (lambda s: s.replace("depth [mm]", "deep [mm]"), "column 'deep [mm]' is not known; known: time, depth"),
        (lambda s: s.replace("normal [N]", "area [mm^2]"), "no column normal; found time, depth, area"),
        (lambda s: s.replace("normal [N]", "depth [mm]"), "no column normal"),
        (lambda s: s.replace(",0,0,0,1\n", ",0,0,0,0\n", 1), ":2: qx qy qz qw: no unit quaternion"),
        (lambda s: s.replace(",qw", ",across [mm]"), "no column qw; allowed: all of qx, qy, qz, qw"),
        (lambda s: s.replace("\n0.0,", "\nnan,"), ":2: column time: got 'nan', allowed: a finite number"),
        (lambda s: s.replace(",0,0,0,1\n", ",0,0,0\n", 1), ":2: got 6 cells, allowed: 7"),
        (lambda s: s.splitlines()[0], "got 1 lines, allowed: a header"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, change, words):
    """With file and line, and what is allowed."""
    with pytest.raises(FitError) as error:
        presses(tmp_path, change(text(*good())))
    assert words in str(error.value)
    assert "press.csv" in str(error.value)


def test_a_press_must_say_how(tmp_path):
    """In a comment, a column, a pose or an option."""
    content = "time [s],depth [mm],normal [N]\n" + "".join(f"{k},{k},{k}\n" for k in range(9))
    with pytest.raises(FitError, match="does not say how it was pressed"):
        presses(tmp_path, content)
    assert presses(tmp_path, content, "tip")[0].direction == "tip"
    with pytest.raises(FitError, match="direction: got 'flt', allowed: flat, side, tip"):
        presses(tmp_path, content, "flt")


@for_each(
    "change, words",
    [
        (lambda d, f: (-d - 0.4, f), "negative while force rises"),
        (lambda d, f: (1e3 * d, f), "from skin to bone of this mesh; is it in µm?"),
        (lambda d, f: (1e-3 * d, f), "is it in m, not mm?"),
        (lambda d, f: (d - 3.0, f), "where is first touch?"),
        (lambda d, f: (d, -f), "force of the finger on the plane?"),
        (lambda d, f: (d, 1e3 * f), "is it in mN, or in grams"),
        (lambda d, f: (d, 1e-3 * f), "is it in kN"),
        (lambda d, f: (d, np.roll(f, N // 2)), "does not grow with depth"),
    ],
)
def test_mixed_up_units_and_signs_are_refused(tmp_path, change, words):
    """The message says what may be wrong."""
    with pytest.raises(FitError) as error:
        notes(tmp_path, text(*change(*good())))
    assert words in str(error.value)


def test_wrong_times_are_refused(tmp_path):
    """Those that fall, and milliseconds that are called seconds."""
    depth, force = good()
    with pytest.raises(FitError, match=r"time: got 0 s after 0.2 s, allowed: rising"):
        notes(tmp_path, text(depth, force, np.where(np.arange(N) == 1, 0.2, np.arange(N) * 1.0) * (np.arange(N) != 2)))
    with pytest.raises(FitError, match="is time in ms"):
        notes(tmp_path, text(depth, force, 1e3 * np.arange(N)))


def test_a_good_press_is_told_nothing_of(tmp_path):
    """And nothing of it is left out."""
    (press,), told = checked(presses(tmp_path, text(*good())), SCENE, MESH)
    assert told == []
    assert len(press.time) == N


def test_doubts_are_told(tmp_path):
    """Saturation, drift, a sensor that is not zero, force before contact and contact before force."""
    depth, force = good()
    (press,), told = checked(presses(tmp_path, text(depth, np.minimum(force, 2.0))), SCENE, MESH)
    assert "2 N while depth goes from" in told[0]
    assert "left out" in told[0]
    assert press.normal.max() < 2.0
    assert "drifts from 0 N before to 0.3 N after" in notes(
        tmp_path, text(depth, force + np.linspace(0.0, 0.33, N) // 0.3 * 0.3)
    )
    assert "0.4 N before contact; zero the sensor" in notes(tmp_path, text(depth, force + 0.4))
    assert "force before contact" in notes(tmp_path, text(depth - 0.35, force))
    assert "first touch is later than" in notes(tmp_path, text(depth + 1.8, force))


def test_a_bag_is_a_press(tmp_path):
    """Poses and a wrench in world axes, of a plane that lies anyhow: depth along its normal, force in its axes."""
    turned = block(plane__normal=[0.0, 1.0, 0.0], plane__point=[0.0, 0.5, 0.0])
    # the block's z along world y: a quarter turn about x, by −90°
    turn = (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    path = tmp_path / "bag"
    with BagWriter(path) as bag:
        bag.add_topic("/finger/pose", cdr.POSE_STAMPED)
        bag.add_topic("/finger/contact_wrench", cdr.WRENCH_STAMPED)
        for k in range(100):
            now = 1_700_000_000_000_000_000 + 10_000_000 * k
            depth = 1e-3 * math.sin(math.pi * k / 99)
            bag.write("/finger/pose", cdr.pose_stamped(now, "world", (0.0, 0.5 - depth, 0.0), turn), now)
            bag.write("/finger/contact_wrench", cdr.wrench_stamped(now, "world", (0.5, 2e3 * depth, 0, 0, 0, 0)), now)
    (press,) = read_bag(path, turned, MESH)
    assert press.depth.max() == pytest.approx(1e-3, rel=1e-2)
    np.testing.assert_allclose(press.normal, 2e3 * press.depth, atol=0.05)
    np.testing.assert_allclose(press.tangential[:, 0], 0.5, rtol=1e-9)
    up = press.orientation[0]
    np.testing.assert_allclose(np.abs(up @ LEVEL), 1.0, atol=1e-12)


def test_a_target_is_a_curve():
    """k = b + m F with a point is F = (b/m)(exp(m d) − 1) through it; points alone are points."""
    press = target_press("1 N at 1.5 mm, k = b + mF with m = 2/mm", SCENE, MESH)
    F, d = press.normal, press.depth
    assert np.interp(1.0, F, d) == pytest.approx(1.5e-3, rel=3e-3)
    k = np.gradient(F, d)
    m, _ = np.polyfit(F[1:-1], k[1:-1], 1)
    assert m == pytest.approx(2000.0, rel=0.05)
    same = target_press("k = b + mF, b = 0.2 N/mm, 1 N at 1.5 mm", SCENE, MESH)
    slope = np.gradient(same.normal, same.depth)
    assert np.polyfit(same.normal[1:-1], slope[1:-1], 1)[1] == pytest.approx(200.0, rel=0.1)
    both = target_press("0.2 N at 0.5 mm, 1 N at 1 mm", SCENE, MESH)
    np.testing.assert_allclose(both.normal, [0.2, 1.0])
    np.testing.assert_allclose(both.depth, [5e-4, 1e-3])


@for_each(
    "words, said",
    [
        ("1 N", "got '1 N', allowed: points as"),
        ("1 N at 1.5 mm, k = b + mF", "1 points, neither b nor m"),
        ("m = 2 N/mm", "got 'm = 2 N/mm'"),
        ("-1 N at 1 mm", "both above 0"),
        ("1 N at 1 mm, b = 2 N/mm", "is not below 1 N/mm"),
    ],
)
def test_a_target_that_is_no_curve_is_refused(words, said):
    with pytest.raises(FitError) as error:
        target_press(words, SCENE, MESH)
    assert said in str(error.value)

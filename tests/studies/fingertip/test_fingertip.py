"""Laws of fingertips: fitted lines against closed forms, verdicts on curves that obey and that do not."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_fingers import small

from finger_sim.plain import plain
from finger_sim.studies.fingertip.laws import exponent, stiffness_line, tangent
from finger_sim.studies.fingertip.measures import Fingertip, Shear, part_below

B, M = 300.0, 1800.0


def exponential(b: float = B, m: float = M) -> tuple[np.ndarray, np.ndarray]:
    """F = (b/m)(exp(m d) − 1), whose stiffness is b + m F."""
    depth = np.linspace(0.0, 2.2e-3, 200)
    return depth, b / m * np.expm1(m * depth)


def obedient() -> Fingertip:
    """A finger that obeys all laws."""
    depth, force = exponential()
    loads, way = np.array([0.5, 1.0, 2.0]), np.linspace(0.0, 2e-3, 10)
    shears = [Shear(load, way, load * way, 1e-4 * (1.0 - 100.0 * way)) for load in (1.0, 4.0)]
    return Fingertip(0.5, depth, force, 1e-4 * force ** (1 / 3), loads, 700.0 * loads, 300.0 * loads[:2], shears)


def test_a_law_is_found_in_its_own_curve():
    """b, m and R² of an exponential; the tangent is dF/dd."""
    line = stiffness_line(*exponential())
    assert line is not None
    assert (line.b, line.m, line.R2) == (
        pytest.approx(B, rel=0.02),
        pytest.approx(M, rel=0.01),
        pytest.approx(1.0, abs=1e-4),
    )
    F, k = tangent(*exponential())
    np.testing.assert_allclose(k, B + M * F, rtol=1e-2)
    assert stiffness_line(*(values[:4] for values in exponential())) is None
    assert exponent(np.array([1.0, 2.0, 4.0]), np.array([3.0, 12.0, 48.0])) == pytest.approx(2.0)


def test_part_of_a_triangle_below_a_level():
    """Against points drawn in the triangle; whole and none where all corners are on one side."""
    draw = np.random.default_rng(0)
    values = np.concatenate([draw.standard_normal((30, 3)), [[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0], [0.0, 0.0, -1.0]]])
    points = draw.dirichlet([1.0, 1.0, 1.0], 20_000)
    np.testing.assert_allclose(part_below(values), (points @ values.T < 0.0).mean(axis=0), atol=0.015)


def test_verdicts():
    """An obedient finger agrees; one that breaks a law differs, with a reason; JSON and a picture take all of it."""
    pytest.importorskip("matplotlib")
    from finger_sim.studies.fingertip import figure

    good = obedient()
    assert [finding.agrees for finding in figure.findings(good)] == [True, True, True, None]
    depth = good.depth
    bad = Fingertip(
        0.5, depth, 1.5e6 * depth**2, good.area, good.loads, 700.0 * good.loads**2, good.unlimited,
        [Shear(s.load, s.way, s.force, s.area[::-1]) for s in good.shears],
    )  # fmt: skip
    verdicts = figure.findings(bad)
    assert [finding.agrees for finding in verdicts[:3]] == [False, False, False]
    assert all(finding.reason for finding in verdicts[:3])
    assert verdicts[1].reason == "limits: to 1 N the power is 2.00 with them, 1.00 without"
    json.dumps(plain(figure.numbers(good)), allow_nan=False)
    assert len(figure.draw(good).axes) == 4


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_finger_is_measured():
    """The small finger: force, area and stiffness grow; shear ends near Coulomb's friction at the load that is held."""
    from finger_sim.studies.fingertip.measures import measured

    found = measured(small("finger_haptic"), lambda *_: None)
    assert (np.diff(found.force) >= 0.0).all()
    assert found.force[-1] > 5.0
    assert found.tangential[-1] > 10.0 * found.tangential[0] > 0.0
    for shear in found.shears:
        assert shear.force[-1] == pytest.approx(found.friction * shear.load, rel=0.15)
        assert shear.force.max() <= found.friction * shear.load * 1.02

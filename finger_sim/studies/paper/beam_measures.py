"""What is read off a beam that swings: where it hangs, how long it is, how it strains; and how a signal swings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import curve_fit

from ...arrays import Floats
from ...bags.layout import node_strain
from ...physics.step import Status
from ...scene import Scene
from ...scene.mesh import TetMesh
from ...simulation.simulator import Simulator

LAST = 1.0
"""Of a run to rest that its numbers are taken from [s]."""
LATE = 0.3
"""Part of a swing after which its frequency is read: at first it is too large for one."""
SMALL = 1e-3
"""Of gravity, for small loads."""
QUADRATIC_SAG = 1.86188
"""Tip of the stiff beam under its weight, were it to sag in proportion: quadratic tetrahedra, the same mesh [m]."""


class Series(NamedTuple):
    """What a beam does, step by step; arrays (steps,)."""

    time: Floats  # [s]
    deflection: Floats  # of the tip, downwards [m]
    length: Floats  # of the axis over that of the undeformed beam
    stretch: Floats  # |F e1|, mean over the volume
    shear: Floats  # |cosine| between F e1 and F e3, mean over the volume
    strain: Floats  # largest strain/limit
    limited: Floats  # tetrahedra that a limit holds
    speed: Floats  # rms over the nodes [m/s]
    capped: Floats  # 1 where the solver stopped before its tolerance


@dataclass(frozen=True)
class Run:
    """A beam let go, and how it ended."""

    scene: Scene
    mesh: TetMesh
    series: Series
    points: Floats  # (n, 3) of the last step [m]
    strain: Floats  # (n,) strain/limit of the last step, the largest of the tetrahedra around each node


class Ruler:
    """Measures a beam that lies along x when undeformed."""

    def __init__(self, mesh: TetMesh) -> None:
        X, tets = mesh.points, mesh.tets
        sections = np.unique(X[:, 0].round(9), return_inverse=True)[1]
        members = (sections == np.arange(sections.max() + 1)[:, None]).astype(np.float64)
        self._middles = members / members.sum(axis=1, keepdims=True)
        self._tip_height = float((self._middles @ X)[-1, 2])
        self._undeformed_length = 1.0
        self._undeformed_length = self.length(X)
        edges = np.swapaxes(X[tets[:, :3]] - X[tets[:, 3:]], 1, 2)
        gradients = np.linalg.inv(edges)
        gradients = np.concatenate([gradients, -gradients.sum(axis=1, keepdims=True)], axis=1)
        by_node = np.zeros((3, len(tets), len(X)))
        for corner in range(4):
            by_node[:, np.arange(len(tets)), tets[:, corner]] = gradients[:, corner].T
        self._along, _, self._up = by_node
        volume = np.linalg.det(edges)
        self._share = volume / volume.sum()

    def deflection(self, x: Floats) -> float:
        """How far the middle of the tip hangs below where it was [m]."""
        return self._tip_height - float(self._middles[-1] @ x[:, 2])

    def length(self, x: Floats) -> float:
        """Length of the line through the middles of the cross-sections, over that when undeformed."""
        return float(np.linalg.norm(np.diff(self._middles @ x, axis=0), axis=1).sum()) / self._undeformed_length

    def stretch_and_shear(self, x: Floats) -> tuple[float, float]:
        """Means over the volume of |F e1|, and of |cosine| between F e1 and F e3."""
        along, up = self._along @ x, self._up @ x
        size = np.linalg.norm(along, axis=1)
        cosine = np.abs((along * up).sum(axis=1)) / (size * np.linalg.norm(up, axis=1))
        return float(self._share @ size), float(self._share @ cosine)


def let_go(scene: Scene, duration: float, done: Callable[[], None]) -> Run:
    """The beam of the scene, straight and at rest at first, for so long [s]; `done` is called after each step."""
    simulator = Simulator(scene)
    ruler = Ruler(simulator.mesh)
    rows = []
    for _ in range(round(duration / scene.dt)):
        out = simulator.step()
        x = simulator.positions
        speed = math.sqrt(float((simulator.velocities**2).sum(axis=1).mean()))
        capped = float(bool(out.status & Status.ITERATION_LIMIT))
        shape = (ruler.deflection(x), ruler.length(x), *ruler.stretch_and_shear(x))
        rows.append((out.time, *shape, out.max_strain_ratio, float(out.limited_tets), speed, capped))
        done()
    mesh = simulator.mesh
    strain = node_strain(simulator.strain_ratio, mesh.tets, len(mesh.points))
    return Run(scene, mesh, Series(*np.array(rows).T), simulator.positions.copy(), strain)


class Measured(NamedTuple):
    """One beam."""

    swing: Run
    rest: Run


class Rest(NamedTuple):
    """A beam at rest: means over the last LAST of a damped run, which `speed` says how much of a rest it is."""

    deflection: float  # [m]
    length: float
    stretch: float
    shear: float
    strain: float  # largest strain/limit: median
    strain_max: float
    limited: float
    speed: float  # rms over nodes and time [m/s]


def at_rest(run: Run) -> Rest:
    """Of a run that was damped until it rests."""
    s = run.series
    last = s.time > s.time[-1] - LAST
    return Rest(
        deflection=float(s.deflection[last].mean()),
        length=float(s.length[last].mean()),
        stretch=float(s.stretch[last].mean()),
        shear=float(s.shear[last].mean()),
        strain=float(np.median(s.strain[last])),
        strain_max=float(s.strain[last].max()),
        limited=float(s.limited[last].mean()),
        speed=math.sqrt(float((s.speed[last] ** 2).mean())),
    )


class Oscillation(NamedTuple):
    """A signal as a decaying oscillation."""

    frequency: float  # [Hz]
    decay: float  # rate at which its amplitude falls [1/s]
    damping_ratio: float
    amplitude: float  # half of its range in the first period
    middle: float  # what it swings about
    explained: float  # share of its variance that one damped cosine has


def oscillation(time: Floats, signal: Floats) -> Oscillation:
    """The frequency of the damped cosine nearest to a signal, and how the rms of each period falls.

    The rms, not the cosine's own decay: a large swing is no cosine, and its middle moves. Decay and damping ratio are
    NaN where the signal has less than two whole periods.
    """
    t = time - time[0]
    guess = 2.0 * math.pi * _peak(t, signal)
    around = _damped_cosine(t, 0.0, 1.0, 0.0, 0.0, guess), _damped_cosine(t, 0.0, 0.0, 1.0, 0.0, guess)
    basis = np.stack([np.ones_like(t), *around], axis=1)
    linear = np.linalg.lstsq(basis, signal, rcond=None)[0]
    found, _ = curve_fit(_damped_cosine, t, signal, [*linear, 0.1, guess], maxfev=10_000)
    omega = abs(float(found[4]))
    rest = signal - _damped_cosine(t, *found)
    period = 2.0 * math.pi / omega
    decay = _decay(t, signal, period)
    return Oscillation(
        frequency=1.0 / period,
        decay=decay,
        damping_ratio=decay / math.hypot(decay, omega),
        amplitude=0.5 * float(np.ptp(signal[t < period])),
        middle=float(found[0]),
        explained=1.0 - float(rest.var() / signal.var()),
    )


def late_oscillation(run: Run, signal: Floats) -> Oscillation:
    """Of one of the run's series, past LATE of it."""
    time = run.series.time
    late = time > LATE * time[-1]
    return oscillation(time[late], signal[late])


def time_to_settle(time: Floats, signal: Floats, middle: float, share: float = 0.1) -> float:
    """When a signal is last further from `middle` than this share of the furthest [s]; ∞: not before its last LAST."""
    away = np.abs(signal - middle)
    last = float(time[np.flatnonzero(away > share * away.max())[-1]])
    return last if last < time[-1] - LAST else math.inf


class Cantilever(NamedTuple):
    """What beam theory says of a solid bar held at one end, under small loads."""

    sag: float  # of the tip under its own weight, with shear (Timoshenko) [m]
    frequency: float  # first, in bending, without shear (Euler-Bernoulli) [Hz]


def cantilever(scene: Scene) -> Cantilever:
    """Of a generated beam of square cross-section that lies along x under gravity along −z."""
    assert scene.mesh.beam is not None
    length, width, depth = scene.mesh.beam.size
    young, poisson, density = scene.material.young, scene.material.poisson, scene.material.density
    area, inertia = width * depth, width * depth**3 / 12.0
    weight = -scene.gravity[2] * density * area
    kappa = 10.0 * (1.0 + poisson) / (12.0 + 11.0 * poisson)
    shear = kappa * area * young / (2.0 * (1.0 + poisson))
    sag = weight * length**4 / (8.0 * young * inertia) + weight * length**2 / (2.0 * shear)
    omega = (1.875104 / length) ** 2 * math.sqrt(young * inertia / (density * area))
    return Cantilever(sag, omega / (2.0 * math.pi))


def beam_numbers(beam: Measured) -> dict[str, Any]:
    """What a figure claims of one beam; units in the keys' ends."""
    scene, swing, rest = beam.swing.scene, beam.swing.series, at_rest(beam.rest)
    held = swing.strain[swing.strain > 0.5]
    return {
        "young_pa": scene.material.young,
        "projection": scene.limits.projection if scene.limits else None,
        "method": scene.solver.method if scene.limits else None,
        "rest_tip_deflection_m": rest.deflection,
        "rest_length_ratio": rest.length,
        "rest_stretch_e1": rest.stretch,
        "rest_shear_13": rest.shear,
        "rest_limited_tets": rest.limited,
        "rest_strain_over_limit_median": rest.strain,
        "rest_strain_over_limit_max": rest.strain_max,
        "rest_rms_speed_m_per_s": rest.speed,
        "rest_capped_steps_share": float(beam.rest.series.capped.mean()),
        "swing_tip_deflection_max_m": float(swing.deflection.max()),
        "swing_length_ratio_max": float(swing.length.max()),
        "swing_stretch_e1_max": float(swing.stretch.max()),
        "swing_limited_tets_max": float(swing.limited.max()),
        "swing_strain_over_limit_median": float(np.median(held)) if held.size else 0.0,
        "swing_strain_over_limit_max": float(swing.strain.max()),
        "swing_capped_steps_share": float(swing.capped.mean()),
        "tip": _oscillation_numbers(beam.swing, swing.deflection, "_m"),
        "length": _oscillation_numbers(beam.swing, swing.length, ""),
    }


def small_load(small: Measured) -> dict[str, float]:
    """A beam under SMALL of gravity, where it sags in proportion; lengths are scaled up to the whole of it."""
    theory = cantilever(small.rest.scene)
    return {
        "gravity_share": SMALL,
        **small_sag(small.rest),
        "sag_quadratic_m": QUADRATIC_SAG,
        "sag_beam_theory_m": theory.sag / SMALL,
        "frequency_hz": late_oscillation(small.swing, small.swing.series.deflection).frequency,
        "frequency_beam_theory_hz": theory.frequency,
    }


def small_sag(rest: Run) -> dict[str, float]:
    """Of the stiff beam at rest under SMALL of gravity, scaled up to the whole of it, beside quadratic tetrahedra."""
    sag = at_rest(rest).deflection / SMALL
    return {
        "sag_m": sag,
        "sag_below_quadratic_percent": 100.0 * (1.0 - sag / QUADRATIC_SAG),
        "stiffness_over_quadratic": QUADRATIC_SAG / sag,
    }


def _oscillation_numbers(run: Run, signal: Floats, unit: str) -> dict[str, float]:
    """Of one of the run's series; `unit`: the end of keys in its unit."""
    late = late_oscillation(run, signal)
    return {
        "frequency_hz": late.frequency,
        "decay_per_s": late.decay,
        "damping_ratio": late.damping_ratio,
        "explained": late.explained,
        f"middle{unit}": late.middle,
        f"late_amplitude{unit}": late.amplitude,
        f"largest_departure{unit}": float(np.abs(signal - late.middle).max()),
        "within_a_tenth_after_s": time_to_settle(run.series.time, signal, late.middle),
    }


def _peak(t: Floats, signal: Floats) -> float:
    """Frequency where the spectrum is highest [Hz], of a signal evenly sampled over more than one period."""
    padded = 8 * len(t)
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(t)), padded))
    frequency = np.fft.rfftfreq(padded, t[1] - t[0])
    spectrum[frequency < 1.0 / t[-1]] = 0.0
    return float(frequency[spectrum.argmax()])


def _damped_cosine(t: Floats, middle: float, a: float, b: float, decay: float, omega: float) -> Floats:
    return middle + np.exp(-decay * t) * (a * np.cos(omega * t) + b * np.sin(omega * t))


def _decay(t: Floats, signal: Floats, period: float) -> float:
    """Rate at which the logarithm of the rms about the mean of each whole period falls [1/s]; NaN: fewer than two."""
    count = int(t[-1] / period)
    if count < 2:
        return math.nan
    rms = [float(signal[(t >= k * period) & (t < (k + 1) * period)].std()) for k in range(count)]
    return -float(np.polyfit(period * np.arange(count), np.log(rms), 1)[0])

r"""A bone that yields: the driven nodes as one rigid body between the tissue and a spring to the commanded pose.

The virtual coupling of haptics (Colgate, Stanley & Brown 1995; Adams & Hannaford 1999), six degrees of freedom, solved
for together with the tissue. V = (w, ω) is the bone's velocity at the finger frame's origin p, world [m/s, rad/s]. A
driven node at arm ρ_d = x_d − p moves by v_d = G_d V, G_d = [I, −[ρ_d]×]. Before that is used the driven nodes are
nodes like others: with their masses, their weight, their blocks of A and their part of limit rows. Residuals on them
add up to one of the bone, Σ G_dᵀ r_d, and to it come h times

    spring  f = k (p_c − p − h w) + d (v_c − w),   τ = k_r (θ − h ω) + d_r (ω_c − ω),   |f| ≤ F, |τ| ≤ T,

θ the rotation vector from the bone to the command (p_c, v_c, ω_c: the commanded pose at the step's end and its
velocity); the weight of the whole body, which the coupling bears by itself, so that it is at the commanded pose when
nothing touches it; and a stop that keeps the driven nodes' mean out of the plane. All is implicit in V: stable at any k
and h.

Newton's method eliminates V last: see border.py.

Slots after the free nodes' and the empty one: nf + 1 the bone's translation, nf + 2 its rotation, then the driven
nodes, where vectors of velocity hold G_d V.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import stage
from .lanes import load4, splat4, store4
from .model import Model, State
from .vectors import cross

_STOP = 1e3  # stiffness of the stop, in units of the body's inertia within a step, and ten times the spring's at least


@stage
def aim_bone(model: Model, state: State, h: float, again: bool) -> None:
    """What the linear step needs to know of the bone at state.x: arms, wrenches at its present velocity, its stop.

    again: state.x is an estimate of the step's end, else its start, from which the present velocity leads on.
    """
    driven, x, v = model.driven, state.x, state.v
    pose, twist, target, bone = state.bone[7:], state.twist, state.target, state.yielding
    base, arms, load, stop = bone.base, bone.arms, bone.load, bone.stop
    lead = 0.0 if again else h
    mean0 = mean1 = mean2 = 0.0
    for d in range(driven.shape[0]):
        n = driven[d]
        a0, a1, a2 = x[n, 0] - pose[0], x[n, 1] - pose[1], x[n, 2] - pose[2]
        arms[d, 0], arms[d, 1], arms[d, 2] = a0, a1, a2
        mean0, mean1, mean2 = mean0 + a0, mean1 + a1, mean2 + a2
        v[n, 0] = twist[0] + twist[4] * a2 - twist[5] * a1
        v[n, 1] = twist[1] + twist[5] * a0 - twist[3] * a2
        v[n, 2] = twist[2] + twist[3] * a1 - twist[4] * a0
        store4(state.driven_velocity, n, 0, load4(v, n, 0))
    turn = rotation_between(pose[3:], target[3:])
    spring = model.spring
    for i in range(3):
        base[i] = spring[0, 0] * (target[i] - pose[i] - lead * twist[i]) + spring[0, 1] * (target[7 + i] - twist[i])
        base[3 + i] = spring[1, 0] * (turn[i] - lead * twist[3 + i]) + spring[1, 1] * (target[10 + i] - twist[3 + i])
    gravity, total = model.gravity, 0.0
    m0 = m1 = m2 = 0.0
    for n in range(x.shape[0]):
        mass = model.mass[n]
        total += mass
        m0, m1, m2 = m0 + mass * x[n, 0], m1 + mass * x[n, 1], m2 + mass * x[n, 2]
    m0, m1, m2 = m0 - total * pose[0], m1 - total * pose[1], m2 - total * pose[2]
    load[0], load[1], load[2] = -total * gravity[0], -total * gravity[1], -total * gravity[2]
    load[3] = -(m1 * gravity[2] - m2 * gravity[1])
    load[4] = -(m2 * gravity[0] - m0 * gravity[2])
    load[5] = -(m0 * gravity[1] - m1 * gravity[0])
    pull = math.sqrt(base[0] * base[0] + base[1] * base[1] + base[2] * base[2])
    bone.reach[0] = h * min(pull, model.spring_limit[0]) / total
    if model.has_plane:
        count = driven.shape[0]
        mean0, mean1, mean2 = mean0 / count, mean1 / count, mean2 / count
        n0, n1, n2 = state.plane_frame[0, 0], state.plane_frame[0, 1], state.plane_frame[0, 2]
        stop[0], stop[1], stop[2] = n0, n1, n2
        stop[3], stop[4], stop[5] = mean1 * n2 - mean2 * n1, mean2 * n0 - mean0 * n2, mean0 * n1 - mean1 * n0
        point = state.plane_point
        gap = n0 * (mean0 + pose[0] - point[0]) + n1 * (mean1 + pose[1] - point[1]) + n2 * (mean2 + pose[2] - point[2])
        for i in range(6):
            gap += lead * stop[i] * twist[i]
        stop[6], stop[7] = gap, max(_STOP * total / (h * h), 10.0 * spring[0, 0])


@stage
def bone_residual(model: Model, state: State, h: float, change: Floats, r: Floats) -> None:
    """Gather the residual of the bone at `change` into slots nf + 1 and nf + 2 of r.

    The driven nodes' slots of r become 0. The spring's wrench on the bone goes into state.coupling [N, N m], the stop's
    force into state.yielding.stop[8] [N].
    """
    nf, bone, spring, coupling = model.free.shape[0], state.yielding, model.spring, state.coupling
    arms, base, load, pulls, stop = bone.arms, bone.base, bone.load, bone.pulls, bone.stop
    force, t0, t1, t2 = splat4(0.0), 0.0, 0.0, 0.0
    for d in range(arms.shape[0]):
        f = load4(r, nf + 3 + d, 0)
        force = force + f
        a, b, c = cross(load4(arms, d, 0), f)
        t0, t1, t2 = t0 + a, t1 + b, t2 + c
        store4(r, nf + 3 + d, 0, splat4(0.0))
    store4(r, nf + 1, 0, force)
    r[nf + 2, 0], r[nf + 2, 1], r[nf + 2, 2] = t0, t1, t2
    for part in range(2):
        gives, slot = h * spring[part, 0] + spring[part, 1], nf + 1 + part
        size = 0.0
        for i in range(3):
            pull = base[3 * part + i] - gives * change[slot, i]
            coupling[3 * part + i] = pull
            size += pull * pull
        size = math.sqrt(size)
        share = 1.0
        if size > model.spring_limit[part]:
            share = model.spring_limit[part] / size
        pulls[part, 3] = share
        for i in range(3):
            pulls[part, i] = coupling[3 * part + i] / size if share < 1.0 else 0.0
            coupling[3 * part + i] *= share
            r[slot, i] += h * (coupling[3 * part + i] + load[3 * part + i])
    stop[8] = 0.0
    if model.has_plane:
        gap = stop[6]
        for i in range(3):
            gap += h * (stop[i] * change[nf + 1, i] + stop[3 + i] * change[nf + 2, i])
        if gap < 0.0:
            stop[8] = -stop[7] * gap
            for i in range(3):
                r[nf + 1, i] += h * stop[8] * stop[i]
                r[nf + 2, i] += h * stop[8] * stop[3 + i]


@stage
def bone_slope(model: Model, state: State, h: float, change: Floats, direction: Floats, part: float) -> float:
    """What spring, stop and weight of `bone_residual` have along `direction`, at change + part · direction."""
    nf, bone, spring, stop, total = model.free.shape[0], state.yielding, model.spring, state.yielding.stop, 0.0
    for k in range(2):
        gives, slot = h * spring[k, 0] + spring[k, 1], nf + 1 + k
        size = pulled = borne = 0.0
        for i in range(3):
            d = direction[slot, i]
            pull = bone.base[3 * k + i] - gives * (change[slot, i] + part * d)
            size += pull * pull
            pulled += pull * d
            borne += bone.load[3 * k + i] * d
        size = math.sqrt(size)
        share = model.spring_limit[k] / size if size > model.spring_limit[k] else 1.0
        total += h * (share * pulled + borne)
    if model.has_plane:
        gap, rate = stop[6], 0.0
        for i in range(3):
            gap += h * (stop[i] * change[nf + 1, i] + stop[3 + i] * change[nf + 2, i])
            rate += h * (stop[i] * direction[nf + 1, i] + stop[3 + i] * direction[nf + 2, i])
        total += rate * max(0.0, -stop[7] * (gap + part * rate))
    return total


@stage
def move_bone(model: Model, state: State, h: float) -> None:
    """The bone's pose now: that of the step's start moved by its velocity for h; the finger frame's origin."""
    start, pose, twist = state.bone[:7], state.bone[7:], state.twist
    for i in range(3):
        pose[i] = state.origin[i] = start[i] + h * twist[i]
    turned = turned_by(start[3:], h * twist[3], h * twist[4], h * twist[5])
    for i in range(4):
        pose[3 + i] = turned[i]


@stage
def place_driven(model: Model, state: State) -> None:
    """The driven nodes where the bone's pose has them."""
    rest, driven, x, pose = model.rest_driven, model.driven, state.x, state.bone[7:]
    a, b, c, w = pose[3], pose[4], pose[5], pose[6]
    for d in range(driven.shape[0]):
        n, r0, r1, r2 = driven[d], rest[d, 0], rest[d, 1], rest[d, 2]
        s0, s1, s2 = 2.0 * (b * r2 - c * r1), 2.0 * (c * r0 - a * r2), 2.0 * (a * r1 - b * r0)
        x[n, 0] = pose[0] + r0 + w * s0 + b * s2 - c * s1
        x[n, 1] = pose[1] + r1 + w * s1 + c * s0 - a * s2
        x[n, 2] = pose[2] + r2 + w * s2 + a * s1 - b * s0


@stage
def turned_by(q: Floats, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The orientation q (x y z w) turned by the rotation vector (x, y, z) [rad], world axes; of unit length."""
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    x, y, z, w = s * x, s * y, s * z, math.cos(0.5 * angle)
    a, b, c, d = (
        w * q[0] + x * q[3] + y * q[2] - z * q[1],
        w * q[1] + y * q[3] + z * q[0] - x * q[2],
        w * q[2] + z * q[3] + x * q[1] - y * q[0],
        w * q[3] - x * q[0] - y * q[1] - z * q[2],
    )
    size = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return a * size, b * size, c * size, d * size


@stage
def rotation_between(a: Floats, b: Floats) -> tuple[float, float, float]:
    """Rotation vector [rad] from orientation a to b (x y z w), world axes, the shorter way."""
    x = b[0] * a[3] - b[3] * a[0] - b[1] * a[2] + b[2] * a[1]
    y = b[1] * a[3] - b[3] * a[1] - b[2] * a[0] + b[0] * a[2]
    z = b[2] * a[3] - b[3] * a[2] - b[0] * a[1] + b[1] * a[0]
    w = b[3] * a[3] + b[0] * a[0] + b[1] * a[1] + b[2] * a[2]
    size = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(size, abs(w)) / size if size > 1e-12 else 2.0
    if w < 0.0:
        factor = -factor
    return factor * x, factor * y, factor * z

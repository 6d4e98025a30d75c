"""A step's wrench on its way to the device in one call: against its parts one after the other, and NumPy and SciPy."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numba
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from finger_sim.haptics.passivity import Port
from finger_sim.haptics.rendering import Rendering
from finger_sim.haptics.sending import BACK, BECAME_STALE, Sender
from finger_sim.scene import Coupling, Pose

MS = 0.001
LIMITS = Coupling(force_limit=6.0, torque_limit=0.2)
Array = NDArray[np.float64]


@dataclasses.dataclass
class Step:
    """What one step is given. Times in s."""

    wrench: Array
    pose: Pose
    motion: Array
    fresh: bool
    transport: float
    age: float
    took: float

    def sent_by(self, sender: Sender) -> tuple[Array, int]:
        command = self.pose if self.fresh else None
        return sender.send(
            self.wrench, LIMITS, command, MS, transport=self.transport, age=self.age, took=self.took
        )  # fmt: skip


def stream(seed: int, steps: int, every: int = 1) -> Iterator[Step]:
    """Of a hand that wanders and turns, in the grip of random wrenches; a command each so many steps."""
    rng = np.random.default_rng(seed)
    at, turn, since = rng.normal(size=3), Rotation.random(rng=rng), 0
    for k in range(steps):
        motion, since = np.zeros(6), since + 1
        if k % every == 0:
            motion, since = rng.normal(size=6) * [2e-4, 2e-4, 2e-4, 1e-3, 1e-3, 1e-3] * (k > 0), 0
            at, turn = at + motion[:3], Rotation.from_rotvec(motion[3:]) * turn
        pose = Pose(tuple(at.tolist()), tuple((rng.choice([-1.0, 1.0]) * turn.as_quat()).tolist()))
        wrench = rng.normal(size=6) * [4.0, 4.0, 4.0, 0.1, 0.1, 0.1]
        times = rng.uniform(0.0, 2 * MS), since * MS + rng.uniform(0.0, 0.5 * MS), rng.uniform(0.0, 0.5 * MS)
        yield Step(wrench, pose, motion, k % every == 0, *times)


def made(control: bool, scale: float = 1.5, ramp: float = 0.05, timeout: float = 0.02) -> Sender:
    sender = Sender(MS)
    sender.rendering.scale, sender.rendering.ramp, sender.rendering.timeout = scale, ramp, timeout
    sender.port.controlled = control
    return sender


@for_each("every", [1, 3, 40])
@for_each("control", [False, True])
def test_a_step_is_rendered_and_then_passes_the_port(control: bool, every: int) -> None:
    """What the parts give in turn, for a motion that SciPy tells; of commands each 40 ms every one goes stale."""
    sender, rendering = made(control), Rendering(1.5, 0.05, 0.02)
    port = Port(MS, control, force_limit=6.0, torque_limit=0.2)
    delay, seen = 0.0, set()
    for step in stream(every, 400, every):
        was = rendering.stale
        recent = rendering.watch(step.age)
        wrench = rendering.render(step.wrench, LIMITS, MS)
        if step.fresh:
            delay = 2.0 * step.transport + step.age + step.took
        wrench = np.array(port.step(wrench.tolist(), step.motion.tolist(), delay, step.fresh))
        device, told = step.sent_by(sender)
        assert_allclose(device, wrench, rtol=0, atol=1e-6)  # unlike SciPy's motions, divided by uneven delays
        assert told == (BACK if was and recent else 0 if recent or was else BECAME_STALE)
        assert sender.delay == pytest.approx(delay)
        seen.add(told)
    assert seen == ({0, BACK, BECAME_STALE} if every == 40 else {0})
    for name in ("energy", "leak", "leaked", "dissipated", "forgiven", "factor", "damping"):
        assert getattr(sender.port, name) == pytest.approx(getattr(port, name), rel=1e-6, abs=1e-12), name
    assert (sender.port.dissipated != 0.0) == (control and every < 40)


def test_the_way_there_and_back_and_the_step_itself_are_the_delay() -> None:
    """The energy is that of wrenches held three steps later, scaled, let in over 50 ms and clamped as NumPy has it."""
    sender, sent, energy = made(control=False), [np.zeros(6)] * 4, 0.0
    for k, step in enumerate(stream(5, 200)):
        step.transport, step.age, step.took = 0.9 * MS, 0.4 * MS, 0.8 * MS
        scaled = 1.5 * min(1.0, (k + 1) / 50) * step.wrench
        for part, limit in ((slice(0, 3), 6.0), (slice(3, 6), 0.2)):
            scaled[part] *= min(1.0, limit / np.linalg.norm(scaled[part]))
        assert_allclose(step.sent_by(sender)[0], scaled, rtol=1e-12)
        sent.append(scaled)
        energy += sent[-5] @ step.motion
        assert sender.port.energy == pytest.approx(energy, abs=1e-12)
    assert abs(energy) > 1e-4


@for_each("bad", [math.nan, math.inf, -math.inf])
@for_each("control", [False, True])
def test_what_is_not_finite_counts_as_no_wrench(bad: float, control: bool) -> None:
    """Only the damper's part is sent then, and from then on all is as if that step had had no wrench."""
    sender, other = made(control), made(control)
    for k, step in enumerate(stream(1, 120)):
        nothing = dataclasses.replace(step, wrench=np.zeros(6)) if k % 10 == 7 else step
        plain = nothing.sent_by(other)[0]
        if nothing is not step:
            step.wrench[k // 10 % 6] = bad
        device = step.sent_by(sender)[0]
        assert_array_equal(device, plain)
        assert device.any() == (nothing is step) or control
    for ours, theirs in zip(sender.port.record, other.port.record, strict=True):
        assert_array_equal(ours, theirs)
    assert math.isfinite(sender.port.energy)


def test_a_first_command_is_no_motion() -> None:
    """Wherever it is; and before it the port sees none."""
    sender, far = made(control=False, ramp=0.0), Pose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    for command in (None, far, far):
        sender.send(np.ones(6), LIMITS, command, MS, transport=0.0, age=0.0, took=0.0)
        assert sender.port.energy == 0.0
    sender.send(np.ones(6), LIMITS, Pose((1.0, 2.0, 3.1), far.orientation), MS, transport=0.0, age=0.0, took=0.0)
    assert sender.port.energy == pytest.approx(1.5 * 0.1)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="of compiled code")
def test_a_step_allocates_nothing() -> None:
    """Whether it is controlled, let through or stale: no more than taking four arrays from Python does."""
    from numba.core.runtime import _nrt_python, rtsys

    _nrt_python.memsys_enable_stats()
    steps, counts = [*stream(3, 200)], []
    for control, age in ((True, 0.0), (False, 0.0), (True, 1.0)):
        sender, out = made(control), np.zeros(6)
        call, record, before, now = sender._send, sender._held, np.array([0.0] * 6 + [1.0]), np.array([0.0] * 6 + [1.0])
        begin = rtsys.get_allocation_stats().alloc
        for step in steps:
            now[:3] = step.pose.position
            call(record, step.wrench, before, now, True, 0.0, age, 0.0, MS, out)
        counts.append(rtsys.get_allocation_stats().alloc - begin)
    assert max(counts) <= 4 * len(steps)

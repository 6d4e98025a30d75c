"""The loop's steps, in compiled code that holds no interpreter.

    wait for the deadline → take what came → step (simulation/whole.py) → send (haptics/sending.py) → keep accounts

`run` returns where Python is needed, and says for what; when it is called again it goes on where it was, on the same
grid of deadlines. That is rare where rcl can be called and steps have deadlines. Where Python takes and sends the
messages, it is so twice a step; where each step answers a command, once. ticker.py calls it. Times are in ns on the
steady clock, unless said.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Bytes, Floats, Ints
from ..bags import recording
from ..bags.recording import Recording
from ..haptics import following, phase, sending
from ..haptics.budget import Purse, spent
from ..haptics.coupling import clamped, turned_round
from ..haptics.path import read, write
from ..haptics.phase import Phase
from ..haptics.sending import Sending
from ..physics.atomics import load_acquire
from ..physics.compile import kernel, stage
from ..physics.model import Model, State
from ..physics.turns import matrix_entries
from ..simulation import whole
from ..simulation.whole import ASLEEP, DONE, FALLS_ASLEEP, FIRST, Body
from .accounts import MOST_TRANSPORT, Counted, Recent, add, count
from .device_bytes import CLUTCH, PASSED_OVER, POSITION, Inlet, take_in
from .device_fill import Outlets, fill_outlets
from .memory import bytes_at
from .pose_bytes import LOOK, read_pose
from .snapshot import Copied, hand_over, is_there, take_counted
from .wire import (
    ADDRESS,
    LENGTH,
    NOTHING,
    RECEIVED,
    Clock,
    Incoming,
    Outgoing,
    fill,
    publish,
    sleep_until,
    steady_ns,
    take,
    wall_ns,
)  # fmt: skip

ASKED, TO_LOOK, TO_PLACE, TO_MEND, TO_TELL, UNHEARD, TO_AWAIT, TO_TAKE, TO_SEND, TO_FIT = range(10)
"""Why `run` returned: somebody asked for a turn; a message is for Python to look at, or its subscription failed
(UNHEARD); the first command is to place the finger; the step is to be mended; `told` says what is to be told; a command
is to be waited for (see `answer`); messages are to be taken, or sent, by Python; a free body is to be found."""
BECAME_STALE, BACK, RUNG, UNSENT = 1, 2, 4, 8
"""Bits of `told`: those of sending.py; the budget has gone to another rung; a message could not be sent."""
_WAIT, _TAKE, _TAKEN, _STEP, _FILL, _SEND, _DONE = range(7)

DEVICE, CONTACT, POSE = range(3)
"""Messages that are sent."""
COMMAND, PLANE, BESIDE = range(3)
"""Subscriptions; from BESIDE on those of a device that tell more of its commands."""
WORLD_ALIGNED, FINGER, WORLD = range(3)
"""Axes and point of reference of contact_wrench; see layout.express_wrench."""


class Deadlines(NamedTuple):
    """The grid of a loop, and how far it has come; (1,) each. Deadline k lies at origin + moved + k · period.

    asked    : 1 where somebody wants a turn
    origin, period
    moved    : so that commands wait little; see haptics/phase.py
    k        : of the present step, or of the next one
    begun    : time at which the step began
    last     : time at which the last one was done
    steps, late, overruns : see StepCounts
    """

    asked: Ints
    origin: Ints
    period: Ints
    moved: Ints
    k: Ints
    begun: Ints
    last: Ints
    steps: Ints
    late: Ints
    overruns: Ints


class Heard(NamedTuple):
    """What came; (1,) each, unless said.

    newest    : (7,) numbers of the newest good command
    received  : time of its receipt; 0: there is none
    stamp     : of its header
    transport : (1,) time from its stamp to its receipt by the node's clock [s]; 0 where that cannot be of the same one
    before    : (7,) numbers of the command that the last step followed
    fresh     : 1 where no step has followed the newest
    zero      : receipt of the command that placed the finger; times are counted from it; 0: none has
    commands  : that came, good or not
    looked    : (n,) time of the last look at each subscription
    frame     : bytes of the frame_id that poses must have
    at        : (7,) a pose that is being read
    which     : subscription whose message is to be looked at, and
    when      : time of its receipt
    failure   : code of rcl, where it failed
    """

    newest: Floats
    received: Ints
    stamp: Ints
    transport: Floats
    before: Floats
    fresh: Ints
    zero: Ints
    commands: Ints
    looked: Ints
    frame: Bytes
    at: Floats
    which: Ints
    when: Ints
    failure: Ints


class Sent(NamedTuple):
    """What goes out; (1,) each, unless said.

    device, contact : (6,) wrenches as they are sent
    axes    : of contact: WORLD_ALIGNED, FINGER or WORLD
    limits  : (2,) of what a device is sent: force [N], torque [N m]
    topics  : (6,) numbers in the recording: device, contact, pose, commands, poses of the plane, the clutch
    stamp   : of the step, by the wall clock
    failure : code of rcl, where it failed
    """

    device: Floats
    contact: Floats
    axes: Ints
    limits: Floats
    topics: Ints
    stamp: Ints
    failure: Ints


class Live(NamedTuple):
    """All that a loop works on, for compiled code.

    stage, begin : where `run` goes on: in which stage, and in which part of the step (whole.advance)
    why          : of whole.advance, to be mended
    told         : bits of what is to be told
    by_hand      : 1 where Python takes and sends the messages
    answers      : 1 where each step answers a command; 0 where steps have deadlines
    """

    stage: Ints
    begin: Ints
    why: Ints
    told: Ints
    by_hand: Ints
    answers: Ints
    clock: Clock
    deadlines: Deadlines
    phase: Phase
    heard: Heard
    sent: Sent
    body: Body
    sending: Sending
    purse: Purse
    incoming: Incoming
    outgoing: Outgoing
    inlet: Inlet
    outlets: Outlets
    recording: Recording
    counted: Counted
    step_time: Recent
    lateness: Recent
    delay: Recent
    transport: Recent
    shown: Copied
    reported: Copied


def deadlines(period: float) -> Deadlines:
    """Of a loop that has not begun. period [s]."""
    grid = Deadlines(*(np.zeros(1, np.int64) for _ in Deadlines._fields))
    grid.period[0] = round(1e9 * period)
    return grid


@kernel
def run(address: int, model: Model, state: State, live: Live) -> int:
    """Steps until Python is needed; why. address, model, state: see whole.advance."""
    while True:
        if live.stage[0] == _WAIT:
            _show(state, live)
            if live.deadlines.asked[0] != 0:
                return ASKED
            if live.answers[0] != 0:
                return TO_AWAIT
            _wait(live)
            live.stage[0] = _TAKE
        if live.stage[0] == _TAKE:
            if live.by_hand[0] != 0:
                live.stage[0] = _TAKEN
                return TO_TAKE
            why = _take_all(live)
            if why != 0:
                return why
            live.stage[0] = _TAKEN
        if live.stage[0] == _TAKEN:
            live.stage[0], live.begin[0] = _STEP, FIRST
            if live.heard.received[0] != 0 and live.heard.zero[0] == 0:
                return TO_PLACE
        if live.stage[0] == _STEP:
            why = _step(address, model, state, live)
            if why != DONE:
                live.why[0] = why
                return TO_MEND
            live.stage[0] = _FILL
            if live.body.lead.driven[0] == 0.0:
                return TO_FIT
        if live.stage[0] == _FILL:
            _fill(state, live)
            live.stage[0] = _SEND
        if live.stage[0] == _SEND:
            live.stage[0] = _DONE
            if live.by_hand[0] != 0:
                return TO_SEND
            _publish(live, DEVICE)
            _publish_due(live)
            _publish(live, CONTACT)
            _publish(live, POSE)
        _account(live)
        live.stage[0] = _WAIT
        if live.told[0] != 0:
            return TO_TELL


@stage
def _show(state: State, live: Live) -> None:
    """Copies for other threads that ask for them."""
    stamp, at = live.sent.stamp[0], live.deadlines.begun[0]
    if load_acquire(live.shown.asked, 0) != 0:
        hand_over(live.shown, state, live.body, live.sent.device, stamp, at)
        is_there(live.shown)
    if load_acquire(live.reported.asked, 0) != 0:
        hand_over(live.reported, state, live.body, live.sent.device, stamp, at)
        take_counted(live.reported, live.counted)
        is_there(live.reported)


@stage
def _wait(live: Live) -> None:
    grid, clock = live.deadlines, live.clock
    deadline = grid.origin[0] + grid.moved[0] + grid.k[0] * grid.period[0]
    now = steady_ns(clock)
    while now < deadline:
        sleep_until(clock, deadline)
        now = steady_ns(clock)
    grid.begun[0], live.sent.stamp[0] = now, wall_ns(clock)
    add(live.lateness, 1e-9 * (now - deadline))


@stage
def _take_all(live: Live) -> int:
    """All that came by the beginning of the step; TO_LOOK or UNHEARD where Python is needed, else 0."""
    heard, incoming, clock, begun = live.heard, live.incoming, live.clock, live.deadlines.begun[0]
    inlet, count = live.inlet, incoming.subscriptions.shape[0]
    for k in range(count):
        which = (k + BESIDE) % count  # what tells more of commands comes before them
        received = heard.looked[which] + 1
        while True:
            size = take(incoming, which)
            if size == NOTHING:
                break
            present, wall = steady_ns(clock), wall_ns(clock)
            received = max(present - max(wall - incoming.infos[which, RECEIVED], 0), received)
            heard.which[0], heard.when[0] = which, min(received, begun)
            if size < 0:
                heard.failure[0] = -size
                return UNHEARD
            data = bytes_at(incoming.messages[which, ADDRESS], incoming.messages[which, LENGTH])
            if which >= BESIDE or (which == COMMAND and inlet.active[0] != 0):
                told = _of_device(live, which, data)
                if told < 0:
                    heard.looked[which] = received
                    return TO_LOOK
                if told == 0:
                    continue
                data = inlet.message
                size = data.shape[0]
            if which == COMMAND:
                heard.commands[0] += 1
            stamp = read_pose(data, heard.frame, heard.at)
            if stamp == LOOK or (which == PLANE and live.body.table.exists[0] == 0.0):
                heard.looked[which] = received
                return TO_LOOK  # Python records it, as it is followed
            recording.put(live.recording, live.sent.topics[3 + which], heard.when[0], data, size)
            if which == COMMAND:
                hear(live, heard.when[0], stamp, 1e-9 * (wall - stamp - (present - heard.when[0])))
            else:
                write(live.body.table.target, read(heard.at))
                live.body.table.given[0] = 1.0
        heard.looked[which] = begun
    return 0


@stage
def _of_device(live: Live, which: int, data: Bytes) -> int:
    """Of a device's message: 1 where a command has come of it, 0 where all is done; negative: it is to be looked at."""
    heard, inlet = live.heard, live.inlet
    what = POSITION if which == COMMAND else inlet.roles[which - BESIDE]
    told = take_in(inlet, what, data, heard.when[0], live.sending.rendered.timeout[0])
    if told == PASSED_OVER:
        return 0
    if told < 0:
        inlet.why[0] = told
        if which == COMMAND:
            heard.commands[0] += 1
        return told
    if what == CLUTCH and told == 1:
        recording.put(live.recording, live.sent.topics[5], heard.when[0], inlet.button, inlet.button.shape[0])
    return told if what == POSITION else 0


@kernel
def answer(live: Live, begun: int, stamp: int) -> None:
    """The next step begins now, for the newest command, and has that stamp."""
    live.deadlines.begun[0], live.sent.stamp[0] = begun, stamp
    live.stage[0] = _TAKEN


@kernel
def let_go(live: Live, now: int, stamp: int) -> bool:
    """Between answers: whether the last command has become too old, or the clutch open; a message has no force then.

    It is sent, unless Python sends by hand.
    """
    heard, sent = live.heard, live.sent
    rendered, age = live.sending.rendered, 1e-9 * (now - heard.received[0])
    old = age > rendered.timeout[0] or rendered.clutched[0] != 0.0
    if heard.received[0] == 0 or rendered.stale[0] != 0.0 or not old:
        return False
    for i in range(6):
        sent.device[i] = 0.0
    _render(live, age, 0.0)
    _fill_one(live, DEVICE, sent.device, stamp, now)
    _fill_due(live, stamp)
    if live.by_hand[0] == 0:
        _publish(live, DEVICE)
        _publish_due(live)
    return True


@kernel
def silence(live: Live, stamp: int) -> None:
    """The end: messages to a device have no force any more. They are sent by Python."""
    sent, outlets = live.sent, live.outlets
    for i in range(6):
        sent.device[i] = 0.0
    fill(live.outgoing, DEVICE, stamp, sent.device)
    for k in range(outlets.due.shape[0]):
        outlets.pushes[k] = 1
    _fill_due(live, stamp)


@kernel
def hear(live: Live, received: int, stamp: int, transport: float) -> None:
    """The pose in heard.at is the newest command."""
    heard = live.heard
    write(heard.newest, read(heard.at))
    heard.received[0], heard.stamp[0], heard.fresh[0] = received, stamp, 1
    heard.transport[0] = transport if 0.0 <= transport <= MOST_TRANSPORT else 0.0
    if heard.zero[0] != 0 and live.body.lead.driven[0] != 0.0:
        when = math.nan if live.answers[0] != 0 else 1e-9 * (received - heard.zero[0])
        following.hear(live.body.lead.course, read(heard.at), when)


@stage
def _step(address: int, model: Model, state: State, live: Live) -> int:
    """The rest of the step; DONE, or what is to be mended."""
    body, purse = live.body, live.purse
    begun = steady_ns(live.clock)
    now = math.nan if live.answers[0] != 0 else 1e-9 * (live.deadlines.begun[0] - live.heard.zero[0])
    why = whole.advance(address, model, state, body, now, live.begin[0])
    if why == FALLS_ASLEEP:
        state.v[:] = 0.0
    elif why != DONE and why != ASLEEP:
        return why
    if purse.seconds[0] > 0.0 and spent(purse, 1e-9 * (steady_ns(live.clock) - begun)):
        live.told[0] |= RUNG
    count(live.counted, body, why == ASLEEP)
    return DONE


@stage
def _fill(state: State, live: Live) -> None:
    """Wrench for the device, wrench of contact and pose: made, and recorded."""
    heard, sent, body, begun = live.heard, live.sent, live.body, live.deadlines.begun[0]
    contact, device, pose = sent.contact, sent.device, body.pose
    for i in range(6):
        device[i] = 0.0
        if body.lead.driven[0] != 0.0:  # of a free body it is there
            contact[i] = state.wrench[i]
    if heard.received[0] != 0:
        if body.lead.yields[0] != 0.0:
            turned_round(state.coupling, pose, body.lead.end, device)
        else:
            for i in range(6):
                device[i] = contact[i]
        rendered = live.sending.rendered
        clamped(device, rendered.force_limit[0], rendered.torque_limit[0], device)
        _render(live, 1e-9 * (begun - heard.received[0]), 1e-9 * (steady_ns(live.clock) - begun))
    _express(contact, pose, sent.axes[0])
    stamp = sent.stamp[0]
    _fill_one(live, DEVICE, device, stamp, begun)
    _fill_one(live, CONTACT, contact, stamp, begun)
    _fill_one(live, POSE, pose, stamp, begun)
    _fill_due(live, stamp)


@stage
def _render(live: Live, age: float, took: float) -> None:
    """sent.device as the device gets it; see sending.send."""
    heard, sent = live.heard, live.sent
    live.told[0] |= sending.send(
        live.sending, sent.device, heard.before, heard.newest, heard.fresh[0] != 0, heard.transport[0], age, took,
        live.body.dt[0], sent.device,
    )  # fmt: skip


@stage
def _fill_one(live: Live, which: int, numbers: Floats, stamp: int, at: int) -> None:
    """A message is made, and recorded as of that steady time."""
    sent = live.sent
    fill(live.outgoing, which, stamp, numbers)
    data = bytes_at(live.outgoing.messages[which, ADDRESS], live.outgoing.messages[which, LENGTH])
    recording.put(live.recording, sent.topics[which], at, data, data.shape[0])


@stage
def _fill_due(live: Live, stamp: int) -> None:
    """Other messages to a device, of sent.device."""
    if live.outlets.due.shape[0] > 0:
        sent, rendered = live.sent, live.sending.rendered
        sent.limits[0], sent.limits[1] = rendered.force_limit[0], rendered.torque_limit[0]
        fill_outlets(live.outlets, live.outgoing, live.inlet, sent.device, sent.limits, live.body.dt[0], stamp)


@stage
def _publish_due(live: Live) -> None:
    for k in range(live.outlets.due.shape[0]):
        if live.outlets.due[k] != 0:
            _publish(live, POSE + 1 + k)


@stage
def _publish(live: Live, which: int) -> None:
    failure = publish(live.outgoing, which)
    if failure != 0:
        live.sent.failure[0] = failure
        live.told[0] |= UNSENT


@stage
def _express(wrench: Floats, pose: Floats, axes: int) -> None:
    """layout.express_wrench."""
    x, y, z, u, v, w = wrench[0], wrench[1], wrench[2], wrench[3], wrench[4], wrench[5]
    if axes == WORLD:
        wrench[3] += pose[1] * z - pose[2] * y
        wrench[4] += pose[2] * x - pose[0] * z
        wrench[5] += pose[0] * y - pose[1] * x
    elif axes == FINGER:
        a, b, c, d, e, f, g, h, i = matrix_entries((pose[3], pose[4], pose[5], pose[6]))
        wrench[0], wrench[1], wrench[2] = a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z
        wrench[3], wrench[4], wrench[5] = a * u + d * v + g * w, b * u + e * v + h * w, c * u + f * v + i * w


@stage
def _account(live: Live) -> None:
    """Of the step that is done: deadlines that have passed are skipped, and counted."""
    grid, heard = live.deadlines, live.heard
    now, k = steady_ns(live.clock), grid.k[0]
    grid.steps[0] += 1
    grid.last[0] = now
    add(live.step_time, 1e-9 * (now - grid.begun[0]))
    if live.answers[0] != 0:
        add(live.lateness, 1e-9 * (grid.begun[0] - heard.received[0]))
    else:
        passed = (now - grid.origin[0] - grid.moved[0]) // grid.period[0]
        grid.late[0] += 1 if passed > k else 0
        grid.k[0] = max(k + 1, passed)
        grid.overruns[0] += grid.k[0] - (k + 1)
        wait = 1e-9 * (grid.begun[0] - heard.received[0]) if heard.fresh[0] != 0 else -1.0
        interval = live.body.lead.course.cadence.interval[0]
        grid.moved[0] += int(1e9 * phase.moved(live.phase, 1e-9 * grid.period[0], interval, wait))
    if heard.fresh[0] != 0:
        heard.fresh[0] = 0
        write(heard.before, read(heard.newest))
        add(live.delay, 1e-9 * (now - heard.received[0]))
        add(live.transport, heard.transport[0])


KERNELS = (run, hear, answer, let_go, silence)
"""What a ticker calls."""

"""Serialized messages out and in, and the clocks of the system, for compiled code that holds no interpreter.

The records hold addresses of functions and of endpoints: rcl.py finds and checks those, endpoints.py keeps these alive.
Times are in ns. A clock and the messages of an Outgoing or an Incoming belong to one thread at a time.
"""

from __future__ import annotations

from typing import NamedTuple

from ..arrays import Bytes, Floats, Ints
from ..bags.template import STAMP_OFFSET
from ..physics.compile import kernel, stage
from .memory import bytes_at, call, write_float64, write_int32

NOTHING = -401
"""`take` found no message: RCL_RET_SUBSCRIPTION_TAKE_FAILED."""
UNFIT = -(1 << 20)
"""`take` got a message, but what it was told about that does not look like an rmw_message_info_t."""

WORDS = 8
"""Of 64 bits, in an rcl_serialized_message_t and in an rmw_message_info_t."""
ADDRESS, LENGTH, CAPACITY, ALLOCATOR = range(4)
"""Words of an rcl_serialized_message_t (rcutils_uint8_array_t); the allocator has the last five."""
SENT, RECEIVED = range(2)
"""Words of an rmw_message_info_t: the sender's stamp, and the time of receipt by the wall clock [ns]."""
GUARDED = 0x5A5A5A5A5A5A5A5A
"""What stands behind an rmw_message_info_t, in as many words, and must stay there."""
_SECOND = 1_000_000_000
LONGEST_WAIT, AHEAD = 3600 * _SECOND, 5 * _SECOND
"""The first message was received so long before the record was made, and so long after it is taken, at most [ns]: it
may have waited, and the wall clock may be set. Any other word is farther from the present."""
_WALL, _STEADY, _ABSOLUTE = 0, 1, 1  # CLOCK_REALTIME, CLOCK_MONOTONIC, TIMER_ABSTIME


class Clock(NamedTuple):
    """The clocks of the system, for compiled code.

    gettime   : address of clock_gettime(2)
    nanosleep : address of clock_nanosleep(2)
    time      : (2,) a struct timespec to write to
    """

    gettime: int
    nanosleep: int
    time: Ints


class Outgoing(NamedTuple):
    """n messages and their publishers, for compiled code.

    publish     : address of rcl_publish_serialized_message
    reset_error : address of rcutils_reset_error
    publishers  : (n,) addresses; 0 once they are released
    messages    : (n, WORDS) rcl_serialized_message_t, each over the bytes of a Template
    numbers     : (n,) where in a message its first block of numbers begins; 0: it has none
    """

    publish: int
    reset_error: int
    publishers: Ints
    messages: Ints
    numbers: Ints


class Incoming(NamedTuple):
    """n subscriptions and the message of each that was taken last, for compiled code.

    take          : address of rcl_take_serialized_message
    reset_error   : address of rcutils_reset_error
    subscriptions : (n,) addresses; 0 once they are released
    messages      : (n, WORDS) rcl_serialized_message_t, whose bytes rcl moves to where there is room for them
    infos         : (n, 2 WORDS) rmw_message_info_t of each message, and GUARDED behind it
    since         : wall time at which the record was made [ns]
    fits          : (1,) 1 once a message has shown that infos are what they are taken for
    clock         : of the thread that takes
    """

    take: int
    reset_error: int
    subscriptions: Ints
    messages: Ints
    infos: Ints
    since: int
    fits: Ints
    clock: Clock


@stage
def wall_ns(clock: Clock) -> int:
    """Time by the wall clock, which may be set [ns]."""
    return _time(clock, _WALL)


@stage
def steady_ns(clock: Clock) -> int:
    """Time by the clock of time.monotonic_ns [ns]."""
    return _time(clock, _STEADY)


@stage
def sleep_until(clock: Clock, when: int) -> int:
    """Sleeps until a steady time [ns]; 0 then, or the errno with which a signal ended it before."""
    clock.time[0], clock.time[1] = when // _SECOND, when % _SECOND
    return call(clock.nanosleep, (_STEADY, _ABSOLUTE, clock.time.ctypes.data, 0))


@stage
def write_stamp(data: Bytes, at: int, time: int) -> None:
    """A time [ns] as a builtin_interfaces/Time at byte `at`; 0 up to 2³¹ s."""
    write_int32(data, at, time // _SECOND)
    write_int32(data, at + 4, time % _SECOND)


@stage
def write_numbers(data: Bytes, at: int, numbers: Floats) -> None:
    """Numbers (m,) as float64 from byte `at` on."""
    for i in range(numbers.shape[0]):
        write_float64(data, at + 8 * i, numbers[i])


@stage
def fill(outgoing: Outgoing, k: int, time: int, numbers: Floats) -> None:
    """Time of its header [ns], and first block of numbers (m,), of message k."""
    data = bytes_at(outgoing.messages[k, ADDRESS], outgoing.messages[k, LENGTH])
    write_stamp(data, STAMP_OFFSET, time)
    write_numbers(data, outgoing.numbers[k], numbers)


@kernel
def publish(outgoing: Outgoing, k: int) -> int:
    """Sends message k as it was filled; 0, or the code of rcl's failure."""
    failure = call(outgoing.publish, (outgoing.publishers[k], outgoing.messages[k].ctypes.data, 0))
    if failure != 0:
        call(outgoing.reset_error, ())
    return failure


@kernel
def take(incoming: Incoming, k: int) -> int:
    """Takes the oldest message that lies in subscription k, and gives its length in bytes.

    Its ADDRESS and LENGTH are in messages[k] then, and infos[k] tells when it was SENT and RECEIVED. Negative: NOTHING,
    or the code of rcl's failure times -1; or UNFIT, where the message is there, but infos is of no use.
    """
    to, info = incoming.messages[k].ctypes.data, incoming.infos[k].ctypes.data
    failure = call(incoming.take, (incoming.subscriptions[k], to, info, 0))
    if failure != 0:
        call(incoming.reset_error, ())
        return -failure
    if incoming.fits[0] == 0:
        if not _fits(incoming, k):
            return UNFIT
        incoming.fits[0] = 1
    length: int = incoming.messages[k, LENGTH]
    return length


@stage
def _fits(incoming: Incoming, k: int) -> bool:
    """Whether infos[k] looks as it must after a message was taken."""
    for i in range(WORDS, 2 * WORDS):
        if incoming.infos[k, i] != GUARDED:
            return False
    received: int = incoming.infos[k, RECEIVED]
    sent: int = incoming.infos[k, SENT]
    return sent >= 0 and incoming.since - LONGEST_WAIT <= received <= wall_ns(incoming.clock) + AHEAD


@stage
def _time(clock: Clock, which: int) -> int:
    call(clock.gettime, (which, clock.time.ctypes.data))
    now: int = clock.time[0] * _SECOND + clock.time[1]
    return now


KERNELS = (publish, take)
"""What Endpoints call."""

"""Bytes, C functions and clocks in compiled code, beside what `struct` and `time` say."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import struct
import subprocess
import sys
import threading
import time

import numba
import numpy as np
import pytest
from processes import REPOSITORY

from finger_sim.physics.compile import kernel
from finger_sim.physics.records import held
from finger_sim.ros import wire
from finger_sim.ros.memory import bytes_at, call, read_float64, read_int32, write_float64, write_int32

INTEGERS = (0, 1, -1, 2**31 - 1, -(2**31), 123_456_789)
FLOATS = (0.0, -0.0, 1.5, -1e300, 5e-324, float("inf"), float("nan"))


@kernel
def put_int32(data, at, value):
    write_int32(data, at, value)


@kernel
def put_float64(data, at, value):
    write_float64(data, at, value)


@kernel
def get_int32(data, at):
    return read_int32(data, at)


@kernel
def get_float64(data, at):
    return read_float64(data, at)


@kernel
def add_up(address, size):
    total = 0
    for byte in bytes_at(address, size):
        total += int(byte)
    return total


@kernel
def call_five(address, a, b, c, d, e):
    return call(address, (a, b, c, d, e))


@kernel
def call_none(address):
    return call(address, ())


@kernel
def stamp(data, at, time):
    wire.write_stamp(data, at, time)


@kernel
def wall(clock):
    return wire.wall_ns(clock)


@kernel
def steady(clock):
    return wire.steady_ns(clock)


@kernel
def sleep_until(clock, when):
    return wire.sleep_until(clock, when)


@pytest.fixture(scope="module")
def clock():
    libc = ctypes.CDLL(None)
    address = [ctypes.cast(function, ctypes.c_void_p).value for function in (libc.clock_gettime, libc.clock_nanosleep)]
    return held(wire.Clock(*address, np.zeros(2, np.int64)))


@pytest.mark.parametrize(
    ("values", "form", "put", "get"), [(INTEGERS, "<i", put_int32, get_int32), (FLOATS, "<d", put_float64, get_float64)]
)
def test_numbers_at_any_byte(values, form, put, get):
    """They are read and written as `struct` does it, and nothing beside them."""
    size = struct.calcsize(form)
    for at in range(10):
        for value in values:
            data, expected = np.full(20, 0xEE, np.uint8), bytearray(b"\xee" * 20)
            struct.pack_into(form, expected, at, value)
            put(data, at, value)
            assert data.tobytes() == expected
            assert struct.pack(form, get(data, at)) == expected[at : at + size]


def test_of_a_larger_number_the_lower_bits_are_written():
    data = np.zeros(6, np.uint8)
    put_int32(data, 1, 0x1_F234_5678)
    assert data.tobytes() == bytes.fromhex("00785634f200")


def test_memory_by_its_address():
    data = np.arange(200, dtype=np.uint8)
    assert add_up(data.ctypes.data + 10, 50) == sum(range(10, 60))
    assert add_up(0, 0) == 0


def test_functions_get_their_arguments_and_their_int_comes_back():
    """Signed 64-bit arguments in their order, an int with its sign."""
    got = []

    def note(*arguments):
        got.append(arguments)
        return -7

    five = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * 5)(note)
    none = ctypes.CFUNCTYPE(ctypes.c_int)(note)
    address = [ctypes.cast(function, ctypes.c_void_p).value for function in (five, none)]
    assert call_five(address[0], 1, -2, 2**62, -(2**62), 5) == -7
    assert call_none(address[1]) == -7
    assert got == [(1, -2, 2**62, -(2**62), 5), ()]


@pytest.mark.parametrize(
    "time", [0, 1, 999_999_999, 1_000_000_000, 2**31 * 1_000_000_000 - 1, 1_795_983_700_067_496_749]
)
def test_stamps(time):
    data = np.zeros(9, np.uint8)
    stamp(data, 1, time)
    assert struct.unpack_from("<iI", data, 1) == divmod(time, 1_000_000_000)


def test_clocks_are_those_of_python(clock):
    for ours, pythons in ((wall, time.time_ns), (steady, time.monotonic_ns)):
        before = pythons()
        read = ours(clock)
        assert before <= read <= pythons()


def test_sleep_ends_at_its_time(clock):
    when = time.monotonic_ns() + 20_000_000
    assert sleep_until(clock, when) == 0
    assert time.monotonic_ns() >= when
    assert sleep_until(clock, when) == 0


def test_a_signal_ends_a_sleep(clock):
    """It does so only in the thread that gets it; that is told, and the rest of the time is not slept."""
    asleep, when = threading.get_ident(), time.monotonic_ns() + 100_000_000_000
    over = threading.Event()

    def disturb():
        while not over.wait(0.01):
            signal.pthread_kill(asleep, signal.SIGUSR1)

    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    thread = threading.Thread(target=disturb)
    try:
        thread.start()
        assert sleep_until(clock, when) == errno.EINTR
        assert time.monotonic_ns() < when
    finally:
        over.set()
        thread.join()
        signal.signal(signal.SIGUSR1, before)


@pytest.mark.slow
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is what this runs")
def test_uncompiled_too():
    """NUMBA_DISABLE_JIT=1: the tests of this file and of poses pass with the same functions as plain Python."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "-x", "ros/test_wire.py"]
        + ["ros/test_pose_bytes.py"],
        cwd=REPOSITORY / "tests",
        capture_output=True,
        text=True,
        timeout=200,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(REPOSITORY)},
    )
    assert done.returncode == 0, done.stdout[-3000:]

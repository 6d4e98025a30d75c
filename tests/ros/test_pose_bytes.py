"""Poses that compiled code reads: the same as bags/poses.py gives, bit for bit, or it is left to that."""

from __future__ import annotations

import itertools
import math
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from finger_sim.bags import poses
from finger_sim.ros.pose_bytes import LOOK, frame_bytes, read_pose

FRAME = "world"


def message(sec, nanosec, name, values, order="<"):
    """PoseStamped in CDR by hand; name: bytes of the frame_id with what ends it."""
    header = struct.pack(f"{order}iII", sec, nanosec, len(name)) + name
    head = bytes([0, order == "<", 0, 0])
    return head + header + bytes(-len(header) % 8) + struct.pack(f"{order}7d", *values)


def compiled(data, frame=FRAME):
    """Stamp and pose, or None where it is left to Python; that has then not been written to."""
    out = np.full(7, 77.0)
    stamp = read_pose(np.frombuffer(bytearray(data), np.uint8), frame_bytes(frame), out)
    if stamp >= 0:
        return stamp, out.tobytes()
    assert stamp == LOOK
    assert (out == 77.0).all()
    return None


def judged(data, frame=FRAME):
    """The same by bags/poses.py; None where it is refused, or big-endian."""
    try:
        said = poses.read_pose(data)
    except ValueError:
        return None
    pose = poses.check_pose(said, frame)
    if isinstance(pose, str) or data[1] == 0:
        return None
    return said.stamp, struct.pack("<7d", *pose.position, *pose.orientation)


SECONDS = st.sampled_from([0, 1, 1_795_983_700, 2**31 - 1, -1, -(2**31)]) | st.integers(-(2**31), 2**31 - 1)
NANOSECONDS = st.sampled_from([0, 999_999_999, 1_000_000_000, 2**32 - 1]) | st.integers(0, 999_999_999)
NAMES = st.sampled_from(
    [b"world\0"] * 6
    + [b"world", b"world\0\0\0", b"world\0more", b"", b"\0", b"worl\0", b"worlds\0", b"map\0", b"w\0rld\0"]
) | st.binary(max_size=12)
COORDINATES = (
    st.floats(-1.0, 1.0)
    | st.floats()
    | st.sampled_from([1e4, -1e4, math.nextafter(1e4, math.inf), -math.nextafter(1e4, math.inf), -0.0, math.nan])
)
ANY_TURN = st.tuples(*[st.floats(-1.0, 1.0)] * 4)


def normalised(q):
    norm = math.sqrt(sum(c * c for c in q)) or 1.0
    return tuple(c / norm for c in q)


def in_single(q):
    return tuple(float(np.float32(c)) for c in q)


def scaled(q, by):
    return tuple(c * by for c in q)


TURNS = st.one_of(
    ANY_TURN.map(normalised),
    ANY_TURN.map(normalised).map(in_single),
    ANY_TURN,
    st.tuples(ANY_TURN.map(normalised), st.sampled_from([1e-6, 1e6, 3e-7, 4e6, 1e-9, 1e9, 1e200, 1e-200])).map(
        lambda both: scaled(*both)
    ),
    st.tuples(*[st.floats()] * 4),
    st.sampled_from([(0.0, 0.0, 0.0, 1.0), (0.0, -0.0, 0.0, -1.0), (0.0,) * 4, (math.nan, 0.0, 0.0, 1.0)]),
)


@st.composite
def messages(draw):
    """Those that a sender may send, and what is left of them when they are cut, changed, or go on."""
    order = draw(st.sampled_from("<<<<<<<>"))
    values = (*draw(st.tuples(COORDINATES, COORDINATES, COORDINATES)), *draw(TURNS))
    data = bytearray(message(draw(SECONDS), draw(NANOSECONDS), draw(NAMES), values, order))
    change = draw(st.sampled_from(["none"] * 5 + ["cut", "more", "byte", "length"]))
    if change == "cut":
        del data[draw(st.integers(0, len(data))) :]
    elif change == "more":
        data += draw(st.binary(max_size=20))
    elif change == "byte":
        data[draw(st.integers(0, 15))] = draw(st.integers(0, 255))
    elif change == "length":
        data[12:16] = struct.pack("<I", draw(st.sampled_from([2**32 - 1, 2**31, 57, 1])))
    return bytes(data)


@settings(max_examples=600, deadline=None)
@given(messages())
@example(b"")
@example(message(5, 6, b"world\0", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0), ">"))
@example(bytes([0, 3, 0, 0]) + message(5, 6, b"world\0", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))[4:])
def test_as_python_reads_and_checks_it(data):
    """Bits of stamp and pose where it is good, nothing where it is refused or of another encoding."""
    assert compiled(data) == judged(data)


@given(st.sampled_from(["", "w", "wörld", "a" * 40, "wo\0rld", "\0"]), NAMES | st.sampled_from(["wörld\0".encode()]))
@settings(max_examples=200, deadline=None)
@example("wo\0rld", b"wo\0rld\0")
@example("", b"")
@example("", b"\0")
@example("wörld", "wörld\0".encode())
@example("a" * 40, b"a" * 41)
def test_any_frame_may_be_the_one(frame, name):
    """Also one that no message can have."""
    data = message(1, 2, name, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    assert compiled(data, frame) == judged(data, frame)


def test_every_cut_of_a_good_message():
    data = message(1, 2, b"world\0", (0.1, 0.2, 0.3, 0.0, 0.6, 0.0, 0.8))
    assert compiled(data) == judged(data) is not None
    for end in range(len(data)):
        assert compiled(data[:end]) is None


def test_normalised_to_the_last_bit():
    """Ten thousand quaternions of double and of single precision: none is left to Python, all are as there."""
    random = np.random.default_rng(5)
    for turn in (random.normal(size=(10_000, 4)) * 10.0 ** random.uniform(-5, 5, (10_000, 1))).tolist():
        for q in (tuple(turn), normalised(turn), in_single(normalised(turn))):
            data = message(0, 0, b"world\0", (0.0, 0.0, 0.0, *q))
            assert compiled(data) == judged(data) is not None


def test_what_lies_between_two_numbers_is_left_to_python():
    """Quaternions of whole numbers whose length is whole and odd beyond 2⁵³: right between two float64 numbers."""
    found = 0
    for a, b, c in itertools.product(range(2**26 + 1, 2**26 + 60, 2), range(2**25 + 2, 2**25 + 40, 2), (2**26, 2**25)):
        length = a * a + b * b + c * c
        parts = (a * a + b * b - c * c, 2 * a * c, 2 * b * c)
        if length % 2 == 0 or not 2**53 < length < 2**54 or any(int(float(part)) != part for part in parts):
            continue
        assert sum(part * part for part in parts) == length * length
        found += 1
        data = message(0, 0, b"world\0", (0.0, 0.0, 0.0, *(part / 2**53 for part in parts), 0.0))
        assert judged(data) is not None
        assert compiled(data) is None
    assert found > 20


@pytest.mark.parametrize("length", [1e-6, math.nextafter(1e-6, 0.0), 1e6, math.nextafter(1e6, math.inf)])
def test_shortest_and_longest(length):
    for place in range(4):
        q = [0.0] * 4
        q[place] = -length
        data = message(0, 0, b"world\0", (0.0, 0.0, 0.0, *q))
        assert compiled(data) == judged(data)
        assert (compiled(data) is not None) == (length in (1e-6, 1e6))

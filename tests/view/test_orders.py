"""What pages say: each message that may be followed is, every other is refused in words."""

from __future__ import annotations

import contextlib
import json
import struct

import pytest
from cases import for_each
from hypothesis import given
from hypothesis import strategies as st

from finger_sim.view.orders import OrderError, read_drawn, read_order

POSE = (0.0, 0.1, -2e-3, 0.0, 0.0, 0.0, 1.0)


@for_each(
    "order",
    [
        {"type": "take"}, {"type": "set", "name": "plane.friction", "value": [1, None]},
        {"type": "record", "on": True}, {"type": "seek", "time": 0}, {"type": "play", "on": False},
        {"type": "play", "on": True, "speed": 0.5}, {"type": "frames", "hz": 60},
    ],
)  # fmt: skip
def test_what_may_be_followed(order) -> None:
    """It is read as it was said."""
    got = read_order(json.dumps(order))
    assert {"type": got.type, **got.said} == order


@for_each(
    "text, told",
    [
        ("", "no JSON"), ("{", "no JSON"), ("[]", "allowed: an object"), ("3", "allowed: an object"),
        ("null", "allowed: an object"), ('{"type": 5}', "type: got 5, allowed: take"), ("{}", "type: got None"),
        ('{"type": "fly"}', "type: got 'fly', allowed: take, release"), ("[" * 30000, "no JSON"),
        ('{"type": "take", "now": 1}', "take.'now': no such key; known here: none"),
        ('{"type": "seek"}', "seek.time: is missing"), ('{"type": "seek", "time": -1}', "seek.time: got -1"),
        ('{"type": "seek", "time": NaN}', "NaN is no number"), ('{"type": "seek", "time": true}', "got True"),
        ('{"type": "seek", "time": 1e999}', "seek.time"),
        ('{"type": "frames", "hz": 61}', "a number from 1 to 60"), ('{"type": "frames", "hz": 0}', "from 1 to 60"),
        ('{"type": "play", "on": 1}', "true or false"), ('{"type": "play", "on": true, "speed": 0}', "play.speed"),
        ('{"type": "record", "on": "yes"}', "true or false"), ('{"type": "scene", "name": ""}', "1 to 200 letters"),
        (json.dumps({"type": "scene", "name": "x" * 300}), "1 to 200 letters"),
    ],
)  # fmt: skip
def test_what_is_refused(text, told) -> None:
    """The error names the key, what was found and what is allowed."""
    with pytest.raises(OrderError) as error:
        read_order(text)
    assert told in str(error.value)
    assert len(str(error.value)) < 1000


@given(st.text() | st.dictionaries(st.text(), st.none() | st.booleans() | st.floats() | st.text()).map(json.dumps))
def test_any_text_is_an_order_or_refused(text) -> None:
    """Nothing else is raised."""
    with contextlib.suppress(OrderError):
        read_order(text)


def test_what_is_said_in_bytes() -> None:
    """The number of a frame that was drawn, alone or with a pose."""
    assert read_drawn(struct.pack("<2I", 1, 2**32 - 1)) == (2**32 - 1, None)
    assert read_drawn(struct.pack("<2I7d", 2, 7, *POSE)) == (7, POSE)


@for_each(
    "data",
    [
        b"", b"\1", struct.pack("<I", 1), struct.pack("<3I", 1, 2, 3), struct.pack("<2I", 2, 7),
        struct.pack("<2I", 3, 7), struct.pack(">2I", 1, 7), struct.pack("<2I7d", 1, 7, *POSE),
        struct.pack("<2I6d", 2, 7, *POSE[:6]), struct.pack("<2I7d", 2, 7, *POSE) + b"0",
    ],
)  # fmt: skip
def test_other_bytes_are_refused(data) -> None:
    """With their number, and what is allowed."""
    with pytest.raises(OrderError, match=f"got {len(data)} bytes .* allowed: 8 that begin with 1, or 64"):
        read_drawn(data)


@given(st.binary(max_size=80))
def test_any_bytes_are_something_or_refused(data) -> None:
    """Nothing else is raised."""
    with contextlib.suppress(OrderError):
        read_drawn(data)

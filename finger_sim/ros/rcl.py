"""rcl's own functions for compiled code: found in the libraries that rclpy has loaded, and checked before any use.

rclpy has nothing that works without the interpreter. What lies below it is plain C, but nobody promises it to Python:

- rcl_publish_serialized_message(publisher, message, NULL) and rcl_take_serialized_message(subscription, message, info,
  NULL), for the rcl_publisher_t and rcl_subscription_t in rclpy's handles, of which nothing but the address is used;
- rcl_serialized_message_t: address, length and capacity of the bytes, and an allocator of five words;
- rmw_message_info_t: the sender's stamp and the time of receipt, and six words more, as in ROS 2 Jazzy (rcl 9.2).

All of it is checked at the start but for the last, which the first message shows (wire.take). FINGER_SIM_RCL=0 in the
environment does without: it is for tests of what is used instead.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Ints
from ..errors import FingerSimError
from .wire import ADDRESS, ALLOCATOR, CAPACITY, GUARDED, LENGTH, WORDS, Clock

SWITCH = "FINGER_SIM_RCL"
"""Variable of the environment; 0: rcl is not used."""
VERSION = (9, 2)
"""Of rcl, in ROS 2 Jazzy."""
CODES = {
    1: "unspecified error",
    3: "not supported",
    10: "no memory",
    11: "invalid argument",
    300: "the publisher, or its context, has ended",
    400: "the subscription, or its context, has ended",
}
"""What rcl_ret_t says."""
_CAPACITY = 12345
"""Of a message that is made to see how it is made."""
_ROOM = 16
"""Words for a structure that should have fewer."""


class UnfitError(FingerSimError):
    """Why compiled code cannot use rcl here."""


class Rcl(NamedTuple):
    """Addresses of C functions, all checked; and what is done with messages that rcl may move.

    make   : fills in an rcl_serialized_message_t (WORDS,) with room for so many bytes
    remove : gives that room back
    allocator : the words of the default one
    """

    publish: int
    take: int
    reset_error: int
    allocator: Ints
    make: Callable[[Ints, int], None]
    remove: Callable[[Ints], None]


class _Words(ctypes.Structure):
    """Takes whatever structure a function gives, as long as it is passed in memory and not longer."""

    _fields_ = (("words", ctypes.c_int64 * _ROOM),)


def find() -> Rcl:
    """Raises UnfitError where anything is not as it must be."""
    if os.environ.get(SWITCH) == "0":
        raise UnfitError(f"{SWITCH}=0 in the environment asks for this")
    if sys.byteorder != "little" or ctypes.sizeof(ctypes.c_void_p) != 8:
        raise UnfitError(f"this is no little-endian machine with addresses of 64 bits: {os.uname().machine}")
    rcl, rcutils = _loaded("librcl.so"), _loaded("librcutils.so")
    publish = _address(rcl, "rcl_publish_serialized_message")
    _check_version(publish)
    make, remove, allocator = _messages(rcutils)
    return Rcl(
        publish=publish,
        take=_address(rcl, "rcl_take_serialized_message"),
        reset_error=_address(rcutils, "rcutils_reset_error"),
        allocator=allocator,
        make=make,
        remove=remove,
    )


def clock() -> Clock:
    """The system's, for one thread."""
    libc = ctypes.CDLL(None)
    return Clock(_address(libc, "clock_gettime"), _address(libc, "clock_nanosleep"), np.zeros(2, np.int64))


def meaning(code: int) -> str:
    """Of an rcl_ret_t."""
    return f"rcl's code {code} ({CODES[code]})" if code in CODES else f"rcl's code {code}"


def _loaded(name: str) -> Any:
    """The library of this name that is loaded, wherever it was found."""
    try:
        return ctypes.CDLL(name, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
    except OSError:
        raise UnfitError(f"rclpy has not loaded {name}") from None


def _address(library: Any, name: str) -> int:
    try:
        address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    except AttributeError:
        address = None
    if not address:
        raise UnfitError(f"the libraries of rclpy have no function {name}")
    return address


def _check_version(address: int) -> None:
    """Of the rcl that a function belongs to, where its package.xml lies beside it."""
    for folder in _file_of(address).parents:
        package = folder / "share" / "rcl" / "package.xml"
        if package.is_file():
            found = re.search(r"<version>\s*(\d+)\.(\d+)[^<]*</version>", package.read_text(errors="replace"))
            if found and (int(found[1]), int(found[2])) != VERSION:
                raise UnfitError(f"rcl is {found[1]}.{found[2]}, must be {VERSION[0]}.{VERSION[1]} ({package})")
            return


def _file_of(address: int) -> Path:
    """The file of the library that an address lies in."""
    with open("/proc/self/maps") as lines:
        for line in lines:
            first, _, last = line.partition(" ")[0].partition("-")
            if int(first, 16) <= address < int(last, 16):
                return Path(line.split(maxsplit=5)[-1].strip())
    return Path()


def _messages(rcutils: Any) -> tuple[Callable[[Ints, int], None], Callable[[Ints], None], Ints]:
    """`make`, `remove` and `allocator` of Rcl, tried out."""
    default = ctypes.CFUNCTYPE(_Words)(_address(rcutils, "rcutils_get_default_allocator"))
    initialise = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)(
        _address(rcutils, "rcutils_uint8_array_init")
    )
    finish = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(_address(rcutils, "rcutils_uint8_array_fini"))
    words = np.array(default().words, np.int64)
    allocator = words[: WORDS - ALLOCATOR]

    def make(message: Ints, capacity: int) -> None:
        code = initialise(message.ctypes.data, capacity, words.ctypes.data)
        if code != 0:
            raise UnfitError(f"rcutils_uint8_array_init gives {meaning(code)} for {capacity} bytes")

    def remove(message: Ints) -> None:
        finish(message.ctypes.data)

    if not allocator[:4].all():
        raise UnfitError(f"rcutils_get_default_allocator gives no four functions: {listed(allocator)}")
    block = np.full(_ROOM, GUARDED, np.int64)
    make(block, _CAPACITY)
    if not (
        block[ADDRESS] not in (0, GUARDED)
        and block[LENGTH] == 0
        and block[CAPACITY] == _CAPACITY
        and np.array_equal(block[ALLOCATOR:WORDS], allocator)
        and (block[WORDS:] == GUARDED).all()
    ):
        raise UnfitError(f"rcutils_uint8_array_t is another structure: {listed(block)} for {_CAPACITY} bytes")
    remove(block)
    if block[ADDRESS] != 0 or block[CAPACITY] != 0 or not (block[WORDS:] == GUARDED).all():
        raise UnfitError(f"rcutils_uint8_array_fini leaves {listed(block)}")
    return make, remove, allocator


def listed(words: Ints) -> str:
    """Words of a structure, for an error."""
    return " ".join(f"{word % (1 << 64):#x}" for word in words.tolist())

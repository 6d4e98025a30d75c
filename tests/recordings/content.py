"""What recordings are made of: messages that know what they are, without the code that reads them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE = "geometry_msgs/msg/Pose"
WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped"
FOREIGN = "their_msgs/msg/Foo"
"""A type that nobody knows and nobody needs."""

COMMANDS, WRENCHES, OTHERS = "/command_pose", "/contact_wrench", "/their/foo"
TYPES = {COMMANDS: POSE_STAMPED, WRENCHES: WRENCH_STAMPED, OTHERS: FOREIGN}

START = 1_767_225_600_000_000_000
"""Log time of the first message [ns]."""
PERIOD = 10_000_000
"""Time from one command to the next [ns]."""
AFTER = 3_000_000, 7_000_000
"""Time from a command to the others that come after it [ns]."""
DAY = 86_400 * 1_000_000_000
COUNT = 60
"""Commands in a recording."""


class Put(NamedTuple):
    """One message that was put into a recording, number `sequence` of its `publisher`."""

    topic: str
    type: str
    log_time: int
    data: bytes
    sequence: int
    publisher: int = 0

    @property
    def seen(self) -> tuple[str, str, int, bytes]:
        """What every reader sees of it."""
        return self.topic, self.type, self.log_time, self.data


@dataclass(frozen=True)
class Content:
    """Messages in the order in which they were written, and what is to be said of them."""

    put: tuple[Put, ...]
    topics: tuple[tuple[str, str], ...] = ((COMMANDS, POSE_STAMPED), (WRENCHES, WRENCH_STAMPED), (OTHERS, FOREIGN))
    """Names and types, also of those that have no message."""
    refused: int = 0
    """Messages among the commands that are no pose."""
    lost: int | None = 0
    """Numbers missing among the commands; None where no one can say."""

    @property
    def ordered(self) -> list[Put]:
        """By log time, those of the same time as they were written."""
        return sorted(self.put, key=lambda message: message.log_time)

    @property
    def commands(self) -> list[Put]:
        """Those that a replay follows, in its order."""
        poses = [message for message in self.ordered if (message.topic, message.type) == (COMMANDS, POSE_STAMPED)]
        return [message for message in poses if len(message.data) == len(pose_stamped(0))]


def _header(stamp: int) -> bytes:
    """Little-endian CDR up to the header's end: the frame `world`, with its NUL and what aligns the next double."""
    return struct.pack("<4sIII6s6x", b"\0\1\0\0", *divmod(stamp, 1_000_000_000), 6, b"world\0")


def position(k: int) -> tuple[float, float, float]:
    """Where command `k` is [m]."""
    return 0.001 * k, 0.0, 0.0105 - 2e-5 * k


def pose_stamped(k: int, stamp: int = START) -> bytes:
    """Command `k`."""
    return _header(stamp) + struct.pack("<7d", *position(k), 0.0, 0.0, 0.0, 1.0)


def _pose(k: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<7d", *position(k), 0.0, 0.0, 0.0, 1.0)


def _wrench(k: int, stamp: int) -> bytes:
    return _header(stamp) + struct.pack("<6d", 0.0, 0.0, 0.01 * k, 0.0, 0.0, 0.0)


def _commands(times: Sequence[int]) -> list[Put]:
    return [Put(COMMANDS, POSE_STAMPED, t, pose_stamped(k, t), k + 1) for k, t in enumerate(times)]


def _others(k: int, t: int) -> list[Put]:
    """What is recorded after command `k`: a wrench after every third, a message of a foreign type after every fifth."""
    w, f = t + AFTER[0], t + AFTER[1]
    wrench = Put(WRENCHES, WRENCH_STAMPED, w, _wrench(k, w), k // 3 + 1)
    foreign = Put(OTHERS, FOREIGN, f, b"\0\1\0\0" + struct.pack("<q", f), k // 5 + 1)
    return [wrench] * (k % 3 == 0) + [foreign] * (k % 5 == 0)


def _interleaved(commands: list[Put]) -> tuple[Put, ...]:
    """Commands and the others as a recorder gets them; all their log times differ."""
    return tuple(each for k, command in enumerate(commands) for each in (command, *_others(k, command.log_time)))


def _steady() -> list[int]:
    return [START + k * PERIOD for k in range(COUNT)]


def plain() -> Content:
    """Nothing is special."""
    times = _steady()
    return Content(_interleaved(_commands(times)))


def clock_back() -> Content:
    """The recorder's clock was set back twice: by 0.1955 s and by 0.0947 s."""
    times = [t - 195_500_000 * (k >= 20) - 94_700_000 * (k >= 45) for k, t in enumerate(_steady())]
    return Content(_interleaved(_commands(times)))


def days_apart() -> Content:
    """Three days pass between two messages."""
    times = [t + 3 * DAY * (k >= 30) for k, t in enumerate(_steady())]
    return Content(_interleaved(_commands(times)))


def one_instant() -> Content:
    """The recorder's clock stood still."""
    commands = _commands([START] * COUNT)
    return Content(tuple(m._replace(data=pose_stamped(k, START + k)) for k, m in enumerate(commands)))


def several_publishers() -> Content:
    """Two publishers take turns on a topic, each with numbers of its own."""
    times = _steady()
    commands = [
        m._replace(publisher=k % 2, sequence=k // 2 + 1 + 5000 * (k % 2)) for k, m in enumerate(_commands(times))
    ]
    return Content(_interleaved(commands))


def numbers_mixed() -> Content:
    """Two publishers take turns, and the recorder did not keep them apart."""
    times = _steady()
    commands = [m._replace(sequence=k // 2 + 1 + 5000 * (k % 2)) for k, m in enumerate(_commands(times))]
    return Content(_interleaved(commands), lost=None)


def numbers_missing() -> Content:
    """One publisher's messages 11 to 13 did not come, nor the other's 40th."""
    times = _steady()
    commands = []
    for k, message in enumerate(_commands(times)):
        number, publisher = k // 2 + 1, k % 2
        missing = 3 * (publisher == 0 and number > 10) + (publisher == 1 and number > 20)
        commands.append(message._replace(publisher=publisher, sequence=number + missing))
    return Content(_interleaved(commands), lost=4)


def no_pose() -> Content:
    """One of the commands is cut short, and one is empty."""
    times = _steady()
    commands = _commands(times)
    commands[20] = commands[20]._replace(data=commands[20].data[:50])
    commands[41] = commands[41]._replace(data=b"")
    return Content(_interleaved(commands), refused=2)


def two_types() -> Content:
    """A publisher of poses without stamps is on the topic of the commands."""
    times = _steady()
    stray = [Put(COMMANDS, POSE, t + 1, _pose(500 + k), k + 1, 1) for k, t in enumerate(times[::6])]
    topics = (*Content(()).topics, (COMMANDS, POSE))
    both = sorted([*_commands(times), *stray], key=lambda message: message.log_time)
    return Content(tuple(both), topics)


def no_commands() -> Content:
    """The topic of the commands is there, without a message."""
    return Content(tuple(each for k, t in enumerate(_steady()) for each in _others(k, t)))


def empty() -> Content:
    """Topics and no message."""
    return Content(())


CONTENTS: dict[str, Callable[[], Content]] = {
    make.__name__: make
    for make in (
        plain, clock_back, days_apart, one_instant, several_publishers, numbers_mixed, numbers_missing, no_pose,
        two_types, no_commands, empty,
    )
}  # fmt: skip

NUMBERED = ("several_publishers", "numbers_mixed", "numbers_missing")
"""Contents that are special only where messages are numbered."""

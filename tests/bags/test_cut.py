"""Bags whose writer is ended early, and signals that wait until a bag can be finished."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from mcap.writer import Writer

from finger_sim.bags import cdr
from finger_sim.bags.interrupts import deferred
from finger_sim.bags.mcap_files import McapSource
from finger_sim.bags.packing import Stored
from finger_sim.bags.reader import BagReader, BagWriter
from finger_sim.errors import BagError

MS = 1_000_000


def pose(k: int) -> bytes:
    return cdr.pose_stamped(k, "world", (0.001 * k, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_a_bag_that_is_cut_is_finished_and_says_so(tmp_path: Path) -> None:
    """Without its metadata.yaml too: the last file holds the reason."""
    bag = BagWriter(tmp_path / "bag", custom_data={"scene": "finger"})
    bag.add_topic("pose", cdr.POSE_STAMPED)
    for k in range(10):
        bag.write("pose", pose(k), k * MS)
    bag.cut("no more commands")
    reader = BagReader(tmp_path / "bag")
    assert (reader.warning, reader.cut, reader.message_count) == (None, "no more commands", 10)
    assert b"cut: no more commands" in (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    with pytest.raises(BagError, match="closed"):
        bag.write("pose", pose(0), 0)


def test_a_disk_that_is_full_from_the_start_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the bag's nor those that were made for it; what was there stays."""
    real = Path.open
    monkeypatch.setattr(Path, "open", lambda path, *mode: real(Path("/dev/full"), "wb"))
    with pytest.raises(BagError, match="No space left on device"):
        BagWriter(tmp_path / "deep" / "bag")
    assert not list(tmp_path.iterdir())


def test_messages_outside_of_chunks_are_read_in_runs(tmp_path: Path) -> None:
    """Not one by one, which would take memory for each; their order is that of time all the same."""
    path = tmp_path / "flat.mcap"
    times = [(k * 7919) % 20_000 for k in range(20_000)]
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema(cdr.POSE_STAMPED, "ros2msg", b"")
        channel = writer.register_channel("/pose", "cdr", schema)
        for k, time in enumerate(times):
            writer.add_message(channel, time, pose(k), time, k + 1)
        writer.finish()
    source = McapSource([Stored(path, path, "mcap")])
    assert len(source.segments) < 10
    assert [message.log_time for message in source.messages()] == sorted(times)
    assert (source.topics[0].count, source.warnings) == (20_000, [])


@pytest.mark.parametrize(("number", "error"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)])
def test_signals_wait(number: int, error: type[BaseException]) -> None:
    """They take effect where the block asks for it, or at its end; then what was there before is back."""
    before = signal.getsignal(number)
    done = []

    def work(ask: bool) -> None:
        with deferred() as deliver:
            signal.raise_signal(number)
            done.append("after the signal")
            if ask:
                deliver()
            done.append("at the end")

    for ask, expected in ((True, ["after the signal"]), (False, ["after the signal", "at the end"])):
        done.clear()
        with pytest.raises(error) as raised:
            work(ask)
        assert done == expected
        assert signal.getsignal(number) is before
        assert getattr(raised.value, "code", 143) == 143

"""Files that are whole or not there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from finger_sim.errors import FingerSimError
from finger_sim.pictures.surfaces import new_figure, save
from finger_sim.plain import whole_file


def begin(path: Path) -> None:
    """Writes half of a file, and is interrupted."""
    with whole_file(path) as file:
        assert file.suffix == ".json"
        file.write_text("ha")
        raise KeyboardInterrupt


def test_what_ends_early_leaves_what_was_there(tmp_path: Path) -> None:
    """An interrupt in the middle of writing: the old file as it was, no other beside it; a link stays one."""
    old, link = tmp_path / "old.json", tmp_path / "link.json"
    old.write_text("old")
    link.symlink_to(old)
    for path in (old, link, tmp_path / "new.json"):
        with pytest.raises(KeyboardInterrupt):
            begin(path)
    assert sorted(tmp_path.iterdir()) == [link, old]
    with whole_file(link) as file:
        file.write_text("new")
    assert (old.read_text(), link.is_symlink()) == ("new", True)


def test_a_device_is_written_to(tmp_path: Path) -> None:
    """It is not replaced by a file."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with whole_file(pipe) as file:
        file.write_text("through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)


def test_a_picture_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ended while matplotlib writes it, it leaves nothing; an error names the path that was given."""
    figure = new_figure(1.0, 1.0)

    def half(path: Path, **_: object) -> None:
        Path(path).write_bytes(b"\x89PN")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure, "savefig", half)
    with pytest.raises(KeyboardInterrupt):
        save(figure, tmp_path / "touch.png")
    assert not list(tmp_path.iterdir())
    nowhere = tmp_path / "nowhere" / "touch.png"
    with pytest.raises(FingerSimError, match=f"{nowhere}: the picture cannot be written: No such file or directory$"):
        save(new_figure(1.0, 1.0), nowhere)

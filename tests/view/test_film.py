"""A recording in the browser: the real server plays it, and a film is made of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from processes import REPOSITORY
from view.browser import until

from finger_sim.view.film import PAUSE, main

pytestmark = pytest.mark.slow
PRESS = ["--start", "0.4", "--duration", "1.2"]
"""Of press_flat: from above the plane until it is pressed."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A press as `finger_sim run` records it."""
    out = tmp_path_factory.mktemp("film") / "press"
    command = ["run", "finger_haptic", "--bag", "press_flat", "-o", str(out), *PRESS]
    subprocess.run(
        [sys.executable, "-m", "finger_sim", *command], check=True, capture_output=True, timeout=200, cwd=REPOSITORY
    )
    return out


@pytest.fixture
def url(bag: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "finger_sim", "view", str(bag), "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=REPOSITORY) as server:
        assert server.stdout is not None
        yield server.stdout.readline().strip()
        server.terminate()


def test_a_recording_is_played_by_the_real_server(url: str, open_tab: Any) -> None:
    """The slider goes to its times: free at the beginning, pressed at the end; then it plays by itself."""
    tab = open_tab(url).live()
    tab.page.locator("#play[data-playing]").evaluate(PAUSE)
    tab.until(lambda data: data["playing"] == "false")
    tab.page.locator("#time").fill("0")
    tab.until(lambda data: float(data["time"]) < 0.05 and data["force"] != "" and float(data["force"]) < 0.01)
    tab.page.locator("#time").fill(tab.page.locator("#time").get_attribute("max"))
    pressed = tab.until(lambda data: float(data["time"]) > 1.1 and float(data["force"] or 0) > 3.0)
    assert float(pressed["depth"]) > 1.5
    assert float(pressed["most"]) > 1.0
    assert tab.text("#bag-name") == "press"
    tab.keep("real-recording")
    tab.page.locator("#time").fill("100")
    tab.until(lambda data: float(data["time"]) < 0.1)
    tab.page.locator("#viewport").focus()
    tab.page.keyboard.press("Space")
    tab.until(lambda data: float(data["time"]) > 0.1)
    until(lambda: tab.page.locator("#play").get_attribute("aria-label") == "Pause" or tab.number("time") > 1.1, tab)


def test_a_film_is_made(bag: Path, tmp_path: Path, browser: Any) -> None:
    """Of as many pictures as asked for, that differ, as wide as asked for."""
    made = tmp_path / "film.webp"
    command = [str(bag), "-o", str(made), "--begin", "0.4", "--end", "1.0", "--rate", "5", "--width", "400"]
    subprocess.run([sys.executable, "-m", "finger_sim.view.film", *command], check=True, timeout=100, cwd=REPOSITORY)
    with Image.open(made) as film:
        assert film.n_frames == 4
        assert film.size == (400, 256)
        pictures = []
        for k in range(4):
            film.seek(k)
            pictures.append(film.convert("RGB").tobytes())
    assert len(set(pictures)) == 4
    assert made.stat().st_size < 1.5e6


def test_what_no_film_can_be_made_of_is_said(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A name of no kind of picture, and a rate out of range."""
    assert main([str(bag), "-o", str(tmp_path / "film.mp4")]) == 1
    assert "'film.mp4', allowed: a name that ends in .webp or .png" in capsys.readouterr().err
    assert main([str(bag), "-o", str(tmp_path / "film.webp"), "--rate", "1000"]) == 1
    assert "0.1 to 60 Hz" in capsys.readouterr().err

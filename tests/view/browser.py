"""A page in Debian's Chromium, drawn in software, and what tests look at and do in it."""

from __future__ import annotations

import io
import itertools
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, Playwright

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
WIDE = {"width": 1366, "height": 768}
TABLET = {"width": 1024, "height": 768}
SMALL = {"width": 1000, "height": 600}
"""Drawn the fastest, with everything on it that a large one has."""
TINY = {"viewport": {"width": 860, "height": 480}, "device_scale_factor": 0.25}
"""For two pages at once."""
FOLDER = "FINGER_SIM_SCREENSHOTS"
"""Names the folder in which pictures of all states are left. Without it, coarse pixels are drawn, which is fast."""
POLL = 30.0
"""Time between two looks at a condition [ms]; a look takes time from what is looked at."""
WITHIN = 60.0
"""Longest wait for any condition [s]: this is drawn in software, maybe on half a core."""


FRESH = """() => {
  document.querySelectorAll("dialog[open]").forEach((each) => each.close());
  document.querySelectorAll("details").forEach((each) => (each.open = each.matches(".group:first-child")));
  document.querySelectorAll("main :is([type=radio], [type=checkbox])").forEach((each) => {
    if (each.checked !== each.defaultChecked && (each.type === "checkbox" || each.defaultChecked)) each.click();
  });
  const filter = document.querySelector("#filter");
  filter.value = "";
  filter.dispatchEvent(new Event("input"));
  document.querySelectorAll("#notices button").forEach((each) => each.click());
  document.body.tabIndex = -1;
  document.body.focus(); // from here on Tab goes through the page
  document.body.removeAttribute("tabindex");
}"""


def launch(playwright: Playwright) -> Browser:
    """Raises playwright's Error where there is no Chromium."""
    return playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)


class Tab:
    """A page, with what went wrong in it. `data`: the attributes in which the page tells its state."""

    def __init__(self, browser: Browser, url: str, **options: Any) -> None:
        self.url = url
        before = options.pop("before", None)
        coarse = {} if os.environ.get(FOLDER) else {"device_scale_factor": 0.5}
        self.context = browser.new_context(**({"viewport": SMALL} | coarse | options))
        self.page: Page = self.context.new_page()
        self.page.set_default_timeout(1e3 * WITHIN)
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.requests.append(socket.url))
        if before is not None:
            self.page.add_init_script(before)
        self.page.goto(url)

    def _console(self, message: Any) -> None:
        # Chromium itself reports each try to connect while there is no server.
        if message.type in ("error", "warning") and "ERR_CONNECTION" not in message.text:
            self.errors.append(message.text)

    def fresh(self) -> None:
        """As it was opened: choices, layers, filter, focus; nothing is held."""
        self.page.evaluate(FRESH)
        self.live().until(lambda data: data["handle"] == "free")

    def shown(self) -> None:
        """Waits until what the server has now is shown, and looks at it as at first."""
        seq = int(self.data["seq"])
        self.until(lambda data: int(data["seq"]) > seq + 2)
        self.page.evaluate("document.querySelector('[data-look=reset]').click()")
        self.redrawn()

    @property
    def data(self) -> dict[str, str]:
        return dict(self.page.evaluate("({...document.documentElement.dataset})"))

    def number(self, name: str) -> float:
        """NaN: it is not shown."""
        return float(self.data.get(name) or "nan")

    def until(self, condition: Callable[[dict[str, str]], bool], within: float = WITHIN) -> dict[str, str]:
        """Waits for a condition on what the page tells."""
        end = time.monotonic() + within
        while not condition(data := self.data):
            assert time.monotonic() < end, f"not within {within:g} s; the page tells {data}"
            self.page.wait_for_timeout(POLL)
        return data

    def live(self) -> Tab:
        """Waits until it shows a frame."""
        self.until(lambda data: data["condition"] in ("live", "bag") and bool(data.get("finger")))
        return self

    def redrawn(self) -> None:
        """Waits until the picture is newer than what was done until now."""
        pictures = int(self.data["pictures"])
        self.until(lambda data: int(data["pictures"]) > pictures + 2)

    def text(self, selector: str) -> str:
        return self.page.locator(selector).inner_text()

    def finger(self) -> tuple[float, float]:
        """Where on the screen the finger is."""
        x, y = self.data["finger"].split(",")
        return float(x), float(y)

    def picture(self) -> np.ndarray:
        """Of the finger alone (height, width, 3)."""
        box = self.page.locator("#viewport").bounding_box()
        assert box is not None
        clip = {"x": box["x"] + 0.2 * box["width"], "y": box["y"] + 0.2 * box["height"]}
        clip |= {"width": 0.6 * box["width"], "height": 0.55 * box["height"]}
        png = self.page.screenshot(clip=clip)  # type: ignore[arg-type]
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.int16)

    def keep(self, name: str) -> None:
        """Leaves a picture, where one is wanted."""
        folder = os.environ.get(FOLDER)
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=Path(folder) / f"{name}.png")

    def close(self) -> None:
        self.context.close()


def until(condition: Callable[[], bool], tab: Tab, within: float = WITHIN) -> None:
    """Waits for a condition on what the server was told, while a page goes on."""
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end, f"not within {within:g} s; the page tells {tab.data}"
        tab.page.wait_for_timeout(POLL)


def assert_apart(tab: Tab, touch: bool) -> None:
    """Nothing overlaps or is cut off: the head fits, and what lies over the view lies apart."""
    size = tab.page.viewport_size
    assert size is not None
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    panel = tab.page.evaluate("document.querySelector('#side').scrollWidth")
    assert panel <= tab.page.evaluate("document.querySelector('#side').clientWidth")
    boxes = {}
    for name in ("#overlay-left", "#overlay-views", "#legend", "#keys", "#hand"):
        box = tab.page.locator(name).bounding_box()
        assert box is not None
        boxes[name] = box
    for (one, a), (other, b) in itertools.combinations(boxes.items(), 2):
        apart = (
            a["x"] + a["width"] <= b["x"] or b["x"] + b["width"] <= a["x"]
            or a["y"] + a["height"] <= b["y"] or b["y"] + b["height"] <= a["y"]
        )  # fmt: skip
        assert apart, (one, other, a, b)
    for button in tab.page.locator("header button:visible, header select:visible").all():
        box = button.bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= size["width"]
        assert not touch or box["height"] >= 40

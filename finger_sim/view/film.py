"""A short film of a recording, or one picture of it, as the page shows it in Chromium.

`python -m finger_sim.view.film BAG -o view.webp` needs the page's server, Playwright, and Chromium.
"""

from __future__ import annotations

import argparse
import io
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..console import gauge, say
from ..errors import FingerSimError, MissingExtraError
from ..plain import printing

if TYPE_CHECKING:
    from PIL.Image import Image
    from playwright.sync_api import Page

ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
"""Of Chromium, which then draws without a graphics card."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
QUALITIES = (80, 65, 50, 35, 20)
"""Of WebP, the best first; the first whose file is small enough is taken."""
BITS = (8, 7, 6, 5)
"""Of each colour of a PNG, in that order."""
NEAR = 0.06
"""How far from a time that was sought the frame may be that is shown for it [s]."""
PLOT, PANEL = 0.12, 0.8
"""Time in which the plots, and in which the numbers of the panel follow a time that was sought [s]."""
PAUSE = "button => { if (button.dataset.playing === 'true') button.click(); }"
"""What ends playing, and does not begin it where the recording has just come to its end."""
WITHIN, LONGEST = 60.0, 120.0
"""Longest wait for the page, and for one thing that the browser does [s]."""


def main(arguments: list[str] | None = None) -> int:
    """Makes the film; 1: it cannot be made, and stderr says why."""
    try:
        _make(_options(arguments))
    except FingerSimError as error:
        say(f"finger_sim.view.film: {error}")
        return 1
    return 0


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("finger_sim.view.film", description=__doc__)
    add = parser.add_argument
    add("bag", type=Path, help="recording with the mesh in it, as the node makes it")
    add("-o", "--out", type=Path, required=True, metavar="FILE", help=".webp for a film, .png for one picture")
    add("--begin", type=float, default=0.0, metavar="S", help="time in the recording (default: %(default)s)")
    add("--end", type=float, metavar="S", help="default: its end; one picture is of --begin")
    add("--rate", type=float, default=12.0, metavar="HZ", help="pictures a second (default: %(default)s)")
    add("--size", type=_size, default=(1000, 640), metavar="WxH", help="of the page (default: 1000x640)")
    add("--width", type=int, default=800, metavar="PX", help="of the film (default: %(default)s)")
    add("--theme", choices=("dark", "light"), default="dark", help="default: %(default)s")
    add("--panel", action="store_true", help="with the panel at the side")
    add("--most", type=float, default=1.5, metavar="MB", help="largest file (default: %(default)s)")
    return parser.parse_args(arguments)


def _size(text: str) -> tuple[int, int]:
    parts = text.split("x")
    if len(parts) != 2 or not all(part.isdecimal() and 200 <= int(part) <= 4000 for part in parts):
        raise argparse.ArgumentTypeError(f"got {text!r}, allowed: two numbers from 200 to 4000, as in 1000x640")
    return int(parts[0]), int(parts[1])


def _make(options: argparse.Namespace) -> None:
    kind = options.out.suffix.lower()
    if kind not in (".webp", ".png"):
        raise FingerSimError(f"-o: got {options.out.name!r}, allowed: a name that ends in .webp or .png")
    if not 0.1 <= options.rate <= 60.0:
        raise FingerSimError(f"--rate: got {options.rate:g}, allowed: 0.1 to 60 Hz")
    with _served(options.bag) as url, _opened(url, options) as page:
        duration = float(page.locator("#bag-end").inner_text().split()[0])
        end = options.begin if kind == ".png" else min(options.end or duration, duration)
        if not 0.0 <= options.begin <= end:
            raise FingerSimError(f"--begin: got {options.begin:g}, allowed: 0 to {end:g} s")
        count = 1 + round((end - options.begin) * options.rate)
        _seek(page, options.begin, duration)
        page.locator("[data-look=reset]").click()
        page.mouse.move(1, options.size[1] - 1)
        pictures = []
        with gauge(f"drawing {options.bag}") as meter:
            for k in range(count):
                settled = PANEL if options.panel else PLOT
                pictures.append(_picture(page, options.begin + k / options.rate, duration, settled))
                meter(k + 1, count)
    _write(pictures, options, kind)


@contextmanager
def _served(bag: Path) -> Iterator[str]:
    """The address at which a recording is shown, until the end."""
    command = [sys.executable, "-m", "finger_sim", "view", str(bag), "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().strip()
            if not url:
                raise FingerSimError(f"{bag}: its page could not be served")
            yield url
        finally:
            server.terminate()


@contextmanager
def _opened(url: str, options: argparse.Namespace) -> Iterator[Page]:
    """The page, once it shows the recording."""
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        raise MissingExtraError("a film", "test") from None
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise FingerSimError(f"a film needs one of the browsers {', '.join(BROWSERS)}: apt-get install chromium")
    width, height = options.size
    with sync_playwright() as playwright:
        chromium = None
        try:
            chromium = playwright.chromium.launch(executable_path=browser, args=ARGUMENTS)
            size: Any = {"width": width, "height": height}
            page = chromium.new_page(viewport=size, color_scheme=options.theme)
            page.set_default_timeout(1e3 * LONGEST)
            page.goto(url)
            if not options.panel:
                page.locator("#fold").click()
            _until(page, lambda data: data["condition"] == "bag" and bool(data.get("finger")))
            page.locator("#play[data-playing]").evaluate(PAUSE)  # once it was told
            _until(page, lambda data: data["playing"] == "false")
            yield page
        except Error as error:
            raise FingerSimError(f"{browser}: {str(error).partition(chr(10))[0]}") from None
        finally:
            if chromium is not None:
                chromium.close()


def _seek(page: Page, at: float, duration: float) -> None:
    """Has the page show a time of the recording [s]."""
    slider = page.locator("#time")
    steps = int(slider.get_attribute("max") or 1)
    slider.fill(str(round(steps * min(at / duration, 1.0))))
    _until(page, lambda data: abs(float(data.get("time") or "nan") - at) <= NEAR)


def _picture(page: Page, at: float, duration: float, settled: float) -> Image:
    """The page at a time of the recording [s], `settled` seconds after it was sought."""
    from PIL import Image

    _seek(page, at, duration)
    page.wait_for_timeout(1e3 * settled)
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def _until(page: Page, condition: Callable[[dict[str, str]], bool]) -> None:
    """Waits until a condition holds on what the page tells."""
    end = time.monotonic() + WITHIN
    while not condition(data := dict(page.evaluate("({...document.documentElement.dataset})"))):
        if time.monotonic() > end:
            raise FingerSimError(f"the page did not show the recording within {WITHIN:g} s; it tells {data}")
        page.wait_for_timeout(10)


def _write(pictures: list[Image], options: argparse.Namespace, kind: str) -> None:
    """Writes the file, no larger than it may be."""
    options.out.parent.mkdir(parents=True, exist_ok=True)
    if kind == ".png":
        data = _png(pictures[0], 1e6 * options.most)
    else:
        height = round(pictures[0].height * options.width / pictures[0].width)
        small = [picture.resize((options.width, height)) for picture in pictures]
        data = _webp(small, options.rate, 1e6 * options.most)
    if len(data) > 1e6 * options.most:
        raise FingerSimError(
            f"{len(data) / 1e6:.2f} MB is more than --most {options.most:g}: make it shorter or smaller"
        )
    options.out.write_bytes(data)
    say(f"{options.out}: {len(pictures)} pictures, {len(data) / 1e6:.2f} MB")


def _png(picture: Image, most: float) -> bytes:
    """With as many bits a colour as make it small enough, or the least."""
    from PIL.ImageOps import posterize

    data = b""
    for bits in BITS:
        out = io.BytesIO()
        posterize(picture, bits).save(out, "PNG", optimize=True)
        data = out.getvalue()
        if len(data) <= most:
            break
    return data


def _webp(pictures: list[Image], rate: float, most: float) -> bytes:
    """In the best quality that is small enough, or the worst."""
    data = b""
    for quality in QUALITIES:
        out = io.BytesIO()
        pictures[0].save(
            out, "WEBP", save_all=True, append_images=pictures[1:], duration=round(1e3 / rate), loop=0,
            quality=quality, method=4,
        )  # fmt: skip
        data = out.getvalue()
        if len(data) <= most:
            break
    return data


if __name__ == "__main__":
    sys.exit(printing("finger_sim.view.film", main))

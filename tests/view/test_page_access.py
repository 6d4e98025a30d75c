"""The page for everybody: by keyboard alone, with names that are read out, and colours that can be read."""

from __future__ import annotations

from typing import Any

import numpy as np
from view.browser import WIDE, Tab, until

LOOK_AT_TEXT = """() => {
  const numbers = (text) => (text.match(/[\\d.]+/g) || []).map(Number);
  const parse = (text) => { const [r, g, b, a = 1] = numbers(text); return { rgb: [r, g, b], a }; };
  const over = (front, back) => front.rgb.map((value, k) => front.a * value + (1 - front.a) * back[k]);
  const ground = (element) => {
    const layers = [];
    for (let at = element; at !== null; at = at.parentElement) {
      const colour = parse(getComputedStyle(at).backgroundColor);
      if (colour.a > 0) layers.push(colour);
      if (colour.a === 1) break;
    }
    return layers.reverse().reduce((back, front) => over(front, back), [255, 255, 255]);
  };
  const opacity = (element) => {
    let all = 1;
    for (let at = element; at !== null; at = at.parentElement) all *= Number(getComputedStyle(at).opacity);
    return all;
  };
  const seen = (element) => {
    const { width, height } = element.getBoundingClientRect();
    return width > 1 && height > 1 && element.checkVisibility();
  };
  const found = [];
  for (const element of document.body.querySelectorAll("*")) {
    const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim() !== "");
    const field = element.matches("input:not([type=checkbox], [type=radio], [type=range]), select, textarea");
    if ((!own && !field) || !seen(element) || element.closest("svg")) continue;
    const back = ground(element);
    const text = (field && element.value) || element.textContent.trim().slice(0, 40);
    const add = (style) => {
      const colour = parse(style.color);
      found.push({ text, place: element.id || element.className || element.tagName, back, back_alpha: 1,
                   front: over({ ...colour, a: colour.a * opacity(element) }, back) });
    };
    add(getComputedStyle(element));
    if (element.placeholder) add(getComputedStyle(element, "::placeholder"));
  }
  return found;
}"""
"""Every text that is seen, with its colour and the one behind it in 0…255."""

NAMES = """() => [...document.querySelectorAll("button, input, select, textarea, summary, a, meter, [tabindex]")]
  .filter((element) => element.checkVisibility())
  .map((element) => ({
    place: element.outerHTML.slice(0, 90),
    name: element.getAttribute("aria-label")
      || (element.getAttribute("aria-labelledby") || "").split(" ")
        .map((id) => document.getElementById(id)?.textContent || "").join("")
      || [...(element.labels || [])].map((label) => label.textContent).join("")
      || element.textContent.trim(),
  }))"""

FOCUSED = """() => {
  const at = document.activeElement;
  const shown = at.matches("#colour-by input, #drag input") ? at.closest("label") : at;
  const style = getComputedStyle(shown);
  return { id: at.id, text: (at.getAttribute("aria-label") || at.textContent || at.value || "").trim().slice(0, 40),
           tag: at.tagName, ring: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2 };
}"""


def luminance(colour: list[float]) -> float:
    """Relative luminance of sRGB in 0…255 (WCAG 2)."""
    parts = np.array(colour) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: list[float], other: list[float]) -> float:
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def assert_readable(tab: Tab, least: int) -> None:
    texts = tab.page.evaluate(LOOK_AT_TEXT)
    assert len(texts) > least
    poor = [(each["place"], each["text"], round(contrast(each["front"], each["back"]), 2)) for each in texts]
    assert not [each for each in poor if each[2] < 4.5]


def test_text_can_be_read(stub: Any, open_tab: Any) -> None:
    """All text has a contrast of 4.5 or more: of a press, of dialogs and popovers, and of a lost connection."""
    tab = open_tab(stub.url, viewport=WIDE).live()
    stub.finger.command[2] -= 0.004
    tab.until(lambda data: float(data["force"] or 0) > 1.0)
    tab.page.locator("#words .warn").wait_for()
    for layer in ("axes", "bone", "ghost"):
        tab.page.evaluate(f"document.querySelector('[data-layer={layer}]').click()")
    tab.page.locator("#hold").click()
    tab.until(lambda data: data["handle"] == "mine")
    for scheme in ("dark", "light"):
        dress(tab, scheme)
        tab.page.evaluate("document.querySelectorAll('details').forEach((each) => (each.open = true))")
        stub.tell({"type": "notice", "level": "warn", "text": "a warning"})
        tab.page.locator("#notices li").first.wait_for()
        assert_readable(tab, 80)
        tab.page.evaluate("document.querySelectorAll('#layers, #hand-options').forEach((each) => (each.open = false))")
        tab.keep(f"all-{scheme}")
        tab.page.locator("#help").click()
        assert_readable(tab, 90)
        tab.keep(f"help-{scheme}")
        tab.page.keyboard.press("Escape")
    stub.stop()
    tab.until(lambda data: data["condition"] == "waiting")
    for scheme in ("dark", "light"):
        dress(tab, scheme)
        assert_readable(tab, 60)
        tab.keep(f"disconnected-{scheme}")


def dress(tab: Tab, scheme: str) -> None:
    """The system is dark, or light."""
    tab.page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    tab.until(lambda data: data["dark"] == str(scheme == "dark").lower())


def test_everything_has_a_name(shared: Any) -> None:
    """Whatever can be operated says what it is."""
    _, tab = shared
    tab.page.evaluate("document.querySelectorAll('details').forEach((each) => (each.open = true))")
    operated = tab.page.evaluate(NAMES)
    assert len(operated) > 50
    assert not [each["place"] for each in operated if not each["name"].strip()]


def test_the_keyboard_reaches_everything(shared: Any) -> None:
    """In the order in which it is seen, with a ring around what has the focus."""
    _, tab = shared
    visited = []
    for _ in range(70):
        tab.page.keyboard.press("Tab")
        focused = tab.page.evaluate(FOCUSED)
        if focused["tag"] == "BODY":
            break
        assert focused["ring"], focused
        visited.append(focused["id"] or focused["text"])
    wanted = ["Skip to the finger", "scene", "record", "reset", "yaml", "help", "theme", "fold", "viewport"]
    assert visited[: len(wanted)] == wanted
    assert {"hold", "filter"} <= set(visited)
    assert visited.index("hold") < visited.index("filter") < visited.index("Licences")
    assert len(visited) > 30


def test_the_keyboard_alone_does_everything(shared: Any) -> None:
    """Press, slide, turn, let go, look from elsewhere, reset, set a value, change colour, theme and layers."""
    stub, tab = shared
    keys = tab.page.keyboard
    keys.press("Tab")
    keys.press("Enter")  # skips to the finger
    assert tab.page.evaluate("document.activeElement.id") == "viewport"
    keys.down("PageDown")
    tab.until(lambda data: float(data["force"] or 0) > 1.0)
    keys.up("PageDown")
    assert (np.diff(np.array(stub.poses)[:, 2]) <= 1e-6).all()
    before = np.array(stub.poses[-1])
    keys.down("ArrowRight")
    until(lambda: np.linalg.norm((np.array(stub.poses[-1]) - before)[:2]) > 2e-3, tab)
    keys.up("ArrowRight")
    turned = list(stub.finger.command[3:])
    keys.down("Shift")
    keys.down("ArrowLeft")
    until(lambda: abs(np.dot(stub.finger.command[3:], turned)) < 0.999, tab)
    keys.up("ArrowLeft")
    keys.up("Shift")
    keys.press("Escape")
    tab.until(lambda data: data["handle"] == "free" and float(data["force"] or 9) == 0.0)
    seen = tab.data["finger"]
    keys.down("d")
    tab.until(lambda data: data["finger"] != seen)
    keys.up("d")
    keys.press("Home")
    keys.press("r")
    until(lambda: "reset" in stub.said, tab)
    tab.page.locator("#colour-by input:checked").focus()
    keys.press("ArrowRight")
    tab.until(lambda data: tab.text("#legend-title") == "Contact pressure [kPa]")
    tab.page.locator("#layers summary").focus()
    keys.press("Enter")
    keys.press("Tab")
    keys.press("Space")
    assert tab.page.locator("[data-layer=wireframe]").is_checked()
    keys.press("Escape")
    assert not tab.page.locator("#layers").evaluate("(element) => element.open")
    tab.page.locator("#theme").focus()
    keys.press("Enter")
    tab.until(lambda data: data["dark"] == "true")
    assert tab.page.locator("#theme").get_attribute("aria-label") == "Theme: dark"
    tab.page.locator("[data-name='force_scale'] input[type=range]").first.focus()
    keys.press("ArrowRight")
    until(lambda: "set" in stub.said, tab)


def test_keys_in_a_field_move_nothing(shared: Any) -> None:
    """Who writes into a field writes, even an r."""
    stub, tab = shared
    tab.page.locator("#filter").focus()
    tab.page.keyboard.type("r friction")
    tab.page.keyboard.press("PageDown")
    tab.redrawn()
    assert tab.page.locator("#filter").input_value() == "r friction"
    assert not {"reset", "take", "pose"} & stub.said.keys()

"""What people do with the page, done in a real browser: hold the finger, set values, see what goes on."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import numpy as np
import pytest
from view.browser import TABLET, TINY, WIDE, Tab, assert_apart, until

PAD = """
window.padAxes = [0, 0, 0, 0]; window.padButtons = Array(17).fill(0); window.rumbles = [];
navigator.getGamepads = () => [{
  connected: true, id: "Test pad", axes: window.padAxes, mapping: "standard",
  buttons: window.padButtons.map((value) => ({ value, pressed: value > 0.5 })),
  vibrationActuator: { playEffect: (kind, how) => { window.rumbles.push(how); return Promise.resolve("complete"); } },
}];
"""
"""A gamepad that a browser without one has."""


NO_WEBGL = """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more);
};
"""


def heights(stub: Any) -> np.ndarray:
    return np.array([position[2] for position in stub.poses])


def press(tab: Tab, down: int = 60) -> None:
    """Drags the finger along the normal, and holds it there."""
    x, y = tab.finger()
    tab.page.keyboard.down("Shift")
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.until(lambda data: data["handle"] == "mine")
    tab.page.mouse.move(x, y + down, steps=12)
    tab.page.keyboard.up("Shift")


def test_a_drag_presses_and_lets_go(stub: Any, open_tab: Any) -> None:
    """Poses that fall arrive at the server, the force rises and is shown; let go, the finger springs off the plane."""
    tab = open_tab(stub.url, viewport=WIDE).live()
    assert_apart(tab, touch=False)
    tab.keep("free")
    press(tab)
    pressed = tab.until(lambda data: float(data["force"] or 0) > 2.0)
    assert pressed["drag"] == "press"
    steps = np.diff(heights(stub))
    assert (steps <= 1e-6).all()
    assert heights(stub)[0] - heights(stub)[-1] > 2e-3
    turns = np.array([pose["orientation"] for pose in stub.said["pose"]])
    assert np.ptp(turns, axis=0).max() < 1e-6
    assert "mm deep" in tab.text("#hand-now")
    assert "mm/s" in tab.text("#hand-now")
    # it rises while the two are read: the same once it is held
    tab.until(lambda data: float(tab.text("#value-normal")) == pytest.approx(float(data["force"]), abs=0.5))
    tab.keep("press")
    tab.page.mouse.up()
    tab.until(lambda data: data["handle"] == "free" and float(data["force"] or 9) == 0.0)
    until(lambda: stub.holder is None, tab)  # the page shows that it let go before the server has heard it
    assert stub.said["release"]


def test_a_drag_moves_in_the_plane_of_the_view(shared: Any) -> None:
    """Looked at from the side, right is along the finger and nothing across."""
    stub, tab = shared
    tab.page.locator("[data-look=side]").click()
    tab.redrawn()
    x, y = tab.finger()
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.page.mouse.move(x + 80, y, steps=8)
    until(lambda: bool(stub.poses) and stub.poses[-1][0] > 0.005, tab)
    assert abs(stub.poses[-1][1] - stub.poses[0][1]) < 1e-3
    tab.page.mouse.up()


def test_the_right_button_and_the_ring_turn(shared: Any) -> None:
    """The finger turns about its own origin."""
    stub, tab = shared
    x, y = tab.finger()
    first = stub.finger.command[3:]
    tab.page.mouse.move(x, y)
    tab.page.mouse.down(button="right")
    tab.page.mouse.move(x + 50, y, steps=6)
    until(lambda: abs(np.dot(stub.finger.command[3:], first)) < 0.995, tab)
    assert np.ptp(np.array(stub.poses), axis=0).max() < 1e-6
    assert tab.data["drag"] == "turn"
    tab.page.mouse.up(button="right")
    tab.until(lambda data: data["handle"] == "free")
    tab.page.locator("#drag input[value=turn]").check(force=True)
    tab.redrawn()  # with the ring
    second = list(stub.finger.command[3:])
    tab.page.mouse.move(x + 84, y)
    tab.page.mouse.down()
    tab.until(lambda data: data["drag"] == "roll")
    tab.page.mouse.move(x + 60, y + 60, steps=6)
    until(lambda: abs(np.dot(stub.finger.command[3:], second)) < 0.99, tab)
    tab.keep("turn")
    tab.page.mouse.up()


def test_one_page_at_a_time_holds(shared: Any, open_tab: Any) -> None:
    """The other says who does, offers nothing, and takes it when it is let go; one that closes in a drag lets go."""
    stub, one = shared
    two = open_tab(stub.url, **TINY).live()
    one.page.locator("#hold").click()
    one.until(lambda data: data["handle"] == "mine")
    two.until(lambda data: data["handle"] == "other")
    first = stub.holder
    assert two.text("#hand-text") == f"Page {first} holds it"
    assert two.page.locator("#hold").is_disabled()
    x, y = two.finger()
    two.page.mouse.move(x, y)
    two.page.mouse.down()
    two.page.mouse.move(x, y + 30, steps=3)
    two.page.mouse.up()
    assert {said["client"] for said in stub.said["pose"]} == {first}
    one.page.locator("#hold").click()
    two.until(lambda data: data["handle"] == "free")
    press(two, 15)
    one.until(lambda data: data["handle"] == "other")
    two.page.close()
    one.until(lambda data: data["handle"] == "free")
    assert stub.holder is None


def test_a_window_that_is_left_lets_go(shared: Any) -> None:
    """As when another program comes to the front."""
    stub, tab = shared
    tab.page.locator("#hold").click()
    tab.until(lambda data: data["handle"] == "mine")
    tab.page.evaluate("window.dispatchEvent(new Event('blur'))")
    tab.until(lambda data: data["handle"] == "free")
    until(lambda: stub.holder is None, tab)


def test_a_browser_that_cannot_draw_shows_numbers(stub: Any, open_tab: Any) -> None:
    """Without WebGL the force goes on being told and plotted, the page says what is missing, and values can be set."""
    tab = open_tab(stub.url, before=NO_WEBGL)
    stub.finger.command[2] -= 0.004
    tab.until(lambda data: float(data["force"] or 0) > 1.0 and int(data["seq"]) > 20)
    assert "no WebGL" in tab.text(".nowebgl")
    assert float(tab.text("#value-normal")) > 1.0
    tab.page.locator("[data-group=often] [data-name='plane.friction'] input[type=range]").focus()
    tab.page.keyboard.press("ArrowRight")
    until(lambda: "set" in stub.said, tab)
    assert all("WebGL" in error for error in tab.errors)
    tab.errors.clear()


def test_parameters_are_set_and_put_back(shared: Any) -> None:
    """By slider and number field, with what is refused said and put back."""
    stub, tab = shared
    field = tab.page.locator("[data-group=often] [data-name='plane.friction']")
    field.locator("input[type=range]").focus()
    tab.page.keyboard.press("ArrowRight")
    until(lambda: "set" in stub.said, tab)
    assert stub.said["set"][-1]["name"] == "plane.friction"
    assert 0.5 < stub.said["set"][-1]["value"] < 0.52
    number = field.locator("input.number")
    number.fill("0.8")
    number.press("Enter")
    until(lambda: stub.said["set"][-1]["value"] == 0.8, tab)
    number.fill("1000")
    number.press("Enter")
    tab.page.locator("#notices li.warn").wait_for()
    assert "0 to 100 is allowed" in tab.text("#notices")
    tab.page.locator("#filter").focus()
    until(lambda: number.input_value() == "0.8", tab)
    stub.tell({"type": "values", "values": {"plane.friction": 0.3}})
    until(lambda: number.input_value() == "0.3", tab)
    level = tab.page.locator("[data-group=often] [data-name='solver.level']")
    level.locator("select").select_option("standard")
    until(lambda: stub.said["set"][-1]["name"] == "solver.level", tab)
    assert stub.said["set"][-1]["value"] == "standard"
    until(lambda: "step 0.42 ms" in level.inner_text() and "0.01 % rms" in level.inner_text(), tab)


def test_the_plane_is_tilted_and_raised(shared: Any) -> None:
    """By sliders that say it as people think of it."""
    stub, tab = shared
    tab.page.locator("[data-name='Plane height'] input").fill("2.5")
    until(lambda: "set" in stub.said, tab)
    assert stub.said["set"][-1]["name"] == "plane.point"
    assert stub.said["set"][-1]["value"] == pytest.approx([0, 0, 2.5e-3])
    tab.page.locator("[data-name='Plane tilt about x'] input").fill("10")
    until(lambda: stub.said["set"][-1]["name"] == "plane.normal", tab)
    x, y, z = stub.said["set"][-1]["value"]
    assert np.rad2deg(np.arctan2(-y, z)) == pytest.approx(10.0, abs=0.01)
    assert x == pytest.approx(0.0)
    tab.keep("tilted")


def test_the_filter_finds_by_meaning(shared: Any) -> None:
    """Words of a name or of what it means; nothing found is said."""
    _, tab = shared
    tab.page.locator("#filter").fill("coulomb")
    shown = tab.page.locator("#groups .field:visible")
    assert [each.get_attribute("data-name") for each in shown.all()] == ["plane.friction"]
    tab.page.locator("#filter").fill("zzz")
    assert tab.page.locator("#nothing").is_visible()
    tab.page.locator("#filter").press("Escape")
    assert shown.count() > 5


def test_strain_is_seen(shared: Any) -> None:
    """A pressed finger has other pixels than a free one, and so has each quantity that colour shows."""
    stub, tab = shared
    for layer in ("contacts", "forces", "nail"):
        tab.page.evaluate(f"document.querySelector('[data-layer={layer}]').click()")
    free = tab.picture()
    still = tab.picture()
    stub.finger.command[2] -= 0.0045
    tab.until(lambda data: float(data["most"] or 0) > 1.0)
    strained = tab.picture()
    noise = np.abs(still - free).sum(axis=2) > 40
    changed = np.abs(strained - free).sum(axis=2) > 40
    assert noise.mean() < 1e-3
    assert changed.mean() > 0.02
    for quantity in ("pressure", "displacement"):
        tab.page.locator(f"#colour-by input[value={quantity}]").check(force=True)
        tab.redrawn()
        assert (np.abs(tab.picture() - strained).sum(axis=2) > 40).mean() > 0.01
        tab.keep(quantity)
    assert tab.text("#legend-title") == "Displacement [mm]"


def test_layers_are_drawn(shared: Any) -> None:
    """Each changes what is seen, and has its key where marks need one."""
    stub, tab = shared
    stub.finger.command[2] -= 0.004
    tab.until(lambda data: int(data["sticks"] or 0) > 0)
    before = tab.picture()
    for layer in ("wireframe", "bone", "axes", "plane", "ghost"):
        tab.page.evaluate(f"document.querySelector('[data-layer={layer}]').click()")
        tab.redrawn()
        after = tab.picture()
        assert (np.abs(after - before).sum(axis=2) > 20).any()
        before = after
    assert tab.text("#key-e2") == "e2: 0.75 to 1.25"
    tab.keep("layers")


def test_sticking_and_slipping_are_told_apart(shared: Any) -> None:
    """In numbers beside marks of different shape."""
    stub, tab = shared
    stub.script = lambda now: [0.0, 0.03 * (now % 0.7), 0.0065, *stub.finger.command[3:]]
    tab.until(lambda data: int(data["slips"] or 0) > 3)
    slipping = tab.text("#key-slips")
    assert slipping.endswith("slip")
    assert int(slipping.split()[0]) > 3
    tab.keep("slide")


def test_the_page_comes_back_by_itself(shared: Any) -> None:
    """A server that goes leaves no number behind; when it is back, the page is live again."""
    stub, tab = shared
    stub.finger.command[2] -= 0.004
    tab.until(lambda data: float(data["force"] or 0) > 1.0)
    tab.page.locator("#hold").click()
    tab.until(lambda data: data["handle"] == "mine")
    stub.stop()
    gone = tab.until(lambda data: data["condition"] == "waiting")
    assert gone["stale"] == "true"
    assert gone["force"] == ""
    assert {tab.text(f"#value-{name}") for name in ("normal", "tangential", "device", "depth")} == {"–"}
    assert {tab.text(f"#stat-{name}") for name in ("rate", "late", "limits", "contacts")} == {"–"}
    assert tab.text("#veil-title") == "The connection is lost"
    assert tab.text("#legend-most") == "max –"
    assert not tab.page.locator("#keys").is_visible()
    assert tab.page.locator("#record").is_disabled()
    assert "not known" in tab.text("#cost")
    assert gone["handle"] == "none"
    tab.keep("disconnected")
    stub.start()
    tab.live()
    tab.until(lambda data: data["handle"] == "free" and data["force"] != "")


def test_a_node_that_starts_or_is_gone_is_said(shared: Any) -> None:
    """In words, with no number left from before."""
    stub, tab = shared
    stub.phase, stub.message = "starting", "compiling: 40 %"
    tab.until(lambda data: data["condition"] == "starting" and data["force"] == "")
    assert tab.text("#veil-text") == "compiling: 40 %"
    tab.keep("starting")
    stub.phase, stub.message = "gone", ""
    tab.until(lambda data: data["condition"] == "gone")
    stub.phase = "running"
    tab.until(lambda data: data["condition"] == "live" and data["force"] != "")


def test_a_silent_server_is_said(shared: Any) -> None:
    """Its last numbers do not stay as if they were live."""
    stub, tab = shared
    stub.mute = True
    tab.until(lambda data: data["condition"] == "silent" and data["force"] == "")
    stub.mute = False
    tab.until(lambda data: data["condition"] == "live" and data["force"] != "")


def test_buttons(shared: Any) -> None:
    """Reset, record with a bag to fetch, which a page that comes later is told of; scene and YAML."""
    stub, tab = shared
    tab.page.locator("#reset").click()
    tab.page.locator("#record").click()
    tab.until(lambda data: data["recording"] == "press")
    tab.page.locator("#record").click()
    link = tab.page.locator("#recordings a")
    with tab.page.expect_download() as download:
        link.click()
    assert download.value.suggested_filename == "press.mcap"
    (page,) = stub.pages
    stub.tell(stub.hello(page) | {"recorded": 2 * stub.recorded})
    link.nth(1).wait_for()
    tab.page.locator("#scene").select_option("finger_coupled")
    tab.page.locator("#yaml").click()
    text = tab.page.locator("#yaml-text")
    text.wait_for()
    assert text.input_value().startswith("mesh:")
    tab.page.keyboard.press("Escape")
    until(lambda: {"reset", "record", "scene", "yaml"} <= stub.said.keys(), tab)
    assert stub.said["scene"][-1]["name"] == "finger_coupled"


def test_a_recording_is_played(stub: Any, open_tab: Any) -> None:
    """Its slider seeks, Space plays and pauses, and nothing of a node is offered."""
    stub.source = "bag"
    tab = open_tab(stub.url, viewport=WIDE).live()
    tab.page.locator("#time").focus()
    tab.page.keyboard.press("End")
    until(lambda: bool(stub.said.get("seek")) and stub.said["seek"][-1]["time"] == pytest.approx(6.0), tab)
    tab.page.locator("#time").fill("800")
    tab.until(lambda data: float(data["time"]) == pytest.approx(2.4, abs=0.02) and float(data["force"] or 0) > 1.0)
    tab.page.locator("#viewport").focus()
    tab.page.keyboard.press("Space")
    tab.until(lambda data: data["playing"] == "true" and float(data["time"]) > 2.5)
    tab.page.locator("#speed").select_option("0.25")
    tab.page.keyboard.press("Escape")
    tab.page.locator("#play").click()
    tab.until(lambda data: data["playing"] == "false")
    assert stub.said["play"][-1] | {"client": 1} == {"type": "play", "on": False, "speed": 0.25, "client": 1}
    assert tab.page.locator("#record").is_disabled()
    assert not tab.page.locator("#hold").is_visible()
    assert tab.text("#stat-rate") == "–"
    tab.keep("recording")


def test_a_virtual_coupling_has_a_ghost(shared: Any) -> None:
    """The commanded pose and its spring are drawn, and have a key."""
    stub, tab = shared
    stub.finger.command[2] -= 0.004
    tab.until(lambda data: float(data["force"] or 0) > 1.0)
    assert not tab.page.locator("#key-ghost").is_visible()
    stub.finger.coupled = True
    tab.page.locator("#key-ghost").wait_for(state="visible")
    tab.keep("coupled")


def test_a_gamepad_moves_and_rumbles(shared: Any) -> None:
    """A stick moves in the plane, a trigger presses, the pad rumbles with the force, and B lets go."""
    stub, tab = shared
    tab.page.evaluate(PAD)
    tab.page.evaluate("window.padAxes[0] = 0.8")
    until(lambda: len(stub.poses) > 3 and np.ptp(np.array(stub.poses)[:, :2], axis=0).max() > 1e-3, tab)
    assert np.ptp(heights(stub)) < 1e-5
    tab.page.evaluate("window.padAxes[0] = 0; window.padButtons[7] = 0.8")
    tab.until(lambda data: float(data["force"] or 0) > 1.0 and float(data.get("rumble") or 0) > 0.05)
    rumbles = json.loads(tab.page.evaluate("JSON.stringify(window.rumbles)"))
    assert all(0.0 <= how["strongMagnitude"] <= 1.0 for how in rumbles)
    tab.page.evaluate("window.padButtons[7] = 0; window.padButtons[1] = 1")
    tab.until(lambda data: data["handle"] == "free" and float(data["force"] or 9) == 0.0)
    tab.page.evaluate("delete navigator.getGamepads")


def test_touch(stub: Any, open_tab: Any) -> None:
    """On a tablet: a tap chooses what a drag does, a finger on the glass presses the finger on the plane."""
    tab = open_tab(stub.url, viewport=TABLET, has_touch=True, is_mobile=True).live()
    assert_apart(tab, touch=True)
    tab.page.locator("#drag label").nth(1).tap()
    x, y = tab.finger()
    client = tab.context.new_cdp_session(tab.page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    touch("touchStart", (x, y))
    tab.until(lambda data: data["handle"] == "mine")
    for k in range(1, 9):
        touch("touchMove", (x, y + 7 * k))
    tab.until(lambda data: float(data["force"] or 0) > 1.0)
    assert (np.diff(heights(stub)) <= 1e-6).all()
    tab.keep("tablet")
    touch("touchEnd")
    tab.until(lambda data: data["handle"] == "free")
    before = tab.finger()
    touch("touchStart", (x + 120, y + 130))
    touch("touchMove", (x + 50, y + 130))
    touch("touchEnd")
    tab.until(lambda data: data["finger"] != ",".join(str(round(each)) for each in before))
    for _ in range(10):  # the browser may take the tap after a drag as one that ends its fling
        tab.page.locator("#theme").tap()
        with contextlib.suppress(AssertionError):
            tab.until(lambda data: data["dark"] == "true", 2.0)
            return
    pytest.fail("no tap changed the theme")

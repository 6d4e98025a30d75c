"""The node's report as the page is told it."""

from __future__ import annotations

from finger_sim.haptics.budget import claimed
from finger_sim.physics.step import Status
from finger_sim.scene import Scene
from finger_sim.view.costs import SETTLE, LevelCosts
from finger_sim.view.words import TEXTS, Report, status_of, words_of

VALUES = {
    "rate [Hz]": "999.5", "real-time factor": "0.9995", "steps": "5000", "late steps": "30", "overruns": "2",
    "step time p50 [ms]": "0.250", "step time p99 [ms]": "0.750", "limited tets": "12", "locked tets": "3",
    "contacts": "25", "contact area [mm^2]": "31.5", "penetration [mm]": "0.0125", "command age [s]": "0.015",
    "command rate [Hz]": "60.0", "following delay [ms]": "16.7", "following": "auto: linear", "steps asleep": "0",
    "status": "LOCKED|LIMIT_EXCEEDED", "recording": "/somewhere/finger_1", "recorded messages": "77",
    "dropped records": "0",
}  # fmt: skip


def test_every_status_bit_has_words() -> None:
    """A new bit needs some."""
    assert set(TEXTS) == {bit for bit in Status if bit}


def test_numbers_in_si_units() -> None:
    """Millimetres become metres; late steps are also told as a share since the report before."""
    before = Report(VALUES | {"steps": "4000", "late steps": "20"})
    told = status_of(Report(VALUES, "ok"), before)
    assert (told["rate"], told["late"], told["late_percent"], told["overruns"]) == (999.5, 30.0, 1.0, 2.0)
    assert told["step_ms"] == {"p50": 0.25, "p99": 0.75}
    assert abs(told["contact_area"] - 31.5e-6) < 1e-12
    assert abs(told["penetration"] - 12.5e-6) < 1e-12
    assert told["command"] == {"age": 0.015, "rate": 60.0, "delay": 0.0167, "mode": "auto: linear"}
    assert told["recording"] == {"on": True, "name": "finger_1", "messages": 77.0, "dropped": 0.0}
    assert [word["code"] for word in told["words"]] == ["LOCKED", "LIMIT_EXCEEDED"]


def test_what_is_not_known_is_none() -> None:
    """Of a node that starts, and of values that are no numbers."""
    told = status_of(Report({"command age [s]": "no command yet"}), Report())
    assert (told["rate"], told["late_percent"], told["command"]["age"], told["accuracy"]) == (None, None, None, None)
    assert told["recording"]["on"] is False


def test_problems_are_told_one_by_one() -> None:
    """At the level of the report; a problem that has a semicolon of its own stays in one piece."""
    fed = "a device is fed 50 commands a second, followed 20 ms late; send 100 or more"
    words = words_of(Report(VALUES | {"status": "OK"}, f"{fed}; slower than real time: factor 0.9", 1))
    assert [(word["text"], word["level"]) for word in words] == [
        (fed, "warn"), ("slower than real time: factor 0.9", "warn")
    ]  # fmt: skip


def test_how_often_a_bit_was_set_is_told_with_it() -> None:
    """Not once more as a problem; where several were set, the node counts them together."""
    one = words_of(Report(VALUES, "LIMIT_EXCEEDED in 9 of 200 steps; slow", 1))
    assert [(word["code"], word["text"].partition(", in ")[2]) for word in one] == [
        ("LOCKED", ""), ("LIMIT_EXCEEDED", "9 of 200 steps"), ("", "")
    ]  # fmt: skip
    assert one[-1]["text"] == "slow"
    status = {"status": "ROW_LIMIT|LIMIT_EXCEEDED"}
    several = words_of(Report(VALUES | status, "ROW_LIMIT|LIMIT_EXCEEDED in 9 of 200 steps", 1))
    assert [word["code"] for word in several] == ["ROW_LIMIT", "LIMIT_EXCEEDED", ""]
    assert several[-1]["text"] == "one or several of these in 9 of 200 steps"


def test_the_error_of_a_level_is_the_measured_one() -> None:
    """Of the scene's own level; of the other one only where it was measured, too; nothing is made up."""
    scene = Scene.load("finger_haptic")
    mesh = scene.load_mesh()
    costs = LevelCosts()
    assert costs.texts() is None
    costs.measured_errors(scene, mesh)
    texts = costs.texts()
    assert f"{claimed(scene, mesh)['scene']:.2g} of the peak force" in texts["lagged"]
    assert "not measured" in texts["standard"]
    costs.measured_errors(scene.with_values({"material.young": 1e4}), mesh)
    assert costs.texts() is None


def test_the_step_time_of_a_level_is_of_that_level_alone() -> None:
    """It counts once enough reports have come since the level changed, and not of a body that sleeps."""
    costs = LevelCosts()
    costs.use("lagged")
    for _ in range(SETTLE):
        costs.see(Report(VALUES))
    assert costs.texts() is None
    costs.see(Report(VALUES | {"steps asleep": "1000"}))
    for _ in range(SETTLE + 1):
        costs.see(Report(VALUES))
    assert "0.25 ms, p99 0.75 ms" in costs.texts()["lagged"]
    assert "not seen yet" in costs.texts()["standard"]
    costs.use("standard")
    costs.see(Report(VALUES))
    assert "not seen yet" in costs.texts()["standard"]

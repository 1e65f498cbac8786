"""The page in a browser: it is driven as a viewer drives it, and looked at through ``window.viewer``."""

import math
from typing import Any

import pytest

pytestmark = pytest.mark.slow


def distance(a: list[float], b: list[float]) -> float:
    return math.dist(a, b)


def test_rackets_meet_the_shuttle_and_the_target_is_shown(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=3").press(" ")
    contacts, strikers = viewer.state("contacts", "strikers")
    assert len(contacts) >= 2
    for contact, striker in zip(contacts, strikers, strict=True):
        viewer.page.evaluate("(t) => window.viewer.seek(t)", contact)
        shuttle, rackets, target = viewer.state("shuttle", "rackets", "target")
        assert distance(shuttle, rackets[striker]) < 0.01
        x0, x1, y0, y1 = target
        assert x0 < x1
        assert y0 < y1
        assert (y0 >= 0) == (striker == 0), "the area lies in the receiver's half"


def test_playing_pausing_seeking_and_stepping(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=1&stroke=1")
    assert viewer.state("playing", "stroke") == [False, 0]
    before = viewer.state("time")
    viewer.press(".")
    assert viewer.state("time") == pytest.approx(before + 0.02)
    viewer.press("ArrowRight")
    assert viewer.state("stroke") == 1
    viewer.press("ArrowLeft")
    assert viewer.state("stroke") == 0
    viewer.press(">", " ")
    assert viewer.state("speed") == 2
    viewer.until(lambda: viewer.state("time") > before + 0.3)
    viewer.press(" ")
    stopped = viewer.state("time")
    viewer.page.wait_for_timeout(200)
    assert viewer.state("time") == stopped
    for number, camera in enumerate(("broadcast", "side", "corner", "follow", "top", "free"), start=1):
        assert viewer.press(str(number)).state("camera") == camera
    viewer.press("r")
    assert viewer.state("playing", "speed") == [True, 0.25]
    viewer.press("ArrowDown")
    viewer.until(lambda: viewer.state("rally") == 1)


def test_a_rally_is_followed_by_the_next_and_its_score(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=1").press(" ")
    points, winner, duration = viewer.state("points", "winner", "duration")
    assert points == [0, 0]
    viewer.page.evaluate("(t) => window.viewer.seek(t)", duration - 0.1)
    viewer.press(" ")
    viewer.until(lambda: viewer.state("rally") == 1)
    assert viewer.state("points") == [int(winner == 0), int(winner == 1)]
    assert viewer.state("server") == winner

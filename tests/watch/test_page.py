"""The page in a browser: driven as a viewer drives it, on phones, tablets and laptops."""

import functools
import math
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.commands.watch import GAME
from shuttle_marl.court.building import SOURCE
from shuttle_marl.court.plan import DUEL, LADDER
from shuttle_marl.game.shipped import load_game
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.reader import check
from shuttle_marl.reports.languages import Texts
from tests.watch.conftest import Viewer, serving

pytestmark = pytest.mark.slow


def test_rackets_meet_the_shuttle_and_the_target_is_shown(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=3").press(" ")
    contacts, strikers = viewer.state("contacts", "strikers")
    assert len(contacts) >= 2
    for contact, striker in zip(contacts, strikers, strict=True):
        viewer.page.evaluate("(t) => window.viewer.seek(t)", contact)
        shuttle, rackets, target = viewer.state("shuttle", "rackets", "target")
        assert math.dist(shuttle, rackets[striker]) < 0.01
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
    viewer.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert viewer.state("time") == stopped
    for number, camera in enumerate(("broadcast", "side", "corner", "follow", "top", "free"), start=1):
        assert viewer.press(str(number)).state("camera") == camera
    assert viewer.press("f").state("flipped") is True
    assert viewer.press("f").state("flipped") is False
    assert viewer.press("h").page.get_by_role("dialog", name="Keys").is_visible()
    assert viewer.press("h").page.get_by_role("dialog", name="Keys").is_visible() is False
    viewer.press("r")
    assert viewer.state("playing", "speed") == [True, 0.25]
    viewer.press("ArrowDown")
    viewer.until(lambda: viewer.state("rally") == 1)


def test_both_agents_are_switched_in_mid_match_and_the_link_reproduces_it(viewer: Any, served: Any, browser: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=2&stroke=2")
    played = viewer.state("strokes")
    viewer.page.locator(".title summary").click()
    viewer.page.get_by_label("Player of side A").select_option("attacking")
    viewer.page.get_by_label("Player of side B").select_option("defensive")
    viewer.page.get_by_label("Temperature of side B").fill("0.5")
    assert viewer.state("strokes") == played, "the rally that plays stays"
    viewer.page.evaluate("window.viewer.go(2)")
    viewer.until(lambda: viewer.state("rally") == 2)
    assert viewer.state("names") == ["attacking", "defensive@0.5"]
    strokes = viewer.state("strokes")
    viewer.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    viewer.page.get_by_text("Menu", exact=True).click()
    viewer.page.get_by_role("button", name="Copy link").click()
    viewer.until(lambda: viewer.state("link") in viewer.page.evaluate("navigator.clipboard.readText()"))
    link = viewer.page.evaluate("navigator.clipboard.readText()")
    viewer.page.evaluate("window.viewer.go(1)")
    viewer.until(lambda: viewer.state("rally") == 1)
    assert viewer.state("names", "strokes") == [["bc", "minimax"], played]
    context = browser.new_context()
    other = type(viewer)(context.new_page()).open(link)
    assert other.state("rally", "names", "strokes") == [2, ["attacking", "defensive@0.5"], strokes]
    context.close()


def test_what_if_continues_without_a_jump_and_comes_back(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=1&stroke=3").enter("analyse")
    contacts, played = viewer.state("contacts", "strokes")
    before = contacts[1] - 0.01
    viewer.seek(before)
    hips = viewer.state("hips")
    viewer.seek(contacts[2])
    table = viewer.page.locator("table.options")
    table.locator("tbody tr:not(.chosen) button").first.click()
    viewer.until(lambda: viewer.state("strokes") != played)
    viewer.play(False)
    again, times = viewer.state("strokes", "contacts")
    assert again[:2] == played[:2]
    assert again[2] != played[2]
    assert times[:2] == contacts[:2]
    viewer.seek(before)
    for old, new in zip(hips, viewer.state("hips"), strict=True):
        assert math.dist(old, new) < 0.002
    link = viewer.state("link")
    viewer.page.get_by_role("button", name="back to the played rally").click()
    viewer.until(lambda: viewer.state("strokes") == played)
    viewer.page.goto("about:blank")
    viewer.open(served.address + link)
    assert viewer.state("strokes") == again


def test_keys_of_other_keyboards_count_by_their_place(viewer: Any, served: Any) -> None:
    """A Cyrillic keyboard, and a keypad without NumLock."""
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=1&stroke=1")

    def fire(code: str, key: str, shift: bool = False) -> None:
        viewer.page.evaluate(
            "(about) => document.body.dispatchEvent(new KeyboardEvent('keydown', { bubbles: true, ...about }))",
            {"code": code, "key": key, "shiftKey": shift},
        )

    begun = viewer.state("time")
    fire("Period", "ю")
    assert viewer.state("time") == pytest.approx(begun + 1 / 50)
    fire("Comma", "Б", shift=True)
    assert viewer.page.locator(".speed").input_value() == "0.5"
    fire("Numpad2", "ArrowDown")
    viewer.until(lambda: viewer.page.locator(".cameras").input_value() == "side")
    fire("KeyW", "ц")
    assert viewer.page.locator("body.text").count() == 1


KEYS = {
    "short-serve": "s", "long-serve": "g", "clear": "c", "lift": "l", "drop": "d", "smash": "s", "half-smash": "a", "drive": "v",
    "push": "p", "net-kill": "k", "net-shot": "n", "block": "b", "cross-court-net-shot": "x",
}  # fmt: skip
AREA_KEYS = {
    "back-right": "7", "back-centre": "8", "back-left": "9", "middle-right": "4", "middle-centre": "5", "middle-left": "6",
    "front-right": "1", "front-centre": "2", "front-left": "3",
}  # fmt: skip


def choose(viewer: Any, stroke: dict[str, Any]) -> None:
    """Choose a stroke by keys alone."""
    for _ in range(3):
        viewer.press(KEYS[stroke["shot"]], AREA_KEYS[stroke["area"]])
        for _ in range(4):
            if viewer.state("selected")["stroke"] == stroke["stroke"]:
                return
            viewer.press("q")
    raise AssertionError(f"{stroke} cannot be chosen: {viewer.state('selected')}")


@pytest.mark.slow(minutes=True)
def test_a_duel_is_played_by_keyboard_recorded_and_ends_with_a_report(viewer: Any, page_folder: Any, tmp_path: Any) -> None:
    folder = tmp_path / "diary"
    with serving("--a", "bc", "--b", "bc", "--record", str(folder)) as server:
        # In words and quickly: no picture is drawn, because every key would wait for it.
        viewer.page.set_viewport_size({"width": 480, "height": 320})
        viewer.open(server.address)
        viewer.page.get_by_label("Opponent of the duel").select_option(str(len(LADDER) - 1))
        viewer.page.get_by_role("button", name=f"Duel to {DUEL} points").press("Enter")
        viewer.until(lambda: viewer.state("names") == ["you", LADDER[-1]])
        assert viewer.state("plan")["points"] == DUEL
        viewer.press("w", ">", ">")
        last, chosen, waited, seen = -1, 0, 0, None
        while True:
            turn, winner, after, rally, duration = viewer.state("turn", "winner", "after", "rally", "duration")
            if seen != (rally, chosen, waited):
                seen, deadline = (rally, chosen, waited), time.monotonic() + 180  # of each step: all take long on a busy machine
            assert time.monotonic() < deadline, (seen, turn, winner)
            if turn is not None:
                if turn["strokes"]:
                    choose(viewer, min(turn["strokes"], key=lambda stroke: stroke["p_ret"]))
                viewer.press("Enter")
                chosen += bool(turn["strokes"])
                waited += not turn["strokes"]
                assert viewer.state("turn") != turn, "it is over at once, or the next one is there already"
            elif winner is None:
                viewer.seek(1e3)
            elif rally != last:
                viewer.seek(duration - 0.02)
                last = rally
                if after["game_won"]:
                    break
            viewer.page.wait_for_timeout(20)
        assert after["over"]
        assert max(after["points"]) == DUEL
        dialog = viewer.page.get_by_role("dialog", name="Game summary")
        dialog.wait_for()
        text = dialog.inner_text()
        assert f"You chose {chosen} strokes." in text, text
        assert re.search(r"wins? the match · {} \W {}".format(*after["points"]), text), text
        points, low, high = map(int, re.search(r"Rating of your decisions: (\d+) \((\d+) to (\d+)\)", text).groups())
        assert low < points < high
        kept = viewer.page.evaluate("JSON.parse(localStorage.getItem('shuttle_marl.rating')).points")
        assert kept == pytest.approx(points, abs=1)
        assert viewer.state("rally") == last
        viewer.until(lambda: len(viewer.state("turn_ms")) == chosen + waited)
        dialog.get_by_role("button", name="Another duel").press("Enter")
        viewer.until(lambda: viewer.state("points") == [0, 0] and viewer.state("rally") == 0)
    (log,) = folder.glob("*.mcap")
    checked = check(log, load_game(GAME))
    assert checked.problems == ()
    assert checked.replayed
    assert checked.rallies == last + 1


def test_a_stroke_is_judged_at_once_and_tried_again_for_practice(viewer: Any, served: Any) -> None:
    viewer.page.set_viewport_size({"width": 480, "height": 700})
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=3").enter("play")
    assert viewer.state("rally", "points", "strokes") in ([0, [0, 0], []], [0, [0, 0], viewer.state("strokes")[:1]]), "at 0-0"
    stroke = max(viewer.state("turn")["strokes"], key=lambda one: one["p_succ"])
    choose(viewer, stroke)
    viewer.press("w", "Enter")
    viewer.page.get_by_role("button", name="Try again").wait_for()
    at = viewer.state("strokes").index(stroke["stroke"])
    assert re.search(r"choice|mistake|blunder|model guesses", viewer.page.locator(".verdict").inner_text())
    plan, played = viewer.state("plan", "strokes")
    viewer.until(lambda: viewer.seek(1e3).state("turn") is not None or viewer.state("winner") is not None)
    viewer.press("u")
    viewer.until(lambda: viewer.state("strokes") == played[:at] and viewer.state("turn") is not None)
    assert viewer.state("person")["practice"] is True
    viewer.page.get_by_role("button", name="back to the played rally").click()
    viewer.until(lambda: viewer.state("strokes") == played)
    assert viewer.state("plan") == plan
    assert viewer.state("person")["practice"] is False


@pytest.mark.parametrize("hand", ["right", "left"])
def test_keys_of_areas_lie_as_the_striker_sees_the_other_half(hand: str, viewer: Any, page_folder: Any) -> None:
    """And the page says who is left-handed."""
    with serving("--a", "bc", "--b", "bc", "--hands", hand, hand) as server:
        viewer.open(f"{server.address}#seed=5&a=bc&b=bc&rally=1&stroke=1")
        viewer.enter("play")
        assert viewer.page.locator(".bug .tag[title='left-handed']").count() == (2 if hand == "left" else 0)
        strokes = viewer.state("turn")["strokes"]
        shot = max({stroke["shot"] for stroke in strokes}, key=lambda name: sum(stroke["shot"] == name for stroke in strokes))
        areas = {stroke["area"] for stroke in strokes if stroke["shot"] == shot and not stroke["area"].endswith("centre")}
        assert areas
        viewer.press(KEYS[shot])
        for area in areas:
            column = area.endswith("left") == (hand == "right")
            key = AREA_KEYS[area] if hand == "right" else str(int(AREA_KEYS[area]) + (2 if column else -2))
            chosen = viewer.press(key).state("selected")
            assert chosen["area"] == area
            x0, x1, y0, _ = chosen["box"]
            assert ((x0 + x1) * (1 if y0 >= 0 else -1) > 0) == column, "their right on the right"


def test_a_person_recovers_to_a_position_that_nobody_sees_before_the_hit(viewer: Any, page_folder: Any) -> None:
    with serving("--game", "default:recovery", "--a", "bc", "--b", "bc") as server:
        viewer.page.set_viewport_size({"width": 480, "height": 700})
        viewer.open(f"{server.address}#seed=5&a=bc&b=bc&rally=1").enter("analyse")
        viewer.seek(viewer.state("contacts")[-1])
        panel = viewer.page.get_by_label("Positions of the receiver")
        viewer.until(lambda: panel.locator("tr.chosen").count() == 1 and panel.locator("tr").count() > 2)
        viewer.press("w").enter("play")
        waits = 0
        while waits < 3:
            turn, winner, rally = viewer.state("turn", "winner", "rally")
            if turn is None:
                viewer.seek(1e3)
                if winner is not None:
                    viewer.press("ArrowDown")
                    viewer.until(lambda known=rally: viewer.state("rally") != known)
                viewer.page.wait_for_timeout(20)
                continue
            assert len(viewer.state("waited")) == turn["number"], "nobody's position is told before the hit"
            if not turn["positions"]:
                choose(viewer, max(turn["strokes"], key=lambda stroke: stroke["p_succ"] * stroke["p_ret"]))
            else:
                people = turn["positions"]
                assert viewer.state("position") == people.index(max(people)), "that of most people is selected"
                _, wanted = min((share, position) for position, share in enumerate(people) if share)
                if waits:  # one click
                    viewer.page.locator(f".recover [data-position='{wanted}']").click()
                else:  # the first is not feasible, the second one key
                    for position in (people.index(0), wanted):
                        viewer.press(str([9, 8, 7, 6, 5, 4, 3, 2, 1][position]))
            if not turn["positions"]:
                viewer.press("Enter")
            viewer.until(lambda known=turn: viewer.state("turn") != known and len(viewer.state("waited")) > known["number"])
            if turn["positions"]:
                waits += 1
                assert viewer.state("waited")[turn["number"]] == wanted
                assert viewer.state("plan")["waited"][str(rally)][str(turn["number"])] == wanted


def at_stroke(pages: tuple[Any, Any], number: int, strokes: int) -> tuple[Any, Any]:
    """The striker and the receiver of a stroke, once both pages show it."""

    def there(one: Any) -> bool:
        if one.seek(1e3).state("rally") < number:
            one.press("ArrowDown")
        return one.state("rally") == number and len(one.state("strokes")) == strokes

    for one in pages:
        one.until(functools.partial(there, one))
    striker = pages[(pages[0].state("server") + strokes) % 2]
    striker.until(lambda: striker.seek(1e3).state("turn") is not None and striker.page.locator(".shots button").count() > 0)
    return striker, pages[1 - pages.index(striker)]


def wait_somewhere(receiver: Any, chosen: dict[tuple[int, int], int], at: tuple[int, int]) -> None:
    """Choose a position for a stroke of a rally."""
    receiver.until(lambda: receiver.seek(1e3).state("position") is not None)
    feasible = np.flatnonzero(receiver.state("turn")["positions"])
    chosen[at] = int(feasible[len(chosen) % len(feasible)])
    receiver.press(str([9, 8, 7, 6, 5, 4, 3, 2, 1][chosen[at]]))
    receiver.until(lambda: receiver.state("friend")["chosen"])


def test_two_browsers_play_a_rally_by_link(viewer: Any, browser: Any, page_folder: Any) -> None:
    """No page shows the other's position before the hit, nor the stroke before the position."""
    with serving("--game", "default:recovery", "--a", "bc", "--b", "bc") as server:
        context = browser.new_context(viewport={"width": 480, "height": 700}, reduced_motion="reduce")
        guest = type(viewer)(context.new_page())
        pages = (viewer, guest)
        viewer.open(server.address)
        viewer.page.get_by_role("button", name="Play a friend by link").click()
        link = viewer.page.get_by_label("Link to the game").input_value()
        viewer.page.set_viewport_size({"width": 480, "height": 700})
        token = link.partition("#game=")[2]
        assert len(token) > 20
        guest.open(link).press("w")
        viewer.until(lambda: viewer.page.get_by_role("dialog").count() == 0)
        viewer.press("w")
        assert [one.state("names") for one in pages] == [["you", "friend"], ["friend", "you"]]
        third = type(viewer)(browser.new_context().new_page())
        third.page.set_default_timeout(120_000)
        third.open(link)
        third.page.get_by_text("Two people play under this link already").wait_for()
        third.page.goto(f"{server.address}#game=wrong")
        third.page.get_by_text("This link names no game of this server").wait_for()
        third.page.context.close()

        chosen: dict[tuple[int, int], int] = {}
        while len(chosen) < 4:
            number, strokes = (guest.state("friend")[name] for name in ("rally", "strokes"))
            striker, receiver = at_stroke(pages, number, strokes)
            if receiver.seek(1e3).state("turn") is not None:
                wait_somewhere(receiver, chosen, (number, strokes))
                if len(chosen) == 2:  # a page that is loaded again keeps its seat and its choice
                    receiver.page.reload()
                    receiver.open(link).press("w")
                    assert receiver.state("friend")["chosen"]
                striker.page.wait_for_timeout(1000)
                assert len(striker.state("waited")) == len(striker.state("strokes")) == strokes
            choose(striker, max(striker.state("turn")["strokes"], key=lambda stroke: stroke["p_succ"] * stroke["p_ret"]))
            striker.press("Enter")
            guest.until(lambda at=[number, strokes]: [guest.state("friend")[name] for name in ("rally", "strokes")] != at)
        assert guest.errors == []
        context.close()


def test_positions_are_asked_and_tried(viewer: Any, served: Any) -> None:
    """A question where to wait, judged by its loss; in Analyse the rally goes on with the receiver elsewhere."""
    viewer.page.set_viewport_size({"width": 480, "height": 700})
    page = viewer.open(f"{served.address}#seed=5&a=bc&b=bc&rally=1").press("w").page
    viewer.enter("learn")
    button = page.locator(".quiz button:not(:disabled)")
    for _ in range(60):
        page.locator(".quiz button:not(:disabled), .learn .row button").first.wait_for()
        if page.locator(".quiz.recover").count():
            break
        page.locator(".quiz button:not(:disabled), .learn .row button").first.click()
    button.first.wait_for()
    asked, analysis, waited = viewer.state("asked", "analysis", "waited")
    places = analysis["strokes"][asked]["places"]
    assert button.count() == len(places)
    best = max(places, key=lambda place: place["perfect"])["position"]
    (here,) = [place for place in places if place["position"] == waited[asked]]
    assert here["loss"] >= 0.02, "the receiver lost there"
    page.locator(f".quiz [data-position='{best}']").click()
    told = page.locator(".learn").inner_text()
    assert "Correct." in told
    assert f"which loses {round(100 * here['loss'])} %" in told
    assert "right" in page.locator(f".quiz [data-position='{best}']").get_attribute("class")
    strokes = viewer.state("strokes")
    page.get_by_role("button", name="Play the better one").click()
    viewer.until(lambda: viewer.state("waited")[asked] == best)
    assert viewer.state("strokes")[: asked + 1] == strokes[: asked + 1], "the stroke stays"
    page.get_by_role("button", name="back to the played rally").click()
    viewer.until(lambda: viewer.state("strokes") == strokes and viewer.state("waited") == waited)


def test_a_log_is_replayed(viewer: Any, page_folder: Any, tmp_path: Any) -> None:
    run_league(LeagueConfig(pool=("attacking", "safe"), matches=2, exact=False, out=tmp_path / "run"))
    path = tmp_path / "run" / "rallies.mcap"
    with RallyLog(path) as log:
        number = int(np.argmax(log.rally_table()["length"]))
        rally = log.rally(number)
    with serving("--replay", str(path), "--rally", str(number)) as server:
        viewer.open(server.address).press(" ").enter("analyse")
        assert viewer.state("rally", "strokes") == [number, rally.stroke.tolist()]
        assert viewer.state("points") == rally.score[0, :2].tolist()
        played = viewer.state("strokes")
        viewer.seek(viewer.state("contacts")[0])
        viewer.page.locator("table.options tbody tr:not(.chosen) button").first.click()
        viewer.until(lambda: viewer.state("strokes") != played)


def test_a_real_match_is_shown(viewer: Any, page_folder: Any) -> None:
    sample = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
    with serving("--real", str(sample), "--rally", "3") as server:
        viewer.open(server.address).press(" ").analysed()
        assert viewer.state("rally") == 3
        assert sum(viewer.state("points")) == 3
        assert len(viewer.state("strokes")) >= 1
        viewer.press("e").page.locator(".browser li").first.wait_for()
        told = viewer.page.locator(".browser li").all_inner_texts()
        assert [bool(re.search(r"\d\W\d", line)) for line in told[:6]] == [True] * 4 + [False] * 2, "the next ones are not told"
        assert [line[0] in "AB" for line in told[:6]] == [True] * 3 + [False] * 3
        viewer.page.locator(".browser [data-rally='5']").click()
        viewer.until(lambda: viewer.state("rally") == 5)
        viewer.enter("analyse")
        assert viewer.page.locator(".browser [aria-current]").get_attribute("data-rally") == "5"
        last = viewer.page.locator("#matches option").last.get_attribute("value")
        viewer.page.get_by_label("Find a match by event, date or player").fill(last)
        viewer.page.keyboard.press("Enter")
        viewer.until(lambda: viewer.state("rally") > 500)


def test_a_shared_page_opens_from_disk(viewer: Any, served: Any, browser: Any, tmp_path: Any) -> None:
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=3&stroke=2")
    strokes = viewer.state("strokes")
    viewer.page.get_by_text("Menu", exact=True).click()
    with viewer.page.expect_download() as download:
        viewer.page.get_by_role("button", name="Save this rally").click()
    file = tmp_path / "rally.html"
    download.value.save_as(file)
    assert file.stat().st_size <= 2e6
    policy = '<meta http-equiv="Content-Security-Policy" content="default-src \'none\';'
    assert policy in file.read_text(encoding="utf-8")[:400]
    context = browser.new_context(offline=True)
    shared = type(viewer)(context.new_page()).open(file.as_uri())
    assert shared.state("strokes", "rally", "stroke") == [strokes, 2, 1]
    shared.analysed().play(False).seek(1e3)
    shared.play().until(lambda: not shared.state("playing"))
    shared.page.wait_for_timeout(500)
    assert shared.page.locator("[role=alert]:visible").count() == 0, "there is no rally after the last one"
    shared.enter("analyse")
    shared.page.locator(".options .try").first.wait_for()
    assert shared.page.locator(".options button.try").count() == 0, "no server, no what if"
    assert shared.page.get_by_text("take over").count() == 0
    assert shared.errors == []
    assert shared.outside == []
    context.close()


SIZES = ((390, 844), (820, 1180), (1366, 768))
"""A phone, a tablet and a laptop: the three layouts [px]."""


def barriers(viewer: Any, *schemes: str) -> list[Any]:
    """Violations that axe-core reports in colour schemes."""
    page, found = viewer.page, []
    if not page.evaluate("!!window.axe"):
        page.evaluate((SOURCE / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8") + "; 0")
    for scheme in schemes:
        page.emulate_media(color_scheme=scheme)
        found += page.evaluate(
            "axe.run(document).then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html.slice(0, 120))]))"
        )
    return found


def test_page_is_accessible(viewer: Any, served: Any) -> None:
    """Also with hints and in words; the other modes are checked with the boxes."""

    def checked(mode: str) -> None:
        for width, height in SIZES:
            viewer.page.set_viewport_size({"width": width, "height": height})
            assert barriers(viewer, "dark") == [], (mode, width)
        assert barriers(viewer, "light") == [], mode

    viewer.open(f"{served.address}#seed=5&a=bc&b=bc&rally=1").analysed()
    viewer.enter("play")
    viewer.press("i").until(lambda: "wins" in viewer.page.locator("section.board").inner_text())
    checked("hints")
    viewer.press("w")
    assert viewer.page.locator(".announcements li").count() >= 1
    checked("words")


SMALL = """() => [...document.querySelectorAll('a[href], button, input, select, summary')].flatMap((element) => {
  const { width, height } = element.getBoundingClientRect(), dialog = document.querySelector('dialog[open]');
  const seen = element.checkVisibility({ visibilityProperty: true }) && (!dialog || dialog.contains(element));
  return seen && Math.min(width, height) < 43.9 ? [`${element.outerHTML.slice(0, 90)} ${width} by ${height}`] : [];
})"""
"""Targets that are narrower or lower than 44 px."""


def test_targets_are_large_where_fingers_touch(browser: Any, served: Any) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True, reduced_motion="reduce")
    viewer = Viewer(context.new_page())

    def checked(what: str) -> None:
        for width, height in SIZES:
            viewer.page.set_viewport_size({"width": width, "height": height})
            assert viewer.page.evaluate(SMALL) == [], (what, width)

    viewer.open(served.address)
    viewer.page.locator(".start").wait_for()
    checked("start")
    viewer.page.goto("about:blank")
    viewer.open(f"{served.address}{PLACE}").analysed()
    for mode in ("watch", "analyse", "learn", "play"):
        viewer.page.locator(f"#tab-{mode}").click()
        viewer.until(lambda mode=mode: bool(viewer.state("mode") == mode))  # type: ignore[misc]
        if mode == "learn":
            viewer.page.locator(".quiz button").first.wait_for()
        checked(mode)
    viewer.press("h")
    checked("keys")
    viewer.press("Escape")
    viewer.page.set_viewport_size({"width": 1366, "height": 768})
    viewer.page.get_by_text("Menu", exact=True).click()
    checked("menu")
    context.close()


def test_a_bad_link_shows_a_rally(viewer: Any, served: Any) -> None:
    for link, told in (
        ("seed=5&a=nonsense&b=bc", 1),
        ("seed=5&a=bc&b=bc&rally=99999", 1),
        ("seed=5&a=bc&b=bc&tried=null", 0),
        ("seed=5&a=bc*0.5.5&b=bc&rally=1e30", 1),
    ):
        viewer.page.goto("about:blank")
        viewer.open(f"{served.address}#{link}").analysed()
        assert viewer.state("rally") == 0
        assert viewer.page.get_by_text("The link cannot be shown").count() == told, link
        viewer.press("ArrowDown").until(lambda: viewer.state("rally") == 1)


LAYOUT_SIZES = ((390, 664), (390, 844), (844, 390), (820, 1180), (1280, 720), (1366, 768), (1680, 980))
PLACE = "#seed=5&a=bc&b=minimax&rally=1&stroke=3"
OVERFLOWS = """() => {
  const out = [], width = document.documentElement.clientWidth;
  for (const element of document.querySelectorAll('body *')) {
    if (element.closest('body:not(.text) .words, dialog, svg, select, option, .tip, .menu:not([open]) > div')) continue;
    const style = getComputedStyle(element), box = element.getBoundingClientRect();
    if (style.display === 'none' || style.visibility === 'hidden' || !box.width || !box.height) continue;
    const name = `${element.tagName}.${element.className} ${element.textContent.slice(0, 30)}`;
    if (box.right > width + 1 || box.left < -1) out.push(`outside the window: ${name}`);
    const clips = style.overflowX === 'hidden' || style.overflowX === 'clip';
    if (clips && element.clientWidth && element.scrollWidth > element.clientWidth + 1) out.push(`clipped: ${name}`);
  }
  return out;
}"""


Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px]."""


BOXES = """(selector) => [...document.querySelectorAll(selector)]
  .filter((e) => e.checkVisibility({ visibilityProperty: true }))
  .map((e) => [e.className || e.textContent, e.getBoundingClientRect()])
  .filter(([, b]) => b.width > 0 && b.height > 0)
  .map(([name, b]) => [name, [b.left, b.top, b.right, b.bottom]])"""
"""Visible elements and their boxes at one moment: a locator finds first and measures later, when they may be gone."""


def named_boxes(viewer: Any, selector: str) -> list[tuple[str, Box]]:
    found = viewer.page.evaluate(BOXES, selector)
    assert found, selector
    return [(name, tuple(at)) for name, at in found]


def boxes(viewer: Any, selector: str) -> list[Box]:
    return [at for _, at in named_boxes(viewer, selector)]


def box(viewer: Any, selector: str) -> Box:
    return boxes(viewer, selector)[0]


def disjoint(a: Box, b: Box) -> bool:
    return a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1


def inside(a: Box, b: Box) -> bool:
    return a[0] >= b[0] - 1 and a[1] >= b[1] - 1 and a[2] <= b[2] + 1 and a[3] <= b[3] + 1


def sized(viewer: Any, sizes: Sequence[tuple[int, int]]) -> Iterator[Box]:
    """Give the page each size in turn, and draw it."""
    for width, height in sizes:
        viewer.page.set_viewport_size({"width": width, "height": height})
        viewer.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        viewer.page.evaluate("scrollTo(0, 0); window.viewer.draw()")
        assert viewer.page.evaluate(OVERFLOWS) == [], (width, height)
        yield 0, 0, width, height


WIDTHS = ((360, 740), (390, 844), (768, 1024), (1024, 768), (1280, 720), (1440, 900), (1920, 1080))
SEPARATE = (
    ".bug, .chip, .back, .cameras, .start, .tabs button, .menu > summary, p.title, .transport button, "
    ".transport select, .timeline, .clock, .column.task, .column.facts"
)
"""What must not lie over each other."""
LONGEST = ("bc:hans-kristian-solberg-vittinghus", "bc:anthony-sinisuka-ginting")


def checked(viewer: Any, window: Box, what: object) -> None:
    """No two boxes lie over each other, and the score is seen whole."""
    found = named_boxes(viewer, SEPARATE)
    for i, (name, here) in enumerate(found):
        for other, there in found[:i]:
            assert disjoint(here, there), (what, name, other)
    court = box(viewer, ".court")
    assert len(boxes(viewer, ".bug .points")) == 2, what
    for score in boxes(viewer, ".bug, .bug .points, .bug .name"):
        assert inside(score, court), what
        assert inside(score, window), what
    if window[2] >= 1024:
        assert court[2] - court[0] >= 0.7 * window[2], what
    else:
        assert court[1] < 100, "the court comes first"
        assert court[2] - court[0] >= 0.5 * window[2], what


@pytest.mark.slow(minutes=True)
def test_no_two_boxes_lie_over_each_other(viewer: Any, served: Any) -> None:
    """With the longest names, in Indonesian, whose texts are the longest, at seven widths; every mode is accessible."""
    language, say = "id", Texts("id")
    viewer.open(f"{served.address}?language={language}")
    viewer.page.locator(".start").wait_for()
    for window in sized(viewer, WIDTHS):
        checked(viewer, window, ("start", window))
    place = PLACE.replace("=bc&", f"={LONGEST[0]}&").replace("=minimax&", f"={LONGEST[1]}&")
    viewer.page.goto("about:blank")
    viewer.open(f"{served.address}?language={language}{place}").analysed()
    assert viewer.page.locator("html").get_attribute("lang") == say("language.tag")
    size = viewer.page.locator(".bug .points").first.evaluate("(e) => getComputedStyle(e).fontSize")
    assert float(size.removesuffix("px")) >= 24, "as on television"
    for mode in ("watch", "open", "analyse", "learn", "play"):
        if mode == "open":
            viewer.press("e")
        elif mode != "watch":  # the page begins with it
            viewer.enter(mode)
            assert viewer.page.locator(f"#tab-{mode}").inner_text() == say(f"mode.{mode}")
        for window in sized(viewer, WIDTHS):
            checked(viewer, window, (mode, window))
        assert "undefined" not in viewer.page.inner_text("body")
        for _ in sized(viewer, SIZES):
            assert barriers(viewer, "dark") == [], mode
        assert barriers(viewer, "light") == [], mode


COURT_CORNERS = "[-6.7, 6.7].flatMap((y) => [-2.59, 2.59].map((x) => window.viewer.windowAt(x, y)))"


def test_nobody_is_covered_and_every_choice_is_in_the_window(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}{PLACE}").analysed()
    viewer.enter("learn")
    for window in sized(viewer, LAYOUT_SIZES):
        court = box(viewer, ".court")
        for answer in boxes(viewer, ".quiz button"):
            assert disjoint(answer, court), window
    viewer.page.set_viewport_size({"width": 1280, "height": 720})
    viewer.enter("play")
    for window in sized(viewer, LAYOUT_SIZES):
        court = box(viewer, ".court")
        covers = boxes(viewer, ".bug, .chip, .cameras, .shots button, .hit")
        for x, y in viewer.page.evaluate(COURT_CORNERS):
            assert inside((x, y, x, y), court), (window, x, y)
            assert all(disjoint((x, y, x, y), cover) for cover in covers), (window, x, y)
        for outline in viewer.state("outlines"):
            assert inside(outline, court), (window, outline, court)
            assert all(disjoint(outline, cover) for cover in covers), (window, outline)
        for i, cover in enumerate(covers):
            assert inside(cover, window), (window, cover)
            assert all(disjoint(cover, other) for other in covers[:i]), window
    viewer.press("w")
    for _ in sized(viewer, LAYOUT_SIZES):
        words, bug = box(viewer, ".words"), box(viewer, ".bug")
        assert words[2] - words[0] <= 800, "one column"
        assert bug[3] <= words[1], "the score is above"


HELD = """() => {
  const { duration } = window.viewer.state(), found = [];
  for (let time = 0; time <= duration; time += 0.06) found.push(window.viewer.held(time));
  return found.map(({ players: [a, b], shuttle }) => [...a, ...b, ...shuttle]);
}"""


@pytest.mark.slow(minutes=True)
def test_every_camera_of_the_director_holds_the_players_and_the_shuttle(viewer: Any, served: Any) -> None:
    """In every third frame of eight rallies, which have all shots but the long serve, at three shapes of the window.

    The near player is large in the broadcast.
    """
    viewer.open(f"{served.address}#seed=5&a=bc&b=bc").press(" ")
    windows = ((1440, 900), (1024, 768), (390, 844))
    for window, _ in zip(windows, sized(viewer, windows), strict=True):
        for number in range(8):
            viewer.page.evaluate("(rally) => window.viewer.go(rally)", number)
            viewer.until(lambda number=number: viewer.state("rally") == number)
            for camera in ("1", "2", "7"):
                found = np.array(viewer.press(camera).page.evaluate(HELD))
                assert found.min() >= 0, (number, window, camera)
                assert found.max() <= 1, (number, window, camera)
                if camera == "1":
                    first, second = found[:, 3] - found[:, 1], found[:, 7] - found[:, 5]
                    is_near = found[:, 3] > found[:, 7]  # whose feet are lower in the picture
                    assert np.where(is_near, first, second).min() >= 0.25, (number, window)


def test_nothing_is_told_before_it_is_played(viewer: Any, served: Any) -> None:
    """Neither strokes to come nor the winner, in the list, the curve, the words, the title, and the chip."""
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=1").press(" ", "e").analysed()
    for mode in ("watch", "play"):
        if mode == "play":
            viewer.enter("play")
        for number in range(2):
            if mode == "watch":
                viewer.page.evaluate("(rally) => window.viewer.go(rally)", number)
                viewer.until(lambda number=number: viewer.state("rally") == number)
                viewer.play(False).analysed()
            contacts, last = viewer.state("contacts"), viewer.state("strokes")
            for i, contact in enumerate(contacts):
                viewer.seek(contact)
                assert viewer.page.locator(".moves li").count() == i + 1
                assert viewer.page.locator(".curve line").count() == i + 2
                assert viewer.page.locator(".announcements li").count() == i + 2
                told = viewer.page.inner_text("body")
                assert not re.search(r"wins? the rally", told), (mode, number, i)
                assert f"{len(last)} strokes" not in told
                if i + 1 < len(contacts):
                    label = viewer.page.locator(".curve").first.get_attribute("aria-label")
                    assert not label.endswith((" 0 %", " 100 %"))
            if mode == "watch":
                viewer.seek(1e3)
                assert re.search(r"wins the rally", viewer.page.inner_text(".moves"))
                viewer.seek(contacts[0])
                assert viewer.page.locator(".moves li .ahead").count() == len(contacts) - 1, "grey after the first viewing"
    viewer.enter("analyse")
    assert viewer.page.locator(".moves li").count() == len(viewer.state("strokes"))


def test_choice_and_result_are_told_apart(viewer: Any, served: Any) -> None:
    """A good net shot that is killed was a right choice, and the kill wins."""
    viewer.open(f"{served.address}#seed=5&a=bc&b=minimax&rally=1").press(" ").enter("analyse")
    killed = 0
    for number in range(12):
        viewer.page.evaluate("(rally) => window.viewer.go(rally)", number)
        viewer.until(lambda number=number: viewer.state("rally") == number)
        rows = viewer.analysed().page.locator(".moves li .what")
        viewer.until(lambda rows=rows: rows.locator(".judged").count() == rows.count())
        verdicts = [row.locator(".judged > span").all_inner_texts() for row in rows.all()]
        choices = r"(brilliant|strong|right|good|fair|debatable|doubtful) choice|mistake|blunder|too rare to judge; the model"
        results = r"(killed|attacked|came back|winner|out|into the net|the rally ends) "
        assert all(re.match(choices, choice) and re.match(results, result) for choice, result in verdicts)
        shots = rows.locator("b").all_inner_texts()
        for i in range(len(shots) - 1):
            assert verdicts[i][1].startswith("killed") == (shots[i + 1] == "net kill")
            killed += shots[i + 1] == "net kill"
        assert verdicts[-1][1].split(" ")[0] in ("winner", "out", "into", "the")
    assert killed


def test_a_rally_is_played_with_one_click_a_stroke(viewer: Any, page_folder: Any) -> None:
    with serving("--game", "default", "--a", "bc", "--b", "bc") as server:
        viewer.open(f"{server.address}#seed=5&a=bc&b=bc&rally=1").enter("play")
        clicks = 0
        while True:
            viewer.until(lambda: viewer.seek(1e3).state("turn") is not None or viewer.state("winner") is not None)
            if viewer.state("turn") is None:
                break
            strokes, number = viewer.state("turn")["strokes"], len(viewer.state("strokes"))
            wanted = max(strokes, key=lambda stroke: stroke["support"] or 0)
            x0, x1, y0, y1 = wanted["box"]
            at = viewer.page.evaluate("([x, y]) => window.viewer.windowAt(x, y)", [(x0 + x1) / 2, (y0 + y1) / 2])
            viewer.page.mouse.move(*at)
            assert viewer.page.locator(".label:not(.hidden)").inner_text().startswith(wanted["shot"].replace("-", " ")[:5])
            viewer.page.mouse.click(*at)
            viewer.until(lambda number=number: len(viewer.state("strokes")) > number)
            assert viewer.state("strokes")[number] == wanted["stroke"], "what people play there most"
            clicks += 1
        assert clicks
        told = viewer.page.locator(".verdict [role='status'] > span")
        viewer.until(lambda: told.count() == 2)
        assert re.search(r"^(out|into the net|winner) | wins? · ", told.last.inner_text()), "the choice, and how the rally ended"
        viewer.page.get_by_text("Menu", exact=True).click()
        viewer.page.get_by_role("button", name=f"Duel to {DUEL} points").click()
        viewer.page.get_by_label("Opponent of the duel").wait_for()


def test_best_play_stands_in_the_laboratory(viewer: Any, served: Any) -> None:
    viewer.open(f"{served.address}{PLACE}")
    groups = viewer.page.get_by_label("Player of side A").evaluate(
        "(select) => [...select.querySelectorAll('optgroup')].map((g) => [g.label, [...g.children].map((o) => o.value)])"
    )
    of = {policy: label for label, policies in groups for policy in policies}
    laboratory = {policy for policy, label in of.items() if label.startswith("Laboratory")}
    assert {"minimax", "ppo"} <= laboratory
    assert all(policy.startswith(("minimax", "best-response", "ppo", "a2c", "sac")) for policy in laboratory)
    assert "plays like a pro" in of["human:0.05"]
    assert "minimax" not in LADDER


def test_the_language_is_chosen_in_the_page_and_kept(viewer: Any, served: Any) -> None:
    page = viewer.page
    page.goto(f"{served.address}{PLACE}")
    page.get_by_text("Menu", exact=True).click()
    with page.expect_navigation():
        page.get_by_label("Language").select_option("id")
    page.get_by_role("tab", name=Texts("id")("mode.learn")).wait_for()
    assert page.evaluate("location.hash").startswith("#seed=5")
    page.goto(f"{served.address}{PLACE.replace('5', '6')}")  # an address without a language
    page.get_by_role("tab", name=Texts("id")("mode.learn")).wait_for()
    assert page.locator("html").get_attribute("lang") == "id"

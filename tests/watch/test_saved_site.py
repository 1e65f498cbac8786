"""A match as a folder of static files, and the page on a server that knows nothing of it."""

import functools
import gzip
import json
import re
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
from playwright.sync_api import Browser

from shuttle_marl.game import default_game
from shuttle_marl.watch import WatchError, messages
from shuttle_marl.watch import site as site_module
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.building import FILES
from shuttle_marl.watch.messages import Hello, PlayerFacts, RallyRequest
from shuttle_marl.watch.plan import Plan, Side
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.site import _rallies, save_site
from shuttle_marl.watch.stager import Stager
from tests.watch.conftest import Viewer

LIMIT = 2_300_000
"""Size of a site of a few rallies [bytes]."""


@pytest.fixture(scope="module")
def answers() -> Answers:
    plan = Plan(seed=12, sides=(Side(policy="bc"), Side(policy="bc")))
    return Answers(PolicyTables(default_game(), ("bc",)), plan, Stager())


@pytest.fixture(scope="module")
def site(page_folder: Path, answers: Answers, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, int, int]:
    folder = tmp_path_factory.mktemp("site")
    return folder, *save_site(folder, page_folder, answers, limit=LIMIT)


@pytest.mark.slow
def test_a_site_is_small_and_names_no_host(site: tuple[Path, int, int, int], page_folder: Path, answers: Answers) -> None:
    folder, count, size, left = site
    assert count + left == answers.length(answers.hello().plan)
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert size == sum(path.stat().st_size for path in files) <= LIMIT
    assert {path.name for path in folder.iterdir()} == {"index.html", "watch.js", "watch.css", "male.glb", "replies"}
    assert len(list(folder.glob("replies/rally-*.bin"))) == count > 0
    index = (folder / "index.html").read_text()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', index)
    assert "script-src 'self';" in policy[1]
    assert "http" not in policy[1]
    assert re.findall(r'(?:src|href)="(?!data:)([^"]*)"', index) == ["watch.css", "watch.js"]
    assert index.index("Content-Security-Policy") < index.index("<script")
    # A site is replaced as a whole.
    (folder / "replies" / "rally-999.bin").write_bytes(b"of a longer match")
    assert save_site(folder, page_folder, answers, limit=LIMIT) == (count, size, left)
    assert not (folder / "replies" / "rally-999.bin").exists()


def test_no_walk_leads_to_other_players() -> None:
    looks = [PlayerFacts(athlete="male", hand=hand) for hand in ("right", "right", "left", "left")]
    walks = []

    class Fake:
        def rally(self, request: RallyRequest) -> tuple[SimpleNamespace, bytes]:
            number = request.rally
            over = SimpleNamespace(over=number == 3)
            players = (looks[0], looks[number])
            return SimpleNamespace(
                rally=SimpleNamespace(ends_changed=False, players=players, winner=0, after=over, strokes=[])
            ), b""

        def __call__(self, request: RallyRequest) -> bytes:
            if request.walk:
                walks.append(request.rally)
            return b""

    hello = SimpleNamespace(recorded=None, plan=Plan(seed=12, sides=(Side(policy="bc"), Side(policy="bc"))))
    assert len(list(_rallies(cast(Answers, Fake()), cast(Hello, hello)))) == 4
    assert walks == [0, 2]


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small page and small models of the athletes."""
    (tmp_path / "page").mkdir()
    for name in FILES:
        (tmp_path / "page" / name).write_bytes(
            b'<html lang="en"><head></head><!-- <head> --></html>' if name == "index.html" else b"x" * 99
        )
    for name in ("male", "female"):
        (tmp_path / name).write_bytes(name.encode() * 50)
    monkeypatch.setattr(site_module, "model_file", lambda name: tmp_path / name)
    return tmp_path / "page"


class Echo:
    """Answers each request by itself; knows rallies by whether the ends were changed, the second athlete, the winner, strokes.

    Args:
        matches: number of the last rally of each match.
    """

    def __init__(
        self, rallies: list[tuple[bool, str, int | None, int]], matches: tuple[int, ...], recorded: int | None = None
    ) -> None:
        self.rallies, self.matches, self.plan = rallies, matches, Plan(seed=12, sides=(Side(policy="bc"), Side(policy="bc")))
        self.known = None if recorded is None else messages.RecordedFacts("club", len(rallies), recorded, [])

    def hello(self) -> Hello:
        nothing: Any = None
        return Hello(version="1", game="g", hall=nothing, policies=[], plan=self.plan, recorded=self.known, ladder=[])

    def rally(self, request: RallyRequest) -> tuple[SimpleNamespace, bytes]:
        ends, athlete, winner, strokes = self.rallies[request.rally]
        players = tuple(PlayerFacts(athlete=name, hand="right") for name in ("male", athlete))
        after = None if winner is None else SimpleNamespace(over=request.rally in self.matches)
        facts = {"ends_changed": ends, "players": players, "winner": winner, "after": after, "strokes": [0] * strokes}
        return SimpleNamespace(rally=SimpleNamespace(**facts)), b""

    def __call__(self, request: messages.Request) -> bytes:
        return msgspec.json.encode(request)

    def length(self, plan: Plan) -> int:
        assert plan == self.plan
        return len(self.rallies)

    def match(self, request: messages.MatchRequest) -> SimpleNamespace:
        end = next(last for last in self.matches if last >= request.rally)
        return SimpleNamespace(rallies=[SimpleNamespace(number=k) for k in range(request.rally, end + 1) if self.rallies[k][3]])

    def opening(self, line: tuple[int, ...]) -> messages.OpeningReply:
        """Two strokes that are usual and one that is not."""
        about: dict[str, Any] = dict.fromkeys(("p_succ", "p_ret", "support", "win", "best", "available"), 0.5)
        about |= dict.fromkeys(("shot", "area", "height", "technique"), "") | {"seat": 0, "box": (0, 0, 0, 0)}
        shares = {len(line): 0.9, 7: 0.01, 8: 0.0099}
        return messages.OpeningReply([messages.OpeningStroke(stroke=k, share=p, **about) for k, p in shares.items()], seed=5)


def saved(folder: Path) -> dict[str, Any]:
    """The replies of a site by name: the requests that an echo has answered, and its own replies as JSON."""
    found = {path.stem: gzip.decompress(path.read_bytes()) for path in (folder / "replies").iterdir()}
    replies = {name: json.loads(found.pop(name)[4:]) for name in ("hello", "openings")}
    return {name: msgspec.json.decode(content, type=REQUESTS) for name, content in found.items()} | replies


REQUESTS = messages.RallyRequest | messages.AnalysisRequest | messages.MatchRequest | messages.StylesRequest


def test_a_site_holds_the_replies_that_its_page_asks_for(files: Path, tmp_path: Path) -> None:
    """Ends change before rally 2, the opponent before rally 4, rally 1 has no strokes, rally 5 ends the match."""
    echo = Echo([(i in (2, 3), "female" if i >= 4 else "male", i % 2, 3 * (i != 1)) for i in range(6)], (5,))
    steps: list[int] = []
    folder = tmp_path / "site"
    count, size, left = save_site(folder, files, cast(Answers, echo), steps.append, language="id")
    assert (count, left, steps) == (6, 0, [1, 2, 3, 4, 5, 6])
    assert size == sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    about: dict[str, Any] = {"id": 0, "plan": echo.plan}
    expected: dict[str, Any] = {f"rally-{i}": messages.RallyRequest(rally=i, **about) for i in range(6)}
    expected |= {f"walk-{i}": messages.RallyRequest(rally=i, walk=True, **about) for i in (0, 2, 4)}
    expected |= {f"analysis-{i}": messages.AnalysisRequest(rally=i, **about) for i in (0, 2, 3, 4, 5)}
    expected["match-0"] = messages.MatchRequest(rally=5, partial=True, **about)
    expected["styles"] = messages.StylesRequest(rally=0, **about)
    found = saved(folder)
    hello, openings = found.pop("hello"), found.pop("openings")["lines"]
    assert found == expected
    assert (hello["id"], hello["rallies"], hello["recorded"]) == (0, 6, None)
    assert {line: [stroke["stroke"] for stroke in reply["strokes"]] for line, reply in openings.items()} == {
        "": [0, 7], "0": [1, 7], "7": [1, 7], "0-1": [2, 7], "0-7": [2, 7], "7-1": [2, 7], "7-7": [2, 7],
    }  # fmt: skip
    assert {reply["seed"] for reply in openings.values()} == {None}
    assert {path.name for path in folder.iterdir()} == {*FILES, "male.glb", "female.glb", "replies"}
    index = (folder / "index.html").read_bytes()
    assert index.startswith(b'<html lang="id"><head><meta http-equiv="Content-Security-Policy"')
    assert index.count(b'<meta name="site" content="static">') == 1


def test_a_site_has_the_rallies_that_fit(files: Path, tmp_path: Path) -> None:
    echo = cast(Answers, Echo([(False, "female" if i == 2 else "male", 0, 3) for i in range(4)], (3,)))
    folder = tmp_path / "site"
    save_site(folder, files, echo)

    def packed(*names: str) -> int:
        return sum((folder / "replies" / f"{name}.bin").stat().st_size for name in names)

    page = sum((folder / name).stat().st_size for name in FILES)
    two = page + 200 + packed("rally-0", "analysis-0", "rally-1", "analysis-1", "walk-0")
    three = two + 300 + packed("rally-2", "analysis-2")
    for size, count in ((two - 1, 1), (two, 2), (three - 1, 2), (three, 3)):
        assert save_site(folder, files, echo, limit=size + 600_000)[::2] == (count, 4 - count)
        assert (folder / "female.glb").exists()  # of the site before: only its replies are removed
        found = saved(folder)
        assert {name for name in found if name.startswith("rally")} == {f"rally-{i}" for i in range(count)}
        assert (found["hello"]["rallies"], found["match-0"].rally) == (count, count - 1)
    with pytest.raises(WatchError, match=r"site: the first rally does not fit into 0\.6 MB"):
        save_site(folder, files, echo, limit=page + 600_000)


def test_recorded_matches_have_an_overview_each(files: Path, tmp_path: Path) -> None:
    """Of a match whose rallies are open there is none; of one that does not fit, of the rallies that fit."""
    rallies = [(False, "male", 0, 3), (False, "male", 1, 3), (False, "male", None, 0), *[(False, "male", 0, 3)] * 3]
    echo = Echo(rallies, (1, 2, 5), recorded=5)
    folder = tmp_path / "site"
    assert save_site(folder, files, cast(Answers, echo))[::2] == (6, 0)
    found, expected = saved(folder), {f"rally-{i}": messages.RallyRequest(id=0, rally=i) for i in range(6)}
    assert (found["hello"]["rallies"], found.pop("hello")["recorded"]) == (
        None, {"title": "club", "count": 6, "first": 5, "matches": []},
    )  # fmt: skip
    assert {name: request for name, request in found.items() if name.startswith("rally")} == expected
    assert {int(name[5:]) for name in found if name.startswith("walk")} == {0, 3, 4}
    overviews = {int(name[6:]): request for name, request in found.items() if name.startswith("match")}
    first = {0: 0, 1: 0, 2: 2, 3: 3, 4: 3, 5: 3}
    assert overviews == {i: messages.MatchRequest(id=0, rally=k) for i, k in first.items()}
    assert "styles" not in found
    fixed = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    size = sum((folder / "replies" / f"{name}.bin").stat().st_size for name in found if name[:2] in ("ra", "wa", "an"))
    count, _, left = save_site(folder, files, cast(Answers, echo), limit=fixed + size + 600_000 - 1)
    assert (count, left) == (5, 1)
    found = saved(folder)
    recorded = found["hello"]["recorded"]
    assert (recorded["count"], recorded["first"]) == (5, 4)
    part = messages.MatchRequest(id=0, rally=4, partial=True)
    assert [found[f"match-{i}"] for i in range(2, 5)] == [messages.MatchRequest(id=0, rally=2), part, part]
    assert "match-5" not in found


def test_a_folder_with_other_files_is_refused(page_folder: Path, answers: Answers, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("<h1>Mine</h1>")
    with pytest.raises(WatchError, match="other files"):
        save_site(tmp_path, page_folder, answers)
    with pytest.raises(WatchError, match="give a folder"):
        save_site(tmp_path / "index.html", page_folder, answers)
    assert (tmp_path / "index.html").read_text() == "<h1>Mine</h1>"


def test_an_empty_folder_is_filled_and_one_without_an_index_is_not(files: Path, tmp_path: Path) -> None:
    echo, folder = cast(Answers, Echo([(False, "male", 0, 1)], (0,))), tmp_path / "site"
    folder.mkdir()
    assert save_site(folder, files, echo)[0] == 1
    (folder / "index.html").unlink()
    with pytest.raises(WatchError, match="give a new or empty folder"):
        save_site(folder, files, echo)


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def address(site: tuple[Path, int, int, int]) -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(site[0]))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@pytest.mark.slow
def test_any_server_shows_a_site(site: tuple[Path, int, int, int], address: str, browser: Browser) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    try:
        viewer = Viewer(page).open(address)
        viewer.seek(viewer.state("duration") - 0.1)
        viewer.play()
        viewer.until(lambda: viewer.state("time") > viewer.state("duration") + 1)
        assert viewer.state("rally") == 0, "players walk to the next rally"
        viewer.press(">", ">").until(lambda: viewer.state("rally") == 1)
        page.evaluate("window.viewer.go(0)")
        page.get_by_role("tab", name="Analyse").click()
        page.locator(".match .chart, .match svg").first.wait_for()
        page.evaluate("window.viewer.go(1)")
        viewer.until(lambda: viewer.state("rally") == 1)
        page.get_by_role("tab", name="Learn").click()
        page.get_by_role("region", name="Find the better stroke").wait_for()
        page.get_by_role("button", name="Rally of the day").click()
        page.get_by_role("heading", name="Rally of the day").wait_for()
        page.get_by_role("tab", name="Analyse").click()
        page.locator(".openings summary").click()
        for step in (1, 2, 3):
            page.locator(".openings tbody button").first.click()
            page.locator(".openings .line button").nth(step).wait_for()
        assert page.get_by_role("button", name="Play it").count() == 0
        assert page.get_by_role("tab", name="Play").count() == 0
        assert viewer.errors == []
        assert viewer.outside == []
    finally:
        page.close()

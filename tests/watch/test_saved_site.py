"""A match as a folder of static files, and the page on a server that knows nothing of it."""

import functools
import re
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from playwright.sync_api import Browser

from shuttle_marl.game import default_game
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.answers import Answers
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


def test_a_folder_with_other_files_is_refused(page_folder: Path, answers: Answers, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("<h1>Mine</h1>")
    with pytest.raises(WatchError, match="other files"):
        save_site(tmp_path, page_folder, answers)
    with pytest.raises(WatchError, match="give a folder"):
        save_site(tmp_path / "index.html", page_folder, answers)
    assert (tmp_path / "index.html").read_text() == "<h1>Mine</h1>"


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

"""A match as a folder of static files, and the page on a server that knows nothing of it."""

import functools
import gzip
import re
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from shuttle_marl.court import WatchError, messages
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.building import FILES
from shuttle_marl.court.match import PolicyTables
from shuttle_marl.court.messages import AnalysisRequest, MatchRequest, RallyRequest, StylesRequest
from shuttle_marl.court.plan import Plan, Side
from shuttle_marl.court.site import save_site
from shuttle_marl.game import default_game
from tests.watch.annotated import annotated_rallies
from tests.watch.conftest import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

LIMIT = 2_300_000
"""Size of a site of a few rallies [bytes]."""


@pytest.fixture(scope="module")
def answers() -> Answers:
    plan = Plan(seed=12, sides=(Side(policy="bc"), Side(policy="bc")))
    return Answers(PolicyTables(default_game(), ("bc",)), plan)


@pytest.fixture(scope="module")
def site(page_folder: Path, answers: Answers, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, int, int]:
    folder = tmp_path_factory.mktemp("site")
    return folder, *save_site(folder, page_folder, answers, limit=LIMIT)


@pytest.mark.slow
def test_a_site_is_small_and_names_no_host(site: tuple[Path, int, int, int], answers: Answers) -> None:
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
def test_any_server_shows_a_site(site: tuple[Path, int, int, int], address: str, browser: "Browser") -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    try:
        viewer = Viewer(page).open(address)
        viewer.seek(viewer.state("duration") - 0.1)
        viewer.play()
        viewer.until(lambda: viewer.state("rally") == 1)
        page.evaluate("window.viewer.go(0)")
        page.get_by_role("tab", name="Analyse").click()
        page.locator(".match .chart, .match svg").first.wait_for()
        page.evaluate("window.viewer.go(1)")
        viewer.until(lambda: viewer.state("rally") == 1)
        page.get_by_role("tab", name="Learn").click()
        page.get_by_role("region", name="Find the better stroke").wait_for()
        assert page.get_by_role("tab", name="Play").count() == 0
        assert viewer.errors == []
        assert viewer.outside == []
    finally:
        page.close()


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A small page."""
    (tmp_path / "page").mkdir()
    for name in FILES:
        html = b'<html lang="en"><head></head><!-- <head> --></html>'
        (tmp_path / "page" / name).write_bytes(html if name == "index.html" else b"x" * 99)
    return tmp_path / "page"


@pytest.fixture(scope="module")
def small(policies: PolicyTables) -> tuple[Answers, Plan]:
    """A duel to two points."""
    plan = Plan(seed=12, sides=(Side(policy="bc"), Side(policy="safe")), points=2)
    return Answers(policies, plan), plan


def saved(folder: Path) -> dict[str, bytes]:
    """The replies of a site by name."""
    return {path.stem: gzip.decompress(path.read_bytes()) for path in (folder / "replies").iterdir()}


def parsed(reply: bytes) -> Any:
    return msgspec.json.decode(reply[4 : 4 + int.from_bytes(reply[:4], "little")])


def test_a_site_holds_the_replies_that_its_page_asks_for(small: tuple[Answers, Plan], files: Path, tmp_path: Path) -> None:
    (answers, plan), folder, steps = small, tmp_path / "site", list[int]()
    whole = answers.length(plan)
    count, size, left = save_site(folder, files, answers, steps.append, language="id")
    assert (count, left, steps) == (whole, 0, [*range(1, whole + 1)])
    assert whole >= 2
    assert size == sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    about: dict[str, Any] = {"id": 0, "plan": plan}
    expected: dict[str, messages.Request] = {f"rally-{i}": RallyRequest(rally=i, **about) for i in range(whole)}
    expected |= {f"analysis-{i}": AnalysisRequest(rally=i, **about) for i in range(whole)}
    expected |= {"match-0": MatchRequest(rally=whole - 1, partial=True, **about), "styles": StylesRequest(rally=0, **about)}
    found = saved(folder)
    hello = parsed(found.pop("hello"))
    assert found == {name: answers(request) for name, request in expected.items()}
    assert (hello["id"], hello["rallies"], hello["recorded"]) == (0, whole, None)
    assert {path.name for path in folder.iterdir()} == {*FILES, "male.glb", "replies"}
    index = (folder / "index.html").read_bytes()
    assert index.startswith(b'<html lang="id"><head><meta http-equiv="Content-Security-Policy"')
    assert index.count(b'<meta name="site" content="static">') == 1


def test_a_site_has_the_rallies_that_fit(small: tuple[Answers, Plan], files: Path, tmp_path: Path) -> None:
    (answers, plan), folder = small, tmp_path / "site"
    save_site(folder, files, answers)
    whole = answers.length(plan)
    names = (*FILES, "male.glb", "replies/rally-0.bin", "replies/analysis-0.bin")
    one = sum((folder / name).stat().st_size for name in names) + 600_000  # room for what is not of one rally
    assert save_site(folder, files, answers, limit=one)[::2] == (1, whole - 1)
    found = saved(folder)  # a site is replaced as a whole
    assert {name for name in found if name.startswith("rally")} == {"rally-0"}
    assert parsed(found["hello"])["rallies"] == 1
    assert found["match-0"] == answers(MatchRequest(id=0, plan=plan, rally=0, partial=True))
    with pytest.raises(WatchError, match=r"site: the first rally does not fit into"):
        save_site(folder, files, answers, limit=one - 1)


def test_recorded_matches_have_reports_instead(policies: PolicyTables, files: Path, tmp_path: Path) -> None:
    plan = Plan(seed=1, sides=(Side(policy="bc"), Side(policy="bc")))
    answers = Answers(policies, plan, recorded=annotated_rallies(policies.game))
    with pytest.raises(WatchError, match="`report` writes pages of recorded matches"):
        save_site(tmp_path / "site", files, answers)
    assert not (tmp_path / "site").exists()


def test_folders_with_other_files_are_refused(small: tuple[Answers, Plan], files: Path, tmp_path: Path) -> None:
    answers, folder = small[0], tmp_path / "site"
    (tmp_path / "index.html").write_text("<h1>Mine</h1>")
    with pytest.raises(WatchError, match="other files"):
        save_site(tmp_path, files, answers)
    with pytest.raises(WatchError, match="give a folder"):
        save_site(tmp_path / "index.html", files, answers)
    assert (tmp_path / "index.html").read_text() == "<h1>Mine</h1>"
    folder.mkdir()
    assert save_site(folder, files, answers)[0]
    (folder / "index.html").unlink()
    with pytest.raises(WatchError, match="give a new or empty folder"):
        save_site(folder, files, answers)

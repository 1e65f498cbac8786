"""What no report of a public match, or of a pair with many strokes, may say; where SHUTTLESET names the folder of the matches."""

import itertools
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import pyarrow as pa
import pytest

from experiments.reports import points_of
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.court.clips import match_clips
from shuttle_marl.court.recorded import RealRallies
from shuttle_marl.data import read_matches
from shuttle_marl.game.shipped import RELIABLE, resolve_game
from shuttle_marl.reports import coach
from shuttle_marl.reports.habits import Expected
from shuttle_marl.reports.languages import LANGUAGES, Language, speaking
from shuttle_marl.reports.match import MatchReport, matches_in
from shuttle_marl.reports.pages import match_page, scouting_page
from shuttle_marl.reports.scouting import ScoutingReport, players_of, scout
from shuttle_marl.reports.summary import met

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = os.environ.get("SHUTTLESET")
pytestmark = [pytest.mark.skipif(not ROOT, reason="SHUTTLESET names no folder"), pytest.mark.slow(minutes=30)]
SIDE = (297 - 2 * 14) * 96 / 25.4
"""Height of a side of A4 within its margins [px]."""
PAIRS = 20


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("matches") / "strokes.parquet"
    write_parquet(path, read_matches(Path(str(ROOT))))
    return path


@pytest.fixture(scope="module")
def strokes(file: Path) -> pa.Table:
    return read_matches(file)


@pytest.fixture
def paper(browser: "Browser") -> Iterator["Page"]:
    page = browser.new_page(viewport={"width": 688, "height": 1000})  # A4 without its margins
    page.emulate_media(media="print")
    yield page
    page.close()


def contents(write: Callable[[], bytes]) -> dict[Language, bytes]:
    found: dict[Language, bytes] = {}
    for language in LANGUAGES:
        with speaking(language):
            found[language] = write()
    return found


def wrong_pages(pages: dict[Language, bytes], paper: "Page", private: Path) -> Iterator[tuple[object, ...]]:
    """Page 1 on more than a side, a sentence that stands twice, a table of nothing but "no", a raw name or a path."""
    for language, content in pages.items():
        paper.set_content(content.decode(), wait_until="domcontentloaded")
        bottom = paper.evaluate("document.querySelector('section.brief').getBoundingClientRect().bottom")
        if bottom > SIDE:
            yield language, "page 1", bottom
        # Parts of cards may be alike, whole sentences of the text are not.
        said = paper.locator("p:not(.card p), section:not(.both) li").all_inner_texts()
        ends = re.compile(r"(?<=[^A-Z]\.)\s+(?=[A-Z])|(?<=\u3002)")
        sentences = Counter(part.strip() for text in said for part in ends.split(text) if part.strip())
        yield from ((language, "twice", sentence) for sentence, times in sentences.items() if times > 1)
        last = "(all) => all.map((t) => [...t.querySelectorAll('tbody td:last-child')].map((cell) => cell.innerText.trim()))"
        for cells in paper.locator("table").evaluate_all(last):
            if not cells or {*cells} <= {"no", "否", "tidak"}:
                yield language, "table", cells
        text = paper.inner_text("body").replace("shuttle_marl", "")
        yield from ((language, "raw", text[max(0, i - 40) : i + 40]) for i in [text.find("_")] if i >= 0)
        if str(private.parent) in text:
            yield language, "path"
        # Page 1 printed alone.
        paper.evaluate("document.querySelectorAll('section.brief ~ *').forEach((part) => part.remove())")
        sides = len(re.findall(rb"/Type\s*/Page\b", paper.pdf(prefer_css_page_size=True, print_background=True)))
        if sides != 1:
            yield language, "sides", sides


def check_match(report: MatchReport, numbers: Mapping[int, int], recorded: RealRallies) -> None:
    """One number for one thing: rallies won by length, by server and in the course."""
    decided = [row.winner for row in report.rallies if row.winner is not None]
    assert [sum(each.rallies for each in report.lengths), sum(each.won for each in report.lengths)] == [
        len(decided),
        decided.count(0),
    ]
    for player in (0, 1):
        sides = [each for each in report.serving if each.player == player and each.label in ("serving", "receiving")]
        assert [sum(each.rallies for each in sides), sum(each.won for each in sides)] == [len(decided), decided.count(player)]
    # The live court shows the rally that has the number.
    for i in numbers.keys() & {*report.moments}:
        rally = recorded.rally(numbers[i])
        shown = dict(zip(rally.names, rally.score.points, strict=True))
        assert shown == dict(zip(report.players, report.rallies[i].points, strict=True))


def check_scout(report: ScoutingReport) -> None:
    """One number for one thing: answers on page 1 and in the tables, strokes and rallies in all and match by match."""
    told = {(each.kind, "".join(each.about[:1]), each.answer): each for each in report.habits}
    for each in (statement.figure for statement in report.page1.of(1, "answer")):
        assert isinstance(each, Expected)
        for answer, share in each.most:
            habit = told.get((each.kind, each.about, answer))
            assert habit is None or (habit.strokes, habit.share) == (each.strokes, share)
    assert report.seen is not None
    assert report.met is not None
    assert report.seen == (sum(form.strokes for form in report.season), len(report.season))
    assert report.player is not None
    together = [form for form in report.season if form.against == report.player.name]
    assert (len(together), sum(form.points for form in together)) == (report.met.matches, report.met.points)


T = TypeVar("T")


def some(names: Sequence[T]) -> Sequence[T]:
    """Every twentieth one, or every n-th one where ``EVERY`` says n: all of them take ten minutes."""
    return names[:: int(os.environ.get("EVERY", "20"))]


def test_the_report_of_every_match(file: Path, strokes: pa.Table, paper: "Page", unbuilt: None) -> None:
    game = resolve_game(None)
    coach.of_strokes(file, game, matches_in(strokes)[0])  # what is computed once in a process
    recorded = RealRallies(file, game, strokes)
    wrong: list[tuple[object, ...]] = []
    matches = some(matches_in(strokes))
    for name in matches:
        report, source = coach.of_strokes(file, game, name)
        pages = contents(lambda report=report, source=source: match_page(report, source, match_clips(report, source)))  # type: ignore[misc]
        wrong += [(name, *each) for each in wrong_pages(pages, paper, file)]
        numbers = match_clips(report, source).numbers
        check_match(report, numbers, recorded)
        # Rallies have their numbers in the match.
        shown = re.findall(r"Rally (\d+), game", pages["en"].decode())
        assert shown
        assert set(map(int, shown)) <= {row.number for row in report.rallies}
        technique = report.game.catalogue.technique
        for choice in report.choices:
            assert report.rallies[choice.rally].winner == 1 - choice.player
            assert technique[choice.played] == technique[choice.better]
            assert min(choice.played_behind, choice.better_behind) >= RELIABLE
    assert not wrong


def test_the_pairs_with_most_strokes(strokes: pa.Table, paper: "Page", file: Path) -> None:
    listed = players_of()
    count = {each.name: each.strokes for each in listed}
    alike = ((a.name, b.name) for a, b in itertools.combinations(listed, 2) if a.discipline == b.discipline)
    wrong: list[tuple[object, ...]] = []
    pairs = some(sorted(alike, key=lambda pair: -count[pair[0]] - count[pair[1]])[:PAIRS])
    for player, opponent in pairs:
        report = scout(opponent, player, data=strokes)
        pages = contents(lambda report=report: scouting_page(report))  # type: ignore[misc]
        wrong += [(player, opponent, *each) for each in wrong_pages(pages, paper, file)]
        check_scout(report)
    assert not wrong


def test_results_of_every_pair_are_those_of_a_plain_count(strokes: pa.Table) -> None:
    met_in_data = {
        tuple(sorted(pair)) for pair in zip(strokes["player"].to_pylist(), strokes["opponent"].to_pylist(), strict=True)
    }
    assert met_in_data
    for first, second in sorted(met_in_data):
        for one, other in ((first, second), (second, first)):
            assert met(strokes, one, other)[:2] == points_of(strokes, one, other)

"""What no report of a public match, or of a pair with many strokes, may say; where SHUTTLESET names the folder of the matches."""

import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa
import pytest
from playwright.sync_api import Browser, Page

from shuttle_marl.analysis.brief import Brief
from shuttle_marl.analysis.match import MatchReport, matches_in
from shuttle_marl.analysis.scouting import players_of, scout
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.coach import match_page, scout_page, sources
from shuttle_marl.data import load_strokes
from shuttle_marl.game.scoring import wins_game
from shuttle_marl.game.shipped import RELIABLE, resolve_game
from shuttle_marl.pages.languages import LANGUAGES, Language, speaking
from tests.pages import parsed

ROOT = os.environ.get("SHUTTLESET")
pytestmark = [pytest.mark.skipif(not ROOT, reason="SHUTTLESET names no folder"), pytest.mark.slow(minutes=30)]
SIDE = (297 - 2 * 14) * 96 / 25.4
"""Height of a side of A4 within its margins [px]."""
PAIRS = 20


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("matches") / "strokes.parquet"
    write_parquet(path, load_strokes(Path(str(ROOT))))
    return path


@pytest.fixture(scope="module")
def strokes(file: Path) -> pa.Table:
    return load_strokes(file)


@pytest.fixture
def paper(browser: Browser) -> Iterator[Page]:
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


def check_pages(pages: dict[Language, bytes], paper: Page, name: str, private: Path) -> None:
    """Page 1 is one side, no sentence stands twice, and no table repeats one word; no raw name and no path."""
    for language, content in pages.items():
        paper.set_content(content.decode(), wait_until="domcontentloaded")
        bottom = paper.evaluate("document.querySelector('section.brief').getBoundingClientRect().bottom")
        assert bottom <= SIDE, (name, language, bottom)
        # Parts of cards and of items about players may be alike, whole sentences of the text are not.
        said = paper.locator("p:not(.card p)").all_inner_texts()
        ends = re.compile(r"(?<=\.)\s+(?=[A-Z])|(?<=\u3002)")
        sentences = Counter(part.strip() for text in said for part in ends.split(text) if part.strip())
        assert max(sentences.values()) == 1, (name, language, sentences.most_common(1))
        for table in paper.locator("table").all():
            cells = {text.strip() for text in table.locator("tbody td:last-child").all_inner_texts()}
            assert not cells <= {"no", "否", "tidak"}, (name, language)
        text = paper.inner_text("body")
        assert "_" not in text, (name, language)
        assert str(private) not in text


def check_brief(found: Brief) -> None:
    """Advice with enough strokes that the observed difference does not contradict, and none beside its opposite."""
    for better, options in ((True, found.dos), (False, found.donts)):
        for each in options:
            assert min(each.strokes, each.others) >= RELIABLE
            assert (each.won / each.strokes > each.others_won / each.others) == better
    assert not {each[:2] for each in found.dos} & {each[:2] for each in found.donts}


def check_score(report: MatchReport) -> None:
    course = match_page._course(report)
    for number, points in enumerate(report.score, 1):
        final = wins_game(max(points), min(points), report.rules)
        assert final or number in course["cut"] or (course["winner"] is None and number == len(report.score))
    played = np.bincount([int(b > a) for a, b in report.score], minlength=2)
    assert course["winner"] is None or played[course["winner"]] == report.rules.games


T = TypeVar("T")


def some(names: Sequence[T]) -> Sequence[T]:
    """All of them, or every n-th one where ``EVERY`` says n."""
    return names[:: int(os.environ.get("EVERY", "1"))]


def test_the_report_of_every_match(file: Path, strokes: pa.Table, paper: Page, unbuilt: None) -> None:
    game = resolve_game(None)
    sources.of_strokes(file, game, matches_in(strokes)[0])  # what is computed once in a process
    seconds = []
    for name in some(matches_in(strokes)):
        started = time.monotonic()
        report, footage = sources.of_strokes(file, game, name)
        pages = contents(lambda report=report, footage=footage: match_page.match_page(report, footage))  # type: ignore[misc]
        seconds.append(time.monotonic() - started)
        check_pages(pages, paper, name, file)
        check_score(report)
        for each in report.briefs:
            check_brief(each)
            assert (len(each.dos), len(each.donts)) == (3, 2), name
        # Rallies have the numbers of the live court.
        column = [a["data-key"] for tag, a in parsed(pages["en"]).tags if tag == "td" and "data-key" in a]
        assert column
        shown = re.findall(r"Rally (\d+), game", pages["en"].decode())
        assert set(map(int, shown)) <= {number + 1 for number in footage.numbers.values()}
        for choice in report.choices:
            assert report.rallies[choice.rally].winner == 1 - choice.player
            technique = report.game.catalogue.technique
            assert technique[choice.played] == technique[choice.better]
            assert min(choice.played_behind, choice.better_behind) >= RELIABLE
    assert float(np.median(seconds)) <= 20


def test_the_pairs_with_most_strokes(strokes: pa.Table, paper: Page, file: Path, unbuilt: None) -> None:
    listed = players_of()
    pairs = [
        (first.name, second.name)
        for i, first in enumerate(listed)
        for second in listed[i + 1 :]
        if first.discipline == second.discipline
    ]
    count = {each.name: each.strokes for each in listed}
    pairs = sorted(pairs, key=lambda pair: -count[pair[0]] - count[pair[1]])[:PAIRS]
    seconds = []
    for player, opponent in some(pairs):
        started = time.monotonic()
        report = scout(opponent, player, data=strokes)
        pages = contents(lambda report=report: scout_page.scouting_page(report))  # type: ignore[misc]
        seconds.append(time.monotonic() - started)
        check_pages(pages, paper, f"{player} against {opponent}", file)
        check_brief(report.brief)
        assert (len(report.brief.dos), len(report.brief.donts)) == (3, 2)
        for advice, real in zip(report.advice, report.realised, strict=True):
            assert real is not None
            assert min(real.strokes, advice.behind) >= RELIABLE
            assert real.won / real.strokes >= real.others_won / real.others
    assert float(np.median(seconds)) <= 60

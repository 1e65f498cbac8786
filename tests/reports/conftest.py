"""A small model with all refits, the sample and the report of a match of it, and a tournament."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from shuttle_marl.court import clips
from shuttle_marl.court.building import BuildError
from shuttle_marl.data import read_matches
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import REFITS, resolve_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports import add_values, strokes_of
from shuttle_marl.reports.languages import Language
from shuttle_marl.reports.match import MatchReport, match_report, matches_in
from shuttle_marl.reports.pages import match_page
from shuttle_marl.reports.words import Words
from tests.pages import Tags, parsed
from tests.reduced import reduced_model

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
A, B = "viktor-axelsen", "kento-momota"


def with_hand(strokes: pa.Table, hand_of: Mapping[str, int | None]) -> pa.Table:
    """Strokes of players of these hands."""
    place = strokes.schema.get_field_index("hand")
    hands = [hand_of[name] for name in strokes["player"].to_pylist()]
    return strokes.set_column(place, strokes.schema.field(place), pa.array(hands, pa.int8()))


@pytest.fixture(scope="session")
def model() -> str:
    return reduced_model(tuple(str(k + 1) for k in range(REFITS)))


@pytest.fixture(scope="session")
def sample() -> pa.Table:
    return read_matches(SAMPLE)


@pytest.fixture(scope="session")
def reported(sample: pa.Table, model: str) -> MatchReport:
    match = sample.filter(pc.equal(sample["match"], matches_in(sample)[1]))
    return match_report(match, game=resolve_game(model))


@pytest.fixture(scope="session")
def page(reported: MatchReport) -> bytes:
    return match_page(reported)


@pytest.fixture
def unbuilt(monkeypatch: pytest.MonkeyPatch) -> None:
    """No program that plays rallies, which takes Node to build."""

    def missing() -> None:
        raise BuildError("Node is missing")

    monkeypatch.setattr(clips, "viewer", missing)


def read(content: bytes) -> tuple[Tags, str]:
    """Tags and text of a page."""
    tags = parsed(content)
    return tags, " ".join(" ".join(tags.words).split())


def assert_fits(content: bytes, language: Language, folder: Path, browser: "Browser") -> None:
    """A page in a language is no wider than a telephone or paper, and no name of a row of a chart is cut off."""
    assert f'<html lang="{Words(language)("language.tag")}">'.encode() in content
    (folder / "page.html").write_bytes(content)
    page = browser.new_page()
    page.goto((folder / "page.html").as_uri())
    for medium, width in (("screen", 390), ("print", 688)):  # A4 without its margins
        page.emulate_media(media=medium)  # type: ignore[arg-type]
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth"), medium
    inside = "(all) => all.every((e) => e.getBoundingClientRect().left >= e.closest('svg').getBoundingClientRect().left - 1)"
    assert page.locator(".chart svg text").evaluate_all(inside)
    page.close()


@pytest.fixture(scope="session")
def bc() -> TabulatedPolicy:
    game = default_game()
    return tabulate(resolve("bc", game), game)


@pytest.fixture(scope="session")
def tournament(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rally log of bc, attacking and random; read-only."""
    from shuttle_marl.league import LeagueConfig
    from tests.tournaments import play_league

    config = LeagueConfig(pool=("bc", "attacking", "random"), matches=6, out=tmp_path_factory.mktemp("played") / "run")
    return play_league(config).folder / "rallies.mcap"


@pytest.fixture(scope="session")
def valued(tournament: Path, bc: TabulatedPolicy) -> pa.Table:
    return add_values(strokes_of(tournament, rallies=10**9), bc)

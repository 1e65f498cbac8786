"""Where players wait: known positions come back, at both ends of the court and for both hands, and no difference is made up."""

import dataclasses
import html
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports.habits import plain
from shuttle_marl.reports.languages import LANGUAGES, Language, current, speaking
from shuttle_marl.reports.match import MatchReport, matches_in
from shuttle_marl.reports.pages import match_page
from shuttle_marl.reports.waits import LEAST_MATCHES, Wait, waits
from shuttle_marl.reports.words import Words
from tests.reports.conftest import assert_fits, with_hand

if TYPE_CHECKING:
    from playwright.sync_api import Browser

HANDS = ("right", None)


def players_of(strokes: pa.Table) -> tuple[str, str]:
    return strokes["player"][0].as_py(), strokes["opponent"][0].as_py()


def replaced(strokes: pa.Table, columns: Mapping[str, object]) -> pa.Table:
    for name, values in columns.items():
        field = strokes.schema.field(name)
        array = values if isinstance(values, pa.Array) else pa.array(values, field.type)
        strokes = strokes.set_column(strokes.schema.get_field_index(name), field, array)
    return strokes


def placed(
    strokes: pa.Table,
    depth: tuple[float, float],
    side: tuple[float, float],
    *,
    end: float = 0.0,
    noise: float = 0.3,
    seed: int = 0,
) -> pa.Table:
    """An annotated match whose players wait at a depth and on a side; points of one end lie ``end`` metres deeper."""
    who = (strokes["opponent"].to_numpy(zero_copy_only=False) == players_of(strokes)[1]).astype(int)
    game, points = strokes["game"].to_numpy(), np.maximum(*(strokes[n].to_numpy() for n in ("points", "points_opponent")))
    far = (game + who + ((game > 2) & (points >= 11))) % 2
    x, y = np.random.default_rng(seed).normal(0, noise, (2, len(strokes)))
    columns = {"receiver_x": x - np.take(side, who), "receiver_y": y + np.take(depth, who) + end * far}
    return replaced(strokes, {**columns, "source": ["club"] * len(strokes)})


@pytest.fixture(scope="module")
def match(sample: pa.Table) -> pa.Table:
    found = sample.filter(pc.equal(sample["match"], matches_in(sample)[1]))
    return with_hand(found, dict.fromkeys(players_of(found), 0))


def test_known_positions_come_back(match: pa.Table) -> None:
    """Of the three most frequent strokes after the serve, with both ends of the court alike."""
    players = players_of(match)
    table = placed(match, (3.0, 4.0), (0.8, -0.8), end=0.6, noise=1e-6)
    found = waits(table, players)
    for player, name in enumerate(players):
        shots = match["shot"].filter(pc.equal(match["player"], name)).to_numpy()
        usual = np.argsort(-np.bincount(shots[shots > 1]), kind="stable")[:3]
        assert [wait.shot for wait in found if wait.player == player] == [SHOTS[shot] for shot in usual]
    for wait in found:
        sign = 1 if wait.player else -1
        assert wait.depth.mean.value == pytest.approx(3.8 + 0.5 * sign, abs=1e-3)
        assert wait.side.mean.value == pytest.approx(-0.8 * sign, abs=1e-3)
        assert {POSITIONS[i] for i in np.flatnonzero(wait.positions)} == (
            {"middle-backhand", "back-backhand"} if wait.player else {"front-forehand", "middle-forehand"}
        )
        assert sorted(wait.positions)[-2:] == pytest.approx([0.5, 0.5])
        assert wait.depth.difference.value == pytest.approx(sign, abs=1e-3)
        assert wait.depth.clear == wait.side.clear == (min(wait.strokes, wait.others) >= 20)
    # The next stroke tells where a player waits, so a stroke before a gap, or the last of a rally, tells nothing.
    stroke = table["stroke"].to_numpy()
    gaps = table.filter(pa.array(stroke % 3 != 0))
    follows = int(((np.diff(gaps["stroke"].to_numpy()) == 1) & (gaps["stroke"].to_numpy()[:-1] > 1)).sum())
    assert sum(wait.strokes for wait in waits(gaps, players)) <= follows < np.sum(stroke > 1) / 2


def test_the_side_of_a_left_hander_is_the_other_one(match: pa.Table) -> None:
    players = players_of(match)
    table = placed(match, (3.8, 3.8), (0.5, 0.5))
    right, unknown, left = (waits(with_hand(table, dict(zip(players, (0, hand), strict=True))), players) for hand in (0, None, 1))
    assert plain(right) == plain(unknown)
    for one, other in zip(right, left, strict=True):
        sign = -1 if one.player else 1
        assert other.side.mean.value == pytest.approx(sign * one.side.mean.value)
        shares = np.reshape(one.positions, (3, 3))
        assert np.reshape(other.positions, (3, 3)) == pytest.approx(shares[:, ::sign])
        assert dataclasses.replace(other.depth, q=one.depth.q) == one.depth


def test_unknown_and_simulated_positions_are_none(match: pa.Table) -> None:
    players = players_of(match)
    none = dict.fromkeys(("receiver_x", "receiver_y"), [None] * len(match))
    assert waits(match, players) == []
    assert waits(replaced(placed(match, (3.0, 4.0), (0, 0)), none), players) == []


def test_differences_that_chance_makes_are_not_named(match: pa.Table) -> None:
    """Nor those of the ends of the court, nor those of few strokes, nor those of centimetres."""
    players = players_of(match)
    named = [any(w.depth.clear or w.side.clear for w in waits(placed(match, (3.8, 3.8), (0, 0), end=0.5, seed=k), players))
             for k in range(8)]  # fmt: skip
    assert sum(named) <= 1
    for depth, rows in (((3.0, 4.5), 60), ((3.8, 3.85), len(match))):
        found = waits(placed(match, depth, (0, 0), noise=0.05).slice(0, rows), players)
        assert found
        assert not any(wait.depth.clear for wait in found)
    one_end = match.filter(pc.equal(match["game"], 1))
    assert all(np.isnan(wait.depth.difference.value) for wait in waits(placed(one_end, (3.0, 4.5), (0, 0)), players))


def test_intervals_resample_matches_where_there_are_enough(match: pa.Table) -> None:
    """A player waits elsewhere from match to match by more than rallies tell."""
    players = players_of(match)
    shift = np.random.default_rng(0).normal(0, 0.3, LEAST_MATCHES)
    tables = [
        replaced(placed(match, (3.8 + move, 3.8), (0, 0), seed=k), {"match": [f"match {k}"] * len(match)})
        for k, move in enumerate(shift)
    ]
    many, few = (waits(pa.concat_tables(tables[:n]), players[:1])[0].depth.mean for n in (LEAST_MATCHES, LEAST_MATCHES - 1))
    assert many.value == pytest.approx(3.8 + shift.mean(), abs=0.05)
    assert many.high - many.low > 2 * (few.high - few.low)


def section(report: MatchReport, found: list[Wait], names: tuple[str, str]) -> str:
    """The section of the page of a match report, behind the drawings of page 1."""
    page = match_page(dataclasses.replace(report, waits=found, players=names, hands=HANDS)).decode()
    heading = Words(current())("waits.heading").lower().replace(" ", "-")
    (found_section,) = re.findall(rf'<section id="{heading}">.*?</section>', page, re.DOTALL)
    drawn = re.findall(r"<figcaption>(.*?)</figcaption>", page.partition("</section>")[0])
    return "".join(f"<figcaption>{caption}</figcaption>" for caption in drawn[1::2]) + str(found_section)


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_section_says_what_the_data_support(match: pa.Table, reported: MatchReport, language: Language) -> None:
    players, names = players_of(match), ("<b>Ann", "Bea")
    found = waits(placed(match, (3.5, 4.0), (0, 0)), players)
    assert waits(placed(match, (3.5, 4.0), (0, 0)), players) == found
    assert json.loads(json.dumps(plain(found)))[0]["positions"] == list(found[0].positions)
    say = Words(language)
    with speaking(language):
        told = section(reported, found, names)
    (lead,) = re.findall(r'<p class="lead">(.*?)</p>', told)
    assert lead.count("Ann") == lead.count("Bea") == 1
    assert "<b>" not in told
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", told)
    assert len(captions) == 2
    assert say("sides.behind_right") in captions[1]
    for name, hand, caption in zip(names, HANDS, captions, strict=True):
        assert html.unescape(caption) == say("waits.chart", player=name, sides=say(f"sides.behind_{hand or 'right'}"))


def unclear(wait: Wait) -> Wait:
    return dataclasses.replace(wait, **{n: dataclasses.replace(getattr(wait, n), clear=False) for n in ("depth", "side")})


def test_unclear_differences_are_said_to_be_none(match: pa.Table, reported: MatchReport) -> None:
    found = waits(placed(match, (3.5, 4.0), (0, 0)), players_of(match))
    alone, say = section(reported, [unclear(wait) for wait in found], ("Ann", "Bea")), Words("en")
    assert f'<p class="lead">{say("waits.none")}</p>' in alone


@pytest.mark.parametrize("language", LANGUAGES)
def test_match_reports_fit_a_telephone_and_paper_in_every_language(
    match: pa.Table, reported: MatchReport, tmp_path: Path, browser: "Browser", language: Language
) -> None:
    found = waits(placed(match, (3.5, 4.0), (0.5, -0.5)), players_of(match))
    report = dataclasses.replace(reported, waits=found, players=("Pornpawee Chochuwong", "Ratchanok Intanon"))
    with speaking(language):
        content = match_page(report)
    assert_fits(content, language, tmp_path, browser)

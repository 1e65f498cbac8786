"""Both reports: what they say, that names stay text, that they need no network, and what they refuse."""

import dataclasses
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from shuttle_marl.base.errors import printable
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.commands.report import main as report_command
from shuttle_marl.commands.scout import main as scout_command
from shuttle_marl.commands.watch import RallyOptions, _downloads
from shuttle_marl.court import clips
from shuttle_marl.court.recorded import LogRallies, RealRallies
from shuttle_marl.court.staged import habits_shown
from shuttle_marl.data.matches import game_end
from shuttle_marl.data.schema import Outcome
from shuttle_marl.exact import Odds
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.scoring import BWF, Rules, Score
from shuttle_marl.game.shipped import default_game, resolve_game
from shuttle_marl.game.stroke import SHOTS, Catalogue
from shuttle_marl.recording import RallyLog
from shuttle_marl.reports import charts, coach
from shuttle_marl.reports.habits import Habit, Page1, Statement
from shuttle_marl.reports.languages import LANGUAGES, Language, speaking
from shuttle_marl.reports.match import Chances, MatchReport, match_report, matches_in
from shuttle_marl.reports.pages import Clips, gaps, match_page, scouting_page
from shuttle_marl.reports.scouting import ScoutingReport, players_of, scout
from shuttle_marl.reports.summary import AnalysisError, rally_table
from shuttle_marl.reports.words import Words
from tests import golden
from tests.reports.conftest import SAMPLE, A, B, assert_fits, read, with_hand

if TYPE_CHECKING:
    from playwright.sync_api import Browser

EVIL = "</script><script>alert(1)</script><img src=http://example.org/x>"
TURNED = "\u202eanaid-nairam"
LONG = "x" * 200


@pytest.fixture(scope="session")
def scouted(model: str) -> ScoutingReport:
    return scout(B, A, model=model)


@pytest.fixture(scope="session")
def scouted_page(scouted: ScoutingReport) -> bytes:
    return scouting_page(scouted)


@pytest.fixture(scope="session")
def match(sample: pa.Table) -> pa.Table:
    return sample.filter(pc.equal(sample["match"], matches_in(sample)[1]))


def test_a_report_counts_forced_and_unforced_errors(match: pa.Table, model: str) -> None:
    faults = np.flatnonzero(match["outcome"].to_numpy() == Outcome.FAULT)
    forced: list[bool | None] = [None] * len(match)
    for i, kind in zip(faults, (True, False, False, *[True] * len(faults)), strict=False):
        forced[i] = kind
    at = match.schema.get_field_index("forced")
    report = match_report(match.set_column(at, match.schema.field(at), pa.array(forced, pa.bool_())), game=resolve_game(model))
    assert np.sum(report.faults, axis=0).tolist() == [len(faults) - 2, 2]
    _, text = read(match_page(report))
    for player, (pressed, own) in zip(report.players, report.faults, strict=True):
        assert f"{own} unforced errors, {pressed} forced by the opponent" in text, player


def test_a_scouting_report_has_its_parts(scouted: ScoutingReport, sample: pa.Table, model: str) -> None:
    tags, text = read(scouting_page(scouted, clips=Clips(reason="Node is missing")))
    parts = [name for tag, a in tags.tags if tag == "section" and (name := a["id"])]
    assert parts == ["brief", "how-kento-momota-plays", "serve,-return-and-third-stroke:-what-to-expect", "how-sure-is-this?"]
    assert "By skill alone, Viktor Axelsen wins about" in text
    assert "left out: Node is missing" in text
    assert "no matches were given to count it in" in text
    told = scout("chou-tien-chen", A, model=model, data=sample)
    assert told.options
    tags, text = read(scouting_page(told))
    assert "rallies-won-against-chou-tien-chen,-situation-by-situation" in [a["id"] for tag, a in tags.tags if tag == "section"]
    assert any(each.clear for each in told.options) != ("Nothing to do more or less" in text)


def test_page_1_has_statements_with_counts_and_nothing_of_luck(
    scouted: ScoutingReport, scouted_page: bytes, reported: MatchReport, page: bytes
) -> None:
    for figures, content in ((scouted.as_json(), scouted_page), (reported.as_json(), page)):
        _, text = read(content)
        said = json.loads(json.dumps(figures["page1"], allow_nan=False))
        assert said
        for each in said:
            assert each["count"] > 0
            assert each["low"] <= each["value"] <= each["high"]
            assert each["text"] in text
            assert (each["q"] is None) == (each["kind"] == "answer")
            assert each["q"] is None or each["q"] <= 0.05
    assert scouted.page1.of(1, "habit", "fault", "winner")


def test_examples_show_habits_of_the_opponent(scouted: ScoutingReport, sample: pa.Table, model: str) -> None:
    said = scouted.page1.of(1, "habit")
    content, examples = habits_shown(scouted, None)
    assert 1 <= len(examples) == sum(key.startswith("rally ") for key in json.loads(content)["replies"]) <= 2
    figures = [said[each.statement].figure for each in examples]
    assert all(isinstance(figure, Habit) and figure.answer in SHOTS for figure in figures)
    assert not any(each.match for each in examples)
    told = scout("chou-tien-chen", A, model=model, data=sample)
    habit = next(each for each in told.habits if each.kind == "shots" and each.share > 0.1)
    one = Statement("habit", 1, habit, 10, 0.5, 0.4, 0.6)
    report = dataclasses.replace(told, page1=Page1((one,), 0, (None, None)))
    _, [example] = habits_shown(report, sample)
    rows = sample.filter(pc.and_(pc.equal(sample["match"], example.match), pc.equal(sample["game"], example.game)))
    played = rows.filter(pc.equal(rows["player"], "chou-tien-chen"))["shot"].to_pylist()
    assert SHOTS.index(habit.answer) in played
    _, text = read(scouting_page(report, clips=Clips(content="{}", examples=[example])))
    points = "\N{EN DASH}".join(map(str, example.points))
    assert f"game {example.game} at {points}" in text


def test_charts_are_those_that_somebody_looked_at(scouted_page: bytes, page: bytes) -> None:
    found = {}
    for name, content in (("scouting report", scouted_page), ("match report", page)):
        for number, svg in enumerate(re.findall("<svg.*?</svg>", content.decode(), re.DOTALL)):
            found[f"{name}, {number}"] = golden.drawing(svg)
    golden.check("report_charts", found, 0.01)


def test_the_figures_are_the_written_ones(scouted: ScoutingReport, reported: MatchReport) -> None:
    for name, report in (("scouting_report", scouted), ("match_report", reported)):
        figures = json.loads(json.dumps(report.as_json(), allow_nan=False))
        golden.check(name, figures | {"model": None} if name == "scouting_report" else figures)


def test_the_first_line_names_the_hands(scouted: ScoutingReport, match: pa.Table, model: str) -> None:
    a, b = dict.fromkeys([*match["player"].to_pylist()])
    report = match_report(with_hand(match, {a: 1, b: None}), game=resolve_game(model))
    assert report.hands == ("left", None)
    first, second = map(Words("en").player, (a, b))
    _, text = read(match_page(report))
    assert f"{first}, left-handed · {second}, hand not known, played as right-handed · Match report" in text
    assert f"{first} strikes at the bottom; the opponent's forehand side is on the left" in text
    assert f"{second} strikes at the bottom; the opponent's backhand side is on the left" in text
    people = {
        name: dataclasses.replace(getattr(scouted, name), hand=hand) for name, hand in (("player", "right"), ("opponent", "left"))
    }
    _, text = read(scouting_page(dataclasses.replace(scouted, **people)))
    assert "Viktor Axelsen, right-handed · Kento Momota, left-handed · Scouting report" in text


def test_hands_are_those_of_the_data_and_else_of_the_model(sample: pa.Table, model: str) -> None:
    others = "chou-tien-chen"
    assert [scout(name, model=model).opponent.hand for name in (A, B)] == ["right", "left"]
    unknown: dict[str, int | None] = dict.fromkeys(sample["player"].unique().to_pylist())
    told, whole, alone = (
        scout(others, model=model, data=with_hand(sample, {**unknown, others: 1, A: hand})) for hand in (None, 0, 1)
    )
    assert told.opponent.hand == "left"
    # A hand that the model adds counts as one of the data.
    assert np.array_equal(told.targets, whole.targets)
    assert not np.array_equal(told.targets, alone.targets)


def test_a_court_is_drawn_as_a_receiver_of_the_hand_stands() -> None:
    """The forehand side of a right-hander is on the left of a striker who looks at them."""
    shares = np.array([0.0, 0.0, 0.0, 0.77, 0.0, 0.23, 0.0, 0.0, 0.0])
    for hand in ("right", "left"):
        drawn = str(charts.court(shares, shares, "court", hand))
        place = {text: float(x) for x, text in re.findall(r"<text[^>]*translate\(([\d.]+) [^>]*>(77|23)<", drawn)}
        assert (place["77"] < place["23"]) == (hand == "right")
        assert "the opponent's forehand side 77" in drawn


@pytest.mark.parametrize(("language", "every"), [("en", 1), ("zh", 5), ("id", 5)])
def test_names_of_strokes_are_those_that_somebody_read(language: Language, every: int) -> None:
    words, catalogue = Words(language), default_game().catalogue
    names = {
        catalogue.names[stroke]: words.stroke(catalogue, stroke, "their", met=stroke % 10 - 1, hands=("right", "left"))
        for stroke in range(0, len(catalogue.names), every)
    }
    golden.check("words", {language: names})


def test_a_stroke_between_two_sides_is_straight_or_cross_court() -> None:
    catalogue = Catalogue.from_names(["smash:middle-right:above:forehand", "net-shot:front-right:below:forehand"])
    for met, hands, words in (
        (6, ("right", "right"), "a cross-court smash with the forehand to their forehand side"),
        (6, ("right", "left"), "a straight smash with the forehand to their forehand side"),
        (8, ("left", None), "a cross-court smash with the forehand to their forehand side"),
        (8, (None, None), "a straight smash with the forehand to their forehand side"),
        (7, ("right", "left"), "a smash with the forehand to their forehand side"),
        (-1, ("right", "left"), "a smash with the forehand to their forehand side"),
    ):
        assert Words("en").stroke(catalogue, 0, "their", met=met, hands=hands) == words
    assert Words("en").stroke(catalogue, 1, "their", met=0) == "a net shot with the forehand to their front forehand corner"
    assert Words("zh").stroke(catalogue, 0, "their", met=8) == "正手直线杀球到对方正手位"
    assert Words("id").stroke(catalogue, 0, "their", met=6) == "smes silang forehand ke sisi forehand lawan"


def test_a_drill_is_drawn_as_both_players_stand() -> None:
    drawn = {hands: str(charts.drill(0, 6, hands, "drill")) for hands in (("right", "right"), ("left", "right"), (None, "left"))}
    assert len({*drawn.values()}) == 3
    assert drawn["left", "right"] == str(charts.drill(2, 6, ("right", "right"), "drill"))
    assert drawn[None, "left"] == str(charts.drill(0, 8, ("right", "right"), "drill"))
    serves = {str(charts.drill(-1, 6, (hand, "right"), "drill")) for hand in ("right", "left", None)}
    assert len(serves) == 1


def test_drills_name_areas_as_the_player_sees_them(reported: MatchReport) -> None:
    catalogue, choice = reported.game.catalogue, reported.choices[0]
    stroke = next(k for k in range(len(catalogue)) if catalogue.area[k] == 6 and not catalogue.is_serve[k])
    met = next(k for k in range(len(catalogue)) if catalogue.area[k] == 0 and not catalogue.is_serve[k])
    choice = dataclasses.replace(choice, incoming=met, better=stroke)
    serve = dataclasses.replace(choice, incoming=len(catalogue), better=0)
    _, text = read(match_page(dataclasses.replace(reported, choices=[choice, serve])))
    assert "to your front forehand corner (blue)" in text
    assert "to their rear forehand corner (orange)" in text
    assert Words("en")("drills.serve", number=2, stroke="a")[:12] in text


def test_a_profile_alone_has_no_advice(model: str) -> None:
    report = scout(B, model=model)
    assert (report.rally, report.player, report.pair) == (None, None, None)
    _, text = read(scouting_page(report))
    assert "How Kento Momota plays" in text
    assert "Strokes of Kento Momota after the serve" in text
    assert "How the strokes end" in text


def test_a_player_with_fifty_strokes(model: str, sample: pa.Table) -> None:
    few = sample.filter(pc.equal(sample["match"], matches_in(sample)[3])).slice(0, 100)
    names = few["player"].to_pylist()
    for column in ("player", "opponent"):
        new = pa.array(["club-player" if name == names[0] else name for name in few[column].to_pylist()], pa.string())
        few = few.set_column(few.schema.get_field_index(column), few.schema.field(column), new)
    report = scout("club-player", model=model, data=few)
    assert report.opponent.since is None
    assert report.seen[0] <= 60
    _, text = read(scouting_page(report))
    assert f"There are only {report.seen[0]} strokes of Club Player" in text
    whole = scout("club-player", A if report.discipline == "men" else "an-se-young", model=model, data=few)
    _, text = read(scouting_page(whole))
    assert "The data have no strokes of Club Player" in text


def test_names_of_players(model: str) -> None:
    assert scout("MOMOTA kento", model=model).opponent == scout(B, model=model).opponent
    with pytest.raises(AnalysisError, match="did you mean kento-momota"):
        scout("kento-momoto", model=model)
    women = next(each.name for each in players_of(model) if each.discipline == "women")
    with pytest.raises(AnalysisError, match="expected one discipline"):
        scout(women, A, model=model)


def test_scores_and_chances_of_a_match(reported: MatchReport, match: pa.Table) -> None:
    rows = rally_table(match)
    winners = rows["winner"].to_pylist()
    assert [reported.players[row.winner] for row in reported.rallies if row.winner is not None] == [w for w in winners if w]
    assert sum(map(sum, reported.score)) == len(winners)
    for before, after in zip(reported.rallies, reported.rallies[1:], strict=False):
        assert before.after == pytest.approx(after.before)
        assert (after.before > before.before) == (before.winner == 0)
    assert reported.rallies[-1].after in (0.0, 1.0)
    swings = [abs(reported.rallies[i].swing) for i in reported.moments]
    assert swings == sorted(swings, reverse=True)
    assert swings[0] == max(abs(row.swing) for row in reported.rallies)
    games = [reported.rallies[i].key[0] for i in reported.moments]
    assert max(map(games.count, games)) <= 2


def test_a_match_in_the_game_of_its_players(match: pa.Table, model: str) -> None:
    people = dict(zip(match["player"].unique().to_pylist(), (A, B), strict=True))
    for column in ("player", "opponent"):
        named = pa.array([people[name] for name in match[column].to_pylist()])
        match = match.set_column(match.column_names.index(column), match.schema.field(column), named.cast(match[column].type))
    one, other = (match_report(match, game=pair_game(*pair, game=model, discipline="men")) for pair in ((A, B), (B, A)))
    assert one.game.people == other.game.people
    assert one.rallies == other.rallies


def test_rallies_are_counted_by_length_and_server(reported: MatchReport) -> None:
    decided = [row for row in reported.rallies if row.winner is not None]
    for group in reported.lengths:
        low, _, high = group.label.replace("+", "\N{EN DASH}999").partition("\N{EN DASH}")
        among = [row.winner for row in decided if int(low) <= row.strokes <= int(high)]
        assert (group.rallies, group.won) == (len(among), among.count(0))
    assert sum(group.rallies for group in reported.lengths) == len(decided)
    for group in reported.serving:
        if group.label in ("serving", "receiving"):
            among = [row.winner for row in decided if (row.server == group.player) == (group.label == "serving")]
            assert (group.rallies, group.won) == (len(among), among.count(group.player))


def test_chances_follow_the_score() -> None:
    rules = Rules(points=1, clear=1, cap=1, games=1)
    chances, score = Chances(Odds(serving=0.8, receiving=0.4, error_bound=0.0), rules), Score(rules=rules)
    scores = score, Score(rules=rules, server=1), score.after(1)
    assert [*map(chances.of, scores)] == pytest.approx([0.8, 0.4, 0.0])


@pytest.mark.parametrize(
    ("points", "following", "score", "winner", "inferred"),
    [
        ((23, 22), 0, (24, 22), 0, True),  # the leader serves next
        ((23, 22), 1, (23, 22), 1, False),  # who did not lead won it: the rules leave several scores
        ((19, 9), 0, (19, 9), 0, False),
        ((21, 18), None, (21, 18), 0, False),
        ((20, 10), None, (21, 10), 0, True),
    ],
)
def test_the_rules_tell_the_score_of_a_game_whose_last_rally_is_missing(
    points: tuple[int, int], following: int | None, score: tuple[int, int], winner: int, *, inferred: bool
) -> None:
    assert game_end(points, following, BWF) == (score, winner, inferred)


def test_a_costly_decision_is_one_of_a_lost_rally_and_keeps_the_technique(reported: MatchReport) -> None:
    technique = reported.game.catalogue.technique
    assert reported.choices
    for choice in reported.choices:
        assert reported.rallies[choice.rally].winner == 1 - choice.player
        assert technique[choice.played] == technique[choice.better]
        assert choice.stroke <= 30


def test_a_match_without_places(match: pa.Table, model: str) -> None:
    for name in [name for name in match.column_names if name.endswith(("_x", "_y")) or name in ("area", "in_court")]:
        field = match.schema.field(name)
        match = match.set_column(match.schema.get_field_index(name), field, pa.nulls(len(match), field.type))
    report = match_report(match, game=resolve_game(model))
    assert report.choices == []
    assert report.page1.of(0, "answer")
    assert "No single choice was clearly worse" in read(match_page(report))[1]


def test_rallies_that_the_data_lack_are_mentioned(match: pa.Table, model: str, reported: MatchReport, page: bytes) -> None:
    assert "By the score" not in read(page)[1]
    keep = pc.invert(pc.is_in(match["rally"], value_set=pa.array([3, 4, 9], match.schema.field("rally").type)))
    report = match_report(match.filter(keep), game=resolve_game(model))
    played = sum(map(sum, report.score))
    assert played > len(report.rallies)
    _, text = read(match_page(report))
    assert f"By the score {played} rallies were played; the data have {len(report.rallies)} of them" in text
    first = match["game"].to_numpy() == 1
    late = first & (match["rally"].to_numpy() > match["rally"].to_numpy()[first].max() - 2)
    assert match_report(match.filter(pa.array(~late)), game=resolve_game(model)).rallies[-1].after == reported.rallies[-1].after


def test_a_game_that_the_data_lack_is_mentioned(match: pa.Table, model: str, reported: MatchReport, page: bytes) -> None:
    assert "Game 1 is not in the data" not in read(page)[1]
    report = match_report(match.filter(pc.greater(match["game"], 1)), game=resolve_game(model))
    assert report.score == reported.score[1:]
    assert all(np.isnan([row.before, row.after]).all() for row in report.rallies)  # nobody knows who won it
    assert "Game 1 is not in the data: the scores and all figures are of the other games alone" in read(match_page(report))[1]


def test_what_the_data_lack_is_said(tmp_path: Path, model: str, match: pa.Table) -> None:
    assert gaps(match) == ()
    n = len(match)
    returned = np.flatnonzero(match["outcome"].to_numpy() == 0)
    area: list[int | None] = match["area"].to_pylist()
    inferred: list[str | None] = [None] * n
    sure: list[float | None] = [None] * n
    for row in returned[:3]:
        area[row] = None
    for row, share in zip(returned[3:5], (0.25, 0.75), strict=True):
        inferred[row], sure[row] = "height area", share
    for row, share in zip(returned[5:8], (0.1, 0.4, 0.9), strict=True):
        sure[row] = share
    for name, values in (("area", area), ("inferred", inferred), ("confidence", sure)):
        field = match.schema.field(name)
        match = match.set_column(match.schema.get_field_index(name), field, pa.array(values, field.type))
    places, doubtful = gaps(match)
    assert places.startswith(f"Of {n:,} strokes of your data, 2 have a place that was inferred")
    assert "right in 50 of 100 cases, and 3 have none" in places
    assert doubtful.startswith("A program recognised 2 strokes")
    write_parquet(tmp_path / "own.parquet", match)
    _, content = read(match_page(*coach.of_strokes(tmp_path / "own.parquet", resolve_game(model))))
    assert places in content
    assert doubtful in content


def test_numbers_of_the_live_court_are_those_of_its_option(tmp_path: Path, model: str, match: pa.Table, unbuilt: None) -> None:
    write_parquet(tmp_path / "strokes.parquet", match)
    report, source = coach.of_strokes(tmp_path / "strokes.parquet", resolve_game(model))
    rallies = RealRallies(tmp_path / "strokes.parquet", resolve_game(model))
    numbers = clips.match_clips(report, source).numbers
    assert sorted(numbers.values()) == list(range(rallies.count))
    # The page counts within the match, names the first number of the court, and no folders.
    _, content = read(match_page(report, source, clips.match_clips(report, source)))
    assert "--real strokes.parquet" in content
    assert str(tmp_path) not in content
    for i in report.moments:
        assert f"Rally {report.rallies[i].number}, game {report.rallies[i].key[0]}" in content
    assert f"The first rally of this match that is there has number {min(numbers.values()) + 1}" in content


def test_names_stay_text(scouted: ScoutingReport, reported: MatchReport) -> None:
    assert scouted.player is not None
    player, opponent = dataclasses.replace(scouted.player, name=TURNED), dataclasses.replace(scouted.opponent, name=EVIL)
    pages = {
        (EVIL, TURNED): scouting_page(dataclasses.replace(scouted, player=player, opponent=opponent)),
        (EVIL, LONG, TURNED): match_page(dataclasses.replace(reported, players=(EVIL, LONG), match=TURNED)),
    }
    for names, content in pages.items():
        tags, text = read(content)
        assert not {tag for tag, _ in tags.tags} & {"img", "iframe", "object"}
        assert [tag for tag, _ in tags.tags].count("script") == 1
        assert [name for name in names if printable(name) not in text] == []
        assert b"\xe2\x80\xae" not in content
        for _, attributes in tags.tags:
            assert not any(key.startswith("on") or key == "style" for key in attributes)
            assert not re.match(r"(?!#|data:,)", attributes.get("href") or "#")


def test_commands(tmp_path: Path, model: str, unbuilt: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert scout_command(["--list", "--game", model, "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["players"]
    assert {"name", "discipline", "strokes", "matches", "last", "imitated"} == set(listed[0])
    out = tmp_path / "s.html"
    assert scout_command([A, B, "--game", model, "--out", str(out), "--language", "zh"]) == 0
    content = out.read_text(encoding="utf-8")
    assert '<html lang="zh-Hans">' in content
    assert len(content) < 3_000_000
    out = tmp_path / "m.html"
    options = ["--game", model, "--out", str(out), "--video", "https://example.org/v?t={seconds}"]
    assert report_command([str(SAMPLE), "--match", "SIMULATED 2", *options]) == 0
    content = out.read_text(encoding="utf-8")
    assert 'href="https://example.org/v?t=' in content
    assert "Watch the rallies on the live court" in content


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "8 matches; expected words of one of these names"),
        (["--match", "("], "--match (: 0 matches; expected words"),
        (["--match", "simulated-99"], "0 matches"),
        (["--match", "simulated-2", "--pairing", "3"], "only rally logs have pairings"),
        (["--match", "simulated-2", "--video", "javascript:{seconds}"], "expected an http or https address"),
        (["--match", "simulated-2", "--video", "https://example.org/"], "with {seconds} once"),
        (["--match", "simulated-2", "--out", "report.pdf"], "expected a name that ends in .html"),
    ],
)
def test_reports_that_are_refused(
    arguments: list[str], message: str, model: str, unbuilt: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report_command([str(SAMPLE), "--game", model, *arguments]) == 1
    assert message in capsys.readouterr().err


def test_a_report_of_agents(tmp_path: Path, model: str, unbuilt: None, capsys: pytest.CaptureFixture[str]) -> None:
    from shuttle_marl.league import LeagueConfig
    from tests.tournaments import play_league

    config = LeagueConfig(pool=("bc", "attacking"), matches=2, game=model, out=tmp_path / "run")
    log = play_league(config).folder / "rallies.mcap"
    out = tmp_path / "m.html"
    assert report_command([str(log), "--match", "1", "--game", model, "--out", str(out)]) == 0
    _, text = read(out.read_bytes())
    assert "Watch the rallies on the live court" in text
    capsys.readouterr()
    assert report_command([str(log), "--match", "7", "--game", model]) == 1
    assert "no match 7" in capsys.readouterr().err
    # The live court serves the same page for each rally of the match.
    game = resolve_game(model)
    recorded = LogRallies(RallyLog(log), game)
    page = _downloads(RallyOptions(replay=log), recorded, game)["report", "text/html"]
    number = next(k for k in range(recorded.count) if recorded.match(k) == (0, 1))
    assert read(page(number + 1))[1] == text


@pytest.mark.parametrize("language", LANGUAGES)
def test_scouting_reports_fit_a_telephone_and_paper_in_every_language(
    tmp_path: Path, browser: "Browser", scouted: ScoutingReport, language: Language
) -> None:
    with speaking(language):
        content = scouting_page(scouted)
    assert_fits(content, language, tmp_path, browser)

"""Recorded rallies of logs and of annotated matches, as the page shows them."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.court import WatchError, messages
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.match import Match, MatchLog, PolicyTables
from shuttle_marl.court.plan import Plan, Side
from shuttle_marl.court.recorded import LogRallies, RealRallies
from shuttle_marl.data import read_matches
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import game_of_people, pair_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog
from shuttle_marl.reports.rally import legal_states
from tests.reduced import reduced_game, reduced_model
from tests.watch.annotated import EVENT, SAMPLE, annotated_rallies, with_column
from tests.watch.conftest import replied

PLAN = Plan(seed=3, sides=(Side(policy="bc"), Side(policy="attacking", temperature=0.5)))


@pytest.fixture(scope="module")
def small() -> PolicyTables:
    return PolicyTables(reduced_game())


@pytest.fixture(scope="module")
def annotated(small: PolicyTables) -> RealRallies:
    return annotated_rallies(small.game)


@pytest.fixture(scope="module")
def strokes() -> pa.Table:
    return read_matches(SAMPLE)


def rows_of(shown: RealRallies, strokes: pa.Table, number: int) -> np.ndarray:
    """Rows of a rally in its table."""
    match = shown.match(number)
    (at,) = [at for at, known in shown.numbers(match).items() if known == number]
    columns = (strokes[name].to_numpy(zero_copy_only=False) for name in ("match", "game", "rally"))
    return np.flatnonzero(np.logical_and.reduce([column == value for column, value in zip(columns, (match, *at), strict=True)]))


def test_a_stroke_is_tried_in_a_recorded_rally(small: PolicyTables, tmp_path: Path) -> None:
    """What was played before it stays."""
    log, game = MatchLog(tmp_path, small), small.game
    for number in range(8):
        log.add(PLAN, Match(PLAN, small).rally(number))
    log.close()
    recorded = LogRallies(RallyLog(next(tmp_path.glob("*.mcap"))), game)
    answers = Answers(small, PLAN, recorded=recorded)
    for rally in map(recorded.rally, range(recorded.count)):
        k = len(rally) - 1
        legal = game.legal_strokes(int(rally.states(game)[k])).tolist()
        other = next(stroke for stroke in legal if stroke != rally.stroke[k])
        strokes = answers.rally(messages.RallyRequest(id=1, rally=rally.number, tried={k: other}))[0].rally.strokes
        assert [one.stroke for one in strokes[: k + 1]] == [*rally.stroke[:k].tolist(), other]
        assert [one.hurried for one in strokes[: k + 1]] == rally.hurried.tolist()
        assert [one.person for one in strokes[: k + 1]] == [False] * k + [True]


def test_real_rallies_have_the_hurried_strikers_of_the_table(tables: PolicyTables, strokes: pa.Table) -> None:
    marked = (np.arange(len(strokes)) % 3 == 0) & (strokes["stroke"].to_numpy() > 1)
    shown = RealRallies(SAMPLE, tables.game, with_column(strokes, "hurried", marked))
    for number in range(50):
        rally = shown.rally(number).checked()
        assert rally.hurried.tolist() == marked[rows_of(shown, strokes, number)].tolist()
        assert (rally.states(tables.game) >= 0).all(), "the game has every state"


def test_where_points_are_not_known_the_winners_of_the_rallies_count(tables: PolicyTables, strokes: pa.Table) -> None:
    for name in ("points", "points_opponent"):
        strokes = with_column(strokes, name, [None] * len(strokes))
    shown = RealRallies(SAMPLE, tables.game, strokes)
    last = [shown.rally(match.first - 1).score for match in shown.matches[1:]]
    assert all(sum(score.games) == len(score.finished) in (1, 2) for score in last)
    assert all(points != (0, 0) for score in last for points in score.finished)


@pytest.mark.parametrize("known", [True, False])
def test_real_rallies_have_hands_and_land_where_they_did(known: bool, tables: PolicyTables, strokes: pa.Table) -> None:
    player, discipline = strokes["player"][0].as_py(), strokes["discipline"][0].as_py()
    hand = [1 if known and name == player else None for name in strokes["player"].to_pylist()]
    shown = RealRallies(SAMPLE, tables.game, with_column(strokes, "hand", hand))
    same = []
    for number in range(40):
        rally = shown.rally(number)
        assert rally.hands == tuple("left" if known and name == player else "right" for name in rally.names)
        assert rally.athletes == (("female" if discipline == "WS" else "male"),) * 2
        area = strokes["area"].to_numpy(zero_copy_only=False)[rows_of(shown, strokes, number)]
        met = (rally.striker == rally.names.index(player)) | np.isnan(area)
        same += (rally.aim[rally.striker, rally.stroke] == area)[~met & ~rally.catalogue.is_serve[rally.stroke]].tolist()
    assert np.mean(same) > 0.9, "strokes to the left-hander"


def named(strokes: pa.Table, people: tuple[str, str]) -> pa.Table:
    """The strokes with other names of the players of the first match."""
    first = {strokes[name][0].as_py(): person for name, person in zip(("player", "opponent"), people, strict=True)}
    for name in ("player", "opponent"):
        strokes = with_column(strokes, name, [first.get(player, player) for player in strokes[name].to_pylist()])
    return strokes


def test_real_rallies_of_different_hands_are_legal(tables: PolicyTables, strokes: pa.Table) -> None:
    people = ("kento-momota", "viktor-axelsen")
    shown = RealRallies(SAMPLE, tables.game, named(strokes, people))
    pair = game_of_people(tables.game, people)
    assert pair is not None
    assert set(shown.people(0).names) == set(people)
    for number in range(20):
        legal_states(shown.rally(number), pair)  # raises if a stroke is not legal


@pytest.mark.parametrize(
    ("people", "known"),
    [
        (("viktor-axelsen", "kento-momota"), True),
        (("viktor-axelsen", "somebody"), False),
        (("viktor-axelsen", "an-se-young"), False),
    ],
)
def test_real_rallies_have_the_values_of_the_two_people(
    people: tuple[str, str], known: bool, small: PolicyTables, strokes: pa.Table
) -> None:
    """Where the model has the skill of both, in one discipline; else those of imitated elite players."""
    recorded = RealRallies(SAMPLE, small.game, named(strokes, people))
    answers, names = Answers(small, PLAN, recorded=recorded), recorded.people(0).names
    found = replied(answers, messages.AnalysisRequest(id=0, rally=0), messages.Analysis)
    facts = answers.rally(messages.RallyRequest(id=0, rally=0))[0].rally
    assert set(names) == set(people)
    assert facts.names == names
    assert facts.skill == ("" if known else None)
    game = pair_game(*names, game=reduced_model()) if known else small.game
    policies = [f"bc:{name}" if known else "bc" for name in names]
    first, second = (tabulate(resolve(name, seat), seat) for name, seat in zip(policies, game.seats, strict=True))
    odds = evaluate(first, second).odds()
    assert found.strokes[0].win == pytest.approx(odds.serving if facts.server == 0 else odds.receiving, abs=1e-6)


def test_whole_rallies_have_the_score_before_them(annotated: RealRallies) -> None:
    rallies = [annotated.rally(number) for number in range(annotated.count)]
    assert [(len(rally), rally.server, rally.points, rally.games, rally.score.finished) for rally in rallies] == [
        (2, 0, (0, 0), (0, 0), ()),
        (1, 1, (0, 1), (0, 0), ()),
        (1, 0, (2, 1), (0, 0), ()),  # of the rally before, because its own is unknown
        (1, 0, (0, 0), (1, 0), ((5, 1),)),
        (3, 1, (0, 0), (1, 1), ((5, 1), (0, 1))),
        (1, 0, (0, 0), (0, 0), ()),
    ]
    assert [rally.names for rally in rallies] == [("ada-lee", "bea")] * 5 + [("cem", "ada-lee")]


def test_annotated_rallies_are_found_by_number_and_match(annotated: RealRallies) -> None:
    assert annotated.numbers(EVENT) == {(1, 1): 0, (1, 2): 1, (1, 4): 2, (2, 1): 3, (3, 1): 4}
    assert [annotated.match(number) for number in (0, 4, 5)] == [EVENT, EVENT, "Club_final"]
    for number in (-1, 6):
        with pytest.raises(WatchError, match=f"no rally {number + 1}: there are 6"):
            annotated.rally(number)
    # Finished games and the last rally have 6 + 1 + 1 points, of which five rallies are there.
    assert [(match.first, match.title, match.missing) for match in annotated.matches] == [
        (0, "KOREA OPEN 2019 Final", 3),
        (5, "Club final", 0),
    ]


@pytest.mark.parametrize(("rally", "partial", "numbers"), [(4, False, [0, 1, 2, 3, 4]), (2, True, [0, 1, 2]), (5, False, [5])])
def test_overviews_are_of_one_match(
    rally: int, partial: bool, numbers: list[int], small: PolicyTables, annotated: RealRallies
) -> None:
    answers = Answers(small, PLAN, recorded=annotated)
    found = answers.match(messages.MatchRequest(id=0, rally=rally, partial=partial))
    assert [row.number for row in found.rallies] == numbers

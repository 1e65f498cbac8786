"""Matches played for the page: the same draws and rules as everywhere, exact values, plans that are checked, and pairs."""

import functools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from shuttle_marl.commands.watch import MatchOptions
from shuttle_marl.court import WatchError, messages
from shuttle_marl.court.answers import Answers, first_key
from shuttle_marl.court.match import Match, MatchLog, PolicyTables
from shuttle_marl.court.messages import RallyRequest
from shuttle_marl.court.plan import LADDER, Person, Plan, Side
from shuttle_marl.court.recorded import LogRallies
from shuttle_marl.court.values import ELITE, StrokeValues
from shuttle_marl.exact import evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.pairs import looks_of, pair_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.reader import check
from shuttle_marl.reports.rating import Rating, rater_of
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.staging.reader import read
from tests.watch.conftest import replied

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
BC = {"policy": "bc"}
PLAN = {"seed": 3, "sides": [BC, {"policy": "attacking", "temperature": 0.5}]}


def match(tables: PolicyTables, **fields: object) -> Match:
    return Match(Plan.parse({**PLAN, **fields}), tables)


def test_rally_waits_for_a_person_and_plays_their_stroke(tables: PolicyTables) -> None:
    game = tables.game
    seat = match(tables).rally(0).server
    person = Person(seat=seat, rally=0, stroke=0)
    asked = match(tables).rally(0, person)
    assert (asked.stroke.tolist(), asked.open, asked.winner, asked.turn) == ([], True, None, ROOT)
    serve = int(game.legal_strokes(ROOT)[-1])
    then = match(tables, chosen={"0": {"0": serve}}).rally(0, person)
    assert then.stroke[0] == serve
    assert then.chosen == (0,)
    if then.open:
        assert len(then.stroke) % 2 == 0
        assert then.turn is not None
    with pytest.raises(WatchError, match="rally 1 is not finished"):
        match(tables).rally(1, person)
    with pytest.raises(WatchError, match="chosen as number 1 is not legal"):
        match(tables, chosen={"0": {"0": game.n_strokes - 1}}).rally(0)


@pytest.fixture(scope="module")
def small() -> PolicyTables:
    return PolicyTables(reduced_game())


def test_persons_of_different_hands_meet_in_the_game_of_different_hands(small: PolicyTables, tmp_path: Path) -> None:
    momota, woman = {"policy": "bc:kento-momota"}, {"policy": "bc:an-se-young"}
    plan = Plan.parse({"seed": 3, "sides": [momota, woman], "changes": [{"rally": 2, "seat": 0, "side": BC}]})
    assert small.between(plan.sides_in(2)) is small
    opposite = small.between(plan.sides_in(0)).game
    assert opposite.hash == load_game(f"{reduced_model()}:opposite").hash != small.game.hash
    answers, log = Answers(small, plan), MatchLog(tmp_path, small)
    rallies = [Match(plan, small).rally(number) for number in range(3)]
    assert [rally.hands for rally in rallies] == [("left", "right"), ("left", "right"), ("right", "right")]
    assert [rally.athletes for rally in rallies] == [("male", "female")] * 2 + [("female", "female")]
    for number, game in ((0, opposite), (2, small.game)):
        rally = rallies[number]
        sides = plan.sides_in(number)
        players = tuple(tabulate(resolve(side.policy, game), game) for side in sides)
        odds = evaluate(players[0], players[1]).odds()
        found = replied(answers, messages.AnalysisRequest(id=0, plan=plan, rally=number), messages.Analysis)
        assert found.strokes[0].win == pytest.approx(odds.serving if rally.server == 0 else odds.receiving, abs=1e-6)
        facts = answers.rally(messages.RallyRequest(id=0, plan=plan, rally=number))[0].rally
        assert [stroke.state for stroke in facts.strokes] == rally.states(game)[: len(rally)].tolist()
    for rally in rallies[:2]:
        log.add(plan, rally)
    log.close()
    path = next(tmp_path.glob("*.mcap"))
    assert check(path, opposite).problems == ()
    shown = LogRallies(RallyLog(path), opposite).rally(1)
    assert (shown.hands, shown.athletes) == (rallies[1].hands, rallies[1].athletes)


def test_a_log_of_a_variant_names_its_game_in_a_new_process() -> None:
    names = ["default:women-opposite", "default:recovery", "default:men-opposite-recovery"]
    hashes = [load_game(name).hash for name in names]
    found = f"[origin_of(shipped_game(played)).name_in('default') for played in {hashes}]"
    script = f"from shuttle_marl.game.shipped import origin_of, shipped_game; print(*{found})"
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert done.stdout.split() == names


def test_the_appearance_that_is_asked_for_overrides_that_of_the_players() -> None:
    policies = PolicyTables(pair())
    players, keys = [], set()
    wanted: list[dict[str, Any]] = [{}, {"athletes": ("female", "female")}, {"hands": ("left", "right")}]
    for looks in wanted:
        reply, packed = Answers(policies, PAIR_PLAN, **looks).rally(FIRST)
        players.append([(player.athlete, player.hand) for player in reply.rally.players])
        assert [(player["athlete"], player["hand"]) for player in read(packed).head["players"]] == players[-1]
        keys.add(first_key(pair(), PAIR_PLAN, **looks))
    assert players[0] == [("male", "right"), ("male", "left")]
    assert players[1] == [("female", "right"), ("female", "left")]
    assert players[2] == [("male", "left"), ("male", "right")]
    assert len(keys) == 3, "the shipped rally is that of other players"


def test_areas_are_named_by_the_forehand_of_the_receiver_and_lie_where_it_is() -> None:
    policies = PolicyTables(pair())
    here, there = (Answers(policies, PAIR_PLAN, hands=(one, "right")) for one in ("right", "left"))
    strokes, mirrored = (answers.rally(FIRST)[0].rally.strokes for answers in (here, there))
    checked = 0
    for stroke, other in zip(strokes, mirrored, strict=True):
        if not pair().catalogue.is_serve[stroke.stroke]:
            assert stroke.area == other.area == AREAS[pair().catalogue.area[stroke.stroke]]
            x0, x1, y0, y1 = stroke.box
            assert other.box == (stroke.box if stroke.seat == 0 else (-x1, -x0, y0, y1))
            checked += stroke.seat and "centre" not in stroke.area
    assert checked


@pytest.mark.parametrize(
    "raw",
    [
        None,
        [],
        {"seed": 1},
        {**PLAN, "seed": -1},
        {**PLAN, "sides": [BC, {"policy": "bc", "temperature": float("nan")}]},
        {**PLAN, "sides": [BC, {"policy": "x" * 300}]},
        {**PLAN, "changes": [{"rally": 1, "seat": 2, "side": BC}]},
        {**PLAN, "chosen": {"x": {}}},
        {**PLAN, "chosen": {"²": {"0": 1}}},
        {**PLAN, "chosen": {"99999999999": {"0": 1}}},
    ],
)
def test_invalid_plans_are_rejected(raw: object) -> None:
    with pytest.raises(WatchError):
        Plan.parse(raw)


def test_pages_cannot_load_code_or_files(tables: PolicyTables) -> None:
    for name in ("os:getcwd", "table:/etc/passwd", "agent:/tmp", "tests.watch:x"):
        plan = Plan.parse({**PLAN, "sides": [BC, {"policy": name}]})
        with pytest.raises(Exception, match="no modules and no files"):
            Match(plan, tables).rally(0)


def test_a_duel_ends_at_its_points_and_is_recorded_by_its_rules(tables: PolicyTables, tmp_path: Path) -> None:
    plan = Plan.parse({**PLAN, "points": 3})
    duel, log = Match(plan, tables), MatchLog(tmp_path, tables)
    log.add(other := Plan.parse(PLAN), Match(other, tables).rally(0))
    number = 0
    while True:
        rally = duel.rally(number)
        log.add(plan, rally)
        number += 1
        assert rally.winner is not None
        if rally.score.after(rally.winner).over:
            break
    log.close()
    assert max(rally.score.after(rally.winner).finished[0]) == 3
    assert number <= 5
    with pytest.raises(WatchError, match="the match was over"):
        duel.rally(number)
    headers = [RallyLog(path).header for path in tmp_path.glob("*.mcap")]
    assert sorted(header.rules.points for header in headers) == [3, 21], "one log for each plan"
    with pytest.raises(WatchError, match="plan"):
        Plan.parse({**PLAN, "points": 0})


SIDES = (Side(policy="bc"), Side(policy="attacking"))


@pytest.fixture(scope="module")
def values(tables: PolicyTables) -> StrokeValues:
    return StrokeValues(tables)


def test_an_analysis_follows_the_rally(values: StrokeValues) -> None:
    game = default_game()
    plan = Plan(seed=9, sides=SIDES)
    match = Match(plan, PolicyTables(game))
    value = evaluate(*(tabulate(resolve(side.policy, game), game) for side in SIDES))
    asked = 0
    for number in range(5):
        rally = match.rally(number)
        found = values.analysis(rally, values.players(SIDES))
        assert len(found.strokes) == len(rally.stroke)
        assert found.win_after == float(rally.winner == 0)
        for i, entry in enumerate(found.strokes):
            names = [option.stroke for option in entry.options]
            assert {rally.stroke[i], entry.better} <= set(names)
            assert len(names) == len(set(names))
            assert entry.loss >= 0
            state, seat = int(rally.states(game)[i]), int(rally.striker[i])
            pair = game.pair(np.array([state]), rally.stroke[i : i + 1])
            striker = (1 + value.striking[seat][state]) / 2, (1 + game.stroke_values(value.striking[1 - seat], pair)[0]) / 2
            seat_0 = striker if seat == 0 else (1 - striker[0], 1 - striker[1])
            assert (entry.win, entry.chosen) == pytest.approx(seat_0, abs=1e-4)
            assert 0 <= entry.match <= 1
            judged, rank = rater_of(game).rated(np.array([state])), int(game.rank(state, int(rally.stroke[i])))
            question = judged.question(rank)
            assert (entry.mark, entry.question is None) == (judged.marks[rank], question is None)
            if question is not None:
                answers = [game.legal_strokes(state)[k] for k in (question[0], *question[1])]
                assert [entry.question.right, *entry.question.wrong] == answers
                asked += 1
    assert asked >= 5


A, B = "viktor-axelsen", "kento-momota"


@functools.cache
def pair() -> Game:
    return pair_game(A, B, game=reduced_model())


PAIR_PLAN = Plan.parse({"seed": 3, "sides": [{"policy": f"bc:{A}"}, {"policy": "minimax"}]})


FIRST = messages.RallyRequest(id=0, plan=PAIR_PLAN, rally=0)


@pytest.fixture(scope="module")
def policies() -> PolicyTables:
    return PolicyTables(pair())


@pytest.fixture(scope="module")
def answers(policies: PolicyTables) -> Answers:
    return Answers(policies, PAIR_PLAN)


def test_the_page_shows_the_players_and_their_game(answers: Answers) -> None:
    reply, _ = answers.rally(messages.RallyRequest(id=0, plan=PAIR_PLAN, rally=0))
    assert (reply.rally.names, reply.rally.skill) == ((A, f"{B} (minimax)"), "")
    for stroke in reply.rally.strokes:
        game = pair().seats[stroke.seat]
        good, returned, _ = game.stroke_probabilities(game.pair(stroke.state, stroke.stroke))
        assert (stroke.p_succ, stroke.p_ret) == pytest.approx((float(good), float(returned)), abs=1e-6)


def test_replies_are_those_that_somebody_looked_at(answers: Answers, policies: PolicyTables) -> None:
    plan = msgspec.structs.replace(PAIR_PLAN, points=3)
    about: dict[str, Any] = {"id": 0, "plan": plan}
    requests: dict[str, messages.Request] = {
        "match": messages.MatchRequest(rally=0, **about),
        "analysis": messages.AnalysisRequest(rally=1, **about),
        "options": messages.OptionsRequest(rally=0, person=Person(seat=0, rally=0, stroke=0), **about),
        "styles": messages.StylesRequest(rally=0, **about),
        "rally": messages.RallyRequest(rally=1, **about),
        "hello": messages.HelloRequest(id=0),
    }
    golden.check("replies", {name: headed(answers(request)) for name, request in requests.items()}, 1e-3)


def test_the_overview_of_a_match_is_one_that_somebody_looked_at(tables: PolicyTables) -> None:
    plan = Plan.parse({**PLAN, "points": 3, "seed": 26})
    answers = Answers(tables, plan)
    whole, part = (messages.MatchRequest(id=0, plan=plan, rally=3, partial=partial) for partial in (False, True))
    requests = {"whole match": whole, "four rallies": part, "marked": messages.AnalysisRequest(id=0, plan=plan, rally=3)}
    golden.check("replies", {name: headed(answers(request)) for name, request in requests.items()}, 1e-3)


def headed(reply: bytes) -> Any:
    """The JSON of a reply."""
    return json.JSONDecoder().raw_decode(reply[reply.index(b"{") :].decode(errors="replace"))[0]


def test_opponents_of_the_ladder_are_ever_stronger(tables: PolicyTables) -> None:
    ladder = Answers(tables, Plan.parse(PLAN)).hello().ladder
    assert ladder == list(LADDER)
    strength = [tables.values((Side(policy=name), ELITE)).odds().rally for name in ladder]
    assert (np.diff(strength) > 0).all(), strength
    assert "left" in looks_of(tables.game, (ladder[1], "bc")).hands, "a left-hander is among them"


def test_decisions_are_rated_by_their_quality(tables: PolicyTables) -> None:
    answers, plan = Answers(tables, Plan.parse(PLAN)), Plan.parse(PLAN)
    values = replied(answers, messages.AnalysisRequest(id=0, plan=plan, rally=0), messages.Analysis).strokes
    assert all((value.quality is None) == (value.change is None) for value in values)
    scores = tuple(value.quality for value in values if value.quality is not None)
    assert scores
    assert all(0 < score <= 1 for score in scores)
    request = messages.RatingRequest(id=0, points=1500, deviation=350, volatility=0.06, scores=scores)
    found = replied(answers, request, messages.RatingReply)
    expected = Rating().after(scores)
    assert (found.points, found.deviation, found.interval) == (expected.points, expected.deviation, expected.interval)


@pytest.mark.parametrize(
    ("person", "logged"),
    [
        (None, False),
        (Person(seat=0, rally=0, stroke=0), True),
        (Person(seat=0, rally=0, stroke=0, practice=True), False),
        (Person(seat=0, rally=0, stroke=0, friend=True), True),
        (Person(seat=1, rally=0, stroke=0, friend=True), False),
    ],
)
def test_rallies_of_a_person_are_recorded_once(
    person: Person | None, logged: bool, policies: PolicyTables, tmp_path: Path
) -> None:
    """Practice is not; a game of two persons is, by who opened it."""
    rally = Match(PAIR_PLAN, policies).rally(0)
    plan = msgspec.structs.replace(PAIR_PLAN, chosen={0: dict(enumerate(rally.stroke.tolist()))})
    log = MatchLog(tmp_path, policies)
    answers = Answers(policies, plan, log=log)
    for _ in range(2):
        assert answers.rally(RallyRequest(id=0, plan=plan, rally=0, person=person))[0].rally.winner == rally.winner
    log.close()
    assert [RallyLog(path).n_rallies for path in tmp_path.glob("*.mcap")] == [1] * logged


def test_matches_are_recorded_in_turn(policies: PolicyTables, tmp_path: Path) -> None:
    """More matches than logs are open: one that comes back has a second log, and no rally is recorded twice."""
    log = MatchLog(tmp_path, policies)
    plans = [msgspec.structs.replace(PAIR_PLAN, seed=seed) for seed in range(9)]
    for plan, number in [*((plan, 0) for plan in plans), (plans[0], 0), (plans[0], 1), (plans[8], 1)]:
        log.add(plan, Match(plan, policies).rally(number))
    log.close()
    logs = [RallyLog(path) for path in tmp_path.glob("*.mcap")]
    assert sorted(found.n_rallies for found in logs) == [1] * 9 + [2]


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        (messages.TagRequest(id=0, at=0, input=None, first=0, rows=()), "tags no video"),
        (messages.OptionsRequest(id=0, plan=PAIR_PLAN, rally=0), "the rally is over"),
        (messages.StylesRequest(id=0, rally=0), "for policies only"),
        (messages.RallyRequest(id=0, rally=0), "shows no recorded rallies"),
    ],
)
def test_what_a_request_lacks_is_said(request_: messages.Request, says: str, answers: Answers) -> None:
    with pytest.raises(WatchError, match=says):
        answers(request_)


@pytest.mark.parametrize("model", ["default", "default:women", "default:recovery"])
def test_the_default_match_is_one_of_real_players(model: str) -> None:
    first, second = (side.policy for side in MatchOptions().plan(load_game(model)).sides)
    expected = ("bc:an-se-young", "bc:chen-yufei") if model.endswith("women") else ("bc:viktor-axelsen", "bc:kento-momota")
    assert (first, second) == expected
    assert MatchOptions(b="minimax").policies(load_game(model)) == (expected[0], "minimax")

"""The live court and recorded rallies in the game of a pair."""

import dataclasses
import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from shuttle_marl.analysis.rally import LogPlayers, analyse_rally
from shuttle_marl.commands.options import RallyGameOptions
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import Derived, RallyLog
from shuttle_marl.recording.replay import check
from shuttle_marl.scene.rally_report import report_rally
from shuttle_marl.watch import messages
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.match_log import MatchLog
from shuttle_marl.watch.plan import Plan
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.recorded import People, Recorded
from shuttle_marl.watch.stager import Stager
from tests.reduced import reduced_game, reduced_model

A, B = "viktor-axelsen", "kento-momota"
PAIR = pair_game(A, B, game=reduced_model())
PLAN = Plan.parse({"seed": 3, "sides": [{"policy": f"bc:{A}"}, {"policy": "minimax"}]})


FIRST = messages.RallyRequest(id=0, plan=PLAN, rally=0)
ROOT = Path(__file__).parents[2]
STAGER = Stager(("male", "male"), ("right", "right"))


@pytest.fixture(scope="module")
def policies() -> PolicyTables:
    return PolicyTables(PAIR)


@pytest.fixture(scope="module")
def answers(policies: PolicyTables) -> Answers:
    return Answers(policies, PLAN, STAGER)


def test_the_page_shows_the_players_and_their_game(answers: Answers) -> None:
    hello = answers.hello()
    assert hello.game == PAIR.hash[:12]
    reply, _ = answers._reply(messages.RallyRequest(id=0, plan=PLAN, rally=0))
    assert isinstance(reply, messages.RallyReply)
    assert (reply.rally.names, reply.rally.skill) == ((A, f"{B} (minimax)"), "")
    for stroke in reply.rally.strokes:
        game = PAIR.seats[stroke.seat]
        good, returned, _ = game.stroke_probabilities(game.pair(stroke.state, stroke.stroke))
        assert (stroke.p_succ, stroke.p_ret) == pytest.approx((float(good), float(returned)), abs=1e-6)


def test_values_are_those_of_the_game_of_the_pair(answers: Answers) -> None:
    reply, _ = answers._reply(messages.AnalysisRequest(id=0, plan=PLAN, rally=0))
    assert isinstance(reply, messages.Analysis)
    names = (f"bc:{A}", "minimax")
    first, second = (tabulate(resolve(name, game), game) for name, game in zip(names, PAIR.seats, strict=True))
    odds = evaluate(first, second).odds()
    rally = answers._played(messages.RallyRequest(id=0, plan=PLAN, rally=0))
    expected = odds.serving if rally.server == 0 else odds.receiving
    assert reply.strokes[0].win == pytest.approx(expected, abs=1e-6)


def test_a_log_of_a_pair(tmp_path: Path, policies: PolicyTables, answers: Answers) -> None:
    log = MatchLog(tmp_path, PAIR, policies)
    rally = answers._played(messages.RallyRequest(id=0, plan=PLAN, rally=0))
    log.add(PLAN, rally)
    log.close()
    path = next(tmp_path.glob("*.mcap"))
    game = RallyGameOptions(game=reduced_model()).load_for(path)
    assert game.people is not None
    assert game.hash == PAIR.hash
    assert check(path, game).problems == ()
    with RallyLog(path) as opened:
        known = LogPlayers(opened, game)
        players = known.of_rally(0)
        assert known.unknown == {}
        assert [table.game.hash for table in players.tables if table] == [seat.hash for seat in PAIR.seats]
        found = analyse_rally(opened.rally(0).row(0, opened.catalogue), game, players)
        derived = opened.stroke_table(Derived(opened, game)).to_pydict()
        assert report_rally(opened, 0, game, known).names == (A, f"{B} (minimax)")
    p_succ = found.of_strokes("p_succ")
    assert np.abs(np.array(derived["p_succ"]) - p_succ).max() < 1e-6
    # The receiver strikes with other tables than the server.
    second = found.decisions[1]
    assert second.p_succ.tolist() != PAIR.seats[1 - second.seat].stroke_probabilities(second.pair)[0].tolist()


@pytest.mark.parametrize(
    ("people", "known"), [((A, B), True), ((B, A), True), ((A, "somebody"), False), ((A, "an-se-young"), False)]
)
def test_real_rallies_have_the_values_of_the_two_people(people: tuple[str, str], known: bool) -> None:
    """Where the model has the skill of both, in one discipline; else those of imitated elite players."""
    rally = dataclasses.replace(Answers(PolicyTables(PAIR), PLAN, STAGER)._played(FIRST), names=people)
    played = People(people, datetime.date(2020, 5, 1))
    recorded = SimpleNamespace(rally=lambda _: rally, people=lambda _: played, players=lambda _: None, count=1, title="real")
    answers = Answers(PolicyTables(reduced_game()), PLAN, STAGER, recorded=cast(Recorded, recorded))
    asked = messages.AnalysisRequest(id=0, rally=0)
    found, facts = answers._reply(asked)[0], answers._reply(messages.RallyRequest(id=0, rally=0))[0]
    assert isinstance(found, messages.Analysis)
    assert isinstance(facts, messages.RallyReply)
    game = pair_game(*people, date="2020-05-01", game=reduced_model()) if known else reduced_game()
    assert facts.rally.skill == ("2020-05-01" if known else None)
    assert facts.rally.names == people
    names = [f"bc:{name}" if known else "bc" for name in people]
    first, second = (tabulate(resolve(name, tables), tables) for name, tables in zip(names, game.seats, strict=True))
    odds = evaluate(first, second).odds()
    assert found.strokes[0].win == pytest.approx(odds.serving if rally.server == 0 else odds.receiving, abs=1e-6)

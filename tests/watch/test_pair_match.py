"""The live court and recorded rallies in the game of a pair."""

from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.analysis.rally import LogPlayers, analyse_rally
from shuttle_marl.commands.options import RallyGameOptions
from shuttle_marl.commands.watch import AdviceOptions, MatchOptions, RallyOptions, _game
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import PairGame, pair_game
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import Derived, RallyLog
from shuttle_marl.recording.replay import check
from shuttle_marl.watch import WatchError, messages
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.match_log import MatchLog
from shuttle_marl.watch.plan import Plan
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.stager import Stager
from tests.reduced import reduced_model

A, B = "viktor-axelsen", "kento-momota"
PAIR = pair_game(A, B, game=reduced_model())
PLAN = Plan.parse({"seed": 3, "sides": [{"policy": f"bc:{A}"}, {"policy": "minimax"}]})


@pytest.fixture(scope="module")
def policies() -> PolicyTables:
    return PolicyTables(PAIR)


@pytest.fixture(scope="module")
def answers(policies: PolicyTables) -> Answers:
    return Answers(policies, PLAN, Stager(("male", "male"), ("right", "right")))


def test_the_page_shows_the_players_and_their_game(answers: Answers) -> None:
    hello = answers._hello()
    assert (hello.pair, hello.game) == (f"{A} against {B}", PAIR.hash[:12])
    reply, _ = answers._reply(messages.RallyRequest(id=0, plan=PLAN, rally=0))
    assert isinstance(reply, messages.RallyReply)
    assert reply.rally.names == (A, f"{B} (minimax)")
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
    assert isinstance(game, PairGame)
    assert game.hash == PAIR.hash
    assert check(path, game).problems == ()
    with RallyLog(path) as opened:
        known = LogPlayers(opened, game)
        players = known.of_rally(0)
        assert known.unknown == {}
        assert [table.game.hash for table in players.tables if table] == [seat.hash for seat in PAIR.seats]
        found = analyse_rally(opened.rally(0).row(0, opened.catalogue), game, players)
        derived = opened.stroke_table(Derived(opened, game)).to_pydict()
    p_succ = found.of_strokes("p_succ")
    assert np.abs(np.array(derived["p_succ"]) - p_succ).max() < 1e-6
    # The receiver strikes with other tables than the server.
    second = found.decisions[1]
    assert second.p_succ.tolist() != PAIR.seats[1 - second.seat].stroke_probabilities(second.pair)[0].tolist()


def test_options_of_the_command() -> None:
    advice = AdviceOptions(game=reduced_model())
    match = MatchOptions(players=(A, B), date="2020-02-02")
    assert match.policies == (f"bc:{A}", f"bc:{B}")
    assert MatchOptions(players=(A, B), a="minimax").policies == ("minimax", f"bc:{B}")
    assert MatchOptions().policies == ("ppo", "bc")
    game = _game(match, RallyOptions(), advice)
    assert isinstance(game, PairGame)
    assert (game.players, str(game.date)) == ((A, B), "2020-02-02")
    with pytest.raises(WatchError, match="leave out --players"):
        _game(match, RallyOptions(replay=Path("x.mcap")), advice)

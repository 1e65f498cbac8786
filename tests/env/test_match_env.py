"""``match_v0``: rallies put together to a match."""

import numpy as np
import pytest

from shuttle_marl import match_v0
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import draw, first_server, outcome_draw, stream
from shuttle_marl.game.observation import RALLY_WIDTH
from shuttle_marl.game.rules import OUTCOMES, strike
from shuttle_marl.game.scoring import Rules, Score
from shuttle_marl.game.tables import ROOT
from tests.exact.exact_games import tiring_game

AGENTS = ("player_0", "player_1")
SHORT = Rules(points=3, clear=2, cap=5, games=2)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("reward", "game"), [("match", default_game()), ("rally", default_game()), ("rally", tiring_game())])
def test_a_match_equals_batched_rallies_and_scoring_on_the_same_draws(play, seed, reward, game):
    env = match_v0.env(rules=SHORT, reward=reward, game=game)
    for episode in range(3):
        striker = int(first_server(draw(stream(seed, episode, 0), 0))[0])
        score = Score(server=striker, rules=SHORT)
        state = ROOT
        rally = count = 0
        owed = [0.0, 0.0]
        for agent, seen, paid, terminated, truncated, info, action in play(env, seed if episode == 0 else None, policy_seed=seed):
            assert not truncated
            player = AGENTS.index(agent)
            assert paid == owed[player]
            owed[player] = 0.0
            points, games, server = score.by_game[-1], score.games, score.server
            own_first = slice(None, None, 1 if player == 0 else -1)
            serving = [server == player, server != player]
            expected = np.r_[np.array(points[own_first]) / 5, np.array(games[own_first]) / 2, serving]
            assert seen["observation"][RALLY_WIDTH:] == pytest.approx(expected)
            assert env.observation_space(agent).contains(seen)
            if info:
                assert info["points"] == points
                assert info["games"] == games
                assert info["server"] == AGENTS[server]
            assert terminated == score.over
            if terminated:
                continue
            assert player == striker
            assert seen["observation"][57] == game.effort(state) / max(1, game.levels - 1)
            assert (seen["action_mask"] == game.mask(np.array(state))).all()
            k = game.pair(np.array([state]), np.array([action])) - game.pair_start[state]
            u = outcome_draw(draw(stream(seed, episode, rally), count))
            outcome, following = strike(game, np.array([state]), k, u)
            striker, count = 1 - striker, count + 1
            state = int(following[0])
            if state < 0:
                winner = striker if OUTCOMES[outcome[0]] == "fault" else 1 - striker
                score = score.after(winner)
                if reward == "rally" or score.over:
                    owed[winner] += 1
                    owed[1 - winner] -= 1
                state, count, rally, striker = ROOT, 0, rally + 1, winner
        assert score.over
        assert owed == [0, 0]


def test_the_first_server_can_be_chosen():
    for server in (0, 1):
        env = match_v0.env(first_server=server)
        for seed in range(6):
            env.reset(seed=seed)
            assert env.agent_selection == AGENTS[server]
            assert env.last()[0]["observation"][-2:].tolist() == [1, 0]


@pytest.mark.parametrize("reward", ["match", "rally"])
def test_an_illegal_stroke_loses_the_match(reward):
    env = match_v0.env(reward=reward)
    env.reset(seed=0)
    loser = env.agent_selection
    env.step(env.unwrapped.game.n_strokes - 1)
    winner = AGENTS[1 - AGENTS.index(loser)]
    assert env.rewards == {loser: -1, winner: 1}
    assert env.infos[loser]["reason"] == "illegal stroke"
    assert all(env.terminations.values())
    assert env.unwrapped.snapshot().match_winner == AGENTS.index(winner)


def test_matches_can_be_cut_off(play):
    rows = list(play(match_v0.env(max_strokes=100), 0))
    assert sum(r[-1] is not None for r in rows) == 100
    assert [r[4] for r in rows[-2:]] == [True, True]
    assert not any(r[3] for r in rows)

"""``match_v0``, and the positions and the text of its snapshots."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.snapshot import in_words, plan_of
from shuttle_marl.game import default_game
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, area_of, mirrored
from shuttle_marl.game.draws import draw, first_server, outcome_draw, stream
from shuttle_marl.game.observation import RALLY_WIDTH
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.rules import OUTCOMES, strike
from shuttle_marl.game.scoring import Rules, Score
from shuttle_marl.game.skill import Skill
from shuttle_marl.game.tables import ROOT
from tests.exact.exact_games import tiring_game
from tests.reduced import reduced_model


def moments(play, env, seed):
    """Snapshots after every stroke of an episode."""
    for *_, action in play(env, seed, policy_seed=seed):
        if action is not None:
            yield env.unwrapped.snapshot()
    yield env.unwrapped.snapshot()


def test_strokes_land_where_they_are_aimed_and_the_next_contact_is_there(play):
    areas = set()
    for seed in range(30):
        for snapshot in moments(play, rally_v0.env(), seed):
            scene = plan_of(snapshot)
            assert len(scene.flights) == len(snapshot.strokes)
            assert all(abs(x) <= HALF_LENGTH + 1 and abs(y) <= HALF_WIDTH + 1 for x, y in scene.bodies)
            assert scene.bodies[0][0] < 0 < scene.bodies[1][0]
            contacts = [*(flight.start for flight in scene.flights), scene.shuttle]
            for flight, following in zip(scene.flights, contacts[1:], strict=True):
                assert flight.end == following
                stroke = flight.stroke
                if OUTCOMES[stroke.outcome] != "fault":
                    sign = 1 if stroke.player == 0 else -1
                    area = snapshot.game.catalogue.area[stroke.stroke]
                    assert area_of(np.array(flight.end[1] * sign), np.array(flight.end[0] * sign)) == area
                    areas.add(int(area))
    assert len(areas) == 9


def test_a_left_hander_is_drawn_in_the_mirror(play, monkeypatch):
    game = pair_game("viktor-axelsen", "kento-momota", game=reduced_model())
    monkeypatch.setattr(Skill, "hand_of", lambda _, player: "left" if player == "kento-momota" else None)
    areas = set()
    for seed in range(10):
        for snapshot in moments(play, rally_v0.env(game=game), seed):
            assert snapshot.hands == ("right", "left")
            turned = plan_of(dataclasses.replace(snapshot, hands=("right", "right")))
            for flight, right in zip(plan_of(snapshot).flights, turned.flights, strict=True):
                stroke = flight.stroke
                if stroke.outcome != OUTCOMES.index("fault"):
                    sign = 1 if stroke.player == 0 else -1
                    area = int(game.catalogue.area[stroke.stroke])
                    where = area_of(np.array(flight.end[1] * sign), np.array(flight.end[0] * sign))
                    assert where == (mirrored(area) if stroke.player == 0 else area)
                    assert (flight.end == right.end) == (stroke.player == 1 or area % 3 == 1)
                    areas.add(area)
    assert len(areas) > 4


def test_text_tells_the_whole_rally(play):
    for seed in range(20):
        env = rally_v0.env(render_mode="ansi")
        rows = list(play(env, seed))
        text = env.render()
        lines = text.splitlines()
        strokes = [(agent, action) for agent, *_, action in rows if action is not None]
        assert len(lines) == len(strokes) + 3
        assert lines[1].startswith("effort: ")
        assert f"seed {seed}, {strokes[0][0]} serves" in lines[0]
        catalogue = env.unwrapped.game.catalogue
        for number, (line, (agent, action)) in enumerate(zip(lines[2:-1], strokes, strict=True), start=1):
            assert line.split()[:2] == [str(number), agent]
            assert in_words(catalogue, action) in line
        info = rows[-1][5]
        assert lines[-2].endswith(info["reason"])
        winner = next(agent for agent, _, reward, *_ in rows[-2:] if reward == 1)
        assert lines[-1] == f"{winner} wins the rally ({info['reason']})"


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

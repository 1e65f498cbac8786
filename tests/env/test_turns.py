"""Rallies and matches whose outcomes are certain, one turn at a time: a serve is returned from above, and a smash wins."""

import dataclasses
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError, OptionError
from shuttle_marl.env.aec import PlayedRally, ShuttleEnv, refuse_options
from shuttle_marl.game import draws
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.rally.stepper import Stroke
from shuttle_marl.game.rules import RETURNED_ABOVE, WINNER, IllegalStrokeError
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.tables import ROOT
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import hand_made, tiring_game
from tests.lost_serves import SCORES
from tests.recovery import Prefers, with_recovery

SERVE, SMASH, LIFT = range(3)
CERTAIN = np.array([[0, 0, 0], [0, ONE - 1, ONE - 1], [ONE - 1] * 3], np.uint16)
"""Of a serve that is always returned from above, a smash that always wins, and a lift that always fails."""
MADE = hand_made()
GAME = dataclasses.replace(MADE, threshold=CERTAIN[MADE.pair_stroke], hurry=np.zeros_like(MADE.hurry))
NAMES = GAME.catalogue.names
HIDDEN = with_recovery(tiring_game(), 3, 3)


class Recorder:
    def __init__(self) -> None:
        self.rallies: list[PlayedRally] = []
        self.closed = 0

    def add(self, rally: PlayedRally) -> None:
        self.rallies.append(rally)

    def close(self) -> None:
        self.closed += 1


def rally(**options: Any) -> ShuttleEnv:
    env = rally_v0.raw_env(**{"game": GAME, "server": 0, **options})
    env.reset(seed=5)
    return env


def match(reward: str = "match", **options: Any) -> ShuttleEnv:
    rules = Rules(points=2, clear=1, cap=2, games=2)
    given: dict[str, Any] = {"game": GAME, "first_server": 0, "rules": rules, "reward": reward, **options}
    env = match_v0.raw_env(**given)
    env.reset(seed=5)
    return env


def by_agent(first: Any, second: Any) -> dict[str, Any]:
    return {"player_0": first, "player_1": second}


def test_a_rally_turn_by_turn() -> None:
    env = rally()
    recorder = env.recorder = Recorder()
    assert (env.agents, env.agent_selection, env.state_number, env.strokes) == (["player_0", "player_1"], "player_0", ROOT, [])
    assert env.choice_draw() == draws.choice_draw(draws.draw(draws.stream(5, 0), 0))[0]
    assert env.observe("player_0")["action_mask"].tolist() == [1, 0, 0]
    assert env.observe("player_1")["action_mask"].tolist() == [0, 0, 0]
    assert env.state().tolist() == [*env.observe("player_0")["observation"], 1.0]
    env.step(SERVE)
    facts = {"striker": "player_0", "stroke": NAMES[SERVE], "hurried": False, "p_succ": 1.0, "p_ret": 1.0}
    assert env.infos["player_1"] == {**facts, "outcome": "returned from above", "reason": None}
    assert (env.agent_selection, env.strokes, env.rewards) == ("player_1", [SERVE], by_agent(0, 0))
    assert env.choice_draw() == draws.choice_draw(draws.draw(draws.stream(5, 0), 1))[0]
    assert env.observe("player_1")["action_mask"].tolist() == [0, 1, 0]
    assert env.state()[-1] == 0
    assert not env.terminations["player_0"]
    assert not recorder.rallies
    env.step(SMASH)
    assert env.rewards == env._cumulative_rewards == by_agent(-1, 1)
    assert (env.terminations, env.truncations) == (by_agent(True, True), by_agent(False, False))
    assert (env.infos["player_0"]["reason"], env.infos["player_0"]["striker"]) == ("winner", "player_1")
    assert env.observe("player_0")["action_mask"].tolist() == [0, 0, 0]
    strokes = (Stroke(0, SERVE, RETURNED_ABOVE, 1.0, 1.0), Stroke(1, SMASH, WINNER, 1.0, 1 / ONE))
    assert recorder.rallies == [PlayedRally(5, 0, 0, None, strokes, (None, None))]
    env.close()
    assert recorder.closed == 1
    env.reset()
    assert (env.episode, env.last_seed, env.rewards, env.infos) == (1, 5, by_agent(0, 0), by_agent({}, {}))
    assert env.choice_draw() == draws.choice_draw(draws.draw(draws.stream(5, 1), 0))[0]


def test_snapshots_of_a_rally() -> None:
    env = rally()
    before = env.snapshot()
    assert (before.title, before.names, before.server, before.striker) == ("rally 1 of seed 5", ("player_0", "player_1"), 0, 0)
    assert (before.strokes, before.winner, before.reason, before.by_game, before.hands) == (
        (),
        None,
        None,
        (),
        ("right", "right"),
    )
    env.step(SERVE)
    during = env.snapshot()
    assert (during.server, during.striker, during.winner, len(during.strokes)) == (0, 1, None, 1)
    env.step(SMASH)
    after = env.snapshot()
    assert (after.server, after.striker, after.winner, after.reason, len(after.strokes)) == (0, None, 1, "winner", 2)


def test_a_fault_is_won_by_the_receiver() -> None:
    env = rally(game=dataclasses.replace(GAME, threshold=np.full_like(GAME.threshold, ONE - 1)), server=1)
    env.step(SERVE)
    assert env.rewards == by_agent(1, -1)
    assert (env.snapshot().winner, env.infos["player_0"]["reason"]) == (0, "fault")


def test_rallies_are_cut_off_after_so_many_strokes() -> None:
    env = rally(max_strokes=1)
    env.step(SERVE)
    assert (env.terminations, env.truncations) == (by_agent(False, False), by_agent(True, True))
    assert (env.infos["player_0"]["reason"], env.snapshot().winner) == ("too many strokes", None)
    ended = rally(max_strokes=2)
    ended.step(SERVE)
    ended.step(SMASH)
    assert (ended.terminations["player_0"], ended.truncations["player_0"]) == (True, False)
    for wrong in (0, 1.5, "3"):
        with pytest.raises(OptionError, match=f"max_strokes {wrong!r}: expected a whole number, 1 or more"):
            rally(max_strokes=wrong)


@pytest.mark.parametrize("strokes", [0, 1])
def test_who_forfeits_loses(strokes: int) -> None:
    env = rally()
    for _ in range(strokes):
        env.step(SERVE)
    env.forfeit(LIFT if strokes else None)
    rewards = (1, -1) if strokes else (-1, 1)
    assert env.rewards == env._cumulative_rewards == by_agent(*rewards)
    assert env.terminations == by_agent(True, True)
    assert env.infos["player_1"] == {
        "striker": f"player_{strokes}", "stroke": NAMES[LIFT] if strokes else None, "hurried": False,
        "p_succ": None, "p_ret": None, "outcome": None, "reason": "illegal stroke",
    }  # fmt: skip
    assert (env.snapshot().winner, env.snapshot().striker) == (1 - strokes, None)


def test_what_needs_an_episode() -> None:
    env = rally_v0.raw_env(game=GAME)
    for act in (lambda: env.step(0), env.forfeit, env.fork):
        with pytest.raises(ResetNeeded, match=r"no episode has started; call reset\(\) first"):
            act()
    assert not env.observe("player_0")["action_mask"].any()


def test_options_of_reset_are_refused_but_that_of_pettingzoo() -> None:
    env = rally()
    env.reset(options={"options": 1})
    env.reset(options={})
    with pytest.raises(OptionError, match="options 'server': reset has no options; `server` and others are of the constructor"):
        env.reset(options={"server": 1})
    refuse_options({"mask": 1}, ("mask", "seed"))
    with pytest.raises(OptionError, match="options 'a', 'b': reset has the options mask"):
        refuse_options({"a": 1, "mask": 2, "b": 3}, ("mask",))
    with pytest.raises(OptionError, match="render_mode 'svg': expected one of human, rgb_array, ansi, or None"):
        rally(render_mode="svg")
    with pytest.raises(OptionError, match="outcomes 'dice': expected one of tables, models"):
        rally(outcomes="dice")
    for wrong in (2, -1, "0"):
        with pytest.raises(OptionError, match=f"server {wrong!r}: expected 0, 1, or None"):
            rally(server=wrong)
        with pytest.raises(OptionError, match=f"first_server {wrong!r}: expected 0, 1, or None"):
            match(first_server=wrong)
    with pytest.raises(OptionError, match="reward 'points': expected 'match' or 'rally'"):
        match("points")


def test_rendering_without_a_mode_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    env = rally()
    monkeypatch.setattr(gymnasium.logger, "min_level", gymnasium.logger.WARN)
    with pytest.warns(UserWarning, match=r"render\(\) does nothing"):
        assert env.render() is None
    text = rally(render_mode="ansi").render()
    assert isinstance(text, str)
    assert text.startswith("rally 1 of seed 5, player_0 serves\n")


def test_forks_have_luck_of_their_own() -> None:
    env = rally(render_mode="ansi")
    env.recorder = Recorder()
    env.step(SERVE)
    fork, same, other = env.fork(7), env.fork(7), env.fork(8)
    assert fork.last_seed == same.last_seed == int(draws.stream(7, 5)[0]) != other.last_seed
    assert fork.choice_draw() == draws.choice_draw(draws.draw(draws.stream(int(draws.stream(7, 5)[0]), 0), 1))[0]
    assert (fork.render_mode, fork.recorder, fork.episode, fork.strokes) == ("ansi", None, 0, [SERVE])
    assert fork.action_space("player_0") is env.action_space("player_0")
    assert fork.state_space is env.state_space
    assert env.fork().last_seed != env.fork().last_seed
    fork.step(SMASH)
    assert fork.terminations == by_agent(True, True)
    assert env.terminations == by_agent(False, False)
    assert env.recorder.rallies == []
    for wrong in (-1, 1 << 64, 1.5):
        with pytest.raises(OptionError, match="expected a whole number"):
            env.fork(wrong)  # type: ignore[arg-type]


def waiting() -> ShuttleEnv:
    """The server is to choose a position."""
    env = rally_v0.raw_env(game=HIDDEN, server=0)
    for seed in range(20):
        env.reset(seed=seed)
        env.step(0)
        if env.chooses_position:
            return env
    raise AssertionError


def test_a_receiver_chooses_a_position_and_then_the_striker_strikes() -> None:
    env = waiting()
    n, recorder = HIDDEN.n_strokes, Recorder()
    env.recorder = recorder
    feasible = np.flatnonzero(HIDDEN.waiting.mask(np.array([env.state_number % HIDDEN.n_base_states]))[0])
    assert (env.agent_selection, env.rewards) == ("player_0", by_agent(0, 0))
    mask = env.observe("player_0")["action_mask"]
    assert np.flatnonzero(mask).tolist() == (n + feasible).tolist()
    assert not env.observe("player_1")["action_mask"].any()
    assert [env.observe(agent)["observation"][-1] for agent in env.agents] == [1, 0]
    assert env.state()[-2:].tolist() == [1, 0]
    assert env.choice_draw() == draws.position_draw(draws.draw(draws.stream(env.last_seed or 0, 0), 1))[0]
    env.step(n + int(feasible[1]))
    assert (env.agent_selection, env.chooses_position) == ("player_1", False)
    assert env.state()[-2:].tolist() == [0, 0]
    assert env.infos["player_0"]["stroke"] == HIDDEN.catalogue.names[0]
    assert env.snapshot().positions == ()
    assert env.snapshot().title == "rally 1"
    env.forfeit()
    assert env.rewards == by_agent(1, -1)
    assert env.snapshot().positions == (4,), "who receives a serve waits in the middle"


def test_who_chooses_an_illegal_position_loses() -> None:
    env = waiting()
    env.forfeit(HIDDEN.n_strokes)
    assert env.rewards == by_agent(-1, 1)
    assert (env.infos["player_0"]["reason"], env.infos["player_0"]["striker"]) == ("illegal position", "player_0")
    assert env.infos["player_0"]["stroke"] == "wait:front-forehand"
    assert (env.chooses_position, env.snapshot().winner) == (False, 1)


def test_forks_believe_where_a_receiver_waits() -> None:
    env = waiting()
    feasible = np.flatnonzero(HIDDEN.waiting.mask(np.array([env.state_number % HIDDEN.n_base_states]))[0]).tolist()
    env.step(HIDDEN.n_strokes + feasible[0])
    believed = np.zeros(9)
    believed[feasible[2]] = 1
    sure = Prefers(tuple(float(place == feasible[1]) + 1e-9 for place in range(9)))
    assert {env.fork(seed, believed)._position for seed in range(9)} == {feasible[2]}
    assert {env.fork(seed, sure)._position for seed in range(9)} == {feasible[1]}
    assert {env.fork(seed)._position for seed in range(60)} == set(feasible)
    assert env._position == feasible[0]
    assert env.fork(1)._positions == [None]
    for wrong in (np.ones(9), np.eye(9)[next(place for place in range(9) if place not in feasible)], np.ones(8) / 8):
        with pytest.raises(PolicyError):
            env.fork(1, wrong)


@pytest.mark.parametrize("reward", ["match", "rally"])
def test_a_match_rally_by_rally(reward: str) -> None:
    env = match(reward)
    recorder = env.recorder = Recorder()
    for number, (points, others, games, other_games) in enumerate(SCORES):
        server = number % 2
        assert env.score_of(0) == (points, others, games, other_games)
        assert env.score_of(1) == (others, points, other_games, games)
        assert (env.agent_selection, env.state_number, env.strokes) == (f"player_{server}", ROOT, [])
        key = draws.stream(5, 0, number)
        assert env.choice_draw() == draws.choice_draw(draws.draw(key, 0))[0]
        vector = env.observe("player_0")["observation"]
        shares = [points / 2, others / 2, games / 2, other_games / 2, float(server == 0), float(server == 1)]
        assert vector[-6:].tolist() == shares
        between = env.snapshot()
        assert between.striker == (0 if number == 0 else None)
        assert between.winner == (None if number == 0 else server)
        env.step(SERVE)
        assert (env.snapshot().striker, env.snapshot().winner, len(env.snapshot().strokes)) == (1 - server, None, 1)
        env.step(SMASH)
        last = number == len(SCORES) - 1
        won = 2 * (1 - server) - 1
        assert env.rewards == (by_agent(-won, won) if last or reward == "rally" else by_agent(0, 0))
        assert env.terminations == by_agent(last, last)
        assert env.snapshot().match_winner == (1 if last else None)
    assert env.snapshot().by_game == ((1, 2), (2, 1), (1, 2))
    assert [played.rally for played in recorder.rallies] == list(range(9))
    assert [played.score for played in recorder.rallies] == SCORES
    assert env.snapshot().title == "match 1 of seed 5"


def test_spaces_are_those_of_what_is_seen() -> None:
    for env, width in ((rally(), 60), (match(), 66), (waiting(), 61), (match(game=HIDDEN), 67)):
        n = env.game.n_actions
        for agent in env.agents:
            space: Any = env.observation_space(agent)
            assert env.observation_space(agent) is env.observation_space(agent)
            box, mask = space["observation"], space["action_mask"]
            assert (box.shape, box.low.max(), box.high.min(), box.low.min(), box.high.max()) == ((width,), 0, 1, 0, 1)
            assert (mask.shape, mask.low.max(), mask.high.min(), mask.high.max(), mask.dtype) == ((n,), 0, 1, 1, np.int8)
            assert env.action_space(agent) is env.action_space(agent) == gymnasium.spaces.Discrete(n)
            assert space.contains(env.observe(agent))
        assert (env.state_space.shape, env.state_space.low.max(), env.state_space.high.max()) == ((width + 1,), 0, 1)
        assert env.state_space.contains(env.state())


def test_the_state_is_what_player_0_sees_and_whose_turn_it_is() -> None:
    env = waiting()
    seen = env.observe("player_0")["observation"]
    assert seen[-1] == 1
    assert env.state().tolist() == [*seen, 0.0]
    env.step(int(np.flatnonzero(env.observe("player_0")["action_mask"])[0]))
    assert env.state().tolist() == [*env.observe("player_0")["observation"][:-1], 0.0, 0.0]


def test_returns_from_below_continue_the_rally() -> None:
    threshold = GAME.threshold.copy()
    threshold[GAME.pair_stroke == SERVE] = 0, 0, ONE - 1
    env = rally(game=dataclasses.replace(GAME, threshold=threshold))
    env.step(SERVE)
    assert (env.infos["player_0"]["outcome"], env.terminations, env.agent_selection) == (
        "returned from below", by_agent(False, False), "player_1",
    )  # fmt: skip
    assert env.observe("player_1")["action_mask"].tolist() == [0, 0, 1]
    env.step(LIFT)
    assert (env.rewards, env.snapshot().winner) == (by_agent(1, -1), 0)


@pytest.mark.parametrize("action", [-1, 3, "smash", 1.0, None])
def test_what_is_no_action_is_refused(action: Any) -> None:
    env = rally()
    with pytest.raises(ActionError, match=f"player_0: action {action!r} is not a stroke; expected an integer from 0 to 2"):
        env.step(action)
    for illegal in (SMASH, LIFT):
        says = rf"player_0: stroke {illegal} \({NAMES[illegal]}\) is not legal in state: own none, .*: 0 {NAMES[SERVE]}$"
        with pytest.raises(IllegalStrokeError, match=says) as refused:
            env.step(illegal)
        assert refused.value.stroke == illegal
    assert env.strokes == []


@pytest.mark.parametrize(("listed", "more"), [(2, " and 1 more"), (3, ""), (4, "")])
def test_refusals_list_some_legal_actions(monkeypatch: pytest.MonkeyPatch, listed: int, more: str) -> None:
    monkeypatch.setattr("shuttle_marl.env.aec._LISTED", listed)
    env = waiting()
    n = env.game.n_strokes
    legal = np.flatnonzero(env.observe("player_0")["action_mask"]).tolist()
    shown = ", ".join(f"{action} {env.game.action_names[action]}" for action in legal[:listed])
    wrong = next(action for action in range(n, n + 9) if action not in legal)
    for action, kind in ((wrong, "position"), (0, "position")):
        with pytest.raises(IllegalStrokeError, match=f"player_0: {kind} {action} .*Legal, as in action_mask: {shown}{more}$"):
            env.step(action)
    with pytest.raises(ActionError, match=f"action {n + 9} is not a stroke or position; expected an integer from 0 to {n + 8}"):
        env.step(n + 9)


def test_agents_leave_after_the_end() -> None:
    for env in (rally(), rally(max_strokes=1)):
        env.step(SERVE)
        if env.max_strokes is None:
            env.step(SMASH)
        assert sorted(env.agents) == ["player_0", "player_1"]
        with pytest.raises(ValueError, match="only valid action is None"):
            env.step(SERVE)
        env.step(None)
        env.step(None)
        assert env.agents == []


def test_a_seed_begins_again_and_none_continues() -> None:
    env = rally_v0.raw_env(game=GAME)
    assert (env.last_seed, env.episode, env.agents, env.agent_selection) == (None, -1, [], "player_0")
    env.reset(seed=9)
    env.reset()
    assert (env.last_seed, env.episode) == (9, 1)
    env.reset(seed=10)
    assert (env.last_seed, env.episode) == (10, 0)
    drawn = rally_v0.raw_env(game=GAME)
    drawn.reset()
    assert drawn.last_seed is not None
    assert 0 <= drawn.last_seed < 1 << 63


def test_rewards_of_a_wait_are_zero() -> None:
    env = waiting()
    env.step(int(np.flatnonzero(env.observe("player_0")["action_mask"])[0]))
    assert env.rewards == env._cumulative_rewards == by_agent(0, 0)


def test_the_checked_environment_reports_the_agent_to_move_and_loses_illegal_strokes() -> None:
    env = rally_v0.env(game=GAME, server=0)
    with pytest.raises(AssertionError, match="before"):
        env.last()
    env.reset(seed=1)
    seen, *rest = env.last()
    assert seen["action_mask"].tolist() == [1, 0, 0]
    assert rest == [0.0, False, False, {}]
    assert env.last(observe=False)[0] is None
    assert str(env) == str(env.unwrapped)
    env.step(SERVE)
    env.step(LIFT)
    assert env.last()[1:4] == (-1.0, True, False)
    assert env.infos["player_0"]["reason"] == "illegal stroke"
    assert env.rewards == by_agent(1, -1)

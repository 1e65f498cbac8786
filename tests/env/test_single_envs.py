"""``Rally-v0`` and ``Match-v0``: one player's seat against an opponent."""

import copy
import subprocess
import sys
import warnings
from collections import Counter
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import shuttle_marl
from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError, OptionError
from shuttle_marl.env.single import SingleEnv, SingleMatchEnv, SingleRallyEnv
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game import default_game, draws
from shuttle_marl.game.observation import RALLY_WIDTH
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.tables import ROOT
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy, tiring_game

GAME = default_game()
SHORT = Rules(points=5, clear=2, cap=7, games=2)
IDS = ("shuttle_marl/Rally-v0", "shuttle_marl/Match-v0")


class ByScore:
    """Plays the first legal stroke when behind, else all alike; keeps what it was told."""

    reads_score = True

    def __init__(self) -> None:
        self.told: list[tuple[int, ...]] = []

    def probabilities(self, states: States) -> np.ndarray:
        assert states.score is not None
        assert states.score.dtype == np.int16
        self.told += [tuple(row) for row in states.score.tolist()]
        p = states.mask / states.mask.sum(axis=1, keepdims=True)
        for row in np.flatnonzero(states.score[:, 0] < states.score[:, 1]):
            p[row] = 0
            p[row, states.mask[row].argmax()] = 1
        return p


def legal_stroke(seen: dict[str, np.ndarray], rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(seen["action_mask"])))


def play(env: Any, episodes: int, seed: int = 0) -> list[tuple[Any, ...]]:
    """(state, stroke, reward) of every step, None between episodes."""
    rng = np.random.default_rng(seed)
    moves: list[tuple[Any, ...]] = []
    for episode in range(episodes):
        seen, info = env.reset(seed=seed if episode == 0 else None)
        over = False
        while not over:
            state, stroke = env.unwrapped.state_number, legal_stroke(seen, rng)
            seen, reward, over, truncated, info = env.step(stroke)
            assert not truncated
            moves.append((state, stroke, reward))
        assert info["reason"] in ("fault", "winner")
    return moves


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", [None, "ansi", "rgb_array"])
def test_gymnasiums_check_passes_without_warnings(name: str, mode: str | None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, opponent="bc", render_mode=mode)
        check_env(env.unwrapped, skip_render_check=mode is None)
        env.close()


@pytest.mark.parametrize(
    "code",
    [
        "import gymnasium, shuttle_marl\ngymnasium.make('{}')",
        "import shuttle_marl, gymnasium\ngymnasium.make('{}')",
        "from shuttle_marl import rally_v0\nimport gymnasium\ngymnasium.make('{}')",
        "import gymnasium\ngymnasium.make('shuttle_marl:{}')",
        "import shuttle_marl, gymnasium\ngymnasium.make('shuttle_marl:{}')",
        "import shuttle_marl, gymnasium, importlib\nimportlib.reload(gymnasium)\ngymnasium.make('{}')",
    ],
)
def test_the_ids_are_known_in_every_order_of_imports(code: str) -> None:
    script = "\n".join(code.format(name) for name in IDS)
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_waiting_for_gymnasium_is_in_no_ones_way() -> None:
    code = """
import sys, shuttle_marl, importlib.resources, importlib.util
assert "gymnasium" not in sys.modules
assert importlib.util.find_spec("gymnasium") is not None
import gymnasium
assert gymnasium.__spec__.loader is gymnasium.__loader__
assert importlib.resources.files("gymnasium").joinpath("__init__.py").is_file()
def waiting():
    return [finder for finder in sys.meta_path if type(finder).__module__.startswith("shuttle_marl")]
assert len(waiting()) == 1
assert "shuttle_marl/Rally-v0" in gymnasium.registry
assert "pettingzoo" not in sys.modules
import pettingzoo
assert not waiting()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_register_envs_can_be_given_the_package() -> None:
    gymnasium.register_envs(shuttle_marl)
    assert isinstance(gymnasium.make(IDS[0]).unwrapped, SingleRallyEnv)
    assert isinstance(gymnasium.make(IDS[1]).unwrapped, SingleMatchEnv)


@pytest.mark.parametrize("server", [None, 0, 1])
@pytest.mark.parametrize("seat", [0, 1])
@pytest.mark.parametrize("tiring", [False, True])
def test_a_rally_is_that_of_the_kernel(seat: int, server: int | None, tiring: bool) -> None:
    game = tiring_game() if tiring else GAME
    table = random_policy(game, 3) if tiring else tabulate(resolve("bc", game), game)
    env = SingleRallyEnv(opponent=table, seat=seat, server=server, game=game)  # type: ignore[arg-type]
    batch = RallyBatch(game, 1, opponents=[table], seat=seat, server=server, seed=3)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for episode in range(150):
        seen, info = env.reset(seed=3 if episode == 0 else None)
        over = False
        while not over:
            assert env.state_number == batch.rows.state[0]
            assert env.unseen == batch.unseen == tuple(info["unseen"].tolist())
            assert np.array_equal(env.action_masks(), game.mask(batch.rows.state)[0])
            assert np.array_equal(seen["action_mask"], env.action_masks())
            stroke = legal_stroke(seen, rng)
            seen, reward, over, _, info = env.step(stroke)
            rewards, done = batch.step(np.array([stroke]), reset=False)
            assert (reward, over) == (rewards[0], done[0])
            assert isinstance(reward, float)
            assert isinstance(over, bool)
        assert not seen["action_mask"].any()
        assert not env.action_masks().any()
        batch.reset()


def test_what_is_seen_and_told_is_that_of_the_environment_inside() -> None:
    env = SingleRallyEnv(opponent="random", seat=1)
    raw = rally_v0.raw_env()
    rng = np.random.default_rng(1)
    seen, info = env.reset(seed=8)
    raw.reset(seed=8)
    for _ in range(300):
        while raw.agent_selection != "player_1":
            raw.step(env.opponent.choose(raw.state_number, raw.choice_draw(), None))
            if raw.terminations["player_1"]:
                raw.reset()
        expected = raw.observe("player_1")
        assert env.observation_space.contains(seen)
        assert all(np.array_equal(seen[key], expected[key]) for key in expected)
        assert {key: value for key, value in info.items() if key not in ("unseen", "illegal")} == raw.infos["player_1"]
        stroke = legal_stroke(seen, rng)
        seen, _, over, _, info = env.step(stroke)
        raw.step(stroke)
        if over:
            seen, info = env.reset()
            while not raw.terminations["player_1"]:
                raw.step(env.opponent.choose(raw.state_number, raw.choice_draw(), None))
            raw.reset()


def test_long_rallies_use_draws_beyond_the_first_block() -> None:
    good, returned, _ = GAME.stroke_probabilities()
    continues = good * returned
    env = SingleRallyEnv(opponent="safe@greedy")
    longest = 0
    for seed in range(200):
        env.reset(seed=seed)
        count, over = 0, False
        while not over:
            first, last = GAME.pair_start[env.state_number], GAME.pair_start[env.state_number + 1]
            raw = env.raw
            key = draws.stream(seed, raw.episode)
            expected = draws.choice_draw(draws.draw(key, len(raw._strokes) if raw.state_number != ROOT else 0))[0]
            assert raw.choice_draw() == expected
            _, _, over, _, _ = env.step(GAME.pair_stroke[first + np.argmax(continues[first:last])])
            count = len(raw._strokes)
        longest = max(longest, count)
    assert longest > 40


@pytest.mark.parametrize("make", [SingleRallyEnv, lambda: SingleMatchEnv(rules=SHORT)])
def test_an_illegal_stroke_loses_the_episode(make: Any) -> None:
    env: SingleEnv = make()
    seen, info = env.reset(seed=1)
    wrong = int(np.flatnonzero(seen["action_mask"] == 0)[0])
    assert info["illegal"] == 0
    seen, reward, over, truncated, info = env.step(wrong)
    assert (reward, over, truncated, info["illegal"]) == (-1.0, True, False, 1)
    assert info["reason"] == "illegal stroke"
    assert info["stroke"] == env.game.catalogue.names[wrong]
    assert not seen["action_mask"].any()
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(0)
    assert env.reset()[1]["illegal"] == 1
    assert env.reset(seed=1)[1]["illegal"] == 0


def test_a_learner_without_a_mask_is_told_in_numbers_what_it_lost() -> None:
    env, rows = SingleRallyEnv(mask="none"), RallyVectorEnv(3, mask="none")
    env.reset(seed=1)
    rows.reset(seed=1)
    assert env.step(int(np.flatnonzero(~env.action_masks())[0]))[4]["illegal"] == 1
    actions = np.where(np.arange(3) == 1, (~rows.action_masks()).argmax(axis=1), rows.random_actions())
    assert rows.step(actions)[4]["illegal"].tolist() == [0, 1, 0]
    assert rows.reset(seed=2)[1]["illegal"].tolist() == [0, 0, 0]


@pytest.mark.parametrize("action", [-1, GAME.n_strokes, 1.5, "smash", None])
def test_what_is_no_stroke_is_refused_and_nothing_changes(action: Any) -> None:
    env = SingleRallyEnv()
    seen, _ = env.reset(seed=1)
    with pytest.raises(ActionError, match="is not a stroke"):
        env.step(action)
    assert np.array_equal(env.action_masks(), seen["action_mask"])
    env.step(np.int64(np.flatnonzero(seen["action_mask"])[0]))


def test_a_step_before_the_first_reset_is_refused() -> None:
    with pytest.raises(ResetNeeded):
        SingleRallyEnv().step(0)


@pytest.mark.parametrize(
    ("make", "options", "error", "message"),
    [
        (SingleRallyEnv, {"seat": 2}, OptionError, "seat 2: expected 0 or 1"),
        (SingleRallyEnv, {"server": 2}, OptionError, "server 2"),
        (SingleRallyEnv, {"render_mode": "film"}, OptionError, "render_mode 'film'"),
        (SingleRallyEnv, {"opponent": "none such"}, PolicyError, "no policy 'none such'"),
        (SingleRallyEnv, {"opponent": ByScore()}, OptionError, "'ByScore' reads the score, which a rally does not have"),
        (SingleRallyEnv, {"opponent": random_policy(random_game(1), 0)}, PolicyError, "tabulated for another game"),
        (SingleMatchEnv, {"reward": "points"}, OptionError, "reward 'points'"),
        (SingleMatchEnv, {"first_server": 2}, OptionError, "first_server 2"),
        (SingleMatchEnv, {"seat": -1}, OptionError, "seat -1"),
    ],
)
def test_options_out_of_range_are_refused(make: Any, options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make(**options)


def test_episodes_of_a_seed_are_the_same_again() -> None:
    env = SingleRallyEnv(opponent="attacking")
    first = play(env, 20, seed=5)
    assert play(env, 20, seed=5) == first
    assert play(SingleRallyEnv(opponent="attacking"), 20, seed=5) == first
    assert play(env, 20, seed=6) != first


def test_without_a_seed_one_is_drawn_and_kept() -> None:
    env = SingleRallyEnv()
    env.reset()
    seed = env.raw.last_seed
    assert seed is not None
    assert SingleRallyEnv().raw.last_seed is None
    state = env.state_number
    env.reset(seed=seed)
    assert env.state_number == state


def test_a_copy_plays_on_by_itself() -> None:
    env = SingleRallyEnv()
    seen, _ = env.reset(seed=2)
    twin = copy.deepcopy(env)
    stroke = int(np.flatnonzero(seen["action_mask"])[0])
    a, b = env.step(stroke), twin.step(stroke)
    assert a[1:3] == b[1:3]
    assert np.array_equal(a[0]["observation"], b[0]["observation"])


def test_the_opponent_is_told_the_score_from_its_own_side() -> None:
    """As in a match played by hand with the same strokes."""
    policy = ByScore()
    env = SingleMatchEnv(opponent=policy, seat=0, rules=SHORT)
    rng = np.random.default_rng(3)
    seen, info = env.reset(seed=7)
    over, strokes = False, []
    while not over:
        strokes.append(legal_stroke(seen, rng))
        seen, _, over, _, info = env.step(strokes[-1])
    mine = iter(strokes)
    raw, expected = match_v0.raw_env(rules=SHORT), []
    raw.reset(seed=7)
    again = ByScore()
    while not raw.terminations["player_0"]:
        if raw.agent_selection == "player_0":
            raw.step(next(mine))
            continue
        score = raw.observe("player_1")["observation"][RALLY_WIDTH : RALLY_WIDTH + 4] * [
            SHORT.cap,
            SHORT.cap,
            SHORT.games,
            SHORT.games,
        ]
        expected.append(tuple(np.rint(score).astype(int).tolist()))
        states = States(game=GAME, state=np.array([raw.state_number]), score=np.array([expected[-1]], np.int16))
        probabilities = np.cumsum(again.probabilities(states)[0])
        raw.step(int(np.argmax(np.rint(probabilities / probabilities[-1] * draws.CHOICE_ONE) > raw.choice_draw())))
    assert next(mine, None) is None
    assert policy.told == expected
    assert len(set(expected)) > 5
    assert info["games"] == raw.infos["player_0"]["games"]
    assert info["points"] == raw.infos["player_0"]["points"]


def test_an_opponent_that_fails_while_it_plays_is_named() -> None:
    class Fails:
        reads_score = True

        def probabilities(self, states: States) -> np.ndarray:
            return np.zeros((len(states), states.game.n_strokes))

    env = SingleMatchEnv(opponent=Fails(), first_server=1)
    with pytest.raises(PolicyError, match="'Fails' returned no distribution"):
        env.reset(seed=0)


@pytest.mark.parametrize("seat", [0, 1])
def test_rewards_by_rally_add_up_to_the_points(seat: int) -> None:
    env = SingleMatchEnv(opponent="attacking", seat=seat, rules=SHORT, reward="rally")  # type: ignore[arg-type]
    rng = np.random.default_rng(4)
    for episode in range(12):
        seen, _ = env.reset(seed=1 if episode == 0 else None)
        total, over, finished = 0.0, False, Counter[int]()
        while not over:
            seen, reward, over, _, _ = env.step(legal_stroke(seen, rng))
            total += reward
        for points in env.raw.snapshot().by_game:
            finished.update({0: points[0], 1: points[1]})
        assert total == finished[seat] - finished[1 - seat]


def test_rewards_by_match_come_at_its_end() -> None:
    env = SingleMatchEnv(opponent="random", rules=SHORT)
    rng = np.random.default_rng(5)
    won = 0
    for episode in range(20):
        seen, _ = env.reset(seed=9 if episode == 0 else None)
        rewards, over = [], False
        while not over:
            seen, reward, over, _, info = env.step(legal_stroke(seen, rng))
            rewards.append(reward)
        assert set(rewards[:-1]) <= {0.0}
        assert rewards[-1] == (1.0 if info["games"][0] == 2 else -1.0)
        won += rewards[-1] > 0
    assert 0 < won < 20


def test_matches_lost_before_the_first_stroke_are_counted() -> None:
    """One-point matches in a game whose serves often end the rally."""
    game = random_game(3, 8, 0.5)
    env = SingleMatchEnv(
        opponent=random_policy(game, 1), first_server=1, rules=Rules(points=1, clear=1, cap=1, games=1), game=game
    )
    rng = np.random.default_rng(6)
    for episode in range(200):
        seen, info = env.reset(seed=1 if episode == 0 else None)
        over = False
        while not over:
            seen, _, over, _, info = env.step(legal_stroke(seen, rng))
    won, lost = env.unseen
    assert won > 5
    assert lost > 5
    assert won + lost + 200 == env.raw.episode + 1
    assert info["unseen"].tolist() == [won, lost]


def test_pictures_and_text() -> None:
    env = gymnasium.make(IDS[1], opponent="bc", render_mode="ansi")
    env.reset(seed=1)
    text = env.render()
    assert isinstance(text, str)
    assert "serves" in text
    with gymnasium.make(IDS[0], render_mode="rgb_array") as pictures:
        pictures.reset(seed=1)
        frame: Any = pictures.render()
        assert frame.dtype == np.uint8


def test_time_limits_of_gymnasium_work() -> None:
    env = gymnasium.make(IDS[1], max_episode_steps=3)
    seen, _ = env.reset(seed=1)
    rng = np.random.default_rng(0)
    for step in range(3):
        seen, _, terminated, truncated, _ = env.step(legal_stroke(seen, rng))
        assert not terminated
        assert truncated == (step == 2)

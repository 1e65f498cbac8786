"""``Rally-v0`` and ``Match-v0``: one player's seat against an opponent; and options that no environment has."""

import copy
import functools
import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError, OptionError
from shuttle_marl.env.open_spiel import RallyGame
from shuttle_marl.env.single import SingleEnv, SingleMatchEnv, SingleRallyEnv
from shuttle_marl.env.vector import MatchVectorEnv, RallyVectorEnv
from shuttle_marl.game import default_game, draws
from shuttle_marl.game.layout import RALLY_WIDTH
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.scoring import Rules
from shuttle_marl.kernel import KernelError
from tests.exact.exact_games import random_game, random_policy

GAME = default_game()
SHORT = Rules(points=5, clear=2, cap=7, games=2)
IDS = ("shuttle_marl/Rally-v0", "shuttle_marl/Match-v0")


def versus(**options: Any) -> Any:
    """Of :mod:`shuttle_marl.env.batched`, which imports PyTorch."""
    from shuttle_marl.env.batched import VersusEnv

    return VersusEnv(**options)


class ByScore:
    """Plays the first legal stroke when behind, else all alike; keeps what it was told."""

    reads_score = True

    def __init__(self) -> None:
        self.told: list[tuple[int, ...]] = []

    def probabilities(self, states: States) -> np.ndarray:
        assert states.score.dtype == np.int16
        self.told += [tuple(row) for row in states.score.tolist()]
        p = states.mask / states.mask.sum(axis=1, keepdims=True)
        for row in np.flatnonzero(states.score[:, 0] < states.score[:, 1]):
            p[row] = 0
            p[row, states.mask[row].argmax()] = 1
        return p


def legal_stroke(seen: dict[str, np.ndarray], rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(seen["action_mask"])))


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", [None, "ansi", "rgb_array"])
def test_gymnasiums_check_passes_without_warnings(name: str, mode: str | None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, opponent="bc", render_mode=mode, game="default" if mode else "default:recovery")
        check_env(env.unwrapped, skip_render_check=mode is None)
        env.close()


@pytest.mark.parametrize(
    "code",
    [
        "import gymnasium, shuttle_marl\ngymnasium.spec('{}')\ngymnasium.register_envs(shuttle_marl)",
        "import gymnasium\ngymnasium.make('shuttle_marl:{}')",
        "import shuttle_marl, gymnasium, importlib\nimportlib.reload(gymnasium)\ngymnasium.spec('{}')",
    ],
)
def test_the_ids_are_known_in_every_order_of_imports(code: str) -> None:
    script = "\n".join(code.format(name) for name in IDS)
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


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
    with pytest.raises(ResetNeeded):
        env.step(0)
    seen, _ = env.reset(seed=1)
    with pytest.raises(ActionError, match="no action"):
        env.step(action)
    assert np.array_equal(env.action_masks(), seen["action_mask"])
    env.step(np.int64(np.flatnonzero(seen["action_mask"])[0]))


@pytest.mark.parametrize("make", [SingleRallyEnv, SingleMatchEnv])
def test_a_deep_copy_plays_on_alike_and_shares_the_opponent(make: Any) -> None:
    env = make()
    seen, _ = env.reset(seed=2)
    twin, action = copy.deepcopy(env), legal_stroke(seen, np.random.default_rng(1))
    assert twin.opponent is env.opponent
    assert all(np.array_equal(a, b) for a, b in zip(env.step(action)[0].values(), twin.step(action)[0].values(), strict=True))


def test_the_opponent_is_told_the_score_from_its_own_side() -> None:
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
    env = SingleMatchEnv(opponent=Fails(), first_server=0)
    env.reset(seed=0)
    for error in (PolicyError, ResetNeeded):  # a stroke after the failure would be that of the opponent
        with pytest.raises(error):
            env.step(int(env.action_masks().argmax()))


def test_matches_lost_before_the_first_stroke_are_counted() -> None:
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


RAW = [rally_v0.raw_env, match_v0.raw_env]
rows = functools.partial(gymnasium.make_vec, "shuttle_marl/Rally-v0", num_envs=2)
single = functools.partial(gymnasium.make, "shuttle_marl/Rally-v0")


@pytest.mark.parametrize(
    ("make", "options", "error", "message"),
    [
        *((make, {"max_strokes": n}, OptionError, f"max_strokes {n!r}: expected a whole") for make in RAW for n in (2.0, "2", 0)),
        (rally_v0.env, {"server": 2}, OptionError, "server 2"),
        (rally_v0.env, {"render_mode": "video"}, OptionError, "human, rgb_array, ansi"),
        (rally_v0.env, {"action": "multi"}, OptionError, "'flat' or 'components'"),
        *((make, {"mask": "nowhere"}, OptionError, "expected '") for make in (rally_v0.env, match_v0.env, single)),
        *((make, {"info": "some"}, OptionError, "expected '") for make in (rally_v0.env, match_v0.env, single)),
        (match_v0.env, {"first_server": -1}, OptionError, "first_server -1"),
        (match_v0.env, {"reward": "game"}, OptionError, "'rally'"),
        (SingleRallyEnv, {"seat": 2}, OptionError, "seat 2: expected 0 or 1"),
        (SingleRallyEnv, {"opponent": "none such"}, PolicyError, "no policy 'none such'"),
        (SingleRallyEnv, {"opponent": ByScore()}, OptionError, "policy 'ByScore' reads the score, which a rally does not have"),
        (SingleRallyEnv, {"opponent": random_policy(random_game(1), 0)}, PolicyError, "tabulated for another game"),
        (SingleMatchEnv, {"first_server": 2}, OptionError, "first_server 2"),
        (rows, {"observation": "pixels"}, OptionError, "observation 'pixels'"),
        (rows, {"seat": 7}, KernelError, "seat 7"),
        (functools.partial(MatchVectorEnv, 2), {"reward": "game"}, OptionError, "reward 'game'"),
        (functools.partial(MatchVectorEnv, 2), {"opponent": ByScore()}, PolicyError, "reads the score"),
        (versus, {"batch": 4, "opponents": "bcc"}, PolicyError, "no policy 'bcc'; did you mean bc"),
        (versus, {"batch": 4, "opponents": ["bc", ByScore()]}, PolicyError, "'ByScore' reads the score"),
        (versus, {"batch": 4, "opponents": []}, KernelError, "no policy: expected one or more"),
        (versus, {"batch": 4, "threads": 0}, OptionError, "threads 0"),
        *((RallyGame, {"params": wrong}, OptionError, "expected") for wrong in ({"server": 2}, {"max_strokes": -1})),
    ],
)
def test_options_that_are_not_there(make: Any, options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make(**options)


@pytest.mark.parametrize("make", RAW)
def test_nothing_is_played_before_the_first_reset(make):
    for play in (lambda env: env.step(0), lambda env: env.step(None), lambda env: env.forfeit()):
        env = make()
        with pytest.raises(ResetNeeded, match="no episode has started; call reset"):
            play(env)
    seen, reward, terminated, truncated, info = make().last()
    assert not seen["action_mask"].any()
    assert (reward, terminated, truncated, info) == (0.0, False, False, {})


def test_reset_has_no_options() -> None:
    env = rally_v0.raw_env()
    env.reset(options={"options": 1})  # of PettingZoo's conformance test
    with pytest.raises(OptionError, match="options 'server': reset has no options; `server` and others are of the constructor"):
        env.reset(options={"server": 1})

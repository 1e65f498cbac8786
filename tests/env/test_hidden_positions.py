"""Where a receiver waits is hidden: what the striker gets is the same whatever it is, and trees find nothing in it.

A position may show in what follows only by the outcome of the stroke that it decides. So two copies of an episode in which a
receiver waits at different places are told alike, up to a different outcome; and trees that get everything that a striker is
given predict the position no better than who knows the state and the equilibrium.
"""

import copy
import itertools
import warnings
import zlib
from collections.abc import Callable, Iterator
from typing import Any, Final

import lightgbm
import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.open_spiel import RallyGame
from shuttle_marl.env.single import SingleMatchEnv, SingleRallyEnv
from shuttle_marl.env.words import TextRallyEnv, text_env
from shuttle_marl.exact import solve
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.rally.stepper import choose
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.tabulated import TabulatedPolicy
from tests.recovery import Prefers, small_recovery_game

GAME = small_recovery_game()
N = GAME.n_strokes


def received(env: Any, *, picture: bool = False) -> list[Any]:
    """Everything that the environment of two agents gives to the agent to move, and to anybody who looks on."""
    raw = env.unwrapped
    found = [env.last(), [env.observe(agent) for agent in env.possible_agents], env.state(), env.infos, env.rewards]
    found += [raw.strokes, raw.state_number, raw.choice_draw(), raw.score_of(0), raw.chooses_position]
    snapshot = raw.snapshot()
    found += [[value for name, value in vars(snapshot).items() if name != "game"], raw.agents, raw.terminations]
    raw.render_mode = "rgb_array" if picture else "ansi"
    return [*found, env.render()]


def same(a: Any, b: Any) -> bool:
    """Whether nested containers have the same content."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


@pytest.mark.parametrize(
    "make",
    [
        rally_v0.raw_env,
        rally_v0.env,
        match_v0.env,
        lambda **options: match_v0.env(reward="rally", mask="info", info="full", **options),
        lambda **options: rally_v0.env(action="components", **options),
        text_env,
    ],
)
def test_what_is_received_does_not_depend_on_the_position(make: Callable[..., Any]) -> None:
    env, rng, told = make(game=GAME, render_mode="ansi"), np.random.default_rng(1), [0, 0]
    env.reset(seed=5)
    for count in range(400):
        raw = env.unwrapped
        if raw.terminations["player_0"]:
            env.reset()
            continue
        legal = np.flatnonzero(raw.observe(raw.agent_selection)["action_mask"])
        if not raw.chooses_position:
            raw.step(int(rng.choice(legal)))
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # exact copies have the luck of the original: here they must
            twin = copy.deepcopy(env)
        other = twin.unwrapped
        first, second = rng.choice(legal, 2, replace=False).tolist()
        raw.step(first)
        other.step(second)
        assert same(received(env, picture=count % 40 == 0), received(twin, picture=count % 40 == 0))
        assert same(received(env.fork(count)), received(twin.fork(count)))
        stroke = int(rng.choice(np.flatnonzero(raw.observe(raw.agent_selection)["action_mask"])))
        raw.step(stroke)
        other.step(stroke)
        alike = raw.infos["player_0"]["outcome"] == other.infos["player_0"]["outcome"]
        told[alike] += 1
        if alike and raw.snapshot().reason is None:
            assert same(received(env), received(twin))
    assert min(told) > 0


@pytest.mark.parametrize("make", [SingleRallyEnv, SingleMatchEnv, TextRallyEnv])
def test_against_an_opponent_only_the_outcome_tells(make: Callable[..., Any]) -> None:
    envs = [make(opponent=Prefers(weights), game=GAME) for weights in ((9, 1, 1) * 3, (1, 1, 9) * 3)]
    rng, differ = np.random.default_rng(2), 0
    for seed in range(120):
        told = [env.reset(seed=seed) for env in envs]
        for _ in range(40):
            raws = [env.unwrapped.rally.raw if make is TextRallyEnv else env.unwrapped.raw for env in envs]
            assert same(*told)
            if raws[0].terminations["player_0"]:
                break
            legal = np.flatnonzero(raws[0].observe(raws[0].agent_selection)["action_mask"])
            action = int(rng.choice(legal))
            sent = raws[0].game.action_names[action] if make is TextRallyEnv else action
            told = [env.step(sent) for env in envs]
            first, second = ([(one.stroke, one.outcome) for one in raw.snapshot().strokes] for raw in raws)
            if first != second:
                differ += 1
                break
    assert differ > 5


def numbers(thing: Any) -> list[float]:
    """Everything in nested containers as numbers; text as counts of its words in 16 bins."""
    if thing is None:
        return [-1.0]
    if isinstance(thing, str):
        return np.bincount([zlib.crc32(word.encode()) % 16 for word in thing.split()], minlength=16).astype(float).tolist()
    if isinstance(thing, dict):
        return [number for key in sorted(thing) for number in numbers(thing[key])]
    if isinstance(thing, list | tuple):
        return [number for each in thing for number in numbers(each)]
    return np.ravel(np.asarray(thing, dtype=np.float64)).tolist()


Seen = Iterator[tuple[Any, int, int] | None]
"""At each step what a striker is given, the state, and the hidden position; None where no mixed position is hidden."""


def mixes(policy: TabulatedPolicy, state: int) -> bool:
    return bool(np.diff(policy.waiting_table[state].astype(int), prepend=0).max() < 0.99 * CHOICE_ONE)


def of_two_agents(policy: TabulatedPolicy, make: Callable[..., Any]) -> Seen:
    env, rng, position = make(game=GAME, render_mode="ansi"), np.random.default_rng(3), -1
    env.reset(seed=7)
    while True:
        raw = env.unwrapped
        if not env.agents or raw.terminations["player_0"]:
            env.reset()
            continue
        if raw.chooses_position:
            position = choose(policy, GAME, raw.state_number, int(rng.integers(65535)), waits=True) - N
            raw.step(N + position)
            yield None
            continue
        if mixes(policy, raw.state_number):
            yield [env.last(), env.observe("player_0"), env.state(), env.render()], raw.state_number, position
        else:
            yield None
        raw.step(choose(policy, GAME, raw.state_number, int(rng.integers(65535))))


def of_one_agent(policy: TabulatedPolicy, make: Callable[..., Any]) -> Seen:
    env, rng = make(opponent=policy, game=GAME), np.random.default_rng(4)
    told = env.reset(seed=8)
    while True:
        raw = env.unwrapped.rally.raw if make is TextRallyEnv else env.unwrapped.raw
        state = raw.state_number
        if raw.chooses_position:
            action = choose(policy, GAME, state, int(rng.integers(65535)), waits=True)
            yield None
        else:
            yield (list(told), state, raw._position) if mixes(policy, state) else None
            action = choose(policy, GAME, state, int(rng.integers(65535)))
        told = env.step(raw.game.action_names[action] if make is TextRallyEnv else action)
        if told[2]:
            told = env.reset()


def of_open_spiel(policy: TabulatedPolicy) -> Seen:
    game, rng = RallyGame(tables=GAME), np.random.default_rng(5)
    while True:
        state, position = game.new_initial_state(), -1
        while not state.is_terminal():
            if state.is_chance_node():
                actions, p = zip(*state.chance_outcomes(), strict=True)
                state.apply_action(int(rng.choice(actions, p=p)))
            elif state.choosing:
                position = choose(policy, GAME, state.number, int(rng.integers(65535)), waits=True) - N
                state.apply_action(N + position)
                yield None
            else:
                if mixes(policy, state.number):
                    player = state.current_player()
                    given = [state.information_state_string(player), state.information_state_tensor(player)]
                    given += [
                        state.observation_string(player),
                        state.observation_tensor(player),
                        state.legal_actions_mask(player),
                    ]
                    yield given, state.number, position
                else:
                    yield None
                state.apply_action(choose(policy, GAME, state.number, int(rng.integers(65535))))


def gain(rows: np.ndarray, position: np.ndarray, chance: np.ndarray) -> tuple[float, float]:
    """By how much trees beat given chances on the second half of the rows: mean log-loss [nats], and its standard error.

    They start from the chances, so all that they learn is more than those say.
    """
    start, half = np.log(np.maximum(chance, 1e-6)), len(rows) // 2
    data = lightgbm.Dataset(rows[:half], position[:half], init_score=start[:half].ravel(order="F"))
    options = {"objective": "multiclass", "num_class": N_POSITIONS, "num_leaves": 7, "learning_rate": 0.1, "num_threads": 2}
    trees = lightgbm.train({**options, "verbose": -1, "seed": 1, "min_data_in_leaf": 100, "lambda_l2": 20}, data, 20)
    logits = trees.predict(rows[half:], raw_score=True) + start[half:]
    logits -= logits.max(axis=1, keepdims=True)
    log_p = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    at = np.arange(len(log_p)), position[half:]
    better = log_p[at] - start[half:][at]
    return float(better.mean()), float(better.std() / np.sqrt(len(better)))


@pytest.fixture(scope="module")
def perfect() -> TabulatedPolicy:
    """Perfect play, which mixes positions."""
    return solve(GAME, tolerance=1e-6).policy[0]


SOURCES: dict[str, Callable[[TabulatedPolicy], Seen]] = {
    "rally_v0": lambda policy: of_two_agents(policy, rally_v0.env),
    "match_v0": lambda policy: of_two_agents(policy, match_v0.env),
    "components": lambda policy: of_two_agents(policy, lambda **options: rally_v0.env(action="components", **options)),
    "words of two": lambda policy: of_two_agents(policy, text_env),
    "Rally": lambda policy: of_one_agent(policy, SingleRallyEnv),
    "Match": lambda policy: of_one_agent(policy, SingleMatchEnv),
    "words of one": lambda policy: of_one_agent(policy, TextRallyEnv),
    "OpenSpiel": of_open_spiel,
}


STEPS: Final = 100_000
"""Steps of each interface."""


@pytest.mark.slow(minutes=True)
@pytest.mark.parametrize("name", SOURCES)
def test_trees_predict_hidden_positions_no_better_than_the_equilibrium(name: str, perfect: TabulatedPolicy) -> None:
    seen = filter(None, itertools.islice(SOURCES[name](perfect), STEPS))
    given, states, positions = zip(*seen, strict=True)
    # At the beginning of an episode there is less to tell.
    columns = itertools.zip_longest(*map(numbers, given), fillvalue=-2.0)
    rows = np.array(list(columns), dtype=np.float32).T
    position = np.array(positions)
    chance = np.diff(perfect.waiting_table[np.array(states)].astype(float), axis=1, prepend=0) / CHOICE_ONE
    found, error = gain(rows, position, chance)
    assert found < 3 * error, "what a striker is given tells where the receiver waits"
    leak = np.random.default_rng(1).random(len(rows)) < 0.2
    leaking = np.c_[rows, np.where(leak, position, -1)]
    found, error = gain(leaking, position, chance)
    assert found > 3 * error, "trees find a leak in one stroke of five"

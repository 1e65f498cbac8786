"""The game with recovery where it is played one stroke at a time: conformance, rules, draws, forks, illegal positions."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.single import SingleMatchEnv
from shuttle_marl.game.layout import SWAP, observations
from shuttle_marl.game.policy import GamePolicy, PolicyError, States, UniformPolicy
from shuttle_marl.game.rally import stepper_of
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import OUTCOMES, IllegalStrokeError
from shuttle_marl.game.shipped import default_game
from shuttle_marl.kernel import struck
from tests.recovery import Prefers, small_recovery_game

GAME = small_recovery_game()
FORWARD = Prefers((9, 5, 9, 2, 1, 2, 1, 1, 1))
both = pytest.mark.parametrize("module", [rally_v0, match_v0])


def some_action(env: Any, rng: np.random.Generator) -> int:
    raw = env.unwrapped
    return int(rng.choice(np.flatnonzero(raw.observe(raw.agent_selection)["action_mask"])))


def test_the_ids_name_the_shipped_game() -> None:
    env: Any = gymnasium.make("shuttle_marl:shuttle_marl/RallyRecovery-v0")
    assert env.unwrapped.game is rally_v0.env(game="default:recovery").unwrapped.game
    assert env.action_space == gymnasium.spaces.Discrete(default_game().n_strokes + N_POSITIONS)
    assert "shuttle_marl/MatchRecovery-v0" in gymnasium.registry


def test_what_is_told_of_a_stroke_tells_nothing_of_the_position() -> None:
    rng, stepper, others = np.random.default_rng(1), stepper_of(GAME), 0
    for pair in rng.integers(0, GAME.n_pairs, 1000).tolist():
        state, stroke, draw = int(GAME.pair_state[pair]), int(GAME.pair_stroke[pair]), int(rng.integers(1 << 24))
        plain, _ = stepper.step(state, 0, stroke, draw)
        for position in np.flatnonzero(GAME.waiting.mask(GAME.base(state))).tolist():
            assert stepper.is_feasible(state, position)
            played, _ = stepper.step(state, 0, stroke, draw, position)
            assert played[3:] == plain[3:]
            others += plain.outcome != played.outcome
    assert others > 20, "positions matter"


def test_outcomes_are_as_frequent_as_their_probabilities() -> None:
    rng, size = np.random.default_rng(3), 1 << 18
    for number in rng.integers(0, GAME.n_pairs, 12).tolist():
        state, k = np.full(size, GAME.pair_state[number]), np.full(size, GAME.base_pair_rank[number % GAME.n_base_pairs])
        for position in np.flatnonzero(GAME.waiting.mask(GAME.base(state[0]))).tolist():
            drawn = rng.integers(0, 1 << 24, size)
            outcome, _ = struck(GAME, state, k, drawn, 0, position)
            expected = GAME.outcome_probabilities(np.array([number]), position)[0]
            found = np.bincount(outcome, minlength=len(OUTCOMES)) / size
            assert (np.abs(found - expected) < 5 * np.sqrt(expected * (1 - expected) / size) + 1e-9).all()


def test_without_a_mask_strikers_strike_and_receivers_wait() -> None:
    states = np.tile(np.flatnonzero(GAME.playable)[[40, 90]], 2_000)
    rows, waits = observations(GAME, states), np.arange(len(states)) % 4 < 2
    seen = np.c_[np.where(waits[:, None], rows[:, SWAP], rows), waits]
    actions = np.asarray(GamePolicy(FORWARD, GAME).act(seen, rng=np.random.default_rng(3)))
    assert np.array_equal(actions >= GAME.n_strokes, waits)
    assert GAME.mask(states[~waits])[np.arange((~waits).sum()), actions[~waits]].all()
    assert GAME.waiting.mask(GAME.base(states[waits]))[np.arange(waits.sum()), actions[waits] - GAME.n_strokes].all()


def to_a_choice(env: Any, seed: int) -> Any:
    """Play until an agent is to choose a position."""
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    while not env.unwrapped.chooses_position:
        env.step(some_action(env, rng))
        if not env.agents or env.terminations["player_0"]:
            env.reset()
    return env


@pytest.mark.parametrize("made_for", ["position", "stroke"])
def test_illegal_positions_lose_as_illegal_strokes_do(made_for: str) -> None:
    env = to_a_choice(rally_v0.env(game=GAME), 4)
    raw = env.unwrapped
    if made_for == "stroke":
        env.step(int(env.last()[0]["action_mask"].argmax()))
    loser, mask = env.agent_selection, env.last()[0]["action_mask"]
    wrong = int(np.flatnonzero(mask == 0)[-1])
    with pytest.raises(
        IllegalStrokeError, match=rf"{made_for} {wrong} \(wait:[a-z-]+\) is not legal in state: .* Legal, as in act"
    ):
        raw.step(wrong)
    env.step(wrong)
    assert env.rewards[loser] == -1
    assert sum(env.rewards.values()) == 0
    assert env.infos[loser]["reason"] == f"illegal {made_for}"
    assert env.infos[loser]["stroke"] == raw.game.action_names[wrong]
    assert all(env.terminations.values())


def waited_in(fork: Any, stroke: int) -> int:
    """Where the receiver of a stroke waited, which is told at the end of the rally."""
    rng, raw = np.random.default_rng(0), fork.unwrapped
    while not raw.snapshot().positions:
        raw.step(some_action(raw, rng))
    told = raw.snapshot().positions
    assert told[:stroke] == (None,) * stroke, "forks do not tell what was hidden"
    return int(told[stroke])


@pytest.mark.parametrize("make", [rally_v0.env, match_v0.raw_env, lambda **options: rally_v0.env(mask="info", **options)])
def test_forks_draw_the_hidden_position_from_what_is_believed(make: Any) -> None:
    env = to_a_choice(make(game=GAME), 3)
    state, at = np.array([env.unwrapped.state_number]), len(env.unwrapped.snapshot().strokes)
    feasible = GAME.waiting.mask(GAME.base(state))[0]
    env.unwrapped.step(GAME.n_strokes + int(feasible.argmax()))
    of_policy = FORWARD.positions(States(game=GAME, state=state.astype(np.int32)))[0]
    for belief, expected in ((None, GAME.people_positions(state)[0]), (FORWARD, of_policy)):
        counts = np.bincount([waited_in(env.fork(seed, belief), at) for seed in range(300)], minlength=9)
        assert np.abs(counts / 300 - expected).max() < 0.12
    last = int(np.flatnonzero(feasible)[-1])
    assert {waited_in(env.fork(seed, np.eye(9)[last]), at) for seed in range(20)} == {last}
    with pytest.raises(PolicyError, match="illegal position"):
        env.fork(1, np.eye(9)[feasible.argmin()])


def test_opponents_who_wait_are_told_the_score_of_the_striker_and_the_strokes() -> None:
    class Reads(UniformPolicy):
        reads_score = reads_history = True

        def positions(self, states: States) -> np.ndarray:
            assert states.score is not None
            assert states.history is not None
            assert states.score[0].tolist() == list(env.raw.score_of(0) or ())
            assert states.history[0, 0] == env.raw.strokes[-1] == states.incoming[0]
            asked.append(1)
            return FORWARD.positions(states)

    rng, asked = np.random.default_rng(1), list[int]()
    env = SingleMatchEnv(opponent=Reads(), game=GAME)
    env.reset(seed=1)
    for _ in range(400):
        if env.step(some_action(env.raw, rng))[2]:
            env.reset()
    assert len(asked) > 50

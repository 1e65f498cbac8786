"""Everything that plays follows the rules of ``game.rules``: stroke by stroke, also where a draw equals a limit."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from shuttle_marl.env import rally_v0
from shuttle_marl.game import Game, default_game, load_game, rules, tabulate
from shuttle_marl.game.draws import draw, extend, first_server, outcome_draw, stream
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import UniformPolicy
from shuttle_marl.game.rally import Rallies, stepper_of
from shuttle_marl.game.rules import FAULT, RETURNED_BELOW, WINNER, State
from shuttle_marl.kernel import Matches, RallyBatch, RallySampler, play_matches, play_rallies, struck
from tests.exact.exact_games import random_game
from tests.kernel.recovery import PAIR
from tests.recovery import with_recovery


def hidden_game(seed: int) -> Game:
    """A random game in which receivers choose between three positions."""
    return with_recovery(random_game(seed), seed, 3)


GAMES: dict[str, Callable[[], Game]] = {
    "default": default_game,
    "recovery": lambda: load_game("default:recovery"),
    "pair": lambda: pair_game("viktor-axelsen", "kento-momota"),
    "hidden-pair": lambda: PAIR,
    **{f"random-{seed}": partial(random_game, seed) for seed in range(3)},
    **{f"random-hidden-{seed}": partial(hidden_game, seed) for seed in range(3, 6)},
}


@pytest.fixture(scope="module", params=GAMES)
def game(request: pytest.FixtureRequest) -> Game:
    return GAMES[request.param]()


class Case(NamedTuple):
    """A stroke, and what becomes of it by the rules: the next state, -1 at the end of the rally."""

    state: int
    striker: int
    stroke: int
    position: int
    draw: int
    outcome: int
    following: int


def cases(game: Game, count: int = 300) -> Iterator[Case]:
    """Strokes in random states, by draws of which two in three equal a limit or lie just below it."""
    rng = np.random.default_rng(1)
    for number in rng.choice(np.flatnonzero(game.playable), count).tolist():
        state, striker = State(*game.observation(number).tolist()), int(rng.integers(2))
        stroke = int(rng.choice(rules.legal_strokes(game, state)))
        position = int(rng.choice(rules.legal_positions(game, state)))
        low, late = int(rng.integers(1 << 16)), int(rng.integers(1 << 8))
        limits, hurry = game.seats[striker].chances(number, stroke, position)
        low = int(rng.choice([low, *limits, *(limit - 1 for limit in limits)]))
        late = int(rng.choice([late, *hurry, *(chance - 1 for chance in hurry)]))
        drawn = max(late, 0) << 16 | max(low, 0)
        outcome = rules.outcome(game, striker, state, stroke, position, drawn)
        after = rules.next_state(game, state, stroke, outcome)
        following = int(game.state_of(*after)) if outcome >= RETURNED_BELOW else -1
        assert (following >= 0) == (outcome >= RETURNED_BELOW), "every return leads to a state of the game"
        yield Case(number, striker, stroke, position, drawn, outcome, following)


def test_the_stepper(game: Game) -> None:
    stepper, n = stepper_of(game), game.n_strokes
    for case in cases(game):
        state = State(*game.observation(case.state).tolist())
        position = case.position if game.hides else None
        played, following = stepper.step(case.state, case.striker, case.stroke, case.draw, position)
        assert (played.player, played.stroke, played.outcome) == (case.striker, case.stroke, case.outcome)
        assert following == case.following or case.outcome < RETURNED_BELOW
        assert np.flatnonzero(stepper.legal_action_mask(case.state)).tolist() == rules.legal_strokes(game, state)
        where = rules.legal_positions(game, state)
        assert stepper.chooses_position(case.state) == (len(where) > 1)
        if game.hides:
            assert (np.flatnonzero(stepper.position_mask(case.state)) - n).tolist() == where


def test_the_compiled_engine(game: Game) -> None:
    state, striker, stroke, position, drawn, outcome, following = np.array(list(cases(game, 500))).T
    assert set(outcome.tolist()) == set(range(len(rules.OUTCOMES)))
    found = struck(game, state, game.rank(state, stroke), drawn, striker, position)
    assert np.array_equal(found, [outcome, following])


def assert_played(game: Game, played: Rallies, key: np.ndarray) -> None:
    """Every stroke of some rallies has the outcome that the rules give by its draws."""
    for i in range(len(played)):
        rally, state = played.row(i, game.catalogue), rules.serve(game)
        drawn = outcome_draw(draw(key[i], np.arange(len(rally))))
        for k, (stroke, outcome) in enumerate(zip(rally.stroke.tolist(), rally.outcome.tolist(), strict=True)):
            striker = (rally.server + k) % 2
            position = int(rally.waited[k]) if game.hides else rules.legal_positions(game, state)[0]
            assert stroke in rules.legal_strokes(game, state)
            assert position in rules.legal_positions(game, state)
            assert outcome == rules.outcome(game, striker, state, stroke, position, int(drawn[k]))
            state = rules.next_state(game, state, stroke, outcome)
        assert outcome < RETURNED_BELOW
        assert played.winner[i] == rally.winner == rules.winner(striker, outcome)


def test_rallies_matches_and_those_of_a_learner(game: Game) -> None:
    first, second = (tabulate(UniformPolicy(), tables) for tables in game.seats)
    assert_played(game, play_rallies(game, (first, second), 60, seed=5), stream(5, np.arange(60)))

    def assess(states: Any) -> Any:
        return np.cos(np.outer(states, np.arange(game.n_actions))).astype(np.float32), np.sin(states).astype(np.float32)

    for opponents in ((), (second,)):
        sampler = RallySampler(game, opponents)
        sampler.reset(6)
        sampler.collect(200, assess)
        assert_played(game, sampler.record(sampler.numbers), stream(6, sampler.numbers))
    key, servers = np.arange(2, dtype=np.uint64), np.array([0, 1], np.int8)
    matches = Matches(entrant=np.array([[0, 1], [0, 1]], np.int32), first_server=servers, key=key)
    played = play_matches(game, matches, [first, second]).rallies
    assert_played(game, played, extend(key[played.match], 2 * played.rally.astype(np.int64) + played.server))
    score, number = (0, 0, 0, 0), 0
    for match, before, server, winner in zip(played.match, played.score.tolist(), played.server, played.winner, strict=True):
        if match != number:
            assert max(score[2:]) == 2, "a match goes on until two games are won"
            score, number, last = (0, 0, 0, 0), match, servers[match]
        assert tuple(before) == score
        assert server == (last if any(score) or match else servers[0])
        score, last = rules.next_score(score, int(winner)), winner


def test_rows_of_given_strokes(game: Game) -> None:
    batch = RallyBatch(game, 20, seed=7)
    for _ in range(15):
        before, strikers = batch.rows.state.tolist(), batch.rows.striker.tolist()
        drawn = outcome_draw(draw(batch.rows.key, batch.rows.stroke)).tolist()
        stroke, position = batch.random_actions()
        reward, done = batch.step(stroke, position if game.hides else None, reset=False)
        for i, (number, striker) in enumerate(zip(before, strikers, strict=True)):
            state = State(*game.observation(number).tolist())
            where = int(position[i])
            outcome = rules.outcome(game, striker, state, int(stroke[i]), where, drawn[i])
            assert done[i] == (outcome < RETURNED_BELOW)
            assert reward[i] == {FAULT: -1, WINNER: 1}.get(outcome, 0)
            after = game.state_of(*rules.next_state(game, state, int(stroke[i]), outcome))
            assert done[i] or batch.rows.state[i] == after
        batch.reset(rows=done)


def test_the_environment_of_two_agents(game: Game) -> None:
    env, rng, n = rally_v0.raw_env(game=game), np.random.default_rng(3), game.n_strokes
    for episode in range(20):
        env.reset(seed=8 if episode == 0 else None)
        key, state = stream(8, episode), rules.serve(game)
        striker = int(first_server(draw(key, 0))[0])
        for k in itertools.count():
            assert env.state_number == game.state_of(*state)
            where = rules.legal_positions(game, state)
            position = int(rng.choice(where))
            if len(where) > 1:
                assert env.agent_selection == f"player_{1 - striker}"
                assert np.flatnonzero(env.observe(env.agent_selection)["action_mask"]).tolist() == [n + p for p in where]
                env.step(n + position)
            legal = rules.legal_strokes(game, state)
            assert env.agent_selection == f"player_{striker}"
            assert np.flatnonzero(env.observe(env.agent_selection)["action_mask"]).tolist() == legal
            stroke = int(rng.choice(legal))
            env.step(stroke)
            outcome = rules.outcome(game, striker, state, stroke, position, int(outcome_draw(draw(key, k))[0]))
            if outcome < RETURNED_BELOW:
                break
            state, striker = rules.next_state(game, state, stroke, outcome), 1 - striker
        assert env.rewards[f"player_{rules.winner(striker, outcome)}"] == 1


def shares(game: Game, striker: int, state: State, stroke: int, position: int) -> dict[int, float]:
    """Share of all draws that lead to each outcome, counted in blocks whose first and last draw have the same one."""
    limits, hurry = game.seats[striker].chances(int(game.state_of(*state)), stroke, position)
    found: Counter[int] = Counter()
    for late, later in itertools.pairwise(sorted({0, *hurry, 1 << 8})):
        for low, high in itertools.pairwise(sorted({0, *limits, 1 << 16})):
            corners = late << 16 | low, (later - 1) << 16 | (high - 1)
            first, last = (rules.outcome(game, striker, state, stroke, position, drawn) for drawn in corners)
            assert first == last
            found[first] += (later - late) * (high - low)
    return {outcome: number / (1 << 24) for outcome, number in found.items()}


def test_open_spiel(game: Game) -> None:
    pytest.importorskip("pyspiel")
    from shuttle_marl.env.open_spiel import RallyGame

    if game.people is not None:
        pytest.skip("one table for both players")
    rng, n = np.random.default_rng(4), game.n_strokes
    for server in (0, 1) * 2:
        played, state, striker = RallyGame({"server": server}, game).new_initial_state(), rules.serve(game), server
        while not played.is_terminal():
            where = rules.legal_positions(game, state)
            position = int(rng.choice(where))
            if len(where) > 1:
                assert (played.current_player(), played.legal_actions()) == (1 - striker, [n + p for p in where])
                played.apply_action(n + position)
            assert (played.current_player(), played.legal_actions()) == (striker, rules.legal_strokes(game, state))
            stroke = int(rng.choice(played.legal_actions()))
            played.apply_action(stroke)
            chances = played.chance_outcomes()
            assert dict(chances) == pytest.approx(shares(game, striker, state, stroke, position))
            outcome = int(rng.choice([result for result, _ in chances], p=[chance for _, chance in chances]))
            played.apply_action(outcome)
            if outcome >= RETURNED_BELOW:
                state, striker = rules.next_state(game, state, stroke, outcome), 1 - striker
        assert played.returns()[rules.winner(striker, outcome)] == 1


@pytest.mark.slow(minutes=True)
def test_jax(game: Game) -> None:
    jax = pytest.importorskip("jax")
    from shuttle_marl.env import jax as rally

    if game.people is not None:
        pytest.skip("one table for both players")
    state, _, stroke, position, drawn, outcome, following = np.array(list(cases(game, 2000)), np.int32).T
    tables = rally.Tables.of(game)
    places = (position,) if game.hides else ()
    step = jax.jit(jax.vmap(rally.step, (None, 0, 0, 0, *(0 for _ in places))))
    found = step(tables, state, stroke, drawn, *places)
    assert np.array_equal(found.terminated, following < 0)
    assert np.array_equal(found.state, np.where(following < 0, rally.init(), following))
    assert np.array_equal(found.reward, (outcome == WINNER).astype(np.float32) - (outcome == FAULT))
    seen, mask = jax.jit(jax.vmap(rally.observe, (None, 0)))(tables, state)
    assert np.array_equal(seen[:, :7], game.observation(state))
    assert np.array_equal(mask[:, : game.n_strokes], game.mask(state))

"""Positions that the striker sees, against matrices that are written out; planted aims and effects."""

import numpy as np
import pytest

from experiments.recovery_bracket import Seen
from experiments.truth.recovery import Judged, aims, by_discipline
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import MOVEMENT
from shuttle_marl.exact import solve
from shuttle_marl.exact.fixed_point import TOLERANCE, solve_players
from shuttle_marl.exact.profile import positions_of
from shuttle_marl.exact.saddles import Saddle
from shuttle_marl.game.court import HANDS
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from tests.dynamics.rows import plain_rows
from tests.exact.exact_games import random_game, random_policy
from tests.exact.test_hidden_positions_solved import entries, waiting, with_recovery


def game_of(seed: int) -> Game:
    """Two serves and a few strokes; for some seeds duels, for some two or three levels of effort."""
    return with_recovery(random_game(seed, 3 + seed % 3), seed)


@pytest.mark.parametrize("seed", range(6))
def test_seen_values_are_minima_of_maxima(seed: int) -> None:
    """In every state, so that they are the fixed point of the equation that defines them; the policy attains them."""
    game = game_of(seed)
    seen = Seen(game)
    value = solve_players(seen, None, TOLERANCE)[0]
    assert value.error_bound <= TOLERANCE
    policy = seen.policy(value.striking[1])
    strokes, positions = policy.pair_probabilities(), positions_of(policy)
    for state in np.flatnonzero(np.diff(game.pair_start)).tolist():
        matrix = entries(game, state, value.striking[1])
        assert value.striking[0][state] == pytest.approx(matrix.max(axis=0).min(), abs=1e-8)
        those = game.waiting.position[state % game.n_base_states][: matrix.shape[1]]
        played = strokes[game.pairs_of(state)] @ matrix @ positions[state, those]
        assert played == pytest.approx(value.striking[0][state], abs=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_against_known_positions_values_are_means_of_maxima(seed: int) -> None:
    game = game_of(seed)
    positions = positions_of(waiting(random_policy(game, seed), seed))
    value = solve_players(Seen(game, positions), Saddle((game,)), TOLERANCE)[0]
    for state in np.flatnonzero(np.diff(game.pair_start)).tolist():
        matrix = entries(game, state, value.striking[1])
        those = game.waiting.position[state % game.n_base_states][: matrix.shape[1]]
        assert value.striking[0][state] == pytest.approx(matrix.max(axis=0) @ positions[state, those], abs=1e-8)


def test_who_sees_is_worth_more_everywhere() -> None:
    """Of two perfect players one sees: no value of that one is below, none of the other one above that of the hidden game."""
    gained = 0
    for seed in range(6):
        game = game_of(seed)
        hidden = solve(game).value[0]
        sees, blind = solve_players(Seen(game), Saddle((game,)), TOLERANCE)[0].striking
        assert (sees >= hidden - 1e-8).all()
        assert (blind <= hidden + 1e-8).all()
        gained += int((sees > hidden + 1e-4).any())
    assert gained >= 4, "games in which perfect play mixes"


def test_planted_aims_are_recovered() -> None:
    """Half of the receivers are left-handed; strokes that stayed in, of other shot types or of unknown positions do not count."""
    n, rng = 16_000, np.random.default_rng(0)
    place, left = rng.normal(0, 0.8, n), rng.random(n) < 0.5
    shot = rng.choice([SHOTS.index(name) for name in ("push", "clear", "smash", "drop", "short-serve")], n).astype(np.int16)
    flat, out = shot == SHOTS.index("push"), rng.random(n) < 0.5
    forehand = rng.random(n) < 1 / (1 + np.exp(np.where(out & flat, 1.0, 0.0) * place))
    waits = np.stack([np.where(rng.random(n) < 0.1, np.nan, place), np.full(n, 3.0)], axis=1).astype(np.float32)
    rows = plain_rows(
        n,
        codes={"shot": shot, "hands": left.astype(np.int16)},
        outcome=np.where(out, Outcome.FAULT, Outcome.RETURNED).astype(np.int8),
        reason=np.full(n, REASONS.index("out"), np.int8),
        receiver_hand=np.where(left, HANDS.index("left"), HANDS.index("right")).astype(np.int8),
        match=rng.integers(0, 20, n).astype(np.int32),
        waiting=waits,
        movement=rng.normal(0, 1, (n, len(MOVEMENT))).astype(np.float32),
    )
    landing = np.where(forehand != left, -1.0, 1.0) * rng.uniform(0.1, 3, n)
    found = aims(rows, landing, rng.dirichlet(np.ones(9), n))
    flat_ones, high_ones = found["flat"]["state"], found["high"]["state"]
    assert flat_ones["strokes"] == pytest.approx((flat & out).sum() * 0.9, rel=0.03)
    assert flat_ones["value"] == pytest.approx(-1, abs=0.25)
    assert flat_ones["low"] < flat_ones["value"] < flat_ones["high"] < -0.6
    assert high_ones["low"] < 0 < high_ones["high"]
    assert found["flat"]["contact"]["value"] == pytest.approx(flat_ones["value"], abs=0.1), "contact points that tell nothing"


def test_effects_are_judged_in_each_discipline() -> None:
    """Predicted shifts that happen to women and not to men."""
    n, rng = 40_000, np.random.default_rng(0)
    match = rng.integers(0, 40, n).astype(np.int32)
    women = match >= 20
    logit, shift = rng.normal(-2, 0.5, n), rng.normal(0, 0.6, n)
    happened = rng.random(n) < 1 / (1 + np.exp(-logit - shift * women))
    rows = plain_rows(n, codes={"discipline": women.astype(np.int16)}, match=match, matches=tuple(map(str, range(40))))
    found = by_discipline([Judged(match, logit, shift, happened)] * 3, rows)
    for of, slope, sign in ((found["MS"]["winner"], 0, 1), (found["WS"]["winner"], 1, -1)):
        assert of["slope_low"] < slope < of["slope_high"]
        assert min(sign * of["low"], sign * of["high"]) > 0
    assert sum(found[name]["winner"]["strokes"] for name in ("MS", "WS")) == n

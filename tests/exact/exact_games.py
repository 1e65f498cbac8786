"""Small games for the tests of exact values, and an oracle that shares no code with the solvers."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st
from scipy.sparse import coo_array, eye_array
from scipy.sparse.linalg import spsolve

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.game.draws import HURRY_ONE, ONE
from shuttle_marl.game.layout import base_pairs, layout
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.stroke import SHOTS, Catalogue
from shuttle_marl.game.tables import Game, thresholds

Floats = npt.NDArray[np.float64]

THREE_STROKES = ("short-serve:front-centre:below:backhand", "smash:middle-left:above:forehand", "lift:back-centre:below:forehand")
OUTCOMES = {  # fault, winner, returned from below, returned from above, in sixteenths
    "short-serve": (2, 0, 7, 7),
    "smash": (2, 6, 4, 4),
    "lift": (4, 0, 4, 8),
    "clear": (1, 0, 12, 3),
}


def hand_made(names: tuple[str, ...] = THREE_STROKES) -> Game:
    """A serve, then strokes whose probabilities depend on the shot type alone, each legal whenever the contact is its own."""
    catalogue = Catalogue.from_names(names)
    rally = ~catalogue.is_serve
    tables = layout(catalogue, np.vstack([np.tile(rally, (len(names), 1)), catalogue.is_serve]))
    fixed = np.array([np.cumsum(OUTCOMES[name.split(":")[0]])[:3] for name in names]) * ONE // 16
    hurry = np.full((base_pairs(tables), 2), 64, np.uint8)
    game = Game(catalogue=catalogue, threshold=np.zeros((len(hurry), 3), np.uint16), hurry=hurry, **tables)
    return dataclasses.replace(game, threshold=fixed[game.pair_stroke].astype(np.uint16))


def small_catalogue(rng: np.random.Generator, rallies: int) -> Catalogue:
    """Two serves, and strokes of which at least one is played from above and one from below."""
    serves = ["short-serve:front-centre:below:backhand", "long-serve:back-left:below:forehand"]
    heights = ["below", "above", *rng.choice(["below", "above"], rallies - 2)]
    names = {f"{SHOTS[2 + 8 * i % 11]}:middle-left:{height}:forehand" for i, height in enumerate(heights)}
    return Catalogue.from_names([*serves, *sorted(names)])


def random_replies(rng: np.random.Generator, catalogue: Catalogue, density: float) -> Bools:
    """``[n + 1, n]`` legal replies to each stroke, and in the last row the serves."""
    n = len(catalogue)
    replies = rng.random((n + 1, n)) < density
    for contact in (0, 1):
        can = np.flatnonzero((catalogue.height == contact) & ~catalogue.is_serve)
        replies[np.arange(n), rng.choice(can, n)] = True
    replies[:n, catalogue.is_serve] = False
    replies[n] = catalogue.is_serve
    return replies


def random_game(seed: int, rallies: int = 5, density: float = 0.5) -> Game:
    """Two serves and ``rallies`` further strokes that may answer each other, all of it drawn at random.

    Every second game counts duels, every third one to three levels of effort.
    """
    rng = np.random.default_rng(seed)
    catalogue = small_catalogue(rng, rallies)
    tables = layout(catalogue, random_replies(rng, catalogue, density), duels=seed % 2 == 1)
    odds = [ONE, *rng.integers(ONE // 2, 2 * ONE, seed % 3).tolist()]
    return with_probabilities(game_without_outcomes(catalogue, tables, odds), seed)


def game_without_outcomes(catalogue: Catalogue, tables: dict[str, Any], odds: Sequence[int] = (ONE,)) -> Game:
    """A game whose probabilities are still to be set."""
    size = base_pairs(tables)
    threshold, hurry = np.zeros((size, 3), np.uint16), np.zeros((size, 2), np.uint8)
    return Game(catalogue=catalogue, threshold=threshold, hurry=hurry, fault_odds=np.array(odds, np.int32), **tables)


TIRING_STROKES = (
    "short-serve:front-centre:below:backhand",
    "clear:back-left:above:forehand",
    "cross-court-net-shot:front-left:below:forehand",
    "half-smash:middle-right:above:around-the-head",
    "lift:back-centre:below:forehand",
    "net-shot:front-centre:below:forehand",
    "net-shot:front-right:above:backhand",
    "smash:middle-left:above:forehand",
)


def tiring_game() -> Game:
    """Long rallies of smashes and net shots, so that all lengths of duels and all three levels of effort are often met."""
    catalogue = Catalogue.from_names(TIRING_STROKES)
    n = len(catalogue)
    replies = np.vstack([np.tile(~catalogue.is_serve, (n, 1)), catalogue.is_serve])
    tables = layout(catalogue, replies, duels=True)
    rng = np.random.default_rng(0)
    good, returned, above = rng.uniform([[0.85], [0.9], [0.3]], [[0.95], [0.98], [0.7]], (3, base_pairs(tables)))
    odds = np.array([ONE, 3 * ONE // 2, 3 * ONE], np.int32)
    hurry = rng.integers(32, 128, (base_pairs(tables), 2), dtype=np.uint8)
    return Game(catalogue=catalogue, threshold=thresholds(good, returned, above), hurry=hurry, fault_odds=odds, **tables)


def with_probabilities(game: Game, seed: int) -> Game:
    """A game of the same layout with other probabilities; good and returned ones between 0.3 and 0.97, others of all sizes."""
    rng = np.random.default_rng([seed, 1])
    good, returned = rng.uniform(0.3, 0.97, (2, game.n_base_pairs))
    above = rng.uniform(0, 1, len(good))
    hurry = rng.integers(0, HURRY_ONE, (len(good), 2), dtype=np.uint8)
    return dataclasses.replace(game, threshold=thresholds(good, returned, above), hurry=hurry)


def random_policy(game: Game, seed: int, sharpness: float = 1.0) -> TabulatedPolicy:
    """Probabilities drawn from a Dirichlet distribution in every state; sharper ones play fewer strokes."""
    weight = np.random.default_rng([seed, 2]).gamma(1 / sharpness, size=game.n_pairs) + 1e-9
    return from_pair_probabilities(game, weight / np.bincount(game.pair_state, weight, game.n_states)[game.pair_state])


games = st.builds(random_game, st.integers(0, 10_000), st.integers(2, 7), st.floats(0.0, 1.0))
seeds = st.integers(0, 10_000)


def pairs_of(game: Game, state: int) -> range:
    """Legal pairs of a state."""
    return range(int(game.pair_start[state]), int(game.pair_start[state + 1]))


def linear_values(games: tuple[Game, Game], probabilities: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Values of a profile of ``[P]`` probabilities by one sparse linear system over the states of both players."""
    size, entries, places, constant = 2 * games[0].n_states, [], [], np.zeros(2 * games[0].n_states)
    for player, (game, probability) in enumerate(zip(games, probabilities, strict=True)):
        outcome = probability[:, None] * game.outcome_probabilities()
        row = player * size // 2 + game.pair_state
        following = (1 - player) * size // 2 + game.arrivals()
        constant += np.bincount(row, outcome[:, 1] - outcome[:, 0], size)
        entries.append(outcome[:, 2:].ravel())
        places.append([np.repeat(row, 4), following.ravel()])
    returned = coo_array((np.concatenate(entries), tuple(np.concatenate(places, axis=1))), (size, size))
    solution: F64 = np.asarray(spsolve((eye_array(size) + returned).tocsc(), constant), np.float64)
    return solution[: size // 2], solution[size // 2 :]


def improved(game: Game, following: Floats) -> Floats:
    """``[P]`` the best stroke of every state, given the values of the next states to the receiver."""
    outcome, probability = game.outcome_probabilities(), np.zeros(game.n_pairs)
    worth = outcome[:, 1] - outcome[:, 0] - (outcome[:, 2:] * following[game.arrivals()]).sum(axis=1)
    for state in np.flatnonzero(np.diff(game.pair_start)).tolist():
        pairs = pairs_of(game, state)
        probability[pairs[int(np.argmax(worth[pairs.start : pairs.stop]))]] = 1
    return probability


def response_by_policy_iteration(games: tuple[Game, Game], opponent: Floats) -> tuple[Floats, Floats]:
    """Values of player 0's best response to ``[P]`` probabilities of player 1 (Howard 1960)."""
    probability = improved(games[0], np.zeros(games[0].n_states))
    while True:
        values = linear_values(games, (probability, opponent))
        better = improved(games[0], values[1])
        if np.array_equal(better, probability):
            return values
        probability = better


def minimax_by_policy_iteration(games: tuple[Game, Game]) -> tuple[Floats, Floats]:
    """Minimax values by strategy iteration: improve player 1 against the best response of player 0 (Hoffman & Karp 1966)."""
    probability = improved(games[1], np.zeros(games[1].n_states))
    while True:
        values = response_by_policy_iteration(games, probability)
        better = improved(games[1], values[0])
        if np.array_equal(better, probability):
            return values
        probability = better

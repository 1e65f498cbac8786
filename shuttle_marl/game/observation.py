"""Numbers that a player sees of a rally: the vector of ``rally_v0``, for networks of one's own too."""

from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, I32, Bools, Ints
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.layout import LONGEST_DUEL, Layout
from shuttle_marl.game.stroke import HEIGHTS, N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import GameError

PARTS: Final = (N_SHOTS, N_AREAS, len(HEIGHTS), N_TECHNIQUES)
"""Number of shot types, areas, heights and techniques: the four components of a stroke."""
STROKE_WIDTH: Final = sum(PARTS)
"""Numbers that describe one stroke: the one-hots of its four components; all zero for "none yet"."""
CONTACT: Final = 2 * STROKE_WIDTH
"""Position of the contact offered to the striker (1: above the net)."""
SERVE: Final = CONTACT + 1
"""Position of the flag that a serve is due."""
DUEL: Final = SERVE + 1
"""Position of the number of net shots in a row, divided by 3."""
EFFORT: Final = DUEL + 1
"""Position of the own effort, divided by the highest one; the opponent's follows."""
HURRIED: Final = EFFORT + 2
"""Position of the flag that the striker is hurried."""
RALLY_WIDTH: Final = HURRIED + 1
"""Length of an observation of a rally."""
SCORE_WIDTH: Final = 6
"""Points, games and serving flag of both players; only in a match."""

SWAP: Final = np.r_[STROKE_WIDTH : 2 * STROKE_WIDTH, :STROKE_WIDTH, CONTACT, SERVE, DUEL, EFFORT + 1, EFFORT, HURRIED]
"""Permutation that turns the striker's observation into the receiver's."""

SWAP_TOKENS: Final = np.array([1, 0, 2, 3, 5, 4, 6])
"""The same of the numbers of :meth:`shuttle_marl.game.layout.Layout.observation`."""


def stroke_features(game: Layout) -> F32:
    """``[n + 1, 27]`` one-hots of shot type, area, height and technique; the last row ("none yet") is zero."""
    catalogue = game.catalogue
    table = np.zeros((len(catalogue) + 1, STROKE_WIDTH), dtype=np.float32)
    rows = np.arange(len(catalogue))
    columns = (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)
    for offset, column in zip(np.r_[0, np.cumsum(PARTS)[:-1]], columns, strict=True):
        table[rows, offset + column] = 1
    return table


def features(game: Layout) -> F32:
    """``[base states, 60]`` observation of the striker in every state without efforts; :func:`with_efforts` writes those.

    0-26 own last stroke, 27-53 the incoming stroke, 54 the contact offered (1 above, 0 below the net), 55 whether a serve
    is due, 56 net shots in a row, 57 own effort and 58 the opponent's, these three as shares of the highest number, 59 whether
    the striker is hurried.
    """
    strokes = stroke_features(game)
    own, incoming, contact, duel, effort, other, hurried = game.observation(np.arange(game.n_base_states)).T
    rest = np.stack([contact, incoming == game.n_strokes, duel / LONGEST_DUEL, effort, other, hurried], axis=1)
    return np.concatenate([strokes[own], strokes[incoming], rest], axis=1, dtype=np.float32)


def with_efforts(game: Layout, rows: F32, state: Ints, receives: Bools | None = None) -> F32:
    """``[B, 60]`` observations of ``[B]`` states, from the rows of :func:`features`.

    Args:
        receives: ``[B]`` whether the receiver looks, whose rows follow all those of the striker; None: the striker always does.
    """
    base, own, other = game.base(state), game.effort(state), game.opponent_effort(state)
    if receives is not None:
        base, own, other = base + game.n_base_states * receives, np.where(receives, other, own), np.where(receives, own, other)
    found: F32 = rows.take(base, axis=0)
    highest = max(1, game.levels - 1)
    found[:, EFFORT], found[:, EFFORT + 1] = own / highest, other / highest
    return found


def observations(game: Layout, state: npt.ArrayLike) -> F32:
    """``[B, 60]`` what the striker sees in each of ``[B]`` states, as ``rally_v0`` shows it."""
    return with_efforts(game, features(game), np.asarray(state))


def states_of(game: Layout, observation: npt.ArrayLike) -> I32:
    """``[B]`` states of ``[B, 60]`` observations of the player who is to strike: the inverse of :func:`observations`.

    Args:
        observation: of ``rally_v0``, or longer ones of ``match_v0``, whose scores are ignored.

    Raises:
        GameError: an observation is of no state of the game.
    """
    seen = np.asarray(observation, dtype=np.float64)
    if seen.ndim != 2 or seen.shape[1] < RALLY_WIDTH:
        raise GameError(f"observations of shape {seen.shape}: expected [B, {RALLY_WIDTH}] or wider")
    if not np.isfinite(seen).all():
        raise GameError("observations contain numbers that are not finite")
    table = stroke_features(game)  # the last row is "no stroke yet"
    parts = (seen[:, :STROKE_WIDTH], seen[:, STROKE_WIDTH : 2 * STROKE_WIDTH])
    own, incoming = (((part[:, None] - table) ** 2).sum(axis=-1).argmin(axis=1) for part in parts)
    efforts = np.rint(seen[:, [EFFORT, EFFORT + 1]] * max(1, game.levels - 1)).astype(np.int64)
    duel = np.rint(seen[:, DUEL] * LONGEST_DUEL).astype(np.int64)
    contact, hurried = np.rint(seen[:, [CONTACT, HURRIED]]).astype(np.int64).T
    effort, opponent_effort = efforts.T
    state = game.state_of(own, incoming, contact, duel, effort, opponent_effort, hurried)
    wrong = state < 0
    wrong[~wrong] = np.abs(observations(game, state[~wrong]) - seen[~wrong, :RALLY_WIDTH]).max(axis=1, initial=0) > 1e-3
    if wrong.any():
        raise GameError(f"observation {int(wrong.argmax())} is of no state of the game with this player to strike")
    return state

"""What a player sees, as numbers in [0, 1]."""

from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.rally import Game
from shuttle_marl.game.stroke import HEIGHTS, N_SHOTS, N_TECHNIQUES

PARTS: Final = (N_SHOTS, N_AREAS, len(HEIGHTS), N_TECHNIQUES)
"""Number of shot types, areas, heights and techniques: the four components of a stroke."""
STROKE_WIDTH: Final = sum(PARTS)
"""Numbers that describe one stroke: the one-hots of its four components; all zero for "none yet"."""
CONTACT: Final = 2 * STROKE_WIDTH
"""Position of the contact offered to the striker (1: above the net)."""
SERVE: Final = CONTACT + 1
"""Position of the flag that a serve is due."""
RALLY_WIDTH: Final = SERVE + 1
"""Length of an observation of a rally."""
SCORE_WIDTH: Final = 6
"""Points, games and serving flag of both players; only in a match."""

SWAP: Final = np.r_[STROKE_WIDTH : 2 * STROKE_WIDTH, :STROKE_WIDTH, CONTACT, SERVE]
"""Permutation that turns the striker's observation into the receiver's."""


def stroke_features(game: Game) -> npt.NDArray[np.float32]:
    """``[n + 1, 27]`` one-hots of shot type, area, height and technique; the last row ("none yet") is zero."""
    catalogue = game.catalogue
    table = np.zeros((len(catalogue) + 1, STROKE_WIDTH), dtype=np.float32)
    rows = np.arange(len(catalogue))
    columns = (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)
    for offset, column in zip(np.r_[0, np.cumsum(PARTS)[:-1]], columns, strict=True):
        table[rows, offset + column] = 1
    return table


def features(game: Game) -> npt.NDArray[np.float32]:
    """``[S, 56]`` observation of the striker in every state.

    0-26 own last stroke, 27-53 the incoming stroke, 54 the contact offered (1 above, 0 below the net), 55 whether a serve
    is due.
    """
    strokes = stroke_features(game)
    edge, contact = np.divmod(np.arange(game.n_states), 2)
    own, incoming = game.edge_own[edge], game.edge_incoming[edge]
    serve = incoming == game.n_strokes
    return np.concatenate([strokes[own], strokes[incoming], np.stack([contact, serve], axis=1)], axis=1, dtype=np.float32)

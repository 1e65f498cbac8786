"""Games of any size, to measure its effect on speed: random replies, random probabilities, the same rules."""

import itertools
from typing import Final

import numpy as np

from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue
from shuttle_marl.game.tables import HURRY_ONE, Game
from shuttle_marl.game.tabulated import base_pairs, layout, thresholds

_SERVES: Final = 4
"""Strokes of a synthetic catalogue that are serves."""


def synthetic_game(strokes: int, replies: int, seed: int = 0) -> Game:
    """A game of ``strokes`` strokes, with ``replies`` legal strokes in every state but the first.

    A rally lasts about eight strokes: between 85 and 99 % of the strokes are good, and as many of those come back.

    Args:
        strokes: size of the catalogue.
        replies: legal strokes of a state, at most all of the contact's; the game has about ``8 strokes * replies`` states and
            ``replies`` times as many legal pairs.
        seed: of the replies and the probabilities.
    """
    rng = np.random.default_rng(seed)
    every = [":".join(parts) for parts in itertools.product(SHOTS, AREAS, HEIGHTS, TECHNIQUES)]
    serves = [name for name in every if "serve" in name][:_SERVES]
    others = [name for name in every if "serve" not in name]
    catalogue = Catalogue.from_names([*serves, *rng.choice(others, strokes - _SERVES, replace=False)])
    legal = np.zeros((strokes + 1, strokes), np.bool_)
    legal[strokes] = catalogue.is_serve
    for contact in (0, 1):
        own = np.flatnonzero((catalogue.height == contact) & ~catalogue.is_serve)
        for stroke in range(strokes):
            legal[stroke, rng.choice(own, min(replies, len(own)), replace=False)] = True
    tables = layout(catalogue, legal)
    pairs = base_pairs(tables)
    good, returned = rng.uniform(0.85, 0.99, (2, pairs))
    threshold = thresholds(good, returned, rng.uniform(0, 1, pairs))
    return Game(catalogue=catalogue, threshold=threshold, hurry=rng.integers(0, HURRY_ONE // 2, (pairs, 2), np.uint8), **tables)

"""A model whose game is so small that a tournament on it takes a fraction of a second."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import base_pairs, layout
from shuttle_marl.game.thresholds import ONE

NAMES = ("short-serve:front-centre:below:backhand", "smash:middle-left:above:forehand", "lift:back-centre:below:forehand")
OUTCOMES = {"short-serve": (2, 2, 9), "smash": (2, 8, 12), "lift": (4, 4, 8)}
"""Fault, or winner, or returned from below: cumulative, in sixteenths."""


@pytest.fixture(scope="session")
def small_model(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Name of a model: a serve, a smash and a lift."""
    folder = tmp_path_factory.mktemp("model")
    catalogue = Catalogue.from_names(NAMES)
    replies = np.vstack([np.tile(~catalogue.is_serve, (len(NAMES), 1)), catalogue.is_serve])
    tables = layout(catalogue, replies)
    pairs = base_pairs(tables)
    hurry = np.full((pairs, 2), 64, np.uint8)
    game = Game(catalogue=catalogue, threshold=np.zeros((pairs, 3), np.uint16), hurry=hurry, **tables)
    outcomes = np.array([OUTCOMES[name.partition(":")[0]] for name in NAMES]) * ONE // 16
    dataclasses.replace(game, threshold=outcomes[game.pair_stroke].astype(np.uint16)).save(folder / "game.safetensors")
    return str(folder)

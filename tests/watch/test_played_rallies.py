"""Rallies of the live court, played by policies."""

import dataclasses

import numpy as np

from shuttle_marl.game.draws import stream
from shuttle_marl.game.scoring import Score
from shuttle_marl.watch.match import play_rally
from tests.recovery import Prefers, small_recovery_game

GAME = small_recovery_game()
POLICIES = (Prefers(weights=(1.0,) * 9), Prefers(weights=tuple(range(1, 10))))


def test_a_rally_goes_on_from_each_of_its_strokes() -> None:
    """Draws belong to the number of a stroke, so what was played up to there is kept and what follows is the same."""
    for number in range(3):
        about = number, ("a", "b"), Score(server=number % 2)
        rally = play_rally(GAME, POLICIES, stream(7, 0, number), about, {})
        assert rally.waited is not None
        assert len(rally.waited) == len(rally.stroke) == len(rally.hurried)
        for kept in range(len(rally.stroke)):
            again = play_rally(GAME, POLICIES, stream(7, 0, number), about, {}, begun=(rally, kept))
            for name in ("stroke", "hurried", "waited"):
                assert (getattr(again, name) == getattr(rally, name)).all(), (number, kept, name)
            assert again.ending == rally.ending


def test_positions_of_kept_strokes_may_be_unknown() -> None:
    about = 0, ("a", "b"), Score(server=0)
    rally = next(
        found for seed in range(20) if len((found := play_rally(GAME, POLICIES, stream(seed, 0, 0), about, {})).stroke) > 3
    )
    unknown = dataclasses.replace(rally, waited=None)
    again = play_rally(GAME, POLICIES, np.zeros(1, np.uint64), about, {}, begun=(unknown, 2))
    assert again.waited is None
    assert (again.stroke[:2] == rally.stroke[:2]).all()

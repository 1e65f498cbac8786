"""Rallies of the live court, played by policies."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.court import WatchError
from shuttle_marl.court.match import CourtRally, play_rally
from shuttle_marl.court.plan import Person
from shuttle_marl.game.draws import stream
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.scoring import Score
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import hand_made
from tests.recovery import Prefers, small_recovery_game

POLICIES = (Prefers(weights=(1.0,) * 9), Prefers(weights=tuple(range(1, 10))))


def test_a_rally_goes_on_from_each_of_its_strokes() -> None:
    """Draws belong to the number of a stroke, so what was played up to there is kept and what follows is the same."""
    for number in range(3):
        about = number, ("a", "b"), Score(server=number % 2)
        rally = play_rally(small_recovery_game(), POLICIES, stream(7, 0, number), about, {})
        assert len(rally.waited) == len(rally.stroke) == len(rally.hurried)
        for kept in range(len(rally.stroke)):
            again = play_rally(small_recovery_game(), POLICIES, stream(7, 0, number), about, {}, begun=(rally, kept))
            for name in ("stroke", "hurried", "waited"):
                assert (getattr(again, name) == getattr(rally, name)).all(), (number, kept, name)
            assert again.ending == rally.ending


def test_positions_of_kept_strokes_may_be_unknown() -> None:
    about = 0, ("a", "b"), Score(server=0)
    rallies = (play_rally(small_recovery_game(), POLICIES, stream(seed, 0, 0), about, {}) for seed in range(20))
    rally = next(rally for rally in rallies if len(rally.stroke) > 3)
    unknown = dataclasses.replace(rally, waited=np.full(len(rally), -1))
    again = play_rally(small_recovery_game(), POLICIES, np.zeros(1, np.uint64), about, {}, begun=(unknown, 2))
    assert (again.waited < 0).all()
    assert (again.stroke[:2] == rally.stroke[:2]).all()


def test_rallies_are_played_to_their_end_or_to_the_turn_of_a_person() -> None:
    game = hand_made()
    policies = (resolve("random", game), resolve("random", game))

    def play(number: int, chosen: dict[int, int] | None = None, person: Person | None = None, **options: Any) -> CourtRally:
        about = number, ("a", "b"), Score(server=number % 2)
        return play_rally(game, policies, stream(5, 0, number), about, chosen or {}, person, **options)

    lengths = set()
    for number in range(20):
        rally = play(number)
        lengths.add(len(rally))
        assert (rally.turn, rally.receives, rally.chosen, rally.waited.max()) == (None, False, (), -1)
        assert rally.ending < RETURNED_BELOW
        assert rally.winner in (0, 1)
        assert (rally.server, rally.key) == (number % 2, int(stream(5, 0, number)[0]) >> 1)
        again = play(number, dict(enumerate(rally.stroke.tolist())) | {99: 0})
        assert again.stroke.tolist() == rally.stroke.tolist()
        assert again.chosen == tuple(range(len(rally))), "strokes after the end are not played"
        states = rally.states(game).tolist()
        for seat in (0, 1):
            mine = play(number, person=Person(seat=seat, rally=number, stroke=0))
            before = int(seat != number % 2)
            assert (len(mine), mine.receives) == (min(before, len(rally)), False)
            if len(rally) > before:
                assert (mine.turn, mine.winner) == (states[before], None)
                assert mine.ending == RETURNED_BELOW or (before and mine.ending > RETURNED_BELOW)
            assert play(number, person=Person(seat=seat, rally=number + 1, stroke=0)).stroke.tolist() == rally.stroke.tolist()
        kept = len(rally) - 1
        with pytest.raises(WatchError, match=f"rally {number + 1}: the stroke chosen as number {len(rally)} is not legal there"):
            play(number, {kept: next(k for k in range(game.n_strokes) if k not in game.legal_strokes(states[kept]))})
    assert len(lengths) > 2

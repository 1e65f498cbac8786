"""The umpire of the staging's benchmark sees breaches of the rules in frames that are changed by hand."""

import dataclasses
from collections.abc import Iterator

import pytest

from benchmarks.court_rules import Breaches, Umpire
from benchmarks.staging import match_rallies
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.staging import Motion, stage

NONE = Breaches()


def played() -> Iterator[tuple[Rally, Umpire]]:
    """Rallies of a match, and the umpire before each."""
    umpire = Umpire(server=0)
    for rally in match_rallies("bc", seed=0):
        if rally.match:
            return
        yield rally, dataclasses.replace(umpire, points=[*umpire.points], games=[*umpire.games])
        assert rally.winner is not None
        umpire.award(rally.winner)


@pytest.fixture(scope="module")
def found() -> list[tuple[Motion, Umpire]]:
    """Short rallies of three or more strokes: with an even and an odd score in the first game, one in the second."""
    wanted = [(0, 0), (0, 1), (1, 0)]
    out, rallies = [], list(played())
    for game, odd in wanted:
        rally, umpire = next(
            (rally, umpire)
            for rally, umpire in rallies
            if 3 <= len(rally) <= 5 and sum(umpire.games) == game and umpire.points[rally.server] % 2 == odd
        )
        out.append((stage(rally, seed=1), umpire))
    return out


def breaches(motion: Motion, umpire: Umpire) -> Breaches:
    out = Breaches()
    out.look(motion, umpire)
    return out


def test_wrong_courts_and_ends_are_seen(found: list[tuple[Motion, Umpire]]) -> None:
    for motion, umpire in found:
        assert breaches(motion, umpire) == NONE
        other = dataclasses.replace(umpire, points=[point + 1 for point in umpire.points])
        assert breaches(motion, other) == dataclasses.replace(NONE, wrong_service_court=1)
        other = dataclasses.replace(umpire, swapped=not umpire.swapped)
        assert breaches(motion, other).wrong_end == 1
        place = motion.position.copy()
        place[motion.contact_frame[0], 1 - motion.trajectory.rally.server, :, 0] *= -1  # the receiver faces the server
        assert breaches(dataclasses.replace(motion, position=place), umpire) == dataclasses.replace(NONE, wrong_service_court=1)

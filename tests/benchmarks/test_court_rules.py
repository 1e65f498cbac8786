"""The umpire of the staging's benchmark sees breaches of the rules in frames that are changed by hand."""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
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
    out = []
    for game, odd in wanted:
        rally, umpire = next(
            (rally, umpire)
            for rally, umpire in played()
            if 3 <= len(rally) <= 5 and sum(umpire.games) == game and umpire.points[rally.server] % 2 == odd
        )
        out.append((stage(rally, seed=1), umpire))
    return out


def breaches(motion: Motion, umpire: Umpire) -> Breaches:
    out = Breaches()
    out.look(motion, umpire)
    return out


def test_the_umpire_counts_as_the_game_does() -> None:
    for rally, umpire in played():
        assert (umpire.server, tuple(umpire.points), tuple(umpire.games)) == (rally.server, rally.points, rally.games)
        assert umpire.swapped is rally.ends_changed


def test_ends_change_at_eleven_in_the_third_game() -> None:
    umpire = Umpire(server=0)
    for winner in (*(0 for _ in range(21)), *(1 for _ in range(21))):
        umpire.award(winner)
    seen = [umpire.swapped]
    for winner in (0,) * 10 + (1,) * 12:
        umpire.award(winner)
        seen.append(umpire.swapped)
    assert umpire.games == [1, 1]
    assert [a for a, b in itertools.pairwise(range(len(seen))) if seen[a] != seen[b]] == [20], "with the eleventh point of either"


def test_staged_rallies_break_no_rule(found: list[tuple[Motion, Umpire]]) -> None:
    for motion, umpire in found:
        assert breaches(motion, umpire) == NONE


def test_wrong_courts_and_ends_are_seen(found: list[tuple[Motion, Umpire]]) -> None:
    for motion, umpire in found:
        other = dataclasses.replace(umpire, points=[point + 1 for point in umpire.points])
        assert breaches(motion, other) == dataclasses.replace(NONE, wrong_service_court=1)
        other = dataclasses.replace(umpire, swapped=not umpire.swapped)
        assert breaches(motion, other).wrong_end == 1
        place = motion.position.copy()
        place[motion.contact_frame[0], 1 - motion.trajectory.rally.server, :, 0] *= -1  # the receiver faces the server
        assert breaches(dataclasses.replace(motion, position=place), umpire) == dataclasses.replace(NONE, wrong_service_court=1)


def test_low_crossings_are_seen(found: list[tuple[Motion, Umpire]]) -> None:
    motion, umpire = found[0]
    low = motion.shuttle.copy()
    low[:, 2] = np.minimum(low[:, 2], 1.5)
    crossings = (np.diff(np.sign(low[: motion.contact_frame[-1] + 1, 1])) != 0).sum()
    assert crossings == len(motion.contact_frame) - 1
    assert breaches(dataclasses.replace(motion, shuttle=low), umpire).low_net_crossings >= crossings


def test_double_hits_are_seen(found: list[tuple[Motion, Umpire]]) -> None:
    motion, umpire = found[0]
    frames = motion.contact_frame.copy()
    frames[1] = frames[0] + 1
    again = dataclasses.replace(motion, contact_frame=frames)
    assert breaches(again, umpire).double_hits == 2, "three strokes in a row by the same player"


def test_net_kills_from_behind_are_seen() -> None:
    rally, umpire = next(
        (rally, umpire)
        for rally, umpire in played()
        if len(rally) < 9 and any(rally.catalogue.names[k].startswith("net-kill") for k in rally.stroke)
    )
    motion = stage(rally, seed=1)
    assert breaches(motion, umpire) == NONE
    kill = next(i for i, k in enumerate(rally.stroke) if rally.catalogue.names[k].startswith("net-kill"))
    shuttle, frame = motion.shuttle.copy(), motion.contact_frame[kill]
    shuttle[frame, 1] = np.copysign(2.51, shuttle[frame, 1])
    assert breaches(dataclasses.replace(motion, shuttle=shuttle), umpire).kill_beyond_front == 1

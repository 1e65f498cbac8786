"""Matches in lock-step against matches played one stroke at a time."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.game import draws, scoring
from shuttle_marl.game.rules import OUTCOMES, WINNER, strike
from shuttle_marl.game.tables import ROOT
from shuttle_marl.kernel.lockstep import Matches, MatchResults, play
from shuttle_marl.league.entrants import Strikers, enter
from shuttle_marl.league.tournament import Pairing, groups, join, matches_of, round_robin
from tests.reduced import reduced_game

GAME = reduced_game()
NAMES = ("attacking", "safe", "random", "attacking@greedy")
ENTRANTS = [enter(name, GAME) for name in NAMES]
STRIKERS = Strikers(GAME, ENTRANTS)
SHORT = scoring.Rules(points=5, clear=2, cap=7, games=2)

Row = tuple[int, int, int, int, str, tuple[int, ...], list[int], list[int]]
"""Match, rally, server, winner, reason, score before, and strokes of a rally."""


def one_by_one(matches: Matches, rules: scoring.Rules) -> list[Row]:
    """Every rally, a stroke at a time."""
    rallies: list[Row] = []
    for m in range(len(matches)):
        score = scoring.Score(server=int(matches.first_server[m]), rules=rules)
        for rally in itertools.count():
            server = score.server
            key = draws.extend(matches.key[m : m + 1], 2 * rally + server)
            before = (*score.points, *score.games)
            state, striker = ROOT, server
            strokes, hurried = list[int](), list[int]()
            while True:
                bits = draws.draw(key, len(strokes))
                table = ENTRANTS[matches.entrant[m, striker]].table
                assert table is not None
                first, last = GAME.pair_start[state], GAME.pair_start[state + 1]
                k = int(np.searchsorted(table.cumulative[first:last], draws.choice_draw(bits)[0], side="right"))
                strokes.append(int(GAME.pair_stroke[first + k]))
                hurried.append(int(GAME.hurried(state)))
                outcome, following = strike(GAME, np.array([state]), np.array([k]), draws.outcome_draw(bits))
                if following[0] < 0:
                    break
                state, striker = int(following[0]), 1 - striker
            winner = striker if outcome[0] == WINNER else 1 - striker
            rallies.append((m, rally, server, winner, OUTCOMES[outcome[0]], before, strokes, hurried))
            score = score.after(winner)
            if score.over:
                break
    return rallies


def as_rows(results: MatchResults) -> list[Row]:
    played = results.rallies
    ends = np.cumsum(played.length)
    return [
        (
            int(played.match[i]),
            int(played.rally[i]),
            int(played.server[i]),
            int(played.winner[i]),
            OUTCOMES[played.reason[i]],
            tuple(int(x) for x in played.score[i]),
            played.stroke[ends[i] - played.length[i] : ends[i]].tolist(),
            played.hurried[ends[i] - played.length[i] : ends[i]].tolist(),
        )
        for i in range(len(played.length))
    ]


def some_matches(seed: int, first: int = 0, last: int = 4) -> Matches:
    return join([matches_of(pairing, seed, first, last) for pairing in round_robin(NAMES)])


@pytest.mark.parametrize("rules", [SHORT, scoring.BWF], ids=["short", "bwf"])
def test_lock_step_is_play_one_stroke_at_a_time(rules: scoring.Rules) -> None:
    matches = some_matches(seed=3, last=2 if rules is scoring.BWF else 6)
    played = play(GAME, matches, STRIKERS.choose, rules=rules)
    assert as_rows(played) == one_by_one(matches, rules)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**63 - 1), st.permutations(range(12)), st.integers(1, 11))
def test_company_never_changes_a_match(seed: int, order: list[int], cut: int) -> None:
    """All at once, and the same matches in another order in two batches."""
    matches = some_matches(seed, last=2)
    whole = as_rows(play(GAME, matches, STRIKERS.choose, rules=SHORT))
    for chosen in (order[:cut], order[cut:]):
        part = Matches(**{f.name: getattr(matches, f.name)[chosen] for f in dataclasses.fields(matches)})
        rows = as_rows(play(GAME, part, STRIKERS.choose, rules=SHORT))
        assert rows == [(i, *row[1:]) for i, m in enumerate(chosen) for row in whole if row[0] == m]


def test_equal_players_mirror_each_other_in_a_cell() -> None:
    """Both matches of a cell give each seat the same luck, so between equals the same seat wins both."""
    twins = Pairing(number=0, entrants=(0, 1), names=("a", "b"))
    strikers = Strikers(GAME, [ENTRANTS[0], ENTRANTS[0]])
    rows = as_rows(play(GAME, matches_of(twins, 0, 0, 20), strikers.choose))
    by_match = [[row[1:] for row in rows if row[0] == m] for m in range(20)]
    assert by_match[0::2] == by_match[1::2]
    assert by_match[0] != by_match[2]


def test_seats_and_first_serve_are_balanced() -> None:
    pairing = round_robin(NAMES)[2]
    matches = matches_of(pairing, 0, 0, 1000)
    at_seat_0 = matches.entrant[:, 0] == pairing.entrants[0]
    serves_first = matches.entrant[np.arange(1000), matches.first_server] == pairing.entrants[0]
    assert at_seat_0.sum() == serves_first.sum() == 500
    assert (at_seat_0 & serves_first).sum() == 250
    assert np.array_equal(matches.key[0::2], matches.key[1::2])
    assert len(np.unique(matches.key)) == 500


def test_other_entrants_and_their_order_change_nothing() -> None:
    def rallies(pool: tuple[str, ...]) -> list[Row]:
        pairing = next(p for p in round_robin(pool) if set(p.names) == {"safe", "random"})
        found = matches_of(pairing, 1, 0, 4)
        entrant = np.array([NAMES.index(name) for name in pool], dtype=np.int32)[found.entrant]
        return as_rows(play(GAME, dataclasses.replace(found, entrant=entrant), STRIKERS.choose, rules=SHORT))

    assert rallies(("safe", "random")) == rallies(NAMES) == rallies(("random", "attacking", "safe"))


def test_different_pairings_and_seeds_have_different_draws() -> None:
    pairings = round_robin(NAMES)
    keys = np.concatenate([matches_of(p, seed, 0, 100).key for p in pairings for seed in (0, 1)])
    assert len(np.unique(keys)) == 2 * len(pairings) * 50


@given(st.integers(2, 9), st.integers(1, 30), st.integers(1, 100), st.sets(st.integers(0, 35)))
def test_groups_hold_every_pairing_once_and_fit(n: int, cells: int, batch: int, alone: set[int]) -> None:
    pairings = round_robin([f"p{i}" for i in range(n)])
    made = list(groups(pairings, 2 * cells, batch, alone))
    assert [p for group in made for p in group] == pairings
    assert all(len(group) * 2 * cells <= batch for group in made if len(group) > 1)
    assert all(len(group) == 1 for group in made if alone & {p.number for p in group})

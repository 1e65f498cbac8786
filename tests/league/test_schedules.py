"""Forms of tournaments: their pairings, results and rounds."""

import contextlib
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game import draws, load_game
from shuttle_marl.game.rally import Rallies
from shuttle_marl.league import LeagueConfig
from shuttle_marl.league.tournament import COUNTS, Pairing, PairResult, forfeited, matches_of, stages, tally
from shuttle_marl.recording.reader import check
from tests.reduced import reduced_model
from tests.stops import Killed, stop
from tests.tournaments import play_league

POOL = ("random", "safe", "attacking", "defensive")
TABLES = ("results.csv", "ranking.csv", "pairings.jsonl")


def result(pairing: Pairing, won: int) -> PairResult:
    half = dict.fromkeys(COUNTS, 0) | {"matches": 5, "wins": won}
    return PairResult(pairing=pairing.number, names=pairing.names, seats=(half, dict(half)))


@given(st.integers(2, 9), st.integers(0, 6), st.randoms(use_true_random=False))
def test_swiss_rounds(n: int, rounds: int, luck: random.Random) -> None:
    pool = [f"p{i}" for i in range(n)]
    results: list[PairResult] = []
    known = stages(pool, "swiss", results, rounds=rounds)
    while len(results) < sum(map(len, known)):
        pairing = next(p for stage in known for p in stage if p.number == len(results))
        results.append(forfeited(pairing, pairing.names[:1], "") if luck.random() < 0.1 else result(pairing, luck.randrange(6)))
        following = stages(pool, "swiss", results, rounds=rounds)
        assert following[: len(known)] == known
        known = following
    met = [frozenset(pairing.names) for stage in known for pairing in stage]
    assert len(set(met)) == len(met)
    assert [pairing.number for stage in known for pairing in stage] == list(range(len(met)))
    rests = []
    for stage in known:
        players = [name for pairing in stage for name in pairing.names]
        assert len(set(players)) == len(players) == n - n % 2
        rests += sorted(set(pool) - set(players))
    assert len(set(rests)) == len(rests)
    assert 1 <= len(known) <= n - 1


def test_swiss_pairs_equals() -> None:
    known = stages("abcd", "swiss", [])
    results = [result(pairing, 5) for pairing in known[0]]
    assert [pairing.names for pairing in known[0]] == [("a", "b"), ("c", "d")]
    assert [pairing.names for pairing in stages("abcd", "swiss", results)[1]] == [("a", "c"), ("b", "d")]


def test_a_bye_counts_as_one_win() -> None:
    (first,) = stages("abcde", "swiss", [])
    assert [pairing.names for pairing in first] == [("a", "b"), ("c", "d")]
    results = [result(pairing, 5) for pairing in first]
    # Now a, c and e, which had the bye, have one point each; d rests.
    assert [pairing.names for pairing in stages("abcde", "swiss", results)[1]] == [("a", "c"), ("b", "e")]


def test_results_as_each_side_has_them() -> None:
    at_0 = {"matches": 3, "wins": 2, "games_won": 5, "games_lost": 2, "points_won": 130, "points_lost": 99, "served": 120}
    at_0 |= {"served_won": 70, "rallies": 229, "strokes": 2001}
    at_1 = {"matches": 3, "wins": 0, "games_won": 1, "games_lost": 6, "points_won": 80, "points_lost": 140, "served": 90}
    at_1 |= {"served_won": 33, "rallies": 220, "strokes": 1902}
    found = PairResult(pairing=0, names=("a", "b"), seats=(at_0, at_1), cells=(1, 2, 0))
    first = {"matches": 6, "wins": 2, "games_won": 6, "games_lost": 8, "points_won": 210, "points_lost": 239, "served": 210}
    assert found.seen_by("a") == first | {"served_won": 103, "rallies": 449, "strokes": 3903}
    second = {"matches": 6, "wins": 4, "games_won": 8, "games_lost": 6, "points_won": 239, "points_lost": 210, "served": 239}
    assert found.seen_by("b") == second | {"served_won": 132, "rallies": 449, "strokes": 3903}
    more = PairResult(pairing=0, names=("a", "b"), seats=(at_1, at_1), cells=(0, 5, 7))
    both = found + more
    assert both.seats == ({n: at_0[n] + at_1[n] for n in COUNTS}, {n: 2 * at_1[n] for n in COUNTS})
    assert (both.cells, both.names) == ((1, 7, 7), ("a", "b"))


def test_rallies_are_counted_for_the_first_entrant_at_both_seats() -> None:
    """Two cells of matches of one or two games to two points; policy 5 is the first entrant, at seat 0 in even matches."""
    rows = [  # match, server, winner, score before, length
        *((6, 0, 0, (0, 0, 0, 0), 3), (6, 0, 1, (1, 0, 0, 0), 4), (6, 1, 0, (1, 1, 0, 0), 5)),
        *((7, 0, 0, (0, 0, 0, 0), 1), (7, 0, 0, (1, 0, 0, 0), 2), (7, 0, 1, (0, 0, 1, 0), 6), (7, 1, 1, (0, 1, 1, 0), 7)),
        *((8, 1, 1, (0, 0, 0, 0), 1), (8, 1, 1, (0, 1, 0, 0), 1), (9, 1, 0, (0, 0, 0, 0), 1), (9, 0, 0, (1, 0, 0, 0), 9)),
    ]
    match, server, winner, score, length = (np.array(column) for column in zip(*rows, strict=True))
    policy = np.where(match[:, None] % 2, [2, 5], [5, 2])
    rallies = Rallies(
        pairing=np.zeros(11, np.uint32), match=match.astype(np.uint32), rally=np.zeros(11, np.uint16),
        policy=policy.astype(np.uint16), server=server.astype(np.uint8), winner=winner.astype(np.uint8),
        reason=np.zeros(11, np.uint8), score=score.astype(np.uint8), length=length.astype(np.int32),
        stroke=np.zeros(0, np.uint8), hurried=np.zeros(0, np.uint8),
    )  # fmt: skip
    pairing = Pairing(number=4, entrants=(2, 5), names=("x", "y"))
    found = tally(pairing, rallies, 5)
    assert (found.pairing, found.names, found.cells) == (4, ("x", "y"), (1, 0, 1))
    assert found.seats == (
        {
            **{"matches": 2, "wins": 1, "games_won": 1, "games_lost": 1, "points_won": 2, "points_lost": 3},
            **{"served": 2, "served_won": 1, "rallies": 5, "strokes": 14},
        },
        {
            **{"matches": 2, "wins": 1, "games_won": 1, "games_lost": 2, "points_won": 2, "points_lost": 4},
            **{"served": 2, "served_won": 1, "rallies": 6, "strokes": 26},
        },
    )


def test_seats_and_serves_alternate_from_match_to_match() -> None:
    for names, seat_0 in ((("a", "b"), [3, 8, 3, 8, 3]), (("b", "a"), [8, 3, 8, 3, 8])):
        pairing = Pairing(number=0, entrants=(3, 8), names=names)
        assert pairing.swapped == (names == ("b", "a"))
        found = matches_of(pairing, 7, 2, 7)
        assert found.entrant[:, 0].tolist() == seat_0
        assert found.entrant.sum(axis=1).tolist() == [11] * 5
        assert found.first_server.tolist() == [1, 1, 0, 0, 1]
        cells = np.array([1, 1, 2, 2, 3])
        assert found.key.tolist() == draws.stream(7, pairing.key, cells).tolist()
        assert pairing.key == draws.pairing_key("a", "b") == draws.pairing_key("b", "a")


def test_rounds_of_swiss_tournaments_and_scores_of_forfeits() -> None:
    def played(n: int, rounds: int) -> int:
        results: list[PairResult] = []
        while len(results) < sum(map(len, known := stages([f"p{i}" for i in range(n)], "swiss", results, rounds=rounds))):
            results += [result(p, 3) for stage in known for p in stage if p.number >= len(results)]
        return len(known)

    assert [played(n, 0) for n in (2, 3, 4, 5, 8, 9)] == [1, 2, 2, 3, 3, 4]
    assert [played(4, rounds) for rounds in (1, 2, 3, 9)] == [1, 2, 3, 3]
    assert 10 < played(32, 31) < 31, "a search that ends"

    (first,) = stages("abcd", "swiss", [])
    mixed = [result(first[0], 1), forfeited(first[1], ["c"], "")]
    assert [p.names for p in stages("abcd", "swiss", mixed)[1]] == [("a", "c"), ("b", "d")]


def test_a_gauntlet_and_a_swiss_tournament(small_model: str, tmp_path: Path) -> None:
    config: dict[str, Any] = {"pool": POOL, "matches": 6, "game": small_model}
    gauntlet = play_league(LeagueConfig(**config, format="gauntlet", out=tmp_path / "gauntlet"))
    assert [found.names for found in gauntlet.results] == [("random", name) for name in POOL[1:]]
    assert "<h1>Gauntlet</h1>" in (tmp_path / "gauntlet" / "report.html").read_text()
    swiss = play_league(LeagueConfig(**config, format="swiss", rounds=3, out=tmp_path / "swiss"))
    # Three rounds of four are a round robin; every match is that of a round robin, whatever the order.
    whole = {frozenset(found.names): found for found in play_league(LeagueConfig(**config, out=tmp_path / "whole")).results}
    assert len(swiss.results) == 6
    for found in (*gauntlet.results, *swiss.results):
        other = whole[frozenset(found.names)]
        assert [found.seen_by(name) for name in found.names] == [other.seen_by(name) for name in found.names]
    logs = sorted(path.name for path in (tmp_path / "swiss").glob("*.mcap"))
    assert logs == ["rallies-2.mcap", "rallies-3.mcap", "rallies.mcap"]
    for log in logs:
        assert check(tmp_path / "swiss" / log, load_game(small_model)).problems == ()
    assert "in rallies-2.mcap" in (tmp_path / "swiss" / "report.html").read_text()


def test_a_swiss_tournament_that_is_stopped_anywhere_continues_with_the_same_bytes(
    small_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    monkeypatch.setattr("shuttle_marl.base.runs.describe", lambda packages: {})
    config: dict[str, Any] = {"pool": POOL, "matches": 4, "batch": 2, "game": small_model, "format": "swiss"}
    play_league(LeagueConfig(**config, out=tmp_path / "whole"))
    names = [*TABLES, "rallies.mcap", "rallies-2.mcap", "report.html"]
    expected = {name: (tmp_path / "whole" / name).read_bytes() for name in names}
    for when in range(3, 10):
        out = tmp_path / str(when)
        with monkeypatch.context() as patch, contextlib.suppress(Killed):
            stop(patch, when, "fsync")
            play_league(LeagueConfig(**config, out=out))
        play_league(LeagueConfig(**config, out=out, resume=True))
        assert {name: (out / name).read_bytes() for name in names} == expected, when


def test_workers_change_no_byte(small_model: str, tmp_path: Path) -> None:
    config: dict[str, Any] = {"pool": POOL, "matches": 6, "game": small_model, "batch": 6}
    for workers in (1, 3):
        play_league(LeagueConfig(**config, workers=workers, out=tmp_path / str(workers)))
    for name in (*TABLES, "rallies.mcap", "report.html", "report.json"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "3" / name).read_bytes()


@pytest.mark.parametrize("profile", ["women", "men"])
def test_tournaments_are_played_in_their_profile(profile: Any) -> None:
    assert LeagueConfig(game=reduced_model(), profile=profile).load().hash == load_game(f"{reduced_model()}:{profile}").hash

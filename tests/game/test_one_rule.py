"""One rule of matches: all who play, check or show them follow the rules they are given, and none has its own."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from shuttle_marl import match_v0
from shuttle_marl.game import default_game, scoring
from shuttle_marl.game.policy import UniformPolicy, tabulate
from shuttle_marl.game.rules import next_score
from shuttle_marl.game.scoring import Rules
from shuttle_marl.kernel import Matches, play_matches
from shuttle_marl.kernel.matches import ask, play

GAME = default_game()
UNIFORM = UniformPolicy()
RULES = [
    *(Rules(points=3, clear=2, cap=cap, games=2) for cap in (3, 4, 6, 9)),
    *(Rules(points=points, clear=clear, cap=7, games=1) for points, clear in ((5, 1), (5, 3), (7, 2))),
    scoring.BWF,
]

Rally = tuple[tuple[int, int, int, int], int]
"""Points and games of seats 0 and 1 before a rally, and who won it."""


def counted(winners: Sequence[int], rules: Rules) -> list[tuple[int, int, int, int]]:
    """The score before every rally, and after the last one."""
    scores: list[tuple[int, int, int, int]] = [(0, 0, 0, 0)]
    for winner in winners:
        assert max(scores[-1][2:]) < rules.games, "a rally after the end of the match"
        scores.append(next_score(scores[-1], winner, rules))
    assert max(scores[-1][2:]) == rules.games, "the match breaks off"
    return scores


def by_scoring(rules: Rules) -> Iterator[list[Rally]]:
    rng = np.random.default_rng(1)
    score = scoring.Score(rules=rules)
    rallies: list[Rally] = []
    while not score.over:
        winner = int(rng.integers(2))
        rallies.append(((*score.points, *score.games), winner))
        score = score.after(winner)
    yield rallies


def by_match_v0(rules: Rules) -> Iterator[list[Rally]]:
    env = match_v0.raw_env(rules=rules)
    env.reset(seed=2)
    rng = np.random.default_rng(2)
    scores: list[tuple[int, int, int, int]] = []
    for _ in env.agent_iter():
        seen, _, terminated, truncated, _ = env.last()
        if not scores or scores[-1] != env.score_of(0):
            scores.append(env.score_of(0))
        if terminated or truncated:
            break
        env.step(int(rng.choice(np.flatnonzero(seen["action_mask"]))))
    winners = [_winner(before, after) for before, after in itertools.pairwise(scores)]
    yield list(zip(scores[:-1], winners, strict=True))


def _winner(before: tuple[int, int, int, int], after: tuple[int, int, int, int]) -> int:
    if before[2:] != after[2:]:
        return int(after[3] > before[3])
    return int(after[1] > before[1])


def some_matches(size: int = 6) -> Matches:
    number = np.arange(size)
    return Matches(entrant=np.zeros((size, 2), np.int32), first_server=(number % 2).astype(np.int8), key=number.astype(np.uint64))


def played(games: Any) -> Iterator[list[Rally]]:
    for m in range(6):
        rows = games.match == m
        yield [(tuple(s), w) for s, w in zip(games.score[rows].tolist(), games.winner[rows].tolist(), strict=True)]


def by_lockstep(rules: Rules) -> Iterator[list[Rally]]:
    def choose(entrant: Any, *seen: Any) -> Any:
        return ask(UNIFORM, GAME, *seen)

    yield from played(play(GAME, some_matches(), choose, rules=rules).rallies)


def by_kernel(rules: Rules) -> Iterator[list[Rally]]:
    yield from played(play_matches(GAME, some_matches(), [tabulate(UNIFORM, GAME)], rules=rules).rallies)


@pytest.mark.parametrize("rules", RULES, ids=str)
@pytest.mark.parametrize("player", [by_scoring, by_match_v0, by_lockstep, by_kernel])
def test_every_player_of_matches_follows_the_rules_it_is_given(player: Any, rules: Rules) -> None:
    for rallies in player(rules):
        scores = counted([winner for _, winner in rallies], rules)
        assert [score for score, _ in rallies] == scores[:-1]

"""Assessment of a tournament beyond its ranking: payoffs, the game between the entrants, and cycles."""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any, Final, TypedDict

import numpy as np

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.exact.meta_games import nash_average
from shuttle_marl.league.ranking import ELO, ExactOdds, Standing, groups, played_cells, prior_wins, wins_of
from shuttle_marl.league.tournament import PairResult

ANCHOR: Final = "minimax"  # perfect play, which can have all the weight in an equilibrium; meta-games are also solved without it
_MOST_CYCLES: Final = 20
_DECIMALS: Final = 6

MetaGame = dict[str, float]
"""Nash average of the game in which each of two players chooses an entrant, with the probability of winning a match as payoff:
the probability of each entrant in the equilibrium of maximum entropy."""


class Cycle(TypedDict):
    """Cycle of three entrants: each beats the next, and the last the first; with the probability of each to do so."""

    players: tuple[str, str, str]
    match_win: tuple[float, float, float]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Assessment:
    """Assessment of N entrants.

    Attributes:
        win: ``[N, N]`` probability that the row wins a match against the column: exact, else sampled with the prior of the
            ratings, else by the ratings.
    """

    names: tuple[str, ...]
    win: F64
    games: dict[str, MetaGame]  # meta-games by description: of all, and without `ANCHOR`
    cycles: list[Cycle]


def assess(standings: Sequence[Standing], results: Sequence[PairResult], exact: ExactOdds) -> Assessment:
    """Assess a tournament by its ranking, the results of all pairings, and exact ones."""
    pool = exact.names
    _, cells, pairs = played_cells(pool, results)
    rating = {standing.player: standing.rating / ELO for standing in standings}
    theta = np.nan_to_num(np.array([rating[name] for name in pool]))
    win = _win(exact, cells, pairs, theta)
    some = {1} if np.isnan(win).any() else {standing.group for standing in standings}  # what was never compared has no meta-game
    rated = {standing.player for standing in standings if standing.matches and standing.group in some}
    return Assessment(
        names=pool, win=win, games=meta_games([name for name in pool if name in rated], pool, win), cycles=cycles(pool, win)
    )


def _win(exact: ExactOdds, cells: F64, pairs: Intp, theta: F64) -> F64:
    win = 1 / (1 + np.exp(theta[None, :] - theta[:, None]))
    group = groups(pairs, len(win))
    win[(group[:, None] != group) & (group[:, None] * group > 0)] = np.nan
    wins = wins_of(cells, pairs, len(win))
    wins += prior_wins(wins)
    played = wins + wins.T
    win = np.where(played > 0, wins / np.where(played > 0, played, 1), win)
    win = np.where(np.isnan(exact.match), win, exact.match)
    # The two directions of a pair are rounded separately.
    return np.asarray(np.round((win + 1 - win.T) / 2, _DECIMALS + 1))


def meta_games(names: Sequence[str], pool: Sequence[str], win: F64) -> dict[str, MetaGame]:
    """The meta-games of all entrants, and of all but perfect play if it is one of three or more.

    Args:
        pool: names of the rows and columns.
        win: ``[N, N]`` probability that the row wins a match against the column.
    """
    games = {"all": list(names)}
    if ANCHOR in names and len(names) > 2:
        games[f"without {ANCHOR}"] = [name for name in names if name != ANCHOR]
    found: dict[str, MetaGame] = {}
    for about, some in games.items():
        if at := [*map(pool.index, some)]:
            payoff = (win - win.T)[np.ix_(at, at)]
            found[about] = dict(zip(some, np.round(nash_average(payoff), _DECIMALS).tolist(), strict=True))
    return found


def cycles(names: Sequence[str], win: F64) -> list[Cycle]:
    """At most twenty cycles of three, the clearest closest match first; ``win``: ``[N, N]`` of the row against the column."""
    margin, n = win - 0.5, len(names)
    found = []
    for i in range(n):
        # A cycle starts with the entrant that is first in the pool.
        weakest = np.minimum(np.minimum(margin[i][:, None], margin), margin[:, i][None, :])
        weakest[: i + 1], weakest[:, : i + 1] = 0, 0
        found += [(float(weakest[j, k]), (i, int(j), int(k))) for j, k in np.argwhere(weakest > 0)]
    found.sort(key=lambda each: (-each[0], each[1]))
    return [
        {"players": (names[i], names[j], names[k]), "match_win": (float(win[i, j]), float(win[j, k]), float(win[k, i]))}
        for _, (i, j, k) in found[:_MOST_CYCLES]
    ]


def as_json(assessment: Assessment, standings: Sequence[Standing]) -> dict[str, Any]:
    """Content of ``report.json``: NaN is None, and numbers are rounded so that files have the same bytes on every machine."""
    content = {
        "ranking": [dataclasses.asdict(standing) for standing in standings],
        "payoffs": {"players": assessment.names, "match_win": assessment.win.tolist()},
        "meta_games": assessment.games,
        "cycles": assessment.cycles,
    }
    plain: dict[str, Any] = json.loads(
        json.dumps(content), parse_float=lambda text: round(float(text), _DECIMALS) + 0.0, parse_constant=lambda _: None
    )
    return plain

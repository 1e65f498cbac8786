"""Ranking of the entrants of a tournament: ratings with intervals, exact figures, and their tables.

Exact figures are the limits of the sampled ones for infinitely many matches.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import pyarrow as pa
from scipy.stats import binomtest

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.league.entrants import Entrant
from shuttle_marl.league.ratings import ELO, TAILS, exact_ratings, rank_intervals, ratings
from shuttle_marl.league.tournament import COUNTS, PairResult

if TYPE_CHECKING:
    from shuttle_marl.exact.odds import Spread, Values

_DECIMALS: Final = 6
"""Decimals of figures in files: coarser than the error bound, so that files are identical on all machines."""
_AWAY: Final = 1e-7
"""Error bound of odds in refits; refits differ by more."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ExactOdds:
    """Exact figures of N entrants; NaN for entrants without a table, which read the score or forfeited.

    Attributes:
        match: ``[N, N]`` probability that the row wins a match against the column, with a random first server.
        exploitability: ``[N]`` gain of the best response, as a value from 0 to 1.
        normalised_score: ``[N]`` 0 for ``bc``, 1 for the best response to it, by rallies won against ``bc``; NaN for all if the
            game has no ``bc``.
        away: ``[N]`` fraction of matches won against all others with a table, in refits of the game; None if not requested.
        away_shares: ``[R, N]`` the same in each of the R refits; empty if not requested.
        problem: reason why there are no figures; empty if there are.
    """

    names: tuple[str, ...]
    match: F64
    exploitability: F64
    normalised_score: F64
    away: "Spread | None" = None
    away_shares: F64 = dataclasses.field(default_factory=lambda: np.empty((0, 0)))
    problem: str = ""

    def share(self, name: str, opponents: Sequence[str]) -> float:
        """Expected fraction of matches won against the opponents that have a table; NaN if none has."""
        shares = self.match[self.names.index(name), [self.names.index(other) for other in opponents]]
        known = shares[~np.isnan(shares)]
        return float(known.mean()) if len(known) else float("nan")

    def pair(self, names: tuple[str, str]) -> float:
        """Probability that the first of two entrants wins a match; NaN if one has no table."""
        return float(self.match[self.names.index(names[0]), self.names.index(names[1])])


def exact_odds(game: Game, entrants: Sequence[Entrant], refits: Sequence[Game] = (), rules: Rules = BWF) -> ExactOdds:
    """Solve every pair of entrants, and the best response to each.

    Args:
        refits: two or more refits of the game, in which the pairs are solved too; empty: skipped.
    """
    from shuttle_marl.exact import ExactError  # noqa: PLC0415  numba

    n, at = len(entrants), [i for i, entrant in enumerate(entrants) if entrant.table is not None]
    blank = ExactOdds(
        names=tuple(entrant.name for entrant in entrants),
        match=np.full((n, n), np.nan),
        exploitability=np.full(n, np.nan),
        normalised_score=np.full(n, np.nan),
    )
    if not at:
        return blank
    try:
        figures = _figures if game.people is None else _figures_of_both_seats
        found, in_refit = figures(game, [entrants[i] for i in at], rules)
        away, shares = _away(n, at, refits, in_refit) if refits else (None, blank.away_shares)
    except ExactError as error:
        return dataclasses.replace(blank, problem=str(error))
    for name, figure in found.items():
        # Adding 0 turns a rounded -0.0 into 0.0.
        getattr(blank, name)[np.ix_(*[at] * figure.ndim)] = np.round(figure, _DECIMALS) + 0.0
    return dataclasses.replace(blank, away=away, away_shares=shares)


def _figures(game: Game, entrants: Sequence[Entrant], rules: Rules) -> tuple[dict[str, F64], Callable[[Game], F64]]:
    """Figures of M entrants by name, and the function from a refit to ``[M, M]`` matches won there."""
    from shuttle_marl.exact import moved  # noqa: PLC0415  numba
    from shuttle_marl.exact.odds import best_odds, crossplay  # noqa: PLC0415  numba
    from shuttle_marl.policy.scorecard import Scorer  # noqa: PLC0415  numba

    tables = [entrant.table for entrant in entrants if entrant.table is not None]
    try:
        scorer = Scorer(game)
    except PolicyError:
        scorer = None  # a game without behaviour-cloned players
    everyone, m = tables.copy(), len(tables)
    if scorer is not None and all(table.hash != scorer.reference.hash for table in tables):
        everyone.append(scorer.reference)
    odds = crossplay(everyone)
    found = {"match": odds.match(rules)[:m, :m], "exploitability": np.array([each.value for each in best_odds(tables)])}
    if scorer is not None:
        reference = [table.hash for table in everyone].index(scorer.reference.hash)
        scores = [scorer.normalised(float(share)) for share in odds.rally[:m, reference]]
        found["normalised_score"] = np.array([np.nan if score is None else score for score in scores])
    return found, lambda refit: crossplay([moved(each, refit.seats[0]) for each in tables], tolerance=_AWAY).match(rules)


def _figures_of_both_seats(
    game: Game,  # noqa: ARG001
    entrants: Sequence[Entrant],
    rules: Rules,
) -> tuple[dict[str, F64], Callable[[Game], F64]]:
    """The same in the game of a pair: means over both seats of each entrant."""
    from shuttle_marl.exact import moved  # noqa: PLC0415  numba
    from shuttle_marl.exact.odds import best_odds  # noqa: PLC0415  numba

    tables = [(e.table, e.opposite) for e in entrants if e.table is not None and e.opposite is not None]
    gains = [[odds.value for odds in best_odds([both[seat] for both in tables])] for seat in (0, 1)]

    def in_refit(refit: Game) -> F64:
        first, second = refit.seats
        return _both_seats([(moved(a, first), moved(b, second)) for a, b in tables], rules, _AWAY)

    return {"match": _both_seats(tables, rules), "exploitability": np.mean(gains, axis=0)}, in_refit


def _both_seats(tables: Sequence[tuple[TabulatedPolicy, TabulatedPolicy]], rules: Rules, tolerance: float = TOLERANCE) -> F64:
    """``[N, N]`` probability that the row wins a match against the column, half of the time from each seat."""
    from shuttle_marl.exact.odds import crossplay  # noqa: PLC0415  numba

    win = crossplay([first for first, _ in tables], [second for _, second in tables], tolerance=tolerance).match(rules)
    return np.asarray((win + 1 - win.T) / 2)


def _away(n: int, at: Sequence[int], refits: Sequence[Game], match: Callable[[Game], F64]) -> "tuple[Spread, F64]":
    """``[N]`` fraction of matches won against all others over refits, and ``[R, N]`` in each; NaN without a table.

    Args:
        at: indices of the M entrants with a table.
        match: ``[M, M]`` probability that the row wins a match against the column in a refit.
    """
    from shuttle_marl.exact.odds import over  # noqa: PLC0415  numba

    def shares(refit: Game) -> "dict[str, Values]":
        win, share = match(refit), np.full(n, np.nan)
        share[at] = np.round((win.sum(axis=1) - win.diagonal()) / max(1, len(at) - 1), _DECIMALS)
        each.append(share)
        return {"share": share}

    each: list[F64] = []
    # Refits are solved one after another, because the pairs of one use all cores.
    return over(refits, shares, at_once=1)["share"], np.array(each)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Standing:
    """Rank and figures of one entrant. Forfeited pairings count for neither side.

    Attributes:
        rank: from 1; entrants that forfeited are ranked behind all others.
        rating: Bradley-Terry rating in Elo points, mean of the pool 0; NaN without matches.
        rating_low: lower end of its 95 % interval.
        rating_high: upper end.
        rating_exact: limit of the rating for infinitely many matches of every pair, with mean 0 over entrants with a table; NaN
            without a table.
        rank_low, rank_high: 95 % interval of the rank among entrants with matches; 0 without matches.
        share: fraction of matches won; NaN without matches.
        share_low: lower end of its 95 % Wilson interval.
        share_high: upper end.
        exact_share: exact expected fraction of matches won against the opponents that have a table; NaN if there are none.
        away_share: mean of the same in refits of the game, against all others; NaN if not requested.
        away_low, away_high: its 95 % prediction interval for one more refit.
        exploitability: gain of the best response to the entrant, as a value from 0 to 1; NaN without a table.
        normalised_score: by rallies won against ``bc``: 0 for ``bc``, 1 for the best response to it; NaN without a table.
    """

    rank: int
    player: str
    rating: float
    rating_low: float
    rating_high: float
    matches: int
    wins: int
    share: float
    share_low: float
    share_high: float
    rally_share: float
    serving: float
    receiving: float
    forfeits: int
    exact_share: float = math.nan
    away_share: float = math.nan
    away_low: float = math.nan
    away_high: float = math.nan
    exploitability: float = math.nan
    normalised_score: float = math.nan
    rating_exact: float = math.nan
    rank_low: int = 0
    rank_high: int = 0


def rank(pool: Sequence[str], results: Sequence[PairResult], seed: int, exact: ExactOdds | None = None) -> list[Standing]:
    """Rank the entrants by rating, best first, with exact figures if given."""
    played, cells, pairs = played_cells(pool, results)
    theta, drawn = ratings(cells, pairs, len(pool), np.random.default_rng(seed))
    rating, (low, high) = ELO * theta, np.percentile(ELO * drawn, TAILS, axis=0)
    present = np.unique(pairs)
    intervals = dict(zip(present.tolist(), rank_intervals(theta[present], drawn[:, present]).tolist(), strict=True))
    standings = {
        i: _standing(name, played, sum(name in r.forfeit for r in results), (rating[i], low[i], high[i]))
        for i, name in enumerate(pool)
    }
    order = sorted(standings, key=lambda i: (standings[i].forfeits, -np.nan_to_num(standings[i].rating, nan=-np.inf), i))
    exact_rating = {} if exact is None else dict(zip(exact.names, ELO * exact_ratings(exact.match), strict=True))
    found = []
    for place, i in enumerate(order):
        first, last = intervals.get(i, (0, 0))
        standing = dataclasses.replace(standings[i], rank=place + 1, rank_low=first, rank_high=last)
        found.append(standing if exact is None else _with_exact(standing, played, exact, float(exact_rating[standing.player])))
    return found


def played_cells(pool: Sequence[str], results: Sequence[PairResult]) -> tuple[list[PairResult], F64, Intp]:
    """The P pairings that were not forfeited, and for the fit their cells ``[P, 3]`` and entrants ``[P, 2]``."""
    played = [result for result in results if not result.forfeit]
    place = {name: i for i, name in enumerate(pool)}
    pairs = np.array([[place[name] for name in r.names] for r in played], dtype=np.intp).reshape(-1, 2)
    return played, np.array([r.cells for r in played], dtype=np.float64).reshape(-1, 3), pairs


def _standing(name: str, played: Sequence[PairResult], forfeits: int, rating: tuple[float, float, float]) -> Standing:
    own = [result.seen_by(name) for result in played if name in result.names]
    count = {c: sum(counts[c] for counts in own) for c in COUNTS}
    matches, wins = count["matches"], count["wins"]
    low, high = binomtest(wins, matches).proportion_ci(method="wilson") if matches else (math.nan, math.nan)
    nothing = float("nan")
    shown = [float(x) for x in rating] if matches else [nothing] * 3
    return Standing(
        rank=0,
        player=name,
        rating=shown[0],
        rating_low=shown[1],
        rating_high=shown[2],
        matches=matches,
        wins=wins,
        share=_ratio(wins, matches),
        share_low=float(low),
        share_high=float(high),
        rally_share=_ratio(count["points_won"], count["rallies"]),
        serving=_ratio(count["served_won"], count["served"]),
        receiving=_ratio(count["points_won"] - count["served_won"], count["rallies"] - count["served"]),
        forfeits=forfeits,
    )


def _with_exact(standing: Standing, played: Sequence[PairResult], exact: ExactOdds, rating: float) -> Standing:
    name, i = standing.player, exact.names.index(standing.player)
    opponents = [other for result in played if name in result.names for other in result.names if other != name]
    share, low, high = (math.nan,) * 3 if exact.away is None else np.array(dataclasses.astuple(exact.away))[:, i].tolist()
    return dataclasses.replace(
        standing,
        away_share=share,
        away_low=low,
        away_high=high,
        exact_share=exact.share(name, opponents),
        # Rounding removes differences between machines.
        rating_exact=round(rating, _DECIMALS),
        exploitability=float(exact.exploitability[i]),
        normalised_score=float(exact.normalised_score[i]),
    )


def ranking_table(standings: Sequence[Standing]) -> pa.Table:
    """The standings as a table with a column per field; NaN becomes null."""
    rows = [
        {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in row.items()}
        for row in map(dataclasses.asdict, standings)
    ]
    kinds: dict[object, pa.DataType] = {int: pa.int64(), str: pa.string(), float: pa.float64()}
    return pa.Table.from_pylist(rows, schema=pa.schema([(f.name, kinds[f.type]) for f in dataclasses.fields(Standing)]))


def results_table(results: Sequence[PairResult], exact: ExactOdds | None = None) -> pa.Table:
    """Two rows per pairing, with the first entrant at seat 0 and at seat 1.

    Returns:
        Columns ``pairing``, ``player``, ``opponent``, ``seat``, those of :data:`COUNTS`, ``mean_rally_length`` (null
        without rallies), ``cells_lost``, ``cells_split``, ``cells_won`` (of the whole pairing), ``exact_match_win``
        (probability that ``player`` wins a match; null if one of the two has no table), ``forfeit``, ``reason``.
    """
    exact_wins = [math.nan if exact is None else exact.pair(result.names) for result in results]
    rows = [
        {
            "pairing": result.pairing,
            "player": result.names[0],
            "opponent": result.names[1],
            "seat": seat,
            **counts,
            "mean_rally_length": counts["strokes"] / counts["rallies"] if counts["rallies"] else None,
            **dict(zip(("cells_lost", "cells_split", "cells_won"), result.cells, strict=True)),
            "exact_match_win": None if math.isnan(exact_win) else exact_win,
            "forfeit": " and ".join(result.forfeit),
            "reason": result.reason,
        }
        for result, exact_win in zip(results, exact_wins, strict=True)
        for seat, counts in enumerate(result.seats)
    ]
    text, number = pa.string(), pa.int64()
    kinds = dict.fromkeys(("player", "opponent", "forfeit", "reason"), text)
    kinds |= dict.fromkeys(("mean_rally_length", "exact_match_win"), pa.float64())
    return pa.Table.from_pylist(rows, schema=pa.schema([(name, kinds.get(name, number)) for name in rows[0]]))


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")

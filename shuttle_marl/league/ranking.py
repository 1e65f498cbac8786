"""Ranking of the entrants of a tournament: Bradley-Terry ratings with intervals, exact figures, and their tables.

Model: entrant i beats j with probability 1 / (1 + exp(theta_j - theta_i)) (Bradley & Terry, Biometrika 1952). It is
fitted to all matches at once, so unlike Elo updates it does not depend on their order. Intervals resample cells, because the two
matches of a cell have the same random numbers and are dependent. Exact figures are the limits for infinitely many matches.
"""

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from scipy.sparse.csgraph import connected_components

from shuttle_marl.base.arrays import F64, Bools, Intp
from shuttle_marl.base.intervals import wilson
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.league.entrants import Entrant
from shuttle_marl.league.tournament import COUNTS, PairResult

ELO: Final = 400 / np.log(10)  # Elo points for a unit of theta: 400 points are odds of ten to one
_TAILS: Final = (2.5, 97.5)
_STEPS: Final = 200
_FIXED_PRIOR: Final = 0.1
_INDEPENDENT: Final = np.array([0.25, 0.5, 0.25])  # of 0, 1 and 2 wins in a cell between equals, if independent
_AT_ONCE: Final = 1 << 21
_SURE: Final = 5e-7  # distance of clipped probabilities from 0 and 1, so that ratings of exact odds (six decimals) are finite
_DECIMALS: Final = 6  # decimals of figures in files: coarser than the error bound, so that files are identical on all machines
_NAN: Final = float("nan")


def bradley_terry(wins: F64, start: F64 | None = None) -> F64:
    """Fit ratings by a damped Newton's method on the likelihood.

    Args:
        wins: ``[..., n, n]`` matches that i won against j, the same pairings in all; the diagonal is ignored. The graph of wins
            must be strongly connected within each component, or the maximum is infinite; :func:`prior_wins` ensures it.
        start: ``[n]`` initial theta; affects the running time only.

    Returns:
        ``[..., n]`` theta, with mean 0 in each component, which are not compared; entrants without matches have 0.
    """
    n = wins.shape[-1]
    diagonal = np.eye(n, dtype=bool)
    wins = np.where(diagonal, 0.0, wins)
    played = wins + np.swapaxes(wins, -1, -2)
    anchor = _anchor(np.asarray(played.reshape(-1, n, n).any(axis=0)))
    theta = np.zeros(wins.shape[:-1]) if start is None else np.broadcast_to(start, wins.shape[:-1])
    for _ in range(_STEPS):
        probability = 1 / (1 + np.exp(theta[..., None, :] - theta[..., :, None]))
        gradient = (wins - played * probability).sum(axis=-1)
        curvature = played * probability * (1 - probability)
        hessian = anchor - curvature
        hessian[..., diagonal] += curvature.sum(axis=-1)
        step = np.linalg.solve(hessian, gradient[..., None])[..., 0]
        # A full Newton step may diverge; a step of this length never lowers the likelihood (Bach, EJS 2010).
        longest = np.maximum(np.ptp(step, axis=-1, keepdims=True), 1e-300)
        theta = theta + step * (np.log1p(longest) / longest)
        if longest.max(initial=0) < 1e-9:
            break
    centred: F64 = theta - theta.mean(axis=-1, keepdims=True)
    return centred


def _anchor(met: Bools) -> F64:
    """``[n, n]`` term of the curvature that fixes the mean of each connected component, which the likelihood leaves open."""
    _, part = connected_components(met, directed=False)
    together = part[:, None] == part
    return np.asarray(together / together.sum(axis=1))


def wins_of(cells: F64, pairs: Intp, n: int) -> F64:
    """``[..., n, n]`` matches won in ``[..., P, 3]`` cells by the number that the first of the ``[P, 2]`` entrants won."""
    wins = np.zeros((*cells.shape[:-2], n, n))
    wins[..., pairs[:, 0], pairs[:, 1]] = cells[..., 1] + 2 * cells[..., 2]
    wins[..., pairs[:, 1], pairs[:, 0]] = cells[..., 1] + 2 * cells[..., 0]
    return wins


def prior_wins(wins: F64) -> F64:
    """``[n, n]`` pseudo-wins of Jeffreys' prior (Firth, Biometrika 1993); their sum is n - 1.

    Ratings of unbeaten entrants become finite, and the first-order bias of the maximum is removed. A fixed number of pseudo-wins
    for each pair would shrink the strongest entrants towards the others.
    """
    played = wins + wins.T
    prior = np.where(played > 0, 0.5, 0.0)
    theta = bradley_terry(wins + prior)
    for _ in range(_STEPS):
        curvature, covariance = _information(played, theta)
        variance = covariance.diagonal()[:, None] + covariance.diagonal() - 2 * covariance
        following = np.where(played > 0, curvature * variance / 2, 0.0)
        change = np.abs(following - prior).max(initial=0)
        prior = following
        if change < 1e-9:
            break
        theta = bradley_terry(wins + prior, theta)
    return prior


def _information(played: F64, theta: F64) -> tuple[F64, F64]:
    """``[n, n]`` curvature of each pair's likelihood, and the covariance of the ratings."""
    probability = 1 / (1 + np.exp(theta[None, :] - theta[:, None]))
    curvature = played * probability * (1 - probability)
    np.fill_diagonal(curvature, 0)
    # No pseudo-inverse, because rounding makes the zero eigenvalue tiny and its inverse huge.
    return curvature, np.asarray(np.linalg.inv(_anchor(played > 0) + np.diag(curvature.sum(axis=1)) - curvature))


def ratings(cells: F64, pairs: Intp, n: int, rng: np.random.Generator, replicates: int = 1000) -> tuple[F64, F64]:
    """Ratings and their Bayesian bootstrap (Rubin, Ann. Statist. 1981) over cells of two dependent matches.

    Args:
        cells: ``[P, 3]`` numbers of cells in which the first entrant of a pairing won no match, one, and both.
        pairs: ``[P, 2]`` the entrants of each pairing.
        replicates: number B of bootstrap samples.

    Returns:
        ``[n]`` theta and ``[B, n]`` theta.
    """
    wins = wins_of(cells, pairs, n)
    prior = prior_wins(wins)
    theta = bradley_terry(wins + prior)
    # The prior is resampled too, so unobserved outcomes are possible; a tenth of it is fixed, so that all ratings are finite.
    drawn_prior = (1 - _FIXED_PRIOR) * prior[pairs[:, 0], pairs[:, 1], None] * _INDEPENDENT
    weights = cells + drawn_prior + 1e-12
    drawn = np.array([rng.dirichlet(weight, size=replicates) for weight in weights]).reshape(-1, replicates, 3).swapaxes(0, 1)
    drawn = drawn * weights.sum(axis=1)[:, None]
    together = max(1, _AT_ONCE // max(1, n * n))
    parts = [wins_of(drawn[first : first + together], pairs, n) for first in range(0, replicates, together)]
    return theta, np.concatenate([bradley_terry(part + _FIXED_PRIOR * prior, theta) for part in parts])


def exact_ratings(match: F64) -> F64:
    """Limit of the sampled ratings as the number of matches of every pair grows.

    Args:
        match: ``[n, n]`` probability that the entrant of the row wins a match against that of the column; NaN where
            there are no exact odds.

    Returns:
        ``[n]`` theta, with mean 0 over entrants with odds; NaN for the others.
    """
    known = np.flatnonzero(~np.isnan(match).all(axis=1))
    theta = np.full(len(match), np.nan)
    if len(known):
        theta[known] = bradley_terry(match[np.ix_(known, known)].clip(_SURE, 1 - _SURE))
    return theta


def rank_intervals(theta: F64, drawn: F64) -> Intp:
    """95 % confidence intervals of the ranks (Mogstad, Romano, Shaikh & Wilhelm, Rev. Econ. Stud. 2024).

    Percentiles of bootstrapped ranks are too narrow where entrants are nearly equal. Here a rank is bounded by the numbers of
    entrants that are significantly above and below, by simultaneous intervals of the differences to all others.

    Args:
        theta: ``[n]`` ratings.
        drawn: ``[B, n]`` bootstrap samples of them.

    Returns:
        ``[n, 2]`` lowest and highest rank, from 1 for the best.
    """
    n = len(theta)
    found = np.empty((n, 2), dtype=np.intp)
    for i in range(n):
        others = np.arange(n) != i
        lead = theta[i] - theta[others]
        noise = drawn[:, i, None] - drawn[:, others] - lead
        deviation = noise.std(axis=0)
        known = deviation > 0
        largest = (np.abs(noise[:, known]) / deviation[known]).max(axis=1, initial=0)
        margin = np.percentile(largest, 95) * deviation
        found[i] = 1 + (known & (lead < -margin)).sum(), n - (known & (lead > margin)).sum()
    return found


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ExactOdds:
    """Exact figures of N entrants; NaN for entrants without a table, which read the score or forfeited.

    Attributes:
        normalised_score: ``[N]`` 0 for ``bc``, 1 for the best response to it, by rallies won against ``bc``; NaN for all if the
            game has no ``bc``.
    """

    names: tuple[str, ...]
    match: F64  # [N, N] probability that the row wins a match against the column, with a random first server
    exploitability: F64  # [N] gain of the best response, as a value from 0 to 1
    normalised_score: F64
    problem: str = ""  # reason why there are no figures; empty if there are

    def share(self, name: str, opponents: Sequence[str]) -> float:
        """Expected fraction of matches won against the opponents that have a table; NaN if none has."""
        shares = self.match[self.names.index(name), [self.names.index(other) for other in opponents]]
        known = shares[~np.isnan(shares)]
        return float(known.mean()) if len(known) else _NAN

    def pair(self, names: tuple[str, str]) -> float:
        """Probability that the first of two entrants wins a match; NaN if one has no table."""
        return float(self.match[self.names.index(names[0]), self.names.index(names[1])])


def unknown(names: Sequence[str], problem: str = "") -> ExactOdds:
    """No exact figures."""
    nothing = np.full(len(names), np.nan)
    match = np.full((len(names), len(names)), np.nan)
    return ExactOdds(names=tuple(names), match=match, exploitability=nothing, normalised_score=nothing.copy(), problem=problem)


def exact_odds(game: Game, entrants: Sequence[Entrant], rules: Rules = BWF) -> ExactOdds:
    """Solve every pair of entrants, and the best response to each; in the game of a pair, means over both seats."""
    from shuttle_marl.exact import ExactError  # noqa: PLC0415  numba
    from shuttle_marl.exact.odds import best_odds, crossplay, pair_odds  # noqa: PLC0415  numba
    from shuttle_marl.policy.scorecard import Scorer  # noqa: PLC0415  numba

    names = [entrant.name for entrant in entrants]
    at = [i for i, entrant in enumerate(entrants) if entrant.table is not None]
    both = ([entrants[i].table for i in at], [entrants[i].opposite for i in at])
    seats = [known for tables in both if (known := [table for table in tables if table is not None])]
    if not at:
        return unknown(names)
    try:
        gains = [[odds.value for odds in best_odds(tables)] for tables in seats]
        win = crossplay(*seats).match(rules)
        found = {"match": win if len(seats) == 1 else (win + 1 - win.T) / 2, "exploitability": np.mean(gains, axis=0)}
        if game.people is None:
            with contextlib.suppress(PolicyError):  # a game without behaviour-cloned players
                scorer = Scorer(game)
                against = pair_odds([(table, scorer.reference) for table in seats[0]])
                scores = [scorer.normalised(odds.rally) for odds in against]
                found["normalised_score"] = np.array([np.nan if score is None else score for score in scores])
    except ExactError as error:
        return unknown(names, str(error))
    exact = unknown(names)
    for name, figure in found.items():
        # Adding 0 turns a rounded -0.0 into 0.0.
        getattr(exact, name)[np.ix_(*[at] * figure.ndim)] = np.round(figure, _DECIMALS) + 0.0
    return exact


@dataclasses.dataclass(frozen=True, kw_only=True)
class Standing:
    """Rank and figures of one entrant. Forfeited pairings count for neither side.

    Attributes:
        rating_exact: limit of the rating for infinitely many matches of every pair, with mean 0 over entrants with a table; NaN
            without a table.
        rank_low, rank_high: 95 % interval of the rank among entrants of the group with matches; 0 without matches.
        group: from 1; between groups there is no chain of matches, so that their ratings, each with mean 0, cannot be compared.
        exact_share: exact expected fraction of matches won against the opponents that have a table; NaN if there are none.
        normalised_score: by rallies won against ``bc``: 0 for ``bc``, 1 for the best response to it; NaN without a table.
    """

    rank: int  # from 1 in its group; entrants that forfeited are ranked behind all others
    player: str
    rating: float  # Bradley-Terry rating in Elo points, mean of the group 0; NaN without matches
    rating_low: float  # lower end of its 95 % interval
    rating_high: float  # upper end
    matches: int
    wins: int
    share: float  # fraction of matches won; NaN without matches
    share_low: float  # lower end of its 95 % Wilson interval
    share_high: float  # upper end
    rally_share: float
    serving: float
    receiving: float
    forfeits: int
    exact_share: float = math.nan
    exploitability: float = math.nan  # gain of the best response to the entrant, as a value from 0 to 1; NaN without a table
    normalised_score: float = math.nan
    rating_exact: float = math.nan
    rank_low: int = 0
    rank_high: int = 0
    group: int = 1


def rank(pool: Sequence[str], results: Sequence[PairResult], seed: int, exact: ExactOdds | None = None) -> list[Standing]:
    """Rank the entrants by rating, best first, with exact figures if given."""
    exact = exact or unknown(pool)
    played, cells, pairs = played_cells(pool, results)
    theta, drawn = ratings(cells, pairs, len(pool), np.random.default_rng(seed))
    present = np.unique(pairs)
    rated = np.full((3, len(pool)), np.nan)
    rated[:, present] = np.stack([ELO * theta, *np.percentile(ELO * drawn, _TAILS, axis=0)])[:, present]
    ranks = np.zeros((len(pool), 2), dtype=np.intp)
    group = np.maximum(groups(pairs, len(pool)), 1)
    for number in np.unique(group[present]):
        among = np.intersect1d(present, np.flatnonzero(group == number))
        ranks[among] = rank_intervals(theta[among], drawn[:, among])
    limits = ELO * exact_ratings(exact.match)
    forfeits = [sum(name in result.forfeit for result in results) for name in pool]
    order = sorted(range(len(pool)), key=lambda i: (forfeits[i], group[i], -np.nan_to_num(rated[0, i], nan=-np.inf), i))
    found: list[Standing] = []
    for i in order:
        name, at = pool[i], exact.names.index(pool[i])
        met = [result for result in played if name in result.names]
        own = [result.seen_by(name) for result in met]
        count = {c: sum(counts[c] for counts in own) for c in COUNTS}
        matches, wins = count["matches"], count["wins"]
        low, high = wilson(wins, matches) if matches else (_NAN, _NAN)
        found.append(
            Standing(
                rank=1 + sum(standing.group == int(group[i]) for standing in found),
                group=int(group[i]),
                player=name,
                rating=float(rated[0, i]),
                rating_low=float(rated[1, i]),
                rating_high=float(rated[2, i]),
                rating_exact=round(float(limits[at]), _DECIMALS),  # removes differences between machines
                rank_low=int(ranks[i, 0]),
                rank_high=int(ranks[i, 1]),
                matches=matches,
                wins=wins,
                share=_ratio(wins, matches),
                share_low=low,
                share_high=high,
                rally_share=_ratio(count["points_won"], count["rallies"]),
                serving=_ratio(count["served_won"], count["served"]),
                receiving=_ratio(count["points_won"] - count["served_won"], count["rallies"] - count["served"]),
                forfeits=forfeits[i],
                exact_share=exact.share(name, [other for result in met for other in result.names if other != name]),
                exploitability=float(exact.exploitability[at]),
                normalised_score=float(exact.normalised_score[at]),
            )
        )
    return found


def groups(pairs: Intp, n: int) -> Intp:
    """``[n]`` groups of entrants with a chain of matches between them, from 1, the largest first; 0 without matches."""
    graph = np.zeros((n, n), dtype=bool)
    graph[pairs[:, 0], pairs[:, 1]] = True
    part = connected_components(graph, directed=False)[1]
    met = np.unique(pairs)
    size = np.bincount(part[met], minlength=n)
    order = sorted(np.unique(part[met]).tolist(), key=lambda each: (-size[each], each))
    number = np.zeros(n, dtype=np.intp)
    number[order] = 1 + np.arange(len(order))
    return np.asarray(np.where(np.isin(np.arange(n), met), number[part], 0))


def played_cells(pool: Sequence[str], results: Sequence[PairResult]) -> tuple[list[PairResult], F64, Intp]:
    """The P pairings that were not forfeited, and for the fit their cells ``[P, 3]`` and entrants ``[P, 2]``."""
    played = [result for result in results if not result.forfeit]
    place = {name: i for i, name in enumerate(pool)}
    pairs = np.array([[place[name] for name in r.names] for r in played], dtype=np.intp).reshape(-1, 2)
    return played, np.array([r.cells for r in played], dtype=np.float64).reshape(-1, 3), pairs


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
    return part / whole if whole else _NAN

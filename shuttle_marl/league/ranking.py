"""Ranking of the entrants of a tournament: Bradley-Terry ratings with intervals, exact figures, and the tables of both.

Model of the ratings: entrant i beats j with probability 1 / (1 + exp(theta_j - theta_i)) (Bradley & Terry, Biometrika 1952).
Fitted to all matches together, so unlike with Elo's updates their order does not matter. Intervals are over the cells of
swapped seats. Exact figures are the limits of the samples after infinitely many matches.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.league.entrants import Entrant
from shuttle_marl.league.tournament import COUNTS, PairResult

if TYPE_CHECKING:
    from shuttle_marl.exact.away import Spread, Values

Floats = npt.NDArray[np.float64]

_DECIMALS: Final = 6
"""Figures are rounded to so many decimals, far above their error bound, so that files have the same bytes on every machine."""
_AWAY: Final = 1e-7
"""Error bound of odds in refits, which are further than that from each other."""
ELO: Final = 400 / np.log(10)
"""Points of Elo's scale for a unit of theta: 400 points are odds of ten to one."""
_STEPS: Final = 200
_LONGEST_STEP: Final = 2.0
_TAILS: Final = (2.5, 97.5)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ExactOdds:
    """Exact figures of N entrants; NaN for one without a table: it reads the score, or it forfeits.

    Attributes:
        names: the entrants.
        match: ``[N, N]`` probability that the entrant of the row wins a match against that of the column, the first server
            drawn at random.
        exploitability: ``[N]`` what the best response to an entrant gains, as a value from 0 to 1.
        normalised_score: ``[N]`` 0 for ``bc``, 1 for the best response to it, by rallies won against ``bc``; NaN for all if the
            game has no ``bc``.
        away: ``[N]`` share of the matches that an entrant wins against all others that have a table, in refits of the game; None
            if it was not asked for.
        problem: why there are no figures at all; empty if there are.
    """

    names: tuple[str, ...]
    match: Floats
    exploitability: Floats
    normalised_score: Floats
    away: "Spread | None" = None
    problem: str = ""

    def share(self, name: str, opponents: Sequence[str]) -> float:
        """Expected share of the matches won against those of the opponents that have a table; NaN without any."""
        shares = self.match[self.names.index(name), [self.names.index(other) for other in opponents]]
        known = shares[~np.isnan(shares)]
        return float(known.mean()) if len(known) else float("nan")

    def pair(self, names: tuple[str, str]) -> float:
        """Probability that the first of two entrants wins a match; NaN if one has no table."""
        return float(self.match[self.names.index(names[0]), self.names.index(names[1])])


def exact_odds(game: Game, entrants: Sequence[Entrant], refits: Sequence[Game] = ()) -> ExactOdds:
    """Solve every pair of entrants, and the best response to each.

    Args:
        game: the tables.
        entrants: N of them.
        refits: other fits of the game, two or more, in which the pairs are solved too; none: they are not.
    """
    from shuttle_marl.exact import ExactError  # noqa: PLC0415  numba

    blank = ExactOdds(
        names=tuple(entrant.name for entrant in entrants),
        match=np.full((len(entrants), len(entrants)), np.nan),
        exploitability=np.full(len(entrants), np.nan),
        normalised_score=np.full(len(entrants), np.nan),
    )
    tables = {i: entrant.table for i, entrant in enumerate(entrants) if entrant.table is not None}
    try:
        return _fill(blank, game, tables, refits) if tables else blank
    except ExactError as error:
        return dataclasses.replace(blank, problem=str(error))


def _fill(blank: ExactOdds, game: Game, tables: Mapping[int, TabulatedPolicy], refits: Sequence[Game]) -> ExactOdds:
    from shuttle_marl.exact.known import best_odds, crossplay  # noqa: PLC0415  numba
    from shuttle_marl.policy.scorecard import Scorer  # noqa: PLC0415  numba

    at, policies = list(tables), list(tables.values())
    try:
        scorer = Scorer(game)
    except PolicyError:
        scorer = None  # a game without behaviour-cloned players
    odds = crossplay(policies if scorer is None else [*policies, scorer.reference])
    match, exploitability, normalised = blank.match.copy(), blank.exploitability.copy(), blank.normalised_score.copy()
    match[np.ix_(at, at)] = odds.match()[: len(at), : len(at)]
    exploitability[at] = [odds.value for odds in best_odds(policies)]
    if scorer is not None:
        scores = [scorer.normalised(float(share)) for share in odds.rally[: len(at), -1]]
        normalised[at] = [np.nan if score is None else score for score in scores]
    # Adding 0 turns a rounded -0.0 into 0.0.
    match, exploitability, normalised = (np.round(x, _DECIMALS) + 0.0 for x in (match, exploitability, normalised))
    filled = dataclasses.replace(blank, match=match, exploitability=exploitability, normalised_score=normalised)
    return dataclasses.replace(filled, away=_away(len(match), tables, refits)) if refits else filled


def _away(n: int, tables: Mapping[int, TabulatedPolicy], refits: Sequence[Game]) -> "Spread":
    """``[N]`` share of the matches won against all others in refits; NaN without a table."""
    from shuttle_marl.exact.away import moved, of_all_pairs, over  # noqa: PLC0415  numba
    from shuttle_marl.exact.known import crossplay  # noqa: PLC0415  numba

    def shares(refit: Game) -> "dict[str, Values]":
        odds = crossplay([moved(table, refit) for table in tables.values()], tolerance=_AWAY)
        share = np.full(n, np.nan)
        share[list(tables)] = np.round(of_all_pairs(odds)["match_share"], _DECIMALS)
        return {"share": share}

    # The pairs of one refit keep all cores busy.
    return over(refits, shares, at_once=1)["share"]


def bradley_terry(wins: Floats) -> Floats:
    """Fit ratings by Newton's method on the likelihood.

    Args:
        wins: ``[..., n, n]`` matches that i won against j; the diagonal is ignored. Results must connect all entrants both
            ways, or the likeliest ratings are infinite; :func:`smoothed` sees to that.

    Returns:
        ``[..., n]`` theta, with mean 0; entrants without matches have 0.
    """
    diagonal = np.eye(wins.shape[-1], dtype=bool)
    wins = np.where(diagonal, 0.0, wins)
    played = wins + np.swapaxes(wins, -1, -2)
    theta = np.zeros(wins.shape[:-1])
    for _ in range(_STEPS):
        probability = 1 / (1 + np.exp(theta[..., None, :] - theta[..., :, None]))
        gradient = (wins - played * probability).sum(axis=-1)
        curvature = played * probability * (1 - probability)
        hessian = -curvature
        hessian[..., diagonal] = curvature.sum(axis=-1)
        # Only differences of theta are determined; the pseudo-inverse leaves their mean alone.
        step = (np.linalg.pinv(hessian, hermitian=True) @ gradient[..., None])[..., 0]
        theta = theta + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        if np.abs(step).max(initial=0) < 1e-10:
            break
    centred: Floats = theta - theta.mean(axis=-1, keepdims=True)
    return centred


def smoothed(cells: Floats) -> Floats:
    """``[P, 3]`` counts of cells with half a cell added to each outcome (Jeffreys' prior).

    So 500 cells out of 500 neither give an infinite rating nor come out as certain.
    """
    return cells + 0.5


def wins_of(shares: Floats, cells: Floats, pairs: npt.NDArray[np.intp], n: int) -> Floats:
    """``[..., n, n]`` matches won, for :func:`bradley_terry`.

    Args:
        shares: ``[..., P, 3]`` share of the cells of which the first entrant of each pairing won no match, one, both.
        cells: ``[P]`` number of cells.
        pairs: ``[P, 2]`` the entrants of each pairing.
        n: number of entrants.
    """
    wins = np.zeros((*shares.shape[:-2], n, n))
    wins[..., pairs[:, 0], pairs[:, 1]] = cells * (shares[..., 1] + 2 * shares[..., 2])
    wins[..., pairs[:, 1], pairs[:, 0]] = cells * (shares[..., 1] + 2 * shares[..., 0])
    return wins


def ratings(cells: Floats, pairs: npt.NDArray[np.intp], n: int, seed: int, replicates: int = 1000) -> tuple[Floats, Floats]:
    """Ratings, and what they would be under other draws of the cells: a Bayesian bootstrap (Rubin, Ann. Statist. 1981).

    The two matches of a cell share their draws, so cells are drawn and not matches.

    Args:
        cells: ``[P, 3]`` for each pairing, in how many cells its first entrant won no match, one, both.
        pairs: ``[P, 2]`` the entrants of each pairing.
        n: number of entrants.
        seed: of the draws.
        replicates: number of draws B.

    Returns:
        ``[n]`` theta and ``[B, n]`` theta.
    """
    counts = smoothed(cells)
    total = counts.sum(axis=1)
    rng = np.random.default_rng(seed)
    drawn = np.array([rng.dirichlet(count, size=replicates) for count in counts]).reshape(-1, replicates, 3)
    theta = bradley_terry(wins_of(counts / total[:, None], total, pairs, n))
    return theta, bradley_terry(wins_of(drawn.swapaxes(0, 1), total, pairs, n))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Standing:
    """One entrant's place. Pairings that were forfeited count nowhere, for neither side.

    Attributes:
        rank: from 1; entrants that forfeited are ranked behind all others.
        player: name.
        rating: Bradley-Terry rating in Elo points, mean of the pool 0; NaN without matches.
        rating_low: lower end of its 95 % interval.
        rating_high: upper end.
        matches: matches played.
        wins: of those won.
        share: share of matches won; NaN without matches.
        share_low: lower end of its 95 % Wilson interval.
        share_high: upper end.
        rally_share: share of rallies won.
        serving: share of rallies won when serving.
        receiving: share of rallies won when receiving.
        forfeits: pairings that this entrant forfeited.
        exact_share: exact expected share of the matches won against the opponents that have a table; NaN without.
        away_share: mean of the same in refits of the game, against all others; NaN without, or if it was not asked for.
        away_low, away_high: its 95 % interval in one more refit.
        exploitability: what its best response gains on the entrant, as a value from 0 to 1; NaN without a table.
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


def rank(pool: Sequence[str], results: Sequence[PairResult], seed: int, exact: ExactOdds | None = None) -> list[Standing]:
    """Rank the entrants by rating, best first; with their exact figures where they are given."""
    played = [result for result in results if not result.forfeit]
    pairs = np.array([[pool.index(name) for name in r.names] for r in played], dtype=np.intp).reshape(-1, 2)
    cells = np.array([r.cells for r in played], dtype=np.float64).reshape(-1, 3)
    theta, drawn = ratings(cells, pairs, len(pool), seed)
    rating, (low, high) = ELO * theta, np.percentile(ELO * drawn, _TAILS, axis=0)
    standings = [
        _standing(name, played, sum(name in r.forfeit for r in results), (rating[i], low[i], high[i]))
        for i, name in enumerate(pool)
    ]
    order = sorted(range(len(pool)), key=lambda i: (standings[i].forfeits, -np.nan_to_num(standings[i].rating, nan=-np.inf), i))
    placed = [dataclasses.replace(standings[i], rank=place + 1) for place, i in enumerate(order)]
    return placed if exact is None else [_with_exact(standing, played, exact) for standing in placed]


def wilson(wins: int, matches: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson, J. Am. Stat. Assoc. 1927); NaN without matches."""
    if not matches:
        return float("nan"), float("nan")
    share, z = wins / matches, NormalDist().inv_cdf(0.975)
    middle = (share + z**2 / (2 * matches)) / (1 + z**2 / matches)
    half = z / (1 + z**2 / matches) * math.sqrt(share * (1 - share) / matches + (z / (2 * matches)) ** 2)
    return middle - half, middle + half


def _standing(name: str, played: Sequence[PairResult], forfeits: int, rating: tuple[float, float, float]) -> Standing:
    own = [result.seen_by(name) for result in played if name in result.names]
    count = {c: sum(counts[c] for counts in own) for c in COUNTS}
    matches, wins = count["matches"], count["wins"]
    low, high = wilson(wins, matches)
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
        share_low=low,
        share_high=high,
        rally_share=_ratio(count["points_won"], count["rallies"]),
        serving=_ratio(count["served_won"], count["served"]),
        receiving=_ratio(count["points_won"] - count["served_won"], count["rallies"] - count["served"]),
        forfeits=forfeits,
    )


def _with_exact(standing: Standing, played: Sequence[PairResult], exact: ExactOdds) -> Standing:
    name, i = standing.player, exact.names.index(standing.player)
    opponents = [other for result in played if name in result.names for other in result.names if other != name]
    share, low, high = (math.nan,) * 3 if exact.away is None else np.array(dataclasses.astuple(exact.away))[:, i].tolist()
    return dataclasses.replace(
        standing,
        away_share=share,
        away_low=low,
        away_high=high,
        exact_share=exact.share(name, opponents),
        exploitability=float(exact.exploitability[i]),
        normalised_score=float(exact.normalised_score[i]),
    )


def ranking_table(standings: Sequence[Standing]) -> pa.Table:
    """The standings as a table with their fields as columns; null where an entrant without matches has no figure."""
    rows = [
        {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in row.items()}
        for row in map(dataclasses.asdict, standings)
    ]
    kinds: dict[object, pa.DataType] = {int: pa.int64(), str: pa.string(), float: pa.float64()}
    return pa.Table.from_pylist(rows, schema=pa.schema([(f.name, kinds[f.type]) for f in dataclasses.fields(Standing)]))


def results_table(results: Sequence[PairResult], exact: ExactOdds | None = None) -> pa.Table:
    """Two rows a pairing, the first entrant at seat 0 and at seat 1.

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

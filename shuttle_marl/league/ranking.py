"""The ranked table of a tournament."""

import dataclasses
import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.league.exact_odds import ExactOdds
from shuttle_marl.league.ratings import ELO, ratings
from shuttle_marl.league.results import COUNTS, PairResult

_TAILS: Final = (2.5, 97.5)


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
    return dataclasses.replace(
        standing,
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


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")

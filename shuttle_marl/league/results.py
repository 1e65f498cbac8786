"""Result of a pairing, and the table of all results."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.league.exact_odds import ExactOdds
from shuttle_marl.league.schedule import Pairing
from shuttle_marl.recording import Rallies

COUNTS = (
    "matches",
    "wins",
    "games_won",
    "games_lost",
    "points_won",
    "points_lost",
    "served",
    "served_won",
    "rallies",
    "strokes",
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PairResult:
    """The matches of one pairing, seen by its first entrant.

    Attributes:
        pairing: number of the pairing.
        names: the entrants.
        seats: at seat 0 and at seat 1, each :data:`COUNTS` as numbers: matches, wins, games and points of the first entrant
            and of the second, rallies that the first one served and won of those, rallies and strokes in all.
        cells: in how many cells the first entrant won neither match, one, and both.
        forfeit: entrants that failed, so that the pairing was not played or was thrown away; empty if none did.
        reason: why they failed.
    """

    pairing: int
    names: tuple[str, str]
    seats: tuple[dict[str, int], dict[str, int]]
    cells: tuple[int, int, int] = (0, 0, 0)
    forfeit: tuple[str, ...] = ()
    reason: str = ""

    def seen_by(self, name: str) -> dict[str, int]:
        """:data:`COUNTS` over both seats, as this entrant of the two has them."""
        first = {count: self.seats[0][count] + self.seats[1][count] for count in COUNTS}
        if name == self.names[0]:
            return first
        return {
            **first,
            "wins": first["matches"] - first["wins"],
            "games_won": first["games_lost"],
            "games_lost": first["games_won"],
            "points_won": first["points_lost"],
            "points_lost": first["points_won"],
            "served": first["rallies"] - first["served"],
            "served_won": first["points_lost"] - (first["served"] - first["served_won"]),
        }

    def __add__(self, more: "PairResult") -> "PairResult":
        """This and further matches of the same pairing."""
        seat_0, seat_1 = ({n: a[n] + b[n] for n in COUNTS} for a, b in zip(self.seats, more.seats, strict=True))
        lost, split, won = (a + b for a, b in zip(self.cells, more.cells, strict=True))
        return dataclasses.replace(self, seats=(seat_0, seat_1), cells=(lost, split, won))

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> "PairResult":
        """Read the fields that ``dataclasses.asdict`` gave."""
        lists = {name: tuple(fields[name]) for name in ("names", "seats", "cells", "forfeit")}
        return cls(**{**fields, **lists})


def forfeited(pairing: Pairing, by: Sequence[str], reason: str) -> PairResult:
    """The result of a pairing that an entrant forfeited."""
    nothing = dict.fromkeys(COUNTS, 0)
    return PairResult(
        pairing=pairing.number,
        names=pairing.names,
        seats=(nothing, dict(nothing)),
        forfeit=tuple(by),
        reason=reason,
    )


def tally(pairing: Pairing, rallies: Rallies, first_policy: int) -> PairResult:
    """Count the rallies of some matches of a pairing; the winner of a match won its last rally.

    Args:
        pairing: the pairing.
        rallies: whole cells of it in order; as they were played, or as they were read back from the rally log.
        first_policy: number of the first entrant in ``rallies.policy``.
    """
    seat = rallies.policy[:, 1] == first_policy
    won = rallies.winner == seat
    last_of_match = np.r_[rallies.match[1:] != rallies.match[:-1], True]
    # A game ends where the next rally is at love all, and with the match.
    last_of_game = last_of_match | np.r_[(rallies.score[1:, 0] | rallies.score[1:, 1]) == 0, True]

    def count(where: npt.NDArray[np.bool_]) -> list[int]:
        at_one = int(np.count_nonzero(where & seat))
        return [int(np.count_nonzero(where)) - at_one, at_one]

    # Without strokes kept, their number is still known.
    strokes, strokes_at_one = (int(rallies.length.sum(dtype=np.int64, where=where)) for where in (True, seat))
    counts = {
        "matches": count(last_of_match),
        "wins": count(last_of_match & won),
        "games_won": count(last_of_game & won),
        "games_lost": count(last_of_game & ~won),
        "points_won": count(won),
        "points_lost": count(~won),
        "served": count(rallies.server == seat),
        "served_won": count((rallies.server == seat) & won),
        "rallies": count(np.ones(len(rallies), dtype=np.bool_)),
        "strokes": [strokes - strokes_at_one, strokes_at_one],
    }
    match_won = won[last_of_match].astype(np.int64)
    per_cell = np.bincount((rallies.match[last_of_match] - rallies.match[0]) >> 1, weights=match_won)
    cells = np.bincount(per_cell.astype(np.int64), minlength=3)
    seats = tuple({name: counts[name][s] for name in COUNTS} for s in (0, 1))
    return PairResult(
        pairing=pairing.number,
        names=pairing.names,
        seats=(seats[0], seats[1]),
        cells=(int(cells[0]), int(cells[1]), int(cells[2])),
    )


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

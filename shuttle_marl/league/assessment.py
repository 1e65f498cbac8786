"""Assessment of a tournament beyond its ranking: meta-game, cycles, robustness of the ranks, and styles of the entrants."""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, TypedDict

import msgspec
import numpy as np

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact.meta_games import alpha_rank, maximal_lottery, nash_average
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.league.ranking import ELO, ExactOdds, Misfit, Standing, groups, misfit, played_cells, prior_wins, wins_of
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.policy.registry import tabulated

ANCHOR: Final = "minimax"  # perfect play, which can have all the weight in an equilibrium; meta-games are also solved without it
_MOST_CYCLES: Final = 20
_SURE: Final = 5e-7
_DECIMALS: Final = 6
_TOLERANCE: Final = 1e-7
_CACHE: Final = Cache("styles", 4096)  # about 2 MB
PEOPLE: Final = "bc"
AXES: Final[dict[str, tuple[str, ...]]] = {
    "smash": ("smash", "half-smash"),
    "drop": ("drop",),
    "clear": ("clear",),
    "lift": ("lift",),
    "block": ("block",),
    "net shot": ("net-shot", "cross-court-net-shot"),
    "net kill": ("net-kill",),
    "drive, push": ("drive", "push"),
}
"""Shot types of each axis; serves belong to none."""


MetaGame = dict[str, dict[str, float]]
"""The game in which each of two players chooses an entrant: by solution, the probability of each entrant.

``nash_average``: maximum-entropy equilibrium, with the probability of winning a match as payoff; ``maximal_lottery``: the same
for the sign of the advantage; ``alpha_rank``: stationary distribution of an evolving population.
"""


class Cycle(TypedDict):
    """Cycle of three entrants: each beats the next, and the last the first; with the probability of each to do so."""

    players: tuple[str, str, str]
    match_win: tuple[float, float, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Style:
    """Style of a policy.

    Attributes:
        likeness: overlap with ``bc``: sum of the smaller of the two probabilities of every stroke, averaged over the states of
            ``bc`` in self-play; 1 for ``bc``.
    """

    likeness: float
    rally_length: float  # expected number of strokes of a rally against `bc`
    shots: dict[str, float]  # fraction of each of `AXES` among the strokes after the serve, against `bc`


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Assessment:
    """Assessment of N entrants.

    Attributes:
        win: ``[N, N]`` probability that the row wins a match against the column: exact, else sampled with the prior of the
            ratings, else by the ratings.
        cyclic_share: fraction of the squared log-odds that no rating can express (Jiang, Lim, Yao & Ye, Math. Programming 2011).
    """

    names: tuple[str, ...]
    win: F64
    misfit: Misfit  # of the ratings to the P pairings that were played
    pairs: list[tuple[str, str]]
    games: dict[str, MetaGame]  # meta-games by description: of all, and without `ANCHOR`
    cyclic_share: float
    cycles: list[Cycle]
    styles: Mapping[str, Style]


def assess(
    standings: Sequence[Standing], results: Sequence[PairResult], exact: ExactOdds, styles: Mapping[str, Style]
) -> Assessment:
    """Assess a tournament by its ranking, the results of all pairings, exact ones, and the styles of entrants with a table."""
    pool = exact.names
    played, cells, pairs = played_cells(pool, results)
    rating = {standing.player: standing.rating / ELO for standing in standings}
    theta = np.nan_to_num(np.array([rating[name] for name in pool]))
    win = _win(exact, cells, pairs, theta)
    some = {1} if np.isnan(win).any() else {standing.group for standing in standings}  # what was never compared has no meta-game
    rated = {standing.player for standing in standings if standing.matches and standing.group in some}
    return Assessment(
        names=pool,
        win=win,
        misfit=misfit(cells, pairs, theta),
        pairs=[result.names for result in played],
        games=meta_games([name for name in pool if name in rated], pool, win),
        cyclic_share=cyclic_share(win),
        cycles=cycles(pool, win),
        styles=styles,
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
    return {about: _meta_game(some, win[np.ix_(at, at)]) for about, some in games.items() if (at := [*map(pool.index, some)])}


def _meta_game(names: Sequence[str], win: F64) -> MetaGame:
    payoff = win - win.T
    solutions = {
        "nash_average": nash_average(payoff),
        "maximal_lottery": maximal_lottery(np.sign(payoff)),
        "alpha_rank": alpha_rank(payoff),
    }
    return {rule: dict(zip(names, np.round(each, _DECIMALS).tolist(), strict=True)) for rule, each in solutions.items()}


def cyclic_share(win: F64) -> float:
    """Fraction of the squared log-odds of all pairs that no differences of ratings can express; 0 for two entrants.

    Args:
        win: ``[N, N]`` probability that the row wins against the column; NaN if unknown.
    """
    p = np.nan_to_num(win, nan=0.5).clip(_SURE, 1 - _SURE)
    odds = np.log(p / (1 - p))
    level = odds.mean(axis=1)
    whole = float((odds**2).sum())
    return round(float(((odds - level[:, None] + level) ** 2).sum()) / whole, _DECIMALS) if whole else 0.0


def cycles(names: Sequence[str], win: F64) -> list[Cycle]:
    """At most twenty cycles of three of N entrants, sorted by the clearness of their closest match.

    Args:
        win: ``[N, N]`` probability that the row wins against the column.
    """
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


def styles(game: Game, tables: Mapping[str, TabulatedPolicy]) -> dict[str, Style]:
    """Styles of policies by name, from the cache if they are known; empty if the game has no ``bc``."""
    try:
        (people,) = tabulated(PEOPLE, game)
    except PolicyError:
        return {}
    keys = {
        name: key_of("style", game.hash, game.opposite.hash, people.hash, table.hash, rooms=("league",))
        for name, table in tables.items()
    }
    known = _CACHE.solved(
        {keys[name]: table for name, table in tables.items()},
        lambda unknown: _solved_styles(game, people, unknown),
        msgspec.json.encode,
        lambda content: msgspec.json.decode(content, type=Style),
    )
    return {name: known[key] for name, key in keys.items()}


def _solved_styles(game: Game, people: TabulatedPolicy, tables: Iterable[TabulatedPolicy]) -> list[Style]:
    from shuttle_marl.exact import moved, visits  # noqa: PLC0415  numba

    usual = people.pair_probabilities()
    theirs = people if game.opposite is game else moved(people, game.opposite)
    met = visits(people, theirs, tolerance=_TOLERANCE).states
    weight = game.of_pairs((met[0] + met[1]) / (met[0] + met[1]).sum())

    def style(policy: TabulatedPolicy) -> Style:
        seen = visits(policy, theirs, tolerance=_TOLERANCE)
        mix = dict(zip(SHOTS, seen.shot_mix(0).tolist(), strict=True))
        rallying = sum(mix[shot] for shots in AXES.values() for shot in shots)
        return Style(
            likeness=round(float((weight * np.minimum(usual, policy.pair_probabilities())).sum()), _DECIMALS),
            rally_length=round(seen.rally_length, _DECIMALS),
            shots={
                axis: round(sum(mix[shot] for shot in shots) / rallying, _DECIMALS) if rallying else 0.0
                for axis, shots in AXES.items()
            },
        )

    return list(in_threads(style, list(tables)))


def as_json(assessment: Assessment, standings: Sequence[Standing]) -> dict[str, Any]:
    """Content of ``report.json``: NaN is None, and numbers are rounded so that files have the same bytes on every machine."""
    fit = assessment.misfit
    pairs = zip(assessment.pairs, fit.share.tolist(), fit.expected.tolist(), fit.z.tolist(), strict=True)
    content = {
        "ranking": [dataclasses.asdict(standing) for standing in standings],
        "payoffs": {"players": assessment.names, "match_win": assessment.win.tolist()},
        "misfit": {
            "statistic": fit.statistic,
            "degrees": fit.degrees,
            "p": fit.p,
            "pairs": [dict(zip(("players", "share", "expected", "z"), pair, strict=True)) for pair in pairs],
        },
        "meta_games": assessment.games,
        "cyclic_share": assessment.cyclic_share,
        "cycles": assessment.cycles,
        "styles": {name: dataclasses.asdict(style) for name, style in assessment.styles.items()},
    }
    plain: dict[str, Any] = json.loads(
        json.dumps(content), parse_float=lambda text: round(float(text), _DECIMALS) + 0.0, parse_constant=lambda _: None
    )
    return plain

"""Tables of a tournament, where every figure has its column, and the ranked table of the console."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from rich.table import Table as RichTable
from rich.text import Text

from shuttle_marl.base import runs
from shuttle_marl.base.errors import printable
from shuttle_marl.league.assessment import Assessment, MetaGame
from shuttle_marl.league.curves import Curve
from shuttle_marl.league.entrants import Format, LeagueConfig
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.style import PEOPLE, Style
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.reports.html import Cell, Column, Table, interval, name, number, percent, table

if TYPE_CHECKING:
    from shuttle_marl.exact.occupancy import Holes

TITLES: Final[dict[Format, str]] = {"round-robin": "Round robin", "swiss": "Swiss tournament", "gauntlet": "Gauntlet"}
_MOST_MISFITS: Final = 40
LEAST_SHOWN: Final = 0.0005
"""Minimum probability of a player in a table of equilibria."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TournamentReport:
    """Content of the report of a tournament.

    Attributes:
        results: of every pairing, in the order in which they were played.
        curves: of the entrants whose training runs still exist.
        logs: rally logs by the number of their first pairing.
    """

    config: LeagueConfig
    game: str
    standings: Sequence[Standing]
    results: Sequence[PairResult]
    assessment: Assessment
    curves: Sequence[Curve] = ()
    logs: Mapping[int, str] = dataclasses.field(default_factory=lambda: {0: runs.RALLIES})
    holes: "Mapping[str, Holes]" = dataclasses.field(default_factory=dict)


def ranking(standings: Sequence[Standing], styles: Mapping[str, Style] | None = None) -> Table:
    """The ranking, without empty columns."""
    likeness = {player: style.likeness for player, style in (styles or {}).items()}
    columns: list[Column[Standing]] = [
        Column("", lambda s: Cell(str(s.rank), s.rank), about="rank", ascending=True),
        Column("player", lambda s: Cell(s.player + (f" (forfeited {s.forfeits})" if s.forfeits else ""), s.player.casefold()),
               left=True),
        Column("rating", lambda s: number(s.rating, "+.0f"), about="Bradley-Terry, in Elo points; mean of the pool 0"),
        Column("95 % interval", lambda s: interval(s.rating_low, s.rating_high, "+.0f"),
               about="of the rating, by a bootstrap over cells of swapped seats"),
        Column("exact rating", lambda s: number(s.rating_exact, "+.0f"), about="its limit after infinitely many matches",
               brief=False),
        Column("ranks (95 %)", lambda s: Cell(f"{s.rank_low} to {s.rank_high}", s.rank_low) if s.rank_low else Cell(),
               about="95 % interval of the rank", ascending=True, brief=False),
        Column("matches won", lambda s: percent(s.share)),
        Column("95 % interval", lambda s: _percents(s.share_low, s.share_high), about="of the matches won", brief=False),
        Column("exact", lambda s: percent(s.exact_share), about="expected fraction of the matches, without sampling"),
        Column("away (95 %)", _away, about="the same in refits of the game: mean, and interval for one more refit"),
        Column("rallies won", lambda s: percent(s.rally_share)),
        Column("serving", lambda s: percent(s.serving), about="rallies won when serving", brief=False),
        Column("receiving", lambda s: percent(s.receiving), about="rallies won when receiving", brief=False),
        Column("exploitability", lambda s: number(s.exploitability, "z.3f"),
               about="gain of the best response to the player; 0 is perfect play", ascending=True),
        Column("normalised", lambda s: number(s.normalised_score, "z.3f"),
               about=f"by rallies won against {PEOPLE}: 0 for {PEOPLE}, 1 for the best response to it"),
        Column("likeness", lambda s: percent(likeness.get(s.player, math.nan)),
               about=f"fraction of the strokes in common with {PEOPLE}", brief=False),
    ]  # fmt: skip
    return table(standings, [column for column in columns if column.left or any(column.cell(s).text for s in standings)])


def _percents(low: float, high: float) -> Cell:
    if math.isnan(low):
        return Cell()
    # Normal intervals of probabilities may reach beyond 0 and 1.
    low, high = max(0.0, low), min(1.0, high)
    return Cell(f"{percent(low).text} to {percent(high).text}", high - low)


def _away(standing: Standing) -> Cell:
    mean = percent(standing.away_share)
    return Cell(f"{mean.text} ({_percents(standing.away_low, standing.away_high).text})", mean.key) if mean.text else mean


def meta_game(about: str, game: MetaGame) -> Table:
    """Probabilities of the entrants in the solutions of a meta-game."""
    most = {player: max(weights[player] for weights in game.values()) for player in game["alpha_rank"]}
    columns: list[Column[str]] = [
        Column("player", name, left=True),
        Column("Nash averaging", lambda player: percent(game["nash_average"][player])),
        Column("maximal lottery", lambda player: percent(game["maximal_lottery"][player])),
        Column("alpha-rank", lambda player: percent(game["alpha_rank"][player])),
    ]
    shown = sorted((player for player in most if most[player] >= LEAST_SHOWN), key=lambda player: -most[player])
    return table(shown, columns, about.capitalize())


def cycles(assessment: Assessment) -> Table:
    """Cycles of three entrants."""
    headings = ("first", "beats second", "beats third, which beats the first", "first win", "second", "third", "closest")
    wins = [(cycle["players"], cycle["match_win"]) for cycle in assessment.cycles]
    rows = [[*map(name, players), *map(percent, won), percent(min(won))] for players, won in wins]
    return Table([Column(heading, name, left=i < 3) for i, heading in enumerate(headings)], rows)


def robustness(assessment: Assessment) -> list[Table]:
    """Tables on the stability of the ranks: refits of the game, and the misfit of the ratings."""
    tables, fit, stable = [], assessment.misfit, assessment.stability
    if stable is not None:
        tables.append(
            table(
                zip(stable["players"], stable["rank"], zip(*stable["rank_in_refits"], strict=True), strict=True),
                [
                    Column("player", lambda row: name(row[0]), left=True),
                    Column("rank", lambda row: number(row[1], "d"), ascending=True),
                    Column("in refits", lambda row: interval(min(row[2]), max(row[2]), "d")),
                    Column("the same", lambda row: percent(row[2].count(row[1]) / len(row[2]), 0)),
                ],
                f"Exact ranks in {len(stable['kendall_tau'])} refits of the game "
                f"(mean Kendall's tau {np.mean(stable['kendall_tau']):.2f})",
            )
        )
    if fit.degrees:
        pairs = zip(assessment.pairs, fit.share.tolist(), fit.expected.tolist(), fit.z.tolist(), strict=True)
        tables.append(
            table(
                sorted(pairs, key=lambda row: -abs(row[3]))[:_MOST_MISFITS],
                [
                    Column("player", lambda row: name(row[0][0]), left=True),
                    Column("opponent", lambda row: name(row[0][1]), left=True),
                    Column("matches won", lambda row: percent(row[1])),
                    Column("by the ratings", lambda row: percent(row[2])),
                    Column("standard errors", lambda row: number(row[3], "+.1f")),
                ],
                f"Misfit of the ratings: chi-squared {fit.statistic:.1f} with {fit.degrees} degrees of freedom, p = {fit.p:.2g}",
            )
        )
    return tables


def console_table(standings: Sequence[Standing], form: Format = "round-robin") -> RichTable:
    """The ranking for the console, with the columns that are brief."""
    shown = RichTable(title=TITLES[form], title_justify="left", header_style="bold")
    ranked = ranking(standings)
    for column in ranked.columns:
        if column.brief:
            shown.add_column(column.heading, justify="left" if column.left else "right", no_wrap=True)
    for standing, row in zip(standings, ranked.rows, strict=True):
        brief = (cell.text for cell, column in zip(row, ranked.columns, strict=True) if column.brief)
        shown.add_row(*(Text(printable(text)) for text in brief), style="dim" if standing.forfeits else None)
    return shown

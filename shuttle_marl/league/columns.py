"""The tables of a tournament: every figure has its column here, for the page, for Markdown and for the console."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from shuttle_marl.league.assessment import Assessment, MetaGame
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.style import PEOPLE, Style
from shuttle_marl.pages import Cell, Column, Table, interval, name, number, percent, table

_MOST_MISFITS: Final = 40
LEAST_SHOWN: Final = 0.0005
"""Minimum probability of a player in a table of equilibria."""


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
        Column("exploitability", lambda s: number(s.exploitability, ".3f"),
               about="gain of the best response to the player; 0 is perfect play", ascending=True),
        Column("normalised", lambda s: number(s.normalised_score, ".3f"),
               about=f"by rallies won against {PEOPLE}: 0 for {PEOPLE}, 1 for the best response to it"),
        Column("likeness", lambda s: percent(likeness.get(s.player, math.nan)),
               about=f"fraction of the strokes in common with {PEOPLE}", brief=False),
    ]  # fmt: skip
    return table(standings, [column for column in columns if column.left or any(column.cell(s).text for s in standings)])


def _percents(low: float, high: float) -> Cell:
    # Normal intervals of probabilities may reach beyond 0 and 1.
    low, high = max(0.0, low), min(1.0, high)
    return Cell() if math.isnan(low) else Cell(f"{percent(low).text} to {percent(high).text}", high - low)


def _away(standing: Standing) -> Cell:
    mean = percent(standing.away_share)
    return Cell(f"{mean.text} ({_percents(standing.away_low, standing.away_high).text})", mean.key) if mean.text else mean


def payoffs(names: Sequence[str], share: Mapping[tuple[str, str], float]) -> Table:
    """Fraction of the matches that the row wins against the column, where it is known."""
    columns: list[Column[str]] = [
        Column("", name, left=True),
        *(Column(other, lambda row, other=other: percent(share.get((row, other), math.nan))) for other in names),  # type: ignore[misc]
    ]
    return table(names, columns)


def meta_game(about: str, game: MetaGame) -> Table:
    """Probabilities of the entrants in the solutions of a meta-game."""
    weights = zip(game.names, game.nash_average.tolist(), game.maximal_lottery.tolist(), game.alpha_rank.tolist(), strict=True)
    shown = sorted((row for row in weights if max(row[1:]) >= LEAST_SHOWN), key=lambda row: -max(row[1:]))
    columns: list[Column[tuple[str, float, float, float]]] = [
        Column("player", lambda row: name(row[0]), left=True),
        Column("Nash averaging", lambda row: percent(row[1])),
        Column("maximal lottery", lambda row: percent(row[2])),
        Column("alpha-rank", lambda row: percent(row[3])),
    ]
    return table(shown, columns, about.capitalize())


def cycles(assessment: Assessment) -> Table:
    """Cycles of three entrants."""
    headings = ("first", "beats second", "beats third, which beats the first", "first win", "second", "third", "closest")
    rows = [[*map(name, cycle.names), *map(percent, cycle.wins), percent(min(cycle.wins))] for cycle in assessment.cycles]
    return Table([Column(heading, name, left=i < 3) for i, heading in enumerate(headings)], rows)


def robustness(assessment: Assessment) -> list[Table]:
    """Tables on the stability of the ranks: refits of the game, and the misfit of the ratings."""
    tables, fit, stable = [], assessment.misfit, assessment.stability
    if stable is not None:
        tables.append(
            table(
                zip(stable.names, stable.home.tolist(), stable.away.T.tolist(), strict=True),
                [
                    Column("player", lambda row: name(row[0]), left=True),
                    Column("rank", lambda row: number(row[1], "d"), ascending=True),
                    Column("in refits", lambda row: interval(min(row[2]), max(row[2]), "d")),
                    Column("the same", lambda row: percent(row[2].count(row[1]) / len(row[2]), 0)),
                ],
                f"Exact ranks in {len(stable.away)} refits of the game (mean Kendall's tau {stable.agreement.mean():.2f})",
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

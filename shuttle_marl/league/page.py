"""The ranked table of the console, and HTML pages of a tournament and of runs side by side."""

import dataclasses
import functools
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup
from rich.table import Table as RichTable
from rich.text import Text

from shuttle_marl.base import runs
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import isolated, printable
from shuttle_marl.base.intervals import Interval, interquartile_mean, probability_of_improvement
from shuttle_marl.league.assessment import Assessment, MetaGame
from shuttle_marl.league.entrants import PAIRINGS, REPORT, Format, LeagueConfig, LeagueError
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.reports import charts
from shuttle_marl.reports.html import Cell, Column, Table, interval, name, number, percent, render, table

TITLES: Final[dict[Format, str]] = {"round-robin": "Round robin", "swiss": "Swiss tournament", "gauntlet": "Gauntlet"}
FIGURES: Final = {"exploitability": "exploitability", "normalised_score": "normalised score", "rally_win": "rallies won"}
_LESS_IS_BETTER: Final = ("exploitability",)
_NUMBER: Final = (int, float)
_LEAST_SHOWN: Final = 0.0005
_NOT_A_SETTING: Final = ("seed", "record")
_MOST: Final = 1000  # players of a tournament
_RATING: Final = ("rank", "rating", "rating_low", "rating_high", "rating_exact", "group")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """Evaluations of a training run."""

    name: str
    rows: list[dict[str, Any]]
    settings: str = "{}"  # of the run, as JSON with sorted keys

    def points(self, figure: str, by: str) -> list[tuple[float, float]]:
        """Points of a figure over ``seconds`` or ``strokes``; rows without one of the two are left out."""
        pairs = ((row.get(by), row.get(figure)) for row in self.rows)
        return [(x, y) for x, y in pairs if isinstance(x, _NUMBER) and isinstance(y, _NUMBER)]

    def last(self, figure: str) -> float:
        """The last value of a figure; NaN without one."""
        found = [row[figure] for row in self.rows if isinstance(row.get(figure), _NUMBER)]
        return float(found[-1]) if found else math.nan


def read_curve(folder: Path, name: str) -> Curve:
    """Read the evaluations and the settings of a training run. Raises RunError: they are damaged."""
    settings = {
        key: value for key, value in runs.read_json(folder / runs.CONFIG, dict[str, Any]).items() if key not in _NOT_A_SETTING
    }
    rows = runs.Journal(folder / runs.METRICS).read()
    return Curve(name=name, rows=rows, settings=json.dumps(settings, sort_keys=True))


def learning_charts(runs: Sequence[Curve]) -> list[tuple[str, Markup]]:
    """Captions and charts of all figures that the runs have, by strokes where all runs count them, else by time."""
    counted = all(run.points(figure, "strokes") for run in runs for figure in FIGURES if run.points(figure, "seconds"))
    by = "strokes" if counted else "seconds"
    found = []
    for figure, caption in FIGURES.items() if runs else ():  # without one, Matplotlib is not imported
        lines = {run.name: run.points(figure, by) for run in runs}
        chart = charts.curves(lines, by, caption, logarithmic=figure in _LESS_IS_BETTER)
        if chart is not None:
            found.append((caption.capitalize(), chart))
    return found


def ranking(standings: Sequence[Standing]) -> Table:
    """The ranking, without empty columns."""
    apart = any(standing.group > 1 for standing in standings)
    columns: list[Column[Standing]] = [
        Column("", lambda s: Cell(str(s.rank), s.rank), about="rank", ascending=True),
        Column("group", lambda s: Cell(str(s.group), s.group) if apart else Cell(), about="groups are not compared",
               ascending=True),
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
        Column("rallies won", lambda s: percent(s.rally_share)),
        Column("serving", lambda s: percent(s.serving), about="rallies won when serving", brief=False),
        Column("receiving", lambda s: percent(s.receiving), about="rallies won when receiving", brief=False),
        Column("exploitability", lambda s: number(s.exploitability, "z.3f"),
               about="gain of the best response to the player; 0 is perfect play", ascending=True),
        Column("normalised", lambda s: number(s.normalised_score, "z.3f"),
               about="by rallies won against bc: 0 for bc, 1 for the best response to it"),
    ]  # fmt: skip
    return table(standings, [column for column in columns if column.left or any(column.cell(s).text for s in standings)])


def _percents(low: float, high: float) -> Cell:
    if math.isnan(low):
        return Cell()
    # Normal intervals of probabilities may reach beyond 0 and 1.
    low, high = max(0.0, low), min(1.0, high)
    return Cell(f"{percent(low).text} to {percent(high).text}", high - low)


def console_table(standings: Sequence[Standing], form: Format = "round-robin") -> RichTable:
    """The ranking for the console, with the columns that are brief."""
    shown = RichTable(title=TITLES[form], title_justify="left", header_style="bold")
    ranked = ranking(standings)
    for column in ranked.columns:
        if column.brief:
            shown.add_column(column.heading, justify="left" if column.left else "right", no_wrap=True)
    if any(standing.group > 1 for standing in standings):
        shown.caption, shown.caption_justify = _summary(standings), "left"
    for standing, row in zip(standings, ranked.rows, strict=True):
        brief = (cell.text for cell, column in zip(row, ranked.columns, strict=True) if column.brief)
        shown.add_row(*(Text(isolated(printable(text))) for text in brief), style="dim" if standing.forfeits else None)
    return shown


def page(
    config: LeagueConfig,
    game: str,
    standings: Sequence[Standing],
    results: Sequence[PairResult],
    assessment: Assessment,
    *,
    logs: Mapping[int, str] = {0: runs.RALLIES},
) -> bytes:
    """The page of a tournament, as the content of a file.

    Args:
        game: hash of the game.
        results: of every pairing, in the order in which they were played.
        logs: rally logs by the number of their first pairing.
    """
    played = [result for result in results if not result.forfeit]
    order = [assessment.names.index(s.player) for s in standings]
    return render(
        __package__,
        "tournament.html.j2",
        title=TITLES[config.format],
        subtitle=f"seed {config.seed} · game {config.game} ({game[:12]}) · {config.rules} points",
        totals={"players": len(standings)}
        | {what: sum(seat[what] for r in played for seat in r.seats) for what in ("matches", "rallies", "strokes")},
        summary=_summary(standings),
        ranking=ranking(standings),
        payoffs=_payoffs([s.player for s in standings], assessment.win[order][:, order]),
        games=_meta_games(assessment.games),
        cycles=_cycles(assessment),
        recorded=config.record == "all",
        logs=[*logs.values()],
        files=(REPORT, PAIRINGS, "results.csv"),
        pairings=_pairings(results, logs, numbered=config.record == "all"),
        forfeits=table([result for result in results if result.forfeit], _FORFEITS),
    )


def _summary(standings: Sequence[Standing]) -> str:
    """Who is first, in a sentence: all entrants whose 95 % interval of the rank includes 1."""
    if (last := max((standing.group for standing in standings), default=1)) > 1:
        return f"{last} groups of entrants have no chain of matches between them: they are ranked apart, and not compared."
    first = [standing.player for standing in standings if standing.rank_low == 1]
    if not first:
        return "No matches were played."
    if len(first) == 1:
        return f"{first[0]} is ranked first: no other 95 % interval of the rank includes 1."
    return f"{', '.join(first[:-1])} and {first[-1]} share the first rank: their 95 % intervals of the rank include it."


def _payoffs(names: Sequence[str], win: F64) -> Table:
    """Matches that each player wins against each other one; ``[N, N]`` probabilities, NaN: unknown."""

    def cell(row: int, column: int) -> Cell:
        p = float(win[row, column])
        return Cell() if row == column or math.isnan(p) else Cell(f"{100 * p:.0f}", p, kind=f"shade-{10 * p:.0f}")

    columns = [Column[int]("", lambda row: name(names[row]), left=True)]
    columns += [Column(charts.label(each), functools.partial(cell, column=i), about=each) for i, each in enumerate(names)]
    return table(range(len(names)), columns)


def _meta_games(games: Mapping[str, MetaGame]) -> Table:
    """Probabilities of the entrants in each game; those that have none are left out."""
    columns: list[Column[str]] = [Column("player", name, left=True)]
    for about, weights in games.items():
        columns.append(Column(about, lambda player, weights=weights: percent(weights.get(player, math.nan))))  # type: ignore[misc]
    most = {player: max(weights.get(player, 0.0) for weights in games.values()) for each in games.values() for player in each}
    shown = sorted((player for player in most if most[player] >= _LEAST_SHOWN), key=lambda player: -most[player])
    return table(shown, columns)


def _cycles(assessment: Assessment) -> Table:
    headings = ("first", "beats second", "beats third, which beats the first", "first win", "second", "third", "closest")
    wins = [(cycle["players"], cycle["match_win"]) for cycle in assessment.cycles]
    rows = [[*map(name, players), *map(percent, won), percent(min(won))] for players, won in wins]
    return Table([Column(heading, name, left=i < 3) for i, heading in enumerate(headings)], rows)


def _pairings(results: Sequence[PairResult], logs: Mapping[int, str], *, numbered: bool) -> Table:
    columns: list[Column[dict[str, Any]]] = [
        Column("player", lambda row: name(row["names"][0]), left=True),
        Column("opponent", lambda row: name(row["names"][1]), left=True),
        Column("matches", lambda row: number(row["matches"], ",")),
        Column("won", lambda row: percent(row["wins"] / row["matches"])),
        Column("rallies won", lambda row: percent(row["points_won"] / row["rallies"])),
        Column("strokes a rally", lambda row: number(row["strokes"] / row["rallies"], ".2f")),
    ]
    if numbered:
        columns.append(Column("first rally", lambda row: row["place"], about="its number in the log", ascending=True))
    rows, first, file = [], 0, runs.RALLIES
    for result in results:
        if result.pairing in logs:
            first, file = 0, logs[result.pairing]
        counts = result.seen_by(result.names[0])
        if counts["matches"]:
            place = Cell(f"{first} in {file}" if len(logs) > 1 else str(first), first)
            rows.append({**counts, "names": result.names, "place": place})
        first += counts["rallies"]
    return table(rows, columns)


_FORFEITS: Final[Sequence[Column[PairResult]]] = (
    Column("player", lambda result: name(result.names[0]), left=True),
    Column("opponent", lambda result: name(result.names[1]), left=True),
    Column("forfeited", lambda result: name(" and ".join(result.forfeit)), left=True),
    Column("reason", lambda result: Cell(result.reason, result.reason), left=True, wrap=True),
)


def compare(folders: Sequence[Path]) -> bytes:
    """The page of one training run, or of some runs side by side, as the content of a file.

    Args:
        folders: of tournaments, of training runs, or of both.

    Raises:
        LeagueError: a folder contains no run, or an unfinished tournament, or is given twice.
        RunError: a file of a run is damaged.
    """
    names = _names(folders)
    tournaments: dict[str, dict[str, Any]] = {}
    trained: list[Curve] = []
    for folder, name_of_run in zip(folders, names, strict=True):
        if (folder / REPORT).is_file():
            tournaments[name_of_run] = runs.read_json(folder / REPORT, dict[str, Any])
        elif (folder / runs.METRICS).is_file():
            trained.append(read_curve(folder, name_of_run))
        else:
            raise LeagueError(f"{folder}: contains neither a finished tournament ({REPORT}) nor a training run ({runs.METRICS})")
    told: list[tuple[str, object]] = [*tournaments.items(), *((run.name, run.rows) for run in trained)]
    for (first, one), (second, other) in itertools.combinations(told, 2):
        if one == other:
            raise LeagueError(f"{first} and {second} are the same run; give one of them")
    return render(
        __package__,
        "comparison.html.j2",
        title="Comparison of runs" if len(folders) > 1 else "Run",
        subtitle=" · ".join(names),
        **_compare_tournaments(tournaments),
        **_compare_training(trained),
    )


def _names(folders: Sequence[Path]) -> list[str]:
    if not folders:
        raise LeagueError("give one run or more")
    whole = [folder.resolve() for folder in folders]
    if len(set(whole)) < len(whole):
        raise LeagueError("a run is given twice")
    shared = Path(os.path.commonpath(whole)) if len(whole) > 1 else whole[0].parent
    return [path.relative_to(shared).as_posix() if path != shared else path.name for path in whole]


def _compare_tournaments(reports: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    rankings: dict[str, dict[str, dict[str, Any]]] = {}
    try:
        for run, report in reports.items():
            rankings[run] = {str(row["player"]): row for row in report["ranking"]}
            if not len(rankings[run]) == len(report["ranking"]) <= _MOST:
                raise ValueError(f"a player is ranked twice, or more than {_MOST:,} are ranked")
            for row in rankings[run].values():
                row |= {figure: math.nan if row[figure] is None else float(row[figure]) for figure in _RATING}
                if row["rating_low"] > row["rating_high"]:
                    raise ValueError("an interval ends before it begins")
    except (KeyError, TypeError, ValueError) as error:
        raise LeagueError(f"{run}/{REPORT}: not the report of a tournament ({type(error).__name__}: {error})") from error
    columns: list[Column[str]] = [Column("player", name, left=True)]
    for run, ranked in rankings.items():
        columns += _rating_columns(run, ranked)
    players = dict.fromkeys(player for ranked in rankings.values() for player in ranked)
    return {"ratings": table(players, columns) if rankings else None}


def _rating_columns(run: str, ranking: Mapping[str, Mapping[str, float]]) -> list[Column[str]]:
    def figure(player: str, key: str) -> float:
        return ranking[player][key] if player in ranking else math.nan

    groups = {row["group"] for row in ranking.values()}
    apart = [Column[str]("group", lambda player: number(figure(player, "group"), ".0f"), about="groups are not compared")]
    return [
        Column(f"{run}: rank", lambda player: number(figure(player, "rank"), ".0f"), ascending=True),
        *(apart if len(groups) > 1 else ()),
        Column("rating", lambda player: number(figure(player, "rating"), "+.0f")),
        Column("95 % interval", lambda player: interval(figure(player, "rating_low"), figure(player, "rating_high"), "+.0f")),
        Column("exact", lambda player: number(figure(player, "rating_exact"), "+.0f")),
    ]


def _compare_training(trained: Sequence[Curve]) -> dict[str, Any]:
    methods: dict[str, list[Curve]] = {}
    for run in trained:
        methods.setdefault(run.settings, []).append(run)
    groups = dict(zip(_labels([*methods]), methods.values(), strict=True))
    # Final figures of the runs of each method, by figure and label.
    finals = {
        figure: {label: [value for run in group if not math.isnan(value := run.last(figure))] for label, group in groups.items()}
        for figure in FIGURES
        if any(run.points(figure, "seconds") for run in trained)
    }
    columns: list[Column[str]] = [
        Column("method", name, left=True),
        Column("runs", lambda label: number(len(groups[label]), "d")),
    ]
    for figure, values in finals.items():
        columns += _final_columns(figure, values)
    return {
        "curves": learning_charts(trained),
        "settings": _settings(trained[0]) if len(trained) == 1 else None,
        "seeds": table(groups, columns) if len(trained) > 1 else None,
        "improvements": _improvements(finals) if len(methods) > 1 else None,
    }


def _settings(run: Curve) -> list[Table]:
    columns: list[Column[tuple[str, Cell]]] = [
        Column("name", lambda row: name(row[0].replace("_", " ")), left=True),
        Column("value", lambda row: row[1]),
    ]
    last = {key: run.last(key) for key in (run.rows[-1] if run.rows else {})}
    figures = [(key, number(value, ",.6g")) for key, value in last.items() if not math.isnan(value)]
    settings = [(key, name(_words(value))) for key, value in json.loads(run.settings).items()]
    return [table(figures, columns, "Last evaluation"), table(settings, columns, "Settings")]


def _final_columns(figure: str, values: Mapping[str, Sequence[float]]) -> list[Column[str]]:
    missing = Interval(math.nan, math.nan, math.nan)
    means = {label: interquartile_mean([runs]) if runs else missing for label, runs in values.items()}
    heading, ascending = FIGURES[figure], figure in _LESS_IS_BETTER
    return [
        Column(heading, lambda label: number(means[label].value, ".4f"), about="interquartile mean", ascending=ascending),
        Column("95 % interval", lambda label: interval(means[label].low, means[label].high, ".4f")),
    ]


def _improvements(finals: Mapping[str, Mapping[str, Sequence[float]]]) -> Table:
    rows: list[tuple[str, str, str, Interval]] = []
    for figure, values in finals.items():
        sign = -1.0 if figure in _LESS_IS_BETTER else 1.0
        for (label, ours), (other, theirs) in itertools.permutations(values.items(), 2):
            if ours and theirs:
                better = probability_of_improvement([sign * x for x in ours], [sign * x for x in theirs])
                rows.append((label, other, FIGURES[figure], better))
    columns: list[Column[tuple[str, str, str, Interval]]] = [
        Column("method", lambda row: name(row[0]), left=True),
        Column("is better than", lambda row: name(row[1]), left=True),
        Column("by", lambda row: name(row[2]), left=True),
        Column("probability", lambda row: percent(row[3].value, 0)),
        Column("95 % interval", lambda row: interval(100 * row[3].low, 100 * row[3].high, ".0f")),
    ]
    return table(rows, columns, "Probability that a run of one method is better than a run of the other [%]")


def _labels(settings: Sequence[str]) -> list[str]:
    """The settings in which methods differ, a label for each."""
    known = [json.loads(text) for text in settings]
    keys = sorted({key for each in known for key in each})
    differ = [key for key in keys if len({json.dumps(each.get(key)) for each in known}) > 1]
    differ = differ or [key for key in ("algorithm", "way", "opponent") if key in keys]
    return [", ".join(f"{key} {_words(each.get(key))}" for key in differ) or "all runs" for each in known]


def _words(value: object) -> str:
    words = " and ".join(map(_words, value)) if isinstance(value, list) else value
    return "none" if words in (None, "") else str(words)

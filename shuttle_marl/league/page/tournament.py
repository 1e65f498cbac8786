"""HTML pages of a tournament and of a comparison of runs."""

import dataclasses
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from shuttle_marl.base import runs
from shuttle_marl.base.intervals import Interval, interquartile_mean, probability_of_improvement
from shuttle_marl.league.curves import FIGURES, Curve, learning_charts, read_curve
from shuttle_marl.league.entrants import PAIRINGS, REPORT, LeagueError
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.report import TITLES, TournamentReport, cycles, meta_game, ranking, robustness
from shuttle_marl.league.style import AXES, PEOPLE
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.recording import Sampling
from shuttle_marl.reports import charts
from shuttle_marl.reports.html import Cell, Column, Table, interval, name, number, percent, render, table

if TYPE_CHECKING:
    from shuttle_marl.exact.occupancy import Hole, Holes

_MOST_RADARS: Final = 40


def page(report: TournamentReport) -> bytes:
    """The page as the content of a file."""
    assessment, standings = report.assessment, report.standings
    played = [result for result in report.results if not result.forfeit]
    counted = ("matches", "rallies", "strokes")
    order = [assessment.names.index(s.player) for s in standings]
    return render(
        __package__,
        "tournament.html.j2",
        title=TITLES[report.config.format],
        subtitle=f"seed {report.config.seed} · game {report.config.game} ({report.game[:12]}) · {report.config.rules} points",
        totals={"players": len(standings)} | {what: sum(seat[what] for r in played for seat in r.seats) for what in counted},
        summary=_summary(standings),
        ranking=ranking(standings, assessment.styles),
        rating_chart=charts.forest([(s.player, s.rating, s.rating_low, s.rating_high, s.rating_exact) for s in standings], "Elo"),
        payoff_chart=charts.heat_map([s.player for s in standings], assessment.win[order][:, order]),
        curves=learning_charts(report.curves),
        holes={player: _holes(player, each) for player, each in report.holes.items()},
        people=PEOPLE,
        styles=_styles(report),
        games=[meta_game(about, game) for about, game in assessment.games.items()],
        cyclic_share=assessment.cyclic_share,
        cycles=cycles(assessment),
        robustness=robustness(assessment),
        recorded_every=Sampling.parse(report.config.record).every,
        logs=[*report.logs.values()],
        files=(REPORT, PAIRINGS, "results.csv"),
        pairings=_pairings(report),
        forfeits=table([result for result in report.results if result.forfeit], _FORFEITS),
    )


def _summary(standings: Sequence[Standing]) -> str:
    """Who is first, in a sentence: all entrants whose 95 % interval of the rank includes 1."""
    first = [standing.player for standing in standings if standing.rank_low == 1]
    if not first:
        return "No matches were played."
    if len(first) == 1:
        return f"{first[0]} is ranked first: no other 95 % interval of the rank includes 1."
    return f"{', '.join(first[:-1])} and {first[-1]} share the first rank: their 95 % intervals of the rank include it."


def _styles(report: TournamentReport) -> dict[str, Any]:
    """Charts and table of the styles; empty without any."""
    styles = report.assessment.styles
    if not styles:
        return {}
    strength = {s.player: s.rating_exact for s in report.standings if not math.isnan(s.rating_exact)}
    points = {player: (style.likeness, strength[player]) for player, style in styles.items() if player in strength}
    rim = {axis: max(style.shots[axis] for style in styles.values()) or 1.0 for axis in AXES}
    reference = styles[PEOPLE].shots if PEOPLE in styles else dict.fromkeys(AXES, 0.0)
    players = [s.player for s in report.standings if s.player in styles]

    def mix(shots: Mapping[str, float]) -> list[float]:
        return [shots[axis] / rim[axis] for axis in AXES]

    columns: list[Column[str]] = [
        Column("player", name, left=True),
        Column("likeness", lambda player: percent(styles[player].likeness)),
        Column("strokes a rally", lambda player: number(styles[player].rally_length, ".2f")),
        *(Column(axis, lambda player, axis=axis: percent(styles[player].shots[axis])) for axis in AXES),  # type: ignore[misc]
    ]
    return {
        "chart": charts.scatter(points, f"likeness to {PEOPLE}", "exact rating") if len(points) > 1 else None,
        "radars": charts.radars(
            [*AXES], {player: mix(styles[player].shots) for player in players[:_MOST_RADARS]}, mix(reference)
        ),
        "has_reference": PEOPLE in styles,
        "table": table(players, columns),
    }


_HOLES: "Final[Sequence[Column[Hole]]]" = (
    Column("state", lambda hole: name(hole.description), left=True, wrap=True),
    Column("in self-play", lambda hole: number(hole.in_self_play, ".2g"), about="visits in a rally against itself"),
    Column("against its best", lambda hole: number(hole.against_best_response, ".2g"),
           about="visits in a rally against its best response"),
    Column("loses a rally", lambda hole: number(hole.loss, ".5f"),
           about="loss there in a rally against its best response, as a value"),
    Column("plays most", lambda hole: _stroke(hole.played, hole.played_share, hole.played_real), left=True, wrap=True),
    Column("best stroke", lambda hole: _stroke(hole.best, hole.best_share, hole.best_real), left=True, wrap=True),
)  # fmt: skip


def _stroke(stroke: str, share: float, real: float | None) -> Cell:
    """A stroke with its probability and the number of real strokes behind it."""
    return name(f"{stroke} ({100 * share:.0f} %{'' if real is None else f', {real:,.0f} real strokes'})")


def _holes(player: str, holes: "Holes") -> Table:
    caption = f"{player}: exploitability {holes.exploitability:z.4f}, {100 * holes.share:.0f} % of its loss here"
    return table(holes.holes, _HOLES, caption)


def _pairings(report: TournamentReport) -> Table:
    columns: list[Column[dict[str, Any]]] = [
        Column("player", lambda row: name(row["names"][0]), left=True),
        Column("opponent", lambda row: name(row["names"][1]), left=True),
        Column("matches", lambda row: number(row["matches"], ",")),
        Column("won", lambda row: percent(row["wins"] / row["matches"])),
        Column("rallies won", lambda row: percent(row["points_won"] / row["rallies"])),
        Column("strokes a rally", lambda row: number(row["strokes"] / row["rallies"], ".2f")),
    ]
    if Sampling.parse(report.config.record).every == 1:
        columns.append(Column("first rally", lambda row: row["place"], about="its number in the log", ascending=True))
    rows, first, file = [], 0, runs.RALLIES
    for result in report.results:
        if result.pairing in report.logs:
            first, file = 0, report.logs[result.pairing]
        counts = result.seen_by(result.names[0])
        if counts["matches"]:
            place = Cell(f"{first} in {file}" if len(report.logs) > 1 else str(first), first)
            rows.append({**counts, "names": result.names, "place": place})
        first += counts["rallies"]
    return table(rows, columns)


_FORFEITS: Final[Sequence[Column[PairResult]]] = (
    Column("player", lambda result: name(result.names[0]), left=True),
    Column("opponent", lambda result: name(result.names[1]), left=True),
    Column("forfeited", lambda result: name(" and ".join(result.forfeit)), left=True),
    Column("reason", lambda result: Cell(result.reason, result.reason), left=True, wrap=True),
)


_NOT_A_SETTING = ("seed", "record")
_LESS_IS_BETTER = ("exploitability",)
_RATING = ("rank", "rating", "rating_low", "rating_high", "rating_exact")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ComparedRun:
    """A training run."""

    curve: Curve
    settings: str


def compare(folders: Sequence[Path]) -> bytes:
    """The page of one training run, or of some runs side by side, as the content of a file.

    Args:
        folders: of tournaments, of training runs, or of both.

    Raises:
        LeagueError: a folder contains no run, or an unfinished tournament, or is given twice.
    """
    names = _names(folders)
    tournaments: dict[str, dict[str, Any]] = {}
    trained: dict[str, ComparedRun] = {}
    for folder, name_of_run in zip(folders, names, strict=True):
        if (folder / REPORT).is_file():
            tournaments[name_of_run] = _read(folder / REPORT)
        elif (folder / runs.METRICS).is_file():
            config = _read(folder / runs.CONFIG)
            settings = {key: value for key, value in config.items() if key not in _NOT_A_SETTING}
            curve = read_curve(folder, name_of_run)
            trained[name_of_run] = ComparedRun(curve=curve, settings=json.dumps(settings, sort_keys=True))
        else:
            raise LeagueError(f"{folder}: contains neither a finished tournament ({REPORT}) nor a training run ({runs.METRICS})")
    return render(
        __package__,
        "comparison.html.j2",
        title="Comparison of runs" if len(folders) > 1 else "Run",
        subtitle=" · ".join(names),
        **_compare_tournaments(tournaments),
        **_compare_training([*trained.values()]),
    )


def _names(folders: Sequence[Path]) -> list[str]:
    """Paths of folders relative to their common parent."""
    if not folders:
        raise LeagueError("give one run or more")
    whole = [folder.resolve() for folder in folders]
    if len(set(whole)) < len(whole):
        raise LeagueError("a run is given twice")
    shared = Path(os.path.commonpath(whole)) if len(whole) > 1 else whole[0].parent
    return [path.relative_to(shared).as_posix() if path != shared else path.name for path in whole]


def _read(path: Path) -> dict[str, Any]:
    try:
        return runs.read_json(path, dict[str, Any])
    except runs.RunError as error:
        raise LeagueError(str(error)) from error


def _compare_tournaments(reports: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """The ratings of all players in all tournaments: a table, and a chart of each tournament."""
    rankings: dict[str, dict[str, dict[str, Any]]] = {}
    try:
        for run, report in reports.items():
            rankings[run] = {str(row["player"]): row for row in report["ranking"]}
            for row in rankings[run].values():
                for figure in _RATING:
                    row[figure] = math.nan if row[figure] is None else float(row[figure])
    except (KeyError, TypeError, ValueError) as error:
        raise LeagueError(f"{run}/{REPORT}: not the report of a tournament ({type(error).__name__}: {error})") from error
    columns: list[Column[str]] = [Column("player", name, left=True)]
    for run, ranked in rankings.items():
        columns += _rating_columns(run, ranked)
    players = dict.fromkeys(player for ranked in rankings.values() for player in ranked)
    rated = {
        run: [(player, *(row[figure] for figure in _RATING[1:])) for player, row in rows.items()]
        for run, rows in rankings.items()
    }
    return {
        "ratings": table(players, columns) if rankings else None,
        "rating_charts": [(run, charts.forest(rows, "Elo")) for run, rows in rated.items()],
    }


def _rating_columns(run: str, ranking: Mapping[str, Mapping[str, float]]) -> list[Column[str]]:
    def figure(player: str, key: str) -> float:
        return ranking[player][key] if player in ranking else math.nan

    return [
        Column(f"{run}: rank", lambda player: number(figure(player, "rank"), ".0f"), ascending=True),
        Column("rating", lambda player: number(figure(player, "rating"), "+.0f")),
        Column("95 % interval", lambda player: interval(figure(player, "rating_low"), figure(player, "rating_high"), "+.0f")),
        Column("exact", lambda player: number(figure(player, "rating_exact"), "+.0f")),
    ]


def _compare_training(trained: Sequence[ComparedRun]) -> dict[str, Any]:
    """Curves of training runs, their final figures over seeds, and which method is better."""
    methods: dict[str, list[ComparedRun]] = {}
    for run in trained:
        methods.setdefault(run.settings, []).append(run)
    labels = _labels([*methods])
    # Final figures of the runs of each method, by figure and label.
    finals = {
        figure: {label: _finals(group, figure) for label, group in zip(labels, methods.values(), strict=True)}
        for figure in FIGURES
        if any(run.curve.points(figure, "seconds") for run in trained)
    }
    sizes = dict(zip(labels, map(len, methods.values()), strict=True))
    columns: list[Column[str]] = [
        Column("method", name, left=True),
        Column("runs", lambda label: number(sizes[label], "d")),
    ]
    for figure, values in finals.items():
        columns += _final_columns(figure, values)
    return {
        "curves": learning_charts([run.curve for run in trained]),
        "settings": _settings(trained[0]) if len(trained) == 1 else None,
        "seeds": table(labels, columns) if len(trained) > 1 else None,
        "improvements": _improvements(finals) if len(methods) > 1 else None,
    }


def _settings(run: ComparedRun) -> list[Table]:
    """The last evaluation of a training run, and its settings."""
    columns: list[Column[tuple[str, Cell]]] = [
        Column("name", lambda row: name(row[0]), left=True),
        Column("value", lambda row: row[1]),
    ]
    last = {key.replace("_", " "): run.curve.last(key) for key in (run.curve.rows[-1] if run.curve.rows else {})}
    figures = [(key, number(value, ",.6g")) for key, value in last.items() if not math.isnan(value)]
    settings = [(key.replace("_", " "), name(_words(value))) for key, value in json.loads(run.settings).items()]
    return [table(figures, columns, "Last evaluation"), table(settings, columns, "Settings")]


def _finals(group: Sequence[ComparedRun], figure: str) -> list[float]:
    return [value for run in group if not math.isnan(value := run.curve.last(figure))]


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
    if not differ:
        differ = [key for key in ("algorithm", "way", "opponent") if key in keys]
    return [", ".join(f"{key} {_words(each.get(key))}" for key in differ) or "all runs" for each in known]


def _words(value: object) -> str:
    words = " and ".join(map(_words, value)) if isinstance(value, list) else value
    return "none" if words in (None, "") else str(words)

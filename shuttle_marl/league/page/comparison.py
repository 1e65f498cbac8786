"""Page that compares runs: ratings of tournaments side by side, and training runs over seeds."""

import dataclasses
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shuttle_marl import runs
from shuttle_marl.league.entrants import LeagueError
from shuttle_marl.league.folder import REPORT
from shuttle_marl.league.page import charts
from shuttle_marl.league.page.document import Column, Table, interval, name, number, percent, render, table
from shuttle_marl.league.page.learning import FIGURES, METRICS, Curve, learning_charts, read_curve
from shuttle_marl.league.seeds import Interval, interquartile_mean, probability_of_improvement

_NOT_A_SETTING = ("seed", "record")
_LESS_IS_BETTER = ("exploitability",)
_RATING = ("rank", "rating", "rating_low", "rating_high", "rating_exact")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ComparedRun:
    """A training run.

    Attributes:
        curve: its evaluations.
        settings: its configuration without the seed, as JSON.
    """

    curve: Curve
    settings: str


def compare(folders: Sequence[Path]) -> bytes:
    """The page of some runs as the content of a file.

    Args:
        folders: of tournaments, of training runs, or of both.

    Raises:
        LeagueError: a folder holds no run, or an unfinished tournament, or is given twice.
    """
    names = _names(folders)
    tournaments: dict[str, dict[str, Any]] = {}
    trained: dict[str, ComparedRun] = {}
    for folder, name_of_run in zip(folders, names, strict=True):
        if (folder / REPORT).is_file():
            tournaments[name_of_run] = _read(folder / REPORT)
        elif (folder / METRICS).is_file():
            config = _read(folder / runs.CONFIG)
            settings = {key: value for key, value in config.items() if key not in _NOT_A_SETTING}
            curve = read_curve(folder, name_of_run)
            trained[name_of_run] = ComparedRun(curve=curve, settings=json.dumps(settings, sort_keys=True))
        else:
            raise LeagueError(f"{folder}: holds neither a finished tournament ({REPORT}) nor a training run ({METRICS})")
    return render(
        "comparison.html.j2",
        title="Comparison of runs",
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
        raise LeagueError(f"{run}/{REPORT}: is not the report of a tournament ({type(error).__name__}: {error})") from error
    columns: list[Column[str]] = [Column("player", name, left=True)]
    for run, ranking in rankings.items():
        columns += _rating_columns(run, ranking)
    players = dict.fromkeys(player for ranking in rankings.values() for player in ranking)
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
        "seeds": table(labels, columns) if trained else None,
        "improvements": _improvements(finals) if len(methods) > 1 else None,
    }


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
    return " and ".join(map(_words, value)) if isinstance(value, list) else "none" if value is None else str(value)

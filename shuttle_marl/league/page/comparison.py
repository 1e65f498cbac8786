"""Page that compares runs: the ratings of tournaments side by side, and training runs over their seeds."""

import dataclasses
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shuttle_marl import runs
from shuttle_marl.league.entrants import LeagueError
from shuttle_marl.league.folder import REPORT
from shuttle_marl.league.page import drawings
from shuttle_marl.league.page.document import (
    Cell,
    Column,
    Html,
    document,
    element,
    name,
    number,
    paragraph,
    section,
    share,
    table,
)
from shuttle_marl.league.page.learning import FIGURES, METRICS, Curve, learning, read_curve
from shuttle_marl.league.seeds import Interval, interquartile_mean, probability_of_improvement

_NOT_A_SETTING = ("seed", "record")
_LESS_IS_BETTER = ("exploitability",)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trained:
    """A training run.

    Attributes:
        curve: its evaluations.
        settings: its configuration without the seed, as text.
    """

    curve: Curve
    settings: str


def compare(folders: Sequence[Path]) -> bytes:
    """The page of some runs, as a file's content.

    Args:
        folders: of tournaments, of training runs, or of both.

    Raises:
        LeagueError: a folder is no run, or one that is not finished as far as it is needed, or is named twice.
    """
    names = _names(folders)
    tournaments: dict[str, dict[str, Any]] = {}
    trained: dict[str, Trained] = {}
    for folder, named in zip(folders, names, strict=True):
        if (folder / REPORT).is_file():
            tournaments[named] = _read(folder / REPORT)
        elif (folder / METRICS).is_file():
            config = _read(folder / runs.CONFIG)
            settings = {key: value for key, value in config.items() if key not in _NOT_A_SETTING}
            trained[named] = Trained(curve=read_curve(folder, named), settings=json.dumps(settings, sort_keys=True))
        else:
            raise LeagueError(f"{folder}: holds neither a finished tournament ({REPORT}) nor a training run ({METRICS})")
    sections: dict[str, list[Html]] = {}
    if tournaments:
        sections["Tournaments"] = _tournaments(tournaments)
    if trained:
        sections |= _training(trained)
    content = [section(heading, *parts) for heading, parts in sections.items()]
    return document("Comparison of runs", " · ".join(names), list(sections), content)


def _names(folders: Sequence[Path]) -> list[str]:
    """Names of folders, without what they have in common."""
    if not folders:
        raise LeagueError("name one run or more")
    whole = [folder.resolve() for folder in folders]
    if len(set(whole)) < len(whole):
        raise LeagueError("a run is named twice")
    shared = Path(os.path.commonpath(whole)) if len(whole) > 1 else whole[0].parent
    return [path.relative_to(shared).as_posix() if path != shared else path.name for path in whole]


def _read(path: Path) -> dict[str, Any]:
    try:
        return runs.read_json(path)
    except runs.RunError as error:
        raise LeagueError(str(error)) from error


def _tournaments(found: Mapping[str, dict[str, Any]]) -> list[Html]:
    """Ratings of all players in all tournaments."""
    rankings: dict[str, dict[str, dict[str, Any]]] = {}
    try:
        for run, report in found.items():
            rankings[run] = {str(row["player"]): row for row in report["ranking"]}
            for row in rankings[run].values():
                for figure in ("rank", "rating", "rating_low", "rating_high", "rating_exact"):
                    row[figure] = math.nan if row[figure] is None else float(row[figure])
    except (KeyError, TypeError, ValueError) as error:
        raise LeagueError(f"{run}/{REPORT}: is not the report of a tournament ({type(error).__name__}: {error})") from error
    players = list(dict.fromkeys(player for ranking in rankings.values() for player in ranking))
    columns = [Column(name="player", left=True)]
    for run in rankings:
        columns += [
            Column(name=f"{run}: rank", falling=False),
            Column(name="rating"),
            Column(name="95 % interval"),
            Column(name="exact"),
        ]
    rows = []
    for player in players:
        cells = [name(player)]
        for ranking in rankings.values():
            if player not in ranking:
                cells += [Cell(shown="")] * 4
                continue
            row = ranking[player]
            low, high = row["rating_low"], row["rating_high"]
            interval = Cell(shown="") if math.isnan(low) else Cell(shown=f"{low:+.0f} to {high:+.0f}", key=high - low)
            cells += [number(row["rank"], ".0f"), number(row["rating"], "+.0f"), interval, number(row["rating_exact"], "+.0f")]
        rows.append(cells)
    note = "Ratings have the mean 0 in each pool, so only differences between players of one tournament can be compared."
    parts = [paragraph(note), table(columns, rows)]
    for run, ranking in rankings.items():
        lines = [
            (player, row["rating"], row["rating_low"], row["rating_high"], row["rating_exact"]) for player, row in ranking.items()
        ]
        parts.append(element("figure", drawings.forest(lines, "Elo"), element("figcaption", f"Ratings of {run}")))
    return parts


def _training(found: Mapping[str, Trained]) -> dict[str, list[Html]]:
    """Curves of training runs, the ends of them over seeds, and which way to train is better."""
    groups: dict[str, list[Trained]] = {}
    for run in found.values():
        groups.setdefault(run.settings, []).append(run)
    labels = _labels(list(groups))
    figures = [figure for figure in FIGURES if any(run.curve.points(figure, "seconds") for run in found.values())]
    columns = [Column(name="way to train", left=True), Column(name="runs")]
    for figure in figures:
        falling = figure not in _LESS_IS_BETTER
        columns += [Column(name=FIGURES[figure], about="interquartile mean", falling=falling), Column(name="95 % interval")]
    rows = []
    ends = {figure: {key: _ends(group, figure) for key, group in groups.items()} for figure in figures}
    for (key, group), label in zip(groups.items(), labels, strict=True):
        cells = [name(label), Cell(shown=str(len(group)), key=len(group))]
        for figure in figures:
            values = ends[figure][key]
            middle = interquartile_mean([values]) if values else Interval(*[math.nan] * 3)
            shown = "" if math.isnan(middle.low) else f"{middle.low:.4f} to {middle.high:.4f}"
            cells += [number(middle.value, ".4f"), Cell(shown=shown, key=None if not shown else middle.high - middle.low)]
        rows.append(cells)
    note = (
        "At the end of the runs: the mean of the middle half over training seeds, with an interval by a bootstrap over seeds. "
        "Runs are of one way to train if their configurations differ in the seed alone."
    )
    parts = [paragraph(note), table(columns, rows)]
    if len(groups) > 1:
        parts.append(_improvements(list(groups), labels, ends))
    return {"Learning": [learning([run.curve for run in found.values()])], "Over training seeds": parts}


def _ends(group: Sequence[Trained], figure: str) -> list[float]:
    return [value for run in group if not math.isnan(value := run.curve.last(figure))]


def _improvements(keys: Sequence[str], labels: Sequence[str], ends: Mapping[str, Mapping[str, Sequence[float]]]) -> Html:
    rows = []
    for figure, found in ends.items():
        sign = -1.0 if figure in _LESS_IS_BETTER else 1.0
        for i, j in itertools.permutations(range(len(keys)), 2):
            ours, theirs = (sign * np.array(found[keys[k]]) for k in (i, j))
            if len(ours) and len(theirs):
                p = probability_of_improvement(ours.tolist(), theirs.tolist())
                shown = "" if math.isnan(p.low) else f"{100 * p.low:.0f} % to {100 * p.high:.0f} %"
                interval = Cell(shown=shown, key=None if not shown else p.high - p.low)
                rows.append([name(labels[i]), name(labels[j]), name(FIGURES[figure]), share(p.value, 0), interval])
    columns = [Column(name=heading, left=True) for heading in ("way to train", "is better than", "by")]
    caption = "Probability that a run of one way is better than a run of the other"
    return table([*columns, Column(name="probability"), Column(name="95 % interval")], rows, caption)


def _labels(settings: Sequence[str]) -> list[str]:
    """The settings in which ways to train differ."""
    found = [json.loads(text) for text in settings]
    keys = sorted({key for each in found for key in each})
    differ = [key for key in keys if len({json.dumps(each.get(key)) for each in found}) > 1]
    if not differ:
        differ = [key for key in ("algorithm", "way", "opponent") if key in keys]
    return [", ".join(f"{key} {_words(each.get(key))}" for key in differ) or "all runs" for each in found]


def _words(value: object) -> str:
    return " and ".join(map(_words, value)) if isinstance(value, list) else "none" if value is None else str(value)

"""Summaries of recorded rallies, compared with real matches."""

import json as json_format
import math
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro

from shuttle_marl import reports as play
from shuttle_marl.base.files import MAX_JSON, read_file, replace_file
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import RALLY_MODEL, HandsTold, RallyModel, hands_told
from shuttle_marl.game.stroke import SHOTS

_HEADINGS: Final = ("", "strokes", "won", "rating", "length", "tempo", "winners", "value", "most played")
_SHOWN: Final = 12


def analysis(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    against: Path | None = None,
    out: Path | None = None,
    model: RallyModel = RALLY_MODEL,
    rallies: int = 20_000,
    hand: HandsTold = (),
    json: bool = False,
) -> None:
    """Summarise the play of every player of a rally log or of annotated matches, with the value of their strokes.

    Args:
        path: a rally log, a folder of them, a stroke table, or a folder with annotated matches.
        against: another of these for comparison, for example real matches; all its players are counted together.
        out: folder for tables of rallies and strokes, as Parquet and CSV files.
        model: game on which values are computed.
        rallies: approximate number of rallies sampled from a log, the same number from each pairing.
        hand: hand of a player, such as kento-momota=left. Default: strokes around the head tell it.
        json: print JSON.
    """
    from shuttle_marl.base import table_files  # noqa: PLC0415
    from shuttle_marl.data import named  # noqa: PLC0415
    from shuttle_marl.reports.summary import players_of  # noqa: PLC0415  these keep --help quick

    if out is not None:
        written = (out / f"{kind}.{suffix}" for kind in ("strokes", "rallies") for suffix in ("parquet", "csv"))
        cli.check_apart(written, [path] if against is None else [path, against])
    tables = model.load_for(path).seats[0].average
    with hands_told(hand):
        strokes = play.strokes_of(path, rallies=rallies)
    valued = play.add_values_of_pairs(strokes, "bc", tables)
    played = dict(zip(*valued.select(["match", "value_game"]).to_pydict().values(), strict=True))
    summaries = {name: play.summarise(valued, name) for name in players_of(valued)[:_SHOWN]}
    if against is not None:
        others = play.add_values_of_pairs(play.strokes_of(against, rallies=rallies), "bc", tables)
        summaries[against.resolve().name] = play.summarise(others)
    if out is not None:
        for kind, table in (("strokes", valued), ("rallies", play.rally_table(valued))):
            table_files.write_parquet(out / f"{kind}.parquet", table)
            replace_file(out / f"{kind}.csv", table_files.csv_bytes(named(table) if kind == "strokes" else table))
    ratings, pairs = _ratings(path), sum(value != tables.hash for value in played.values())
    known = f"{pairs} of {len(played)} matches"
    where = f"of {known} in the game of the two people, with their skill, of the others " if pairs else ""
    cli.show(
        {name: _figures(summary, ratings.get(name)) for name, summary in summaries.items()},
        json,
        cli.table("", _HEADINGS, (_row(name, summary, ratings.get(name)) for name, summary in summaries.items())),
        "won: rallies won, of all players together by the server; rating: Elo rating in the tournament; length: strokes of a "
        "rally; tempo: seconds between two strokes; winners: part of the strokes that ended a rally; value: points added by 100 "
        f"strokes, {where}in the average game {tables.hash[:12]}",
    )


def _ratings(path: Path) -> dict[str, float]:
    from shuttle_marl.league.entrants import REPORT  # noqa: PLC0415

    try:
        ranking = json_format.loads(read_file((path if path.is_dir() else path.parent) / REPORT, MAX_JSON))["ranking"]
        rated = {str(row["player"]): float(row["rating"]) for row in ranking if row["rating"] is not None}
        return rated if len({row["group"] for row in ranking}) == 1 else {}  # those of several groups are not compared
    except (OSError, ValueError, LookupError, TypeError):
        return {}


def _figures(summary: "play.Summary", rating: float | None) -> dict[str, Any]:
    from shuttle_marl.reports.summary import ENDINGS  # noqa: PLC0415

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        return None if isinstance(value, float) and math.isnan(value) else value

    figures = {name: plain(value) for name, value in vars(summary).items()}
    shares = {
        "shots": dict(zip(SHOTS, figures["shots"], strict=True)),
        "endings": dict(zip(ENDINGS, figures["endings"], strict=True)),
    }
    return {**figures, **shares, "rating": rating}


def _row(name: str, summary: "play.Summary", rating: float | None) -> tuple[cli.Figure, ...]:
    def cell(value: float | None, form: str, scale: float = 1) -> str:
        return "" if value is None or math.isnan(value) else format(scale * value, form)

    s, shots = summary, dict(zip(SHOTS, summary.shots.tolist(), strict=True))
    figures = cell(rating, "+.0f"), cell(s.length, ".1f"), cell(s.seconds, ".2f"), cell(float(s.endings[0]), ".0%")
    return name, s.strokes, cell(s.wins, ".1%"), *figures, cell(s.value, ".2f", 100), cli.shares(shots, 2)


COMMANDS: Final = analysis
main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl.analysis", __doc__ or "")

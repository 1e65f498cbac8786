"""Players ranked by the value added by their strokes, with intervals over matches.

    python -m experiments.stroke_value [--data DATA] [--out FOLDER] [--json]

Without ``--data`` the folder in the environment variable SHUTTLESET is used, or the simulated sample of the repository. The value
of a stroke is the change of the probability of winning the rally, computed exactly on the shipped game if both players continue
like the average player (``bc``), relative to the mean stroke of the discipline.
"""

import csv
import dataclasses
import functools
import io
import json as json_format
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from shuttle_marl.analysis import (
    AnalysisError,
    PlayerValue,
    add_values,
    pictures,
    rally_table,
    rank_players,
    strokes_of,
    summarise,
)
from shuttle_marl.analysis.pictures import COLOURS, INK, SHORT_NAMES
from shuttle_marl.analysis.values import LEAST_MATCHES, LEAST_STROKES
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.cli import run
from shuttle_marl.data import anonymised
from shuttle_marl.exact.away import Spread, Values, over
from shuttle_marl.exact.profile import moved
from shuttle_marl.game import load_game
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve

SAMPLE: Final = Path(__file__).parents[1] / "datasets" / "sample" / "strokes.parquet"
_GROUPS: Final = {"MS": "men's singles", "WS": "women's singles"}
_DRAWN: Final = range(9, 14)
"""Range of rally lengths for the picture."""


def stroke_value(
    *,
    data: Path | None = None,
    out: Path | None = None,
    reference: str = "bc",
    model: str = "default",
    least_matches: int = LEAST_MATCHES,
    least_strokes: int = LEAST_STROKES,
    anonymous: bool = False,
    json: bool = False,
) -> None:
    """Rank players by value added per stroke.

    Args:
        data: annotated matches, a Parquet file of `data convert`, or a rally log; default: see above.
        out: folder for pictures and a CSV table.
        reference: policy whose play the values assume.
        model: a shipped model or a model folder.
        least_matches: players with fewer matches are left out.
        least_strokes: players with fewer strokes are left out.
        anonymous: replace the names of players and matches by pseudonyms.
        json: print JSON.
    """
    path = data or Path(os.environ.get("SHUTTLESET") or SAMPLE)
    game = load_game(model)
    policy, strokes = tabulate(resolve(reference, game), game), strokes_of(path)
    strokes = anonymised(strokes) if anonymous else strokes
    valued = add_values(strokes, policy)
    least = {"least_matches": least_matches, "least_strokes": least_strokes}
    players = rank_players(valued, **least, centred=True)
    left_out = len(pc.unique(valued["player"])) - len(players)
    refits = refits_of(game)
    away = (
        over(refits, functools.partial(_values_in, strokes, policy, [p.player for p in players], least))
        if len(refits) > 1
        else None
    )
    groups = groups_of(players)
    if out is not None:
        _write(out, players)
        everyone = {"all players": summarise(valued)} | {
            mine[0].player: summarise(valued, mine[0].player) for mine in groups.values()
        }
        pictures.save(draw_ranking(groups, "Value added by strokes"), out / "ranking.png")
        pictures.save(pictures.landings(everyone, everyone["all players"], "all players"), out / "landings.png")
        pictures.save(pictures.transitions(everyone["all players"], "Replies of all players"), out / "replies.png")
        pictures.save(pictures.shot_mix(everyone), out / "shots.png")
        shown = next((r for r in rally_table(valued).to_pylist() if r["length"] in _DRAWN and _known(valued, r)), None)
        if shown is not None:
            pictures.save(draw_rally(valued, shown["first"], shown["length"]), out / "rally.png")
    if json:
        known = valued["value_added"].null_count
        result = {"data": path.name, "strokes": valued.num_rows, "valued": valued.num_rows - known}
        listed = [
            {
                **dataclasses.asdict(player),
                "away": None if away is None else {name: figure.at(i).as_json() for name, figure in away.items()},
            }
            for i, player in enumerate(players)
        ]
        sys.stdout.write(json_format.dumps({**result, "left_out": left_out, "players": listed}) + "\n")
        return
    spreads = {p.player: away["value"].at(i) for i, p in enumerate(players)} if away is not None else {}
    for text, mine in groups.items():
        _print(text, mine, spreads)
    if left_out:
        sys.stdout.write(f"{left_out} players with fewer than {least_matches} matches or {least_strokes} strokes are left out.\n")


def _values_in(
    strokes: pa.Table, policy: TabulatedPolicy, names: Sequence[str], least: dict[str, int], refit: Game
) -> dict[str, Values]:
    """``[players]`` value added and its part by decisions, valued in a refit of the game."""
    ranked = rank_players(add_values(strokes, moved(policy, refit)), **least, centred=True)
    found = {player.player: player for player in ranked}
    return {part: np.array([getattr(found[name], part) for name in names]) for part in ("value", "decision")}


def _known(valued: pa.Table, rally: dict[str, int]) -> bool:
    rows = valued.slice(rally["first"], rally["length"])
    whole = rows.num_rows == rally["length"] and rows["stroke"][-1].as_py() == rally["length"]
    return whole and not rows["value_added"].null_count


def _write(out: Path, players: Sequence[PlayerValue]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, [f.name for f in dataclasses.fields(PlayerValue)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(dataclasses.asdict(p) for p in players)
    replace_file(out / "players.csv", text.getvalue().encode())


def _print(title: str, players: Sequence[PlayerValue], away: Mapping[str, Spread]) -> None:
    table = Table(title=f"Points won by 100 strokes, {title}", box=SIMPLE_HEAD)
    for heading in ("", "player", "matches", "strokes", "value added", "away", "by decisions"):
        table.add_column(heading, justify="left" if heading == "player" else "right", no_wrap=True)
    for rank, p in enumerate(players, start=1):
        added = f"{100 * p.value:+.2f} ({100 * p.low:+.2f}, {100 * p.high:+.2f})"
        chosen = f"{100 * p.decision:+.2f} ({100 * p.decision_low:+.2f}, {100 * p.decision_high:+.2f})"
        there = away.get(p.player)
        elsewhere = "" if there is None else f"({100 * float(there.low):+.2f}, {100 * float(there.high):+.2f})"
        table.add_row(str(rank), p.player, str(p.matches), f"{p.strokes:,}", added, elsewhere, chosen)
    console = Console(highlight=False, width=max(Console().width, 120))
    console.print(table)
    if away:
        console.print("away: 95 % interval for the same matches in one more refit of the game on resampled matches.")


def groups_of(players: Sequence[PlayerValue]) -> dict[str, list[PlayerValue]]:
    """Players by discipline."""
    return {text: mine for kind, text in _GROUPS.items() if (mine := [p for p in players if p.discipline == kind])}


def draw_ranking(groups: Mapping[str, Sequence[PlayerValue]], title: str) -> Any:
    """Value added by each player and the part due to decisions, with intervals; one panel per group."""
    sizes = [len(players) for players in groups.values()]
    drawn = pictures.figure(8.8, 1.4 + 0.29 * sum(sizes))
    panels = np.atleast_1d(drawn.subplots(len(groups), 1, sharex=True, height_ratios=sizes))
    extreme = 100 * max(max(abs(p.value), abs(p.decision)) for players in groups.values() for p in players)
    for axes, (group, players) in zip(panels, groups.items(), strict=True):
        y = -np.arange(len(players), dtype=np.float64)
        for offset, colour, label, columns in (
            (0.12, COLOURS[0], "value added", ("value", "low", "high")),
            (-0.14, COLOURS[1], "of it, by decisions", ("decision", "decision_low", "decision_high")),
        ):
            mean, low, high = (100 * np.array([getattr(p, name) for p in players]) for name in columns)
            axes.hlines(y + offset, low, high, color=colour, alpha=0.5, linewidth=2)
            axes.plot(mean, y + offset, "o", color=colour, markersize=4, label=label)
        axes.axvline(0, color=INK, linewidth=0.8)
        axes.set(xlim=(-3 * extreme, 3 * extreme), ylim=(y[-1] - 0.7, 0.7))
        axes.set_yticks(y, [f"{p.player}  ({p.matches} matches)" for p in players], fontsize=8)
        axes.set_ylabel(group)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(fontsize=8, frameon=False, loc="lower right")
    panels[-1].set_xlabel("points won by 100 strokes, with 95 % intervals", fontsize=9)
    drawn.suptitle(title, fontsize=11)
    return drawn


def draw_rally(valued: pa.Table, first: int, length: int) -> Any:
    """Draw the server's probability of winning a rally, stroke by stroke.

    Args:
        valued: strokes from :func:`shuttle_marl.analysis.values.add_values`.
        first: row of the first stroke.
        length: number of strokes.

    Raises:
        AnalysisError: the value of a stroke is not known.
    """
    rows = valued.slice(first, length).to_pylist()
    wins = [rows[0]["win_before"]]
    wins += [row["win_after"] if row["player"] == rows[0]["player"] else _flipped(row["win_after"]) for row in rows]
    if any(win is None for win in wins):
        raise AnalysisError(f"the rally from row {first} on has strokes whose value is not known; choose another one")
    drawn = pictures.figure(10.5, 4.6)
    axes = drawn.subplots()
    axes.axhline(50, color=INK, linewidth=0.6, linestyle=":")
    axes.plot(range(len(wins)), 100 * np.array(wins), color=INK, linewidth=1, zorder=2)
    for i, row in enumerate(rows, start=1):
        seat = int(row["player"] != rows[0]["player"])
        axes.plot(i, 100 * wins[i], "o", color=COLOURS[seat], zorder=3)
        area = "" if row["area"] is None else f"\n{AREAS[row['area']]}"
        gain = f"{round(100 * row['value_added']):+d}"
        text = f"{SHORT_NAMES.get(SHOTS[row['shot']], SHOTS[row['shot']])}{area}\n{gain}"
        offset, across, side = (0.0, 8.0), "center", "bottom"
        if i == len(rows):  # beside its point, because the line comes from above or below
            offset, across, side = (9.0, 0.0), "left", "center"
        elif wins[i] < wins[i - 1]:
            offset, side = (0.0, -8.0), "top"
        axes.annotate(
            text,
            (i, 100 * wins[i]),
            offset,
            textcoords="offset points",
            ha=across,
            va=side,
            fontsize=7,
            color=COLOURS[seat],
        )
    axes.set(
        ylim=(-12, 112),
        xlim=(-0.5, len(rows) + 1.2),
        xlabel="stroke",
        ylabel=f"probability that {rows[0]['player']} wins the rally [%]",
    )
    axes.set_xticks(range(1, len(rows) + 1))
    ends = "wins" if rows[-1]["value_added"] > 0 else "loses"
    axes.set_title(
        f"{rows[0]['player']} serves against {rows[0]['opponent']}; {rows[-1]['player']} strikes last and {ends}", fontsize=10
    )
    axes.spines[["top", "right"]].set_visible(False)
    return drawn


def _flipped(probability: float | None) -> float | None:
    return None if probability is None else 1 - probability


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run(stroke_value, prog="experiments.stroke_value", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())

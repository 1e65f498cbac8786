"""Tables of a tournament, from its run folder."""

import functools
import json
import math
from pathlib import Path
from typing import Any, Final

import pyarrow.csv

from docs.tools.markdown import markdown
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.exact import evaluate
from shuttle_marl.exact.odds import of_pair, over
from shuttle_marl.game.shipped import load_game, refits_of
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.league import report
from shuttle_marl.league.ranking import Standing
from shuttle_marl.policy.registry import resolve

SHORT: Final = ("minimax", "ppo:self-play", "ppo", "bc", "random")
"""Players of the short ranking."""
REFERENCE: Final = "bc"


class TableError(ShuttleError):
    """A table that cannot be written, or that does not show the results."""


def _finished(folder: Path) -> tuple[list[Standing], dict[str, Any], dict[str, Any]]:
    """The standings, the configuration and the manifest of a finished run."""
    try:
        config, manifest = (json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in ("config", "manifest"))
        rows: list[dict[str, Any]] = pyarrow.csv.read_csv(folder / "ranking.csv").to_pylist()
    except (OSError, ValueError) as error:
        raise TableError(f"{folder}: no finished run of the league ({error})") from error
    nothing: Any = math.nan
    standings = [Standing(**{name: nothing if value is None else value for name, value in row.items()}) for row in rows]
    return standings, config, manifest


def ranking(folder: Path) -> str:
    """The ranked table of a finished run, and what was played.

    Raises:
        TableError: the folder holds no finished run.
    """
    standings, config, manifest = _finished(folder)
    played = (
        f"{len(standings)} players, {config['matches']:,} matches a pair, seed {config['seed']}, "
        f"game `{manifest['game']['hash'][:12]}`."
    )
    shown = report.ranking(standings)
    headings = tuple(column.heading for column in shown.columns)
    rows = [tuple(cell.text for cell in row) for row in shown.rows]
    return f"{markdown(headings, rows, left=('player',))}\n\n{played}"


def ranking_short(folder: Path) -> str:
    """A few players of a finished run, with the figures that matter most.

    Raises:
        TableError: the folder holds no finished run.
    """
    standings, config, _ = _finished(folder)
    shown = [standing for standing in standings if standing.player in SHORT]
    against = _rallies_won(tuple(s.player for s in shown), config["game"])
    rows = [
        (
            f"`{s.player}`",
            f"{s.rating:+.0f} ({s.rating_low:+.0f} to {s.rating_high:+.0f})",
            f"{100 * s.share:.1f} %",
            *against[s.player],
            f"{s.exploitability:z.3f}",
            f"{s.normalised_score:.3f}",
        )
        for s in shown
    ]
    headings = (
        "player",
        "rating (95 %)",
        "matches won",
        "rallies won against `bc`",
        "in refits (95 %)",
        "exploitability",
        "normalised score",
    )
    return markdown(headings, rows, left=("player",))


@functools.cache
def _rallies_won(players: tuple[str, ...], model: str) -> dict[str, tuple[str, str]]:
    """Exact share of the rallies that each player wins against the average player, both serving equally often: in the game
    itself, and in its refits with the 95 % interval for one more refit."""
    game = load_game(model)
    refits = refits_of(game)
    opponent = tabulate(resolve(REFERENCE, game), game)
    shown = {}
    for name in players:
        table = tabulate(resolve(name, game), game)
        there = over(refits, functools.partial(of_pair, table, opponent))["rally_win"]
        mean, low, high = (f"{100 * min(1.0, max(0.0, float(part))):.1f}" for part in (there.value, there.low, there.high))
        home = evaluate(table, opponent).odds().rally
        shown[name] = (f"{100 * home:.1f} %", f"{mean} % ({low} to {high})")
    return shown

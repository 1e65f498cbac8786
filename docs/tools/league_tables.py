"""Tables of a tournament, from its run folder."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import pyarrow.csv

from docs.tools.markdown import markdown
from shuttle_marl.errors import ShuttleError
from shuttle_marl.exact import evaluate
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.table import tabulate
from shuttle_marl.league.folder import HEADINGS, cells
from shuttle_marl.league.ranking import Standing
from shuttle_marl.policy.registry import resolve

SHORT: Final = ("minimax", "ppo:self-play", "best-response:bc", "ppo", "bc", "random")
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
    return f"{markdown(HEADINGS, [cells(s) for s in standings], left=('player',))}\n\n{played}"


def ranking_short(folder: Path) -> str:
    """A few players of a finished run, with the figures that matter most.

    Raises:
        TableError: the folder holds no finished run.
    """
    standings, config, _ = _finished(folder)
    shown = [standing for standing in standings if standing.player in SHORT]
    against = dict(zip((s.player for s in shown), _rallies_won((s.player for s in shown), config["game"]), strict=True))
    rows = [
        (
            f"`{s.player}`",
            f"{s.rating:+.0f} ({s.rating_low:+.0f} to {s.rating_high:+.0f})",
            f"{100 * s.share:.1f} %",
            f"{100 * against[s.player]:.1f} %",
            f"{s.exploitability:.3f}",
            f"{s.normalised_score:.3f}",
        )
        for s in shown
    ]
    headings = ("player", "rating (95 %)", "matches won", "rallies won against `bc`", "exploitability", "normalised score")
    return markdown(headings, rows, left=("player",))


def _rallies_won(players: Iterable[str], model: str) -> list[float]:
    """Exact probability that each player wins a rally against the average player, both serving equally often."""
    game = load_game(model)
    tables = [tabulate(resolve(name, game), game, name) for name in (REFERENCE, *players)]
    return [evaluate(table, tables[0]).odds().rally for table in tables[1:]]

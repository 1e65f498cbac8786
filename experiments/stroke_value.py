"""Players ranked by the value added by their strokes, with intervals over matches.

    python -m experiments.stroke_value [--data DATA] [--json]

Without ``--data`` the folder in the environment variable SHUTTLESET is used, or the simulated sample of the repository. The value
of a stroke is the change of the probability of winning the rally, computed exactly on the shipped game if both players continue
like the average player (``bc``), relative to the mean stroke of the discipline.
"""

import dataclasses
import functools
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from docs.tools.results import show
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import anonymised
from shuttle_marl.exact.away import Values, over
from shuttle_marl.exact.profile import moved
from shuttle_marl.game import load_game
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports import PlayerValue, add_values, charts, rank_players, strokes_of
from shuttle_marl.reports.charts import INK
from shuttle_marl.reports.value import LEAST_MATCHES, LEAST_STROKES

SAMPLE: Final = Path(__file__).parents[1] / "datasets" / "sample" / "strokes.parquet"
_GROUPS: Final = {"MS": "men's singles", "WS": "women's singles"}


def stroke_value(
    *,
    data: Path | None = None,
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
    refits, names = refits_of(game), [player.player for player in players]
    away = over(refits, functools.partial(_values_in, strokes, policy, names, least)) if len(refits) > 1 else None
    known = valued.num_rows - valued["value_added"].null_count
    result = {"data": path.name, "strokes": valued.num_rows, "valued": known, "left_out": left_out}
    listed = [
        {
            **dataclasses.asdict(player),
            "away": None if away is None else {name: figure.at(i).as_json() for name, figure in away.items()},
        }
        for i, player in enumerate(players)
    ]
    show({**result, "players": listed}, "stroke_value", as_json=json)


def _values_in(
    strokes: pa.Table, policy: TabulatedPolicy, names: Sequence[str], least: dict[str, int], refit: Game
) -> dict[str, Values]:
    """``[players]`` value added and its part by decisions, valued in a refit of the game."""
    ranked = rank_players(add_values(strokes, moved(policy, refit)), **least, centred=True)
    found = {player.player: player for player in ranked}
    return {part: np.array([getattr(found[name], part) for name in names]) for part in ("value", "decision")}


def groups_of(players: Sequence[PlayerValue]) -> dict[str, list[PlayerValue]]:
    """Players by discipline."""
    return {text: mine for kind, text in _GROUPS.items() if (mine := [p for p in players if p.discipline == kind])}


def draw_ranking(groups: Mapping[str, Sequence[PlayerValue]], title: str) -> Any:
    """Value added by each player and the part due to decisions, with intervals; one panel per group."""
    sizes = [len(players) for players in groups.values()]
    drawn = charts.figure(8.8, 1.4 + 0.29 * sum(sizes))
    panels = np.atleast_1d(drawn.subplots(len(groups), 1, sharex=True, height_ratios=sizes))
    extreme = 100 * max(max(abs(p.value), abs(p.decision)) for players in groups.values() for p in players)
    for axes, (group, players) in zip(panels, groups.items(), strict=True):
        y = -np.arange(len(players), dtype=np.float64)
        for offset, colour, label, columns in (
            (0.12, "#127257", "value added", ("value", "low", "high")),
            (-0.14, "#d95f02", "of it, by decisions", ("decision", "decision_low", "decision_high")),
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


main = entry_point(stroke_value, "python -m experiments.stroke_value", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())

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
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from docs.tools.results import show
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.exact.odds import Values, over
from shuttle_marl.exact.profile import moved
from shuttle_marl.game import load_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports import add_values, rank_players, strokes_of

SAMPLE: Final = Path(__file__).parents[1] / "datasets" / "sample" / "strokes.parquet"


def stroke_value(*, data: Path | None = None, model: str = "default", json: bool = False) -> None:
    """Rank players by value added per stroke.

    Args:
        data: annotated matches, a Parquet file of `data convert`, or a rally log; default: see above.
        model: a shipped model or a model folder.
        json: print JSON.
    """
    path = data or Path(os.environ.get("SHUTTLESET") or SAMPLE)
    game = load_game(model)
    policy, strokes = tabulate(resolve("bc", game), game), strokes_of(path)
    valued = add_values(strokes, policy)
    players = rank_players(valued, centred=True)
    left_out = len(pc.unique(valued["player"])) - len(players)
    refits, names = refits_of(game), [player.player for player in players]
    away = over(refits, functools.partial(_values_in, strokes, policy, names)) if len(refits) > 1 else None
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


def _values_in(strokes: pa.Table, policy: TabulatedPolicy, names: Sequence[str], refit: Game) -> dict[str, Values]:
    """``[players]`` value added and its part by decisions, valued in a refit of the game."""
    ranked = rank_players(add_values(strokes, moved(policy, refit)), centred=True)
    found = {player.player: player for player in ranked}
    return {part: np.array([getattr(found[name], part) for name in names]) for part in ("value", "decision")}


main = entry_point(stroke_value, "python -m experiments.stroke_value", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())

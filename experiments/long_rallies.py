"""Do the average players attack less in long rallies and lift less at the end of close games, as people do?

    python -m experiments.long_rallies --data DATA [--split validation] [--model default] [--out FILE] [--json]

Replies to lifts and clears by the number of the stroke, and strokes but serves before and from 19-19 on: of people, of ``bc`` and
``bc:history`` in the states that people were in (expected shares), and in simulated matches of each against itself. ``memory`` is
``bc:history`` without the number of the stroke and the score. Strokes whose four strokes before are unknown are left out.
"""

import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from docs.tools.results import show
from experiments.truth.matches import Strokes, of_splits, ratio_by_match, states_of, strokes_of
from experiments.truth.worlds import World, shipped_world
from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.runs import describe
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import Split, read_matches
from shuttle_marl.data.simulated import simulate
from shuttle_marl.dynamics.features import strokes_before
from shuttle_marl.game.policy import States
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS

SIMULATED: Final = 12
"""Simulated matches for every real one."""
LENGTHS: Final = {"2-18": (2, 18), "19-26": (19, 26), "27-": (27, 9999)}
"""First and last stroke of each part of the table."""
GROUPS: Final = {"attack": ("smash", "half-smash"), "clear": ("clear",), "lift": ("lift",), "high": ("lift", "clear")}
END: Final = 19
"""Points of both players from which a game is at its end."""


def long_rallies(
    *, data: Path, split: Split = "validation", model: str = "default", seed: int = 0, out: Path | None = None, json: bool = False
) -> None:
    """Compare choices in long rallies and at the end of close games with those of the average players.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to compare.
        model: shipped model or model folder that was not fitted to them.
        seed: of the simulated matches.
        out: JSON file for the result.
        json: print JSON.
    """
    world = shipped_world(model)
    people = of_splits(strokes_of(read_matches(data)), split).marked(world.hurry)
    style = people.rows.codes["shot"].astype(np.int64) * N_TECHNIQUES + people.rows.codes["technique"]
    chances = np.full((3, len(people), N_SHOTS * N_TECHNIQUES), np.nan)
    for part, which in world.parts(people):
        chances[:, which] = _chances(part, people.take(which))
    players = dict(zip(("bc", "memory", "history"), chances, strict=True))
    known = ~np.isnan(chances).any(axis=(0, 2))
    sides = {"people": _figures(people, np.eye(N_SHOTS)[people.rows.codes["shot"]], known, seed)}
    for name, policy in (("bc", world.bc), ("history", world.history)):
        if policy is None:
            raise ShuttleError(f"--model {model}: the model has no bc:history; fit it again")
        shots = players[name].reshape(-1, N_SHOTS, N_TECHNIQUES).sum(axis=2)
        matches = SIMULATED * len(people.matches)
        played = strokes_of(simulate(world.game, {"one": policy, "other": policy}, matches=matches, seed=seed))
        sides[f"{name}_there"] = _figures(people, shots, known, seed)
        sides[name] = _figures(played, np.eye(N_SHOTS)[played.rows.codes["shot"]], np.ones(len(played), np.bool_), seed)
    loss = {name: -np.log(p[known, style[known]]) for name, p in players.items()}
    of, match = np.ones(int(known.sum())), people.rows.match[known]
    result: dict[str, Any] = {
        **describe(("numpy",)),
        **{"split": split, "matches": len(people.matches), "strokes": len(of)},
        "log_loss": {name: float(one.mean()) for name, one in loss.items()},
        "gain": {name: ratio_by_match(loss["history"] - loss[name], of, match, seed) for name in ("bc", "memory")},
        "sides": sides,
    }
    show(result, "long_rallies", as_json=json, out=out)


def _chances(world: World, strokes: Strokes) -> F64:
    """``[3, N, 39]`` probabilities of shot types and techniques of each player, NaN where a stroke before is not known."""
    game, rows, player, n = world.game, strokes.rows, world.history, world.game.n_strokes
    assert player is not None
    last = np.stack([strokes_before(rows, name, game.catalogue.by_parts, n) for name in ("incoming", "own")])
    earlier = np.where((last[1] >= 0) & (last[1] < n), np.roll(last, 2, axis=1), np.where(rows.stroke <= 2, n, -1))
    history, state = np.concatenate([last, earlier]).T.astype(np.int32), states_of(game, rows).astype(np.int32)
    score = np.pad(rows.points.astype(np.int16), ((0, 0), (0, 2)))
    known = np.flatnonzero((state >= 0) & (history >= 0).all(axis=1) & (score >= 0).all(axis=1))
    styles = np.eye(N_SHOTS * N_TECHNIQUES)[game.catalogue.shot.astype(np.int64) * N_TECHNIQUES + game.catalogue.technique]
    found = np.full((3, len(rows), N_SHOTS * N_TECHNIQUES), np.nan)
    for part in np.array_split(known, len(known) // 4096 + 1):
        alone = States(game=game, state=state[part], history=history[part])
        seen = States(
            game=game, state=state[part], history=history[part], number=rows.stroke[part].astype(np.int32), score=score[part]
        )
        for i, p in enumerate((world.bc.probabilities(alone), player.probabilities(alone), player.probabilities(seen))):
            found[i, part] = np.maximum(p @ styles, 1e-9)
    return found


def _figures(strokes: Strokes, shots: F64, known: Bools, seed: int) -> dict[str, Any]:
    """Shares of shot types, by ``[N, 13]`` shots or their probabilities, with intervals over matches; and lengths of rallies."""
    rows, number, last = strokes.rows, strokes.number, np.arange(len(strokes)) == strokes.last
    played, incoming = rows.points.min(axis=1) >= 0, rows.codes["incoming_shot"]
    of = {name: [SHOTS.index(shot) for shot in group] for name, group in GROUPS.items()}

    def mean(values: F64, which: Bools) -> dict[str, float]:
        return ratio_by_match(values[which], np.ones(int(which.sum())), rows.match[which], seed)

    found: dict[str, Any] = {"replies": {}, "games": {}}
    for name, (first, final) in LENGTHS.items():
        which = known & np.isin(incoming, of["high"]) & (number >= first) & (number <= final)
        found["replies"][name] = {kind: mean(shots[:, of[kind]].sum(axis=1), which) for kind in ("attack", "clear")}
    for name, close in (("before", rows.points.min(axis=1) < END), ("end", rows.points.min(axis=1) >= END)):
        lifts = mean(shots[:, of["lift"]].sum(axis=1), known & played & close & (number > 1))
        found["games"][name] = {"lift": lifts, "strokes": mean(number.astype(np.float64), last & played & close)}
    return found


main = entry_point(long_rallies, "python -m experiments.long_rallies", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())

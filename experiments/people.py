"""Opponents of ``exploit`` that are people: individuals, fitted to their earlier matches and met in their later ones.

    python -m experiments.people --data FOLDER [--players N] [--refits N] [--json FILE]

The matches of each player are divided by time into two halves. A method is made against the player as fitted to the earlier half,
and judged exactly against refits to the later half, each with the matches of that half drawn again. So a score contains what a
player changes, and what a fit does not know. Players are those with the most strokes, at least two matches in each half.
"""

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro
from rich.console import Console

from experiments.saving import RunFolder, save_results
from experiments.truth.matches import of_splits, strokes_of
from shuttle_marl.base.arrays import I64
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import read_matches
from shuttle_marl.dynamics.choices import MIN_STROKES, player_choices
from shuttle_marl.dynamics.features import Rows, load_hurry
from shuttle_marl.dynamics.fitted import load_models
from shuttle_marl.dynamics.skill import days_of
from shuttle_marl.exact import best_response
from shuttle_marl.exact.odds import best_odds, pair_odds
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.policy.baselines import clones
from shuttle_marl.suite.methods.adapters import TOLERANCE, respond
from shuttle_marl.suite.results import aggregate, arena_of, find_task
from shuttle_marl.suite.task import POINTS, WEIGHT, Arena

_MATCHES: Final = 2  # matches of a player in each half, at least
_STROKES: Final = 1100  # the same of strokes


@dataclasses.dataclass(frozen=True, kw_only=True)
class People(RunFolder):
    """Settings of the experiment."""

    data: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Stroke tables."""
    players: int = 8
    """Players, those with the most strokes."""
    refits: int = 5
    """Refits of the later half in which methods are judged."""

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON."""
        return {"players": self.players, "refits": self.refits}


@dataclasses.dataclass(frozen=True, eq=False)
class Person:
    """A player with the rows of the strokes of each half."""

    name: str
    earlier: I64
    later: I64


def people_of(rows: Rows) -> Iterator[Person]:
    """Players with enough matches and strokes in both halves, most strokes first."""
    days = days_of(rows)
    names, counts = np.unique(rows.striker, return_counts=True)
    for name in names[np.lexsort((names, -counts))]:
        own = np.flatnonzero(rows.striker == name)
        matches = np.unique(rows.match[own])
        ordered = matches[np.argsort(days[matches], kind="stable")]
        half = np.isin(rows.match[own], ordered[: len(ordered) // 2])
        if len(ordered) >= 2 * _MATCHES and min(half.sum(), (~half).sum()) >= _STROKES:
            yield Person(str(name), own[half], own[~half])


def fitted(arena: Arena, rows: Rows, people: list[Person], parts: list[I64]) -> list[TabulatedPolicy]:
    """The policy of each player, fitted to some rows: the average player with shifts, as in the shipped model."""
    game, shipped = arena.game, clones(model_folder("default"))
    choices, _ = player_choices(load_models().choosers, rows.take(np.concatenate(parts)), None, None)
    shaped = {name: getattr(choices, name).reshape(-1, *getattr(shipped, name).shape[1:]) for name in ("style", "area")}
    found = dataclasses.replace(shipped, players=choices.players, **shaped)
    return [
        from_pair_probabilities(game, np.tile(found.pair_probabilities(game, person.name), game.n_blocks)) for person in people
    ]


def redrawn(rows: Rows, part: I64, rng: np.random.Generator) -> I64:
    """Rows of the matches of a part, drawn with replacement until they are enough for a fit."""
    matches, found = np.unique(rows.match[part]), part[:0]
    while len(found) < MIN_STROKES:
        found = np.concatenate([part[rows.match[part] == match] for match in rng.choice(matches, len(matches))])
    return found


def methods_of(arena: Arena, person: TabulatedPolicy, other: TabulatedPolicy) -> dict[str, TabulatedPolicy]:
    """Methods by name; ``other`` is another player, who tells whether it matters who the opponent is."""
    bc = arena.policy("bc")
    return {
        "minimax": arena.policy("minimax"),
        "best-response": best_response(person, tolerance=TOLERANCE).policy,
        "restricted": respond(person, WEIGHT),
        "best-response-bc": respond(bc, 1.0),
        "restricted-other": respond(other, WEIGHT),
    }


def people(config: tyro.conf.OmitArgPrefixes[People], json: Path | None = None) -> None:
    """Play the methods, and write their scores.

    Args:
        config: what is played.
        json: write the results here too.
    """
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    arena = arena_of(find_task("exploit-v1"), "default", "test")
    rows = of_splits(strokes_of(read_matches(config.data)), "train", "validation").rows
    hurry = load_hurry(model_folder("default"))
    rows = rows if hurry is None else hurry.marked(rows)
    those = [person for person, _ in zip(people_of(rows), range(config.players), strict=False)]
    earlier = fitted(arena, rows, those, [person.earlier for person in those])
    rng = np.random.default_rng(0)
    later = [fitted(arena, rows, those, [redrawn(rows, each.later, rng) for each in those]) for _ in range(config.refits)]
    figures: dict[str, dict[str, dict[str, list[float]]]] = {}
    with config.open("people") as folder:
        for i, person in enumerate(those):
            console.print(f"{person.name}: {len(person.earlier):,} strokes, then {len(person.later):,}")
            met = {"earlier": [earlier[i]], "later": [refit[i] for refit in later]}
            players = methods_of(arena, earlier[i], earlier[(i + 1) % len(those)])
            for kind, opponents in met.items():
                won = {
                    name: pair_odds([(player, each) for each in opponents], tolerance=TOLERANCE)
                    for name, player in players.items()
                }
                won["best"] = best_odds(opponents, tolerance=TOLERANCE)
                for name, odds in won.items():
                    score = [POINTS * (a.rally - b.rally) for a, b in zip(odds, won["minimax"], strict=True)]
                    values = [round(float(value), 4) for value in score]
                    figures.setdefault(name, {}).setdefault(f"score, {kind}", {})[person.name] = values
        summary = {
            name: {what: aggregate({"people": by_person}) for what, by_person in each.items()} for name, each in figures.items()
        }
        sizes = {person.name: [len(person.earlier), len(person.later)] for person in those}
        found = {"game": arena.game.hash, "refits": config.refits, "strokes": sizes, "summary": summary, "figures": figures}
        save_results(folder, found, json)


main = entry_point(people, "python -m experiments.people", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())

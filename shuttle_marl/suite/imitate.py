"""The task ``imitate-v0``: predict the next stroke of people in matches that were not seen.

The matches are not part of the package: ``--data`` names a folder of the download, or a Parquet file of ``data convert``.
"""

import dataclasses
import functools
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.files import content_hash
from shuttle_marl.data.schema import Outcome as Ending
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.known import pair_odds
from shuttle_marl.game.tables import Game
from shuttle_marl.suite.frontier import POINTS, exploitabilities
from shuttle_marl.suite.method import Method, called, made
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.task import Arena, Case, Outcome, Setting, Task, required, table_of

_FOLDS = 5
_FLOOR = 1e-6
"""Least probability of a stroke in the log-loss."""
_TIE = 1e-9
"""Greatest difference of probabilities that are equal but for rounding."""


@dataclasses.dataclass(frozen=True, eq=False)
class HumanStrokes:
    """Strokes of people; those with an unknown state, and faults, whose target is unknown, are left out.

    Attributes:
        state: ``[N]`` state of each stroke.
        pair: ``[N]`` legal pair of the state and the nearest stroke of the catalogue.
        player: ``[N]`` name of the striker.
        match: ``[N]`` name of the match.
    """

    game: Game
    state: I64
    pair: I64
    player: list[str]
    match: list[str]

    def take(self, rows: Bools) -> "HumanStrokes":
        """Some of the strokes."""
        numbers = np.flatnonzero(rows).tolist()
        names = ([column[i] for i in numbers] for column in (self.player, self.match))
        return HumanStrokes(self.game, self.state[rows], self.pair[rows], *names)


class ImitateSetting(Setting):
    """Setting of ``imitate``, the argument of a method."""


class Imitate(Task):
    """Predict the next stroke of people: a table of references, because public matches can be memorised.

    Given: the strokes of the training matches. Score: log-loss of the whole stroke (type, area, contact, technique) in unseen
    matches, in nats, mean over matches; also how often the stroke is among the one or three likeliest, and what the policy loses
    to perfect play.
    """

    name = "imitate-v0"
    access = "samples"
    metric = "log_loss"
    unit = "nats"
    zero = "certainty"
    ranked = False
    higher_is_better = False
    seeds = 1
    protocol: ClassVar[str] = "method(setting: ImitateSetting) -> object with fit(strokes: HumanStrokes) -> player"

    def all_cases(self, arena: Arena) -> list[Case]:  # noqa: ARG002
        """One."""
        return [Case(name="matches")]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:  # noqa: ARG002
        """Fit the method to the training matches."""
        train, _ = parts(arena)
        learner = made(method, ImitateSetting(game=arena.game, model=arena.model, seed=seed, folder=folder), self.name, "fit")
        return Outcome(policies={"player": table_of(called(self.name, learner.fit, train), arena.game, self.name)})

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:  # noqa: ARG002
        """The strokes of both parts."""
        return [content_hash(part.pair.tobytes()) for part in parts(arena)]

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Log-loss, top-1 and top-3, rallies lost to perfect play and exploitability in points."""
        player, unseen = required(outcome), parts(arena)[1]
        probability = player.pair_probabilities()
        return {
            "log_loss": float(np.mean(list(self.parts(arena, case, outcome).values()))),
            "top_1": top(1, probability, unseen),
            "top_3": top(3, probability, unseen),
            "regret": POINTS * (0.5 - pair_odds([(player, arena.policy("minimax"))])[0].rally),
            "exploitability": exploitabilities([player], tolerance=TOLERANCE)[0],
        }

    def parts(self, arena: Arena, case: Case, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Log-loss in each unseen match."""
        unseen = parts(arena)[1]
        names, match = np.unique(unseen.match, return_inverse=True)
        loss = -np.log(np.maximum(required(outcome).probability_of(unseen.pair), _FLOOR))
        return dict(zip(names.tolist(), (np.bincount(match, loss) / np.bincount(match)).tolist(), strict=True))


def top(k: int, probability: F64, strokes: HumanStrokes) -> float:
    """Top-k accuracy of ``[P]`` probabilities, from 0 to 1. Ties are broken uniformly at random, in expectation."""
    row, pair = strokes.game.pairs(strokes.state)
    above = probability[pair] - probability[strokes.pair][row]
    likelier, equal = (np.bincount(row, which, len(strokes.state)) for which in (above > _TIE, np.abs(above) <= _TIE))
    return float(np.clip((k - likelier) / equal, 0, 1).mean())


@functools.lru_cache(maxsize=2)
def parts(arena: Arena) -> tuple[HumanStrokes, HumanStrokes]:
    """Strokes to learn from, and those to predict.

    The test split predicts the validation matches of the data set. The dev split predicts a fifth of the training matches, which
    the models of the package, such as ``bc``, have seen.

    Raises:
        SuiteError: no data were named.
        DataError: they cannot be read.
    """
    if arena.data is None:
        raise SuiteError("imitate-v0 needs annotated matches: --data names the folder of `data download`")
    from shuttle_marl.data import read_matches  # noqa: PLC0415
    from shuttle_marl.data.upstream import matches_of  # noqa: PLC0415

    strokes = human_strokes(read_matches(arena.data), arena.game)
    match = np.array(strokes.match)
    train = np.isin(match, list(matches_of("train")))
    unseen = np.isin(match, list(matches_of("validation")))
    if arena.split == "dev":
        names = sorted(matches_of("train"), key=lambda name: content_hash(name.encode()))
        unseen = np.isin(match, names[::_FOLDS])
        train &= ~unseen
    if not (train.any() and unseen.any()):
        raise SuiteError(f"{arena.data}: holds no strokes of the training or of the validation matches")
    return strokes.take(train), strokes.take(unseen)


def human_strokes(table: pa.Table, game: Game) -> HumanStrokes:
    """The strokes of a table of :data:`shuttle_marl.data.schema.STROKES` in the states of a game."""
    from shuttle_marl.analysis.values import nearest_strokes  # noqa: PLC0415
    from shuttle_marl.dynamics.features import states_of, strokes_before  # noqa: PLC0415
    from shuttle_marl.dynamics.hurried import hurry_of, marked_rows  # noqa: PLC0415

    rows = marked_rows(table, hurry_of(game))
    nearest = nearest_strokes(game.catalogue)
    own, incoming = (strokes_before(rows, name, nearest, game.n_strokes) for name in ("own", "incoming"))
    state = states_of(game, rows, own, incoming)
    codes = rows.game_codes
    stroke = nearest[codes["shot"], codes["area"], codes["contact"], codes["technique"]]
    pair = np.where((state >= 0) & (stroke >= 0), game.pair(np.maximum(state, 0), np.maximum(stroke, 0)), -1)
    kept = (pair >= 0) & (rows.outcome != Ending.FAULT)
    player, match = table["player"].to_pylist(), table["match"].to_pylist()
    whole = HumanStrokes(game=game, state=state.astype(np.int64), pair=pair.astype(np.int64), player=player, match=match)
    return whole.take(kept)
